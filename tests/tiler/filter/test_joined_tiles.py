"""Tiles of passes on one point per cell: as large as fit, as many as there are workers."""

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
from tiler.plan import Plan, PlannedPass, make_plan
from tiler.plan.estimates import overlap_of, projected_memory
from tiler.plan.memory import BASE_BYTES, JOINED_BYTES, elected_peak

pytestmark = pytest.mark.processes

EACH = 40_000
"""Candidates of a bucket."""

Records = dict[Cell, BucketPoints]


def buckets(columns: range, rows: range) -> Records:
    return {Cell(ix, iy): BucketPoints(100_000, EACH, 128**2) for ix in columns for iy in rows}


def planned(cloud: Path, kind: str, method: str = "auto") -> Plan:
    """Plan with buckets of 128 m."""
    config = RunConfig(kind=kind, method=method, in_process=True, workers=1, memory=8 << 30)
    plan = make_plan([str(cloud)], config)
    bucket = replace(plan.buckets, size=plan.frame.counts(Fraction(128)))
    return changed(plan, meta=replace(plan.grid.meta, bucket=bucket), tile=Fraction(512))


@pytest.fixture
def plan(make_cloud: Callable[..., Path]) -> Plan:
    return planned(make_cloud(), "als")


@pytest.fixture
def matched(make_cloud: Callable[..., Path]) -> Plan:
    return planned(make_cloud(), "dim")


def pass_of(plan: Plan, name: str) -> PlannedPass:
    return next(step for step in plan.method.passes if step.name == name)


def work_of(plan: Plan, records: Records, step: PlannedPass) -> float:
    """Ratio of the area of all windows, cut at the survey, to the area of the survey."""
    survey = plan.buckets.hull(records)
    windows = (
        plan.buckets.hull(tile.cells).pad(tile.halo) for tile in tiles_of(plan, records, step)
    )
    return sum(window.intersection(survey).area() for window in windows) / survey.area()


def test_as_many_as_workers_in_halves_of_about_half(plan: Plan) -> None:
    records, roofs = buckets(range(-3, 9), range(5, 13)), pass_of(plan, "roofs")
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
    records, roofs = buckets(range(14), range(8)), pass_of(plan, "roofs")
    tiles = tiles_of(changed(plan, tile_workers=2, tile_memory=memory), records, roofs)
    assert {tile.cells[0].ix for tile in tiles} == lines


def test_zero_is_the_roundest_line(plan: Plan) -> None:
    records, roofs = buckets(range(-7, 8), range(4)), pass_of(plan, "roofs")
    tiles = tiles_of(changed(plan, tile_workers=1, tile_memory=2 << 28), records, roofs)
    assert 0 in {tile.cells[0].ix for tile in tiles}


def test_windows_fit_the_memory_and_a_survey_that_grows_keeps_its_tiles(plan: Plan) -> None:
    records, roofs = buckets(range(64), range(64)), pass_of(plan, "roofs")
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
    records, (survey, noise, seeds, *_) = buckets(range(8), range(8)), plan.method.passes
    assert len(list(tiles_of(plan, records, seeds))) == 1
    assert len(list(tiles_of(plan, records, survey))) == 4
    assert len(list(tiles_of(plan, records, noise))) == 4
    assert len(list(tiles_of(changed(plan, tile_workers=0), records, seeds))) == 4


def test_passes_on_elected_points_join_tiles_unless_the_user_chose_a_size(
    matched: Plan,
) -> None:
    records, canopy = buckets(range(12), range(16)), pass_of(matched, "canopy")
    assert len(list(tiles_of(matched, records, canopy))) == 1
    assert len(list(tiles_of(matched, records, pass_of(matched, "cells")))) == 12
    chosen = changed(matched, tile_workers=0)
    assert len(list(tiles_of(chosen, records, canopy))) == 12
    assert work_of(chosen, records, canopy) > 5


