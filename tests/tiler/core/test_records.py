"""Records of tasks are the JSON that the store keeps, and digests depend on values alone."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import pytest

from tests.scenes.records import bucket_record, spool_record
from tiler.core.lattice import Bounds, Cell
from tiler.core.records import (
    NOT_IN_DIGEST,
    BucketRecord,
    SpoolRecord,
    TileRecord,
    buckets_in,
    digest_of,
)
from tiler.errors import StoreError


def test_a_record_survives_the_store() -> None:
    piece = spool_record(
        read=5, dropped={"withheld": 1}, buckets=[[0, -1, 4]], bounds=[0, 0, 2, 2], z=[3, 4]
    )
    assert SpoolRecord.of(json.loads(json.dumps(piece.to_json()))) == piece
    bucket = bucket_record(cell=[0, -1], n=4, strays=[[0, 7, 1.5, 2.5, 9.0]])
    assert buckets_in(json.loads(json.dumps({"buckets": [bucket.to_json()]}))) == [bucket]


def test_keys_have_the_order_of_the_fields() -> None:
    assert list(bucket_record().to_json()) == [
        "cell", "n", "n_candidates", "n_participating", "n_measured", "duplicates", "z_participating", "classes",
        "strays", "bounds", "z",
    ]  # fmt: skip


def test_further_keys_are_ignored_and_missing_ones_are_an_error_of_the_store() -> None:
    stored = bucket_record(n=3).to_json()
    assert BucketRecord.of({**stored, "later": 1}).n == 3
    del stored["n_candidates"]
    with pytest.raises(StoreError, match="a record of the store has no 'n_candidates'"):
        BucketRecord.of(stored)


def test_a_field_that_may_be_missing_has_no_key_if_it_is_none() -> None:
    tile = TileRecord(
        points=1, ground=1, low_noise=0, unclassified=0, kept=0, marked=0, tries=1, halo=5, window_points=2,
        core_area=9, window_area=16, cells=[[0, 0]], labels="digest", partial={}, stats={},
    )  # fmt: skip
    assert not {"elected", "elected_points"} & tile.to_json().keys()
    assert TileRecord.of(tile.to_json()) == tile
    elected = replace(tile, elected="another", elected_points=[1])
    assert TileRecord.of(elected.to_json()) == elected


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
