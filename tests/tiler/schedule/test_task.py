"""The digest of a task: the same for the same work, another one for whatever changes what comes out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import pytest

from tiler.core.lattice import Bounds, Cell
from tiler.schedule import NOT_IN_DIGEST, digest_of


@dataclass(frozen=True)
class Work:
    path: str
    cells: tuple[Cell, ...]
    bounds: Bounds
    size: Fraction = Fraction(1, 3)
    held_bytes: int = field(default=0, metadata=NOT_IN_DIGEST)


WORK = Work("s3://anna:secret@bucket/a.laz", (Cell(1, -2),), Bounds(0, 0, 5, 5))


@pytest.mark.parametrize(
    "other",
    [
        {"cells": (Cell(1, -3),)},
        {"bounds": Bounds(0, 0, 5, 6)},
        {"size": Fraction(1, 4)},
        {"path": "s3://bucket/b.laz"},
    ],
)
def test_each_field_of_the_work_has_a_say(other: dict[str, object]) -> None:
    assert digest_of(replace(WORK, **other)) != digest_of(WORK)


def test_how_it_is_done_and_who_may_read_it_have_none() -> None:
    assert digest_of(replace(WORK, held_bytes=7)) == digest_of(WORK)
    assert digest_of(replace(WORK, path="s3://anna:other@bucket/a.laz")) == digest_of(WORK)


def test_what_has_no_place_in_a_digest_is_refused() -> None:
    with pytest.raises(TypeError, match="PosixPath has no place in the arguments of a task"):
        digest_of(Path("a"))
