"""Tiles of passes on candidates: as large as fit, as many as there are workers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

from tests.tiler.plans import changed
from tiler.config import RunConfig
from tiler.core.lattice import Cell
from tiler.filter.tasks.tiles import BucketPoints, _bytes, tiles_of
from tiler.plan import Plan, make_plan
from tiler.plan.memory import JOINED_BYTES

pytestmark = pytest.mark.processes

EACH = 40_000
"""Candidates of a bucket."""

Records = dict[Cell, BucketPoints]


def buckets(columns: range, rows: range) -> Records:
    return {Cell(ix, iy): BucketPoints(100_000, EACH) for ix in columns for iy in rows}


@pytest.fixture
def plan(make_cloud: Callable[..., Path]) -> Plan:
    """Of laser scans, with buckets of 128 m."""
    plan = make_plan(
        [str(make_cloud())], RunConfig(kind="als", in_process=True, workers=1, memory=8 << 30)
    )
    bucket = replace(plan.buckets, size=plan.frame.counts(Fraction(128)))
    return changed(plan, meta=replace(plan.grid.meta, bucket=bucket), tile=Fraction(512))


def test_as_many_as_workers_in_halves_of_about_half(plan: Plan) -> None:
    records, roofs = buckets(range(-3, 9), range(5, 13)), plan.method.passes[4]
    # of which eight would hold too few
    for workers, number in ((1, 1), (2, 2), (3, 4), (8, 4)):
        tiles = list(tiles_of(changed(plan, tile_workers=workers), records, roofs))
        assert len(tiles) == number
        assert sorted(cell for tile in tiles for cell in tile.cells) == sorted(records)
        assert all(0.3 < len(tile.cells) * number / len(records) < 2 for tile in tiles)
        assert len({tile.name for tile in tiles}) == number


@pytest.mark.parametrize(("memory", "lines"), [(8 << 30, {0, 7}), (2 << 28, {0, 4, 8})])
def test_parts_for_workers_are_more_equal_than_those_for_memory(
    plan: Plan, memory: int, lines: set[int]
) -> None:
    """Of 14 columns the line 8, divided by two most often, leaves 57 % of the points in the west."""
    records, roofs = buckets(range(14), range(8)), plan.method.passes[4]
    tiles = tiles_of(changed(plan, tile_workers=2, tile_memory=memory), records, roofs)
    assert {tile.cells[0].ix for tile in tiles} == lines


def test_zero_is_the_roundest_line(plan: Plan) -> None:
    records, roofs = buckets(range(-7, 8), range(4)), plan.method.passes[4]
    tiles = tiles_of(changed(plan, tile_workers=1, tile_memory=2 << 28), records, roofs)
    assert 0 in {tile.cells[0].ix for tile in tiles}


def test_windows_fit_the_memory_and_a_survey_that_grows_keeps_its_tiles(plan: Plan) -> None:
    records, roofs = buckets(range(64), range(64)), plan.method.passes[4]
    tiles = list(tiles_of(plan, records, roofs))
    assert len(tiles) == 60
    assert all(
        _bytes(plan, records, roofs, tile.cells, tile.halo) <= JOINED_BYTES for tile in tiles
    )
    grown = list(tiles_of(plan, records | buckets(range(64, 70), range(64)), roofs))
    assert len({tile.cells for tile in tiles} & {tile.cells for tile in grown}) >= 45


def test_a_size_that_was_asked_for_and_passes_on_all_points_keep_the_lattice(
    plan: Plan,
) -> None:
    records, (survey, seeds, *_) = buckets(range(8), range(8)), plan.method.passes
    assert len(list(tiles_of(plan, records, seeds))) == 1
    assert len(list(tiles_of(plan, records, survey))) == 4
    assert len(list(tiles_of(changed(plan, tile_workers=0), records, seeds))) == 4
