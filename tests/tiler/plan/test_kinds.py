"""The plan reckons with the passes that the cloud may need: those of its kind, where that is known beforehand."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace
from fractions import Fraction

from ptd.matched.cells import CELL_M
from tests.tiler.conftest import MakeCloud, without_sensor
from tests.tiler.plans import changed
from tiler.config import RunConfig
from tiler.core.lattice import Cell, Lattice
from tiler.filter.tasks.tiles import BucketPoints, tiles_of
from tiler.plan import make_plan, plan_json, plan_lines, projected_memory
from tiler.plan.memory import BASE_BYTES, VERTEX_BYTES
from tiler.plan.method import known_kind
from tiler.plan.sizes import tile_m


def test_passes_of_another_kind_are_not_reckoned_with(make_cloud: MakeCloud) -> None:
    bounds = (500_000.0, 5_400_000.0, 500_001.0, 5_400_001.0)
    cloud = str(make_cloud(point_format=0, edit=without_sensor))
    unknown, laser, matched = (
        make_plan(
            [cloud],
            RunConfig(kind=kind, bounds=bounds, tile_size=Fraction(512), in_process=True),
        )
        for kind in (None, "als", "dim")
    )
    assert (laser.method.kind, laser.method.halo_m) == ("lidar", 229.0)
    assert (matched.method.kind, matched.method.halo_m) == ("dim", 678.0)
    assert (unknown.method.kind, unknown.method.halo_m) == (None, 678.0)
    assert unknown.margin == matched.margin > laser.margin
    assert [step.name for step in matched.method.steps] == [
        "survey",
        "cells",
        "objects",
        "inner-objects",
        "canopy",
        "surface",
    ]
    assert set(laser.method.steps) & set(matched.method.steps) == {laser.method.passes[0]}
    assert plan_json(unknown)["halo_by_kind_m"] == {"lidar": 229.0, "dim": 678.0}
    assert plan_json(laser)["halo_by_kind_m"] == {}

    words = {
        kind: "\n".join(plan_lines(plan)) for kind, plan in ((None, unknown), ("als", laser))
    }
    assert (
        "229 m of halo (3.59 times the work) for a LiDAR cloud, or 678 m of halo" in words[None]
    )
    assert "some of them only for some clouds" in words[None]
    assert "(229 m are enough with --kind als)" in " ".join(words[None].split())
    assert "678 m" not in words["als"]
    assert "some of them only for some clouds" not in words["als"]

    statistics = {"survey": {"survey": {"kind": "lidar"}}}
    kind = known_kind(unknown.config, statistics, unknown.inputs.evidence)
    known = changed(unknown, statistics=statistics, kind=kind)
    assert known.method.steps == laser.method.steps
    assert known.margin == laser.margin


def test_rasters_of_windows_take_room_over_voids(make_cloud: MakeCloud) -> None:
    """Two buckets 2 km apart: one tile as points alone count, but the raster between them does not fit."""
    plan = make_plan(
        [str(make_cloud())], RunConfig(kind="dim", memory=16 << 30, in_process=True)
    )
    plan = changed(plan, tile=Fraction(4000))
    surface = next(step for step in plan.method.passes if step.name == "surface")
    apart = round(2000 / plan.grid.bucket_m)
    records = {Cell(0, 0): BucketPoints(9, 0, 9), Cell(apart, apart): BucketPoints(9, 0, 9)}
    cells = (2000 / CELL_M) ** 2
    small = changed(plan, tile_memory=BASE_BYTES + round(cells * VERTEX_BYTES))
    assert len(list(tiles_of(small, records, surface))) == 2
    assert (
        len(
            list(
                tiles_of(
                    changed(plan, tile_memory=4 * small.method.tile_memory), records, surface
                )
            )
        )
        == 1
    )
    flat = copy(surface.pass_)
    object.__setattr__(flat, "raster_cell_m", 0.0)
    without = replace(surface, pass_=flat)
    assert len(list(tiles_of(small, records, without))) == 1


def test_passes_on_every_point_make_no_tile_smaller(make_cloud: MakeCloud) -> None:
    """At 700 points/m2 the survey's tiles are divided; those of passes with hundreds of metres around stay 512 m."""
    plan = make_plan(
        [str(make_cloud())], RunConfig(kind="dim", memory=3 << 29, in_process=True)
    )
    meta = replace(plan.grid.meta, bucket=Lattice(plan.frame.counts(Fraction(16))))
    plan, steps = changed(plan, meta=meta), {step.name: step for step in plan.method.passes}
    assert tile_m(plan.resources.memory, 700.0, 1.0, plan.method.steps, meta) == 512
    dense = changed(plan, points=20_000_000, covered_m2=2e4, tile=Fraction(512))
    assert projected_memory(dense)["filter"] <= plan.resources.memory
    side = math.ceil(512 / plan.grid.bucket_m)
    n = round(700 * plan.grid.bucket_m**2)
    records = {
        Cell(ix, iy): BucketPoints(n, 0, n // 700) for ix in range(side) for iy in range(side)
    }
    assert len(list(tiles_of(dense, records, steps["survey"]))) > 4
    assert len(list(tiles_of(dense, records, steps["objects"]))) == 1
