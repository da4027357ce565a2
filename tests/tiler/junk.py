"""JSON documents with something else wherever something is."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

JUNK: list[Any] = [
    None, True, -1, 1.5, float("nan"), 10**400, "x", "a\nb", [], [1], [[]], [[[1, 2]]], {}, {"a": 1}, {"type": "Point"},
]  # fmt: skip


def spoilt(document: Any) -> Iterator[Any]:
    """The document with each of its parts replaced by each kind of junk, and left out."""

    def parts(value: Any, path: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
        items = (
            value.items()
            if isinstance(value, dict)
            else enumerate(value)
            if isinstance(value, list)
            else ()
        )
        for name, item in items:
            yield (*path, name)
            yield from parts(item, (*path, name))

    for path in parts(document, ()):
        for junk in (*JUNK, parts):  # the function stands for what is left out
            changed = copy.deepcopy(document)
            place = changed
            for name in path[:-1]:
                place = place[name]
            if junk is parts:
                del place[path[-1]]
            else:
                place[path[-1]] = junk
            yield changed
