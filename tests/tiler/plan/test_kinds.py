"""The plan reckons with the passes that the cloud may need: those of its kind, where that is known beforehand."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

from tests.tiler.conftest import MakeCloud
from tiler.config import RunConfig
from tiler.plan import make_plan, plan_json, plan_lines


def test_passes_of_another_kind_are_not_reckoned_with(make_cloud: MakeCloud) -> None:
    bounds = (500_000.0, 5_400_000.0, 500_001.0, 5_400_001.0)
    unknown, laser, matched = (
        make_plan(
            [str(make_cloud())], RunConfig(kind=kind, bounds=bounds, tile_size=Fraction(512), in_process=True)
        )
        for kind in (None, "als", "dim")
    )
    assert (laser.kind, laser.halo_m) == ("lidar", 229.0)
    assert (matched.kind, matched.halo_m) == ("dim", 356.0)
    assert (unknown.kind, unknown.halo_m) == (None, 356.0)
    assert unknown.margin == matched.margin > laser.margin
    assert [step.name for step in matched.steps] == ["survey", "cells", "objects", "inner-objects", "surface"]
    assert set(laser.steps) & set(matched.steps) == {laser.passes[0]}
    assert plan_json(unknown)["halo_by_kind_m"] == {"lidar": 229.0, "dim": 356.0}
    assert plan_json(laser)["halo_by_kind_m"] == {}

    words = {kind: "\n".join(plan_lines(plan)) for kind, plan in ((None, unknown), ("als", laser))}
    assert "229 m of halo, overlap work 3.59 for a laser scan, or 356 m of halo" in words[None]
    assert "not all of them apply" in words[None]
    assert "(229 m are enough with --kind als)" in words[None]
    assert "356 m" not in words["als"]
    assert "not all of them apply" not in words["als"]

    known = replace(unknown, statistics={"survey": {"survey": {"kind": "lidar"}}})
    assert known.steps == laser.steps
    assert known.margin == laser.margin