@pytest.mark.parametrize("workers", [1, 2, 8, 64])
@pytest.mark.parametrize(("columns", "rows"), [(12, 16), (24, 32), (48, 48)])
def test_wide_halos_do_not_multiply_the_work_for_workers(
    columns: int, rows: int, workers: int, matched: Plan
) -> None:
    """A tile is halved for another worker only if that ends the pass earlier."""
    records, canopy = buckets(range(columns), range(rows)), pass_of(matched, "canopy")
    plan = changed(matched, tile_workers=workers)
    tiles = list(tiles_of(plan, records, canopy))
    assert sorted(cell for tile in tiles for cell in tile.cells) == sorted(records)
    # Tiles of about 2.4 halos are not halved, as their windows would keep more than four fifths.
    assert len(tiles) >= min(workers, columns * rows // 192)
    assert work_of(plan, records, canopy) < 4.5


def test_large_surveys_are_cut_so_that_windows_fit(matched: Plan) -> None:
    records, canopy = buckets(range(64), range(64)), pass_of(matched, "canopy")
    for memory in (2 << 30, 4 << 30):
        plan = changed(matched, tile_memory=memory)
        tiles = list(tiles_of(plan, records, canopy))
        assert len(tiles) > 4
        assert all(
            _bytes(plan, records, canopy, tile.cells, tile.halo) <= memory for tile in tiles
        )
    assert work_of(plan, records, canopy) < 3


def test_memory_follows_the_halo(plan: Plan, matched: Plan) -> None:
    """Passes on candidates keep to 1 GiB; a tile of 4.8 halos gets the memory of its window, as far as it is there."""
    canopy, objects = pass_of(matched, "canopy"), pass_of(matched, "objects")
    assert plan.tile_memory_of(pass_of(plan, "roofs")) == JOINED_BYTES
    window_m2 = (2 + 2 + 2 * 2**0.5) ** 2 * canopy.halo_m**2
    much = changed(matched, tile_memory=64 << 30)
    assert much.tile_memory_of(canopy) == pytest.approx(BASE_BYTES + 260 * window_m2)
    assert JOINED_BYTES < matched.tile_memory_of(objects) < matched.tile_memory_of(canopy)
    for memory in (1 << 29, 5 << 28, 4 << 30):
        joined = changed(matched, tile_memory=memory)
        of_chosen_size = changed(joined, tile_workers=0)
        for changed_plan in (joined, of_chosen_size):
            size = changed_plan.tile_memory_of(canopy)
            assert BASE_BYTES < size < elected_peak(size) <= memory


@pytest.mark.parametrize(("memory", "workers"), [(8 << 30, 1), (8 << 30, 2), (2 << 30, 1)])
def test_the_plan_estimates_the_work_of_joined_tiles(
    memory: int, workers: int, matched: Plan
) -> None:
    records, canopy = buckets(range(24), range(24)), pass_of(matched, "canopy")
    bounds = matched.buckets.hull(records)
    plan = changed(
        matched,
        tile_memory=memory,
        tile_workers=workers,
        extent=bounds,
        points=len(records) * 100_000,
        covered_m2=len(records) * 128.0**2,
    )
    assert overlap_of(plan, [canopy]) == pytest.approx(work_of(plan, records, canopy), rel=0.3)


@pytest.mark.parametrize("method", ["ridge2016", "chen2023"])
def test_wider_halos_stay_within_the_projected_memory(
    method: str, make_cloud: Callable[..., Path]
) -> None:
    """Published methods on photogrammetric clouds have passes on elected points with variable halos."""
    records = buckets(range(48), range(48))
    plan = planned(make_cloud(), "dim", method)
    plan = changed(
        plan,
        extent=plan.buckets.hull(records),
        points=len(records) * 100_000,
        covered_m2=len(records) * 128.0**2,
    )
    steps = [step for step in plan.method.steps if step.pass_.elected]
    assert any(step.pass_.influence_radius_m is None for step in steps)
    projected = projected_memory(plan)["filter"]
    assert projected <= plan.method.tile_memory
    for step in steps:
        for tile in tiles_of(plan, records, step):
            assert _bytes(plan, records, step, tile.cells, tile.max_halo) <= projected
