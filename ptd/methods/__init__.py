"""The table of methods."""

from __future__ import annotations

from typing import Any

from ptd.methods import auto, chen2023, classic, dong2017, dong2018, rarefy, ridge2016
from ptd.params import parse
from ptd.passes import Method

METHODS: dict[str, Method] = {
    m.name: m
    for m in (
        auto.METHOD,
        classic.METHOD,
        chen2023.METHOD,
        dong2017.METHOD,
        dong2018.METHOD,
        rarefy.METHOD,
        ridge2016.METHOD,
    )
}


def make_params(name: str, texts: dict[str, str] | None = None) -> Any:
    """Parameters of a method from ``name=value`` texts; raises ValueError with one line."""
    if name not in METHODS:
        raise ValueError(f"no method {name!r}; there are {', '.join(METHODS)}")
    return parse(METHODS[name].params, texts or {})
