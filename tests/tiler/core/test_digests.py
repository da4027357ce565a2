"""The digest of a task: equal for the same work, different for anything that changes the result."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import pytest

from tiler.core.digests import NOT_IN_DIGEST, digest_of
from tiler.core.lattice import Bounds, Cell


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
def test_each_field_of_the_work_changes_the_digest(other: dict[str, object]) -> None:
    assert digest_of(replace(WORK, **other)) != digest_of(WORK)


def test_fields_about_the_way_of_working_and_passwords_do_not_change_the_digest() -> None:
    assert digest_of(replace(WORK, held_bytes=7)) == digest_of(WORK)
    assert digest_of(replace(WORK, path="s3://anna:other@bucket/a.laz")) == digest_of(WORK)


def test_values_that_have_no_digest_are_refused() -> None:
    with pytest.raises(
        TypeError, match=r"(Posix|Windows)Path is not allowed in the arguments of a task"
    ):
        digest_of(Path("a"))
