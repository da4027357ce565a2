"""Matched clouds: what `auto` finds in them, and that neither tiles nor the order of points nor the frame show."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import ptd
from ptd.frame import Scale
from ptd.ground.labelling import GROUND, LOW_NOISE, UNCLASSIFIED
from ptd.matched import bent_hull, canopy, last_look, objects, passes, surface
from ptd.methods.auto.method import Auto
from ptd.passes import Points
from tests.ptd.tiling import classify_tiled
from tests.scenes.village import counts, short_sighted_surface, village


def test_a_cloud_in_feet_has_the_labels_of_one_in_metres() -> None:
    """US survey feet: all but points at the very limit, as heights and slopes are whole counts of either unit."""
    xyz, _ = village()
    foot = Fraction(1200, 3937)
    feet = Points(np.rint(1000 * xyz.T / float(foot)).astype(np.int32))
    found = [
        classify_tiled(points, scale, Auto(), None, kind="dim")[0]
        for points, scale in ((counts(xyz), Scale()), (feet, Scale(foot / 1000, foot / 1000)))
    ]
    assert {int(GROUND), int(UNCLASSIFIED), int(LOW_NOISE)} <= set(found[0].tolist())
    assert (found[0] != found[1]).mean() < 1e-3


def test_walls_roofs_crowns_and_blunders_are_no_ground() -> None:
    xyz, truth = village()
    found = ptd.classify(xyz, "auto", kind="dim").classification
    assert (found[truth == 2] == 2).mean() > 0.97
    assert (found[truth == 6] == 2).mean() < 0.01
    assert (found[truth == 5] == 2).mean() < 0.05
    assert (found[truth == 7] == 7).mean() > 0.9


@pytest.fixture
def short_sighted(monkeypatch: pytest.MonkeyPatch) -> type[Auto]:
    """`auto` whose matched branch sees less far, so that tiles of a small scene have neighbours beyond their reach."""
    short_sighted_surface(monkeypatch)
    monkeypatch.setattr(objects, "MAX_WIDTH_M", 14.0)
    monkeypatch.setattr(objects, "TERRAIN_M", 10.0)
    seen = max(
        size_m
        * (objects.reach_cells(size_m) + replace(bent_hull.STIFF, cell_m=size_m).reach + 1)
        for size_m in passes.CELL_SIZES_M
    )
    later = [replace(step, influence_radius_m=seen) for step in passes.PASSES[1:3]]
    beyond = max(
        size_m * (surface.reach_cells(size_m) + canopy.reach_cells(size_m) + 3)
        for size_m in passes.CELL_SIZES_M
    )
    later.append(replace(passes.PASSES[3], influence_radius_m=beyond))
    monkeypatch.setattr(objects, "MAX_ISLAND_WIDTH_M", 6.0)
    monkeypatch.setattr(objects, "VIEW_M", 8.0)
    reach_m = max(
        size_m
        * (
            surface.reach_cells(size_m)
            + objects.island_reach_cells(size_m)
            + last_look.reach_cells(size_m)
        )
        for size_m in passes.CELL_SIZES_M
    )
    last = replace(passes.PASSES[4], influence_radius_m=reach_m)

    class ShortSighted(Auto):
        passes = (Auto().passes[0], passes.PASSES[0], *later, last)

    return ShortSighted


@pytest.mark.parametrize(("tile_m", "every"), [(20.0, 1), (37.0, 1), (37.0, 9)])
def test_tiles_do_not_show(short_sighted: type[Auto], tile_m: float, every: int) -> None:
    points = counts(village()[0][::every] + [0.0, 0.0, 30.0])
    whole, marks, state = classify_tiled(points, Scale(), short_sighted(), None, kind="dim")
    assert not marks.any()
    assert 0.3 < (whole == 2).mean() < 0.95
    labels, marks, tiled = classify_tiled(points, Scale(), short_sighted(), tile_m, kind="dim")
    assert not marks.any()
    assert tiled == state
    assert np.array_equal(labels, whole)


def test_the_order_of_points_and_the_frame_change_nothing() -> None:
    xyz, _ = village()
    order = np.random.default_rng(0).permutation(len(xyz))
    found = ptd.classify(xyz, "auto", kind="dim").classification
    assert np.array_equal(
        ptd.classify(xyz[order], "auto", kind="dim").classification, found[order]
    )
    moved = ptd.classify(xyz + [640_000.0, -64_000.0, 0.0], "auto", kind="dim").classification
    assert np.array_equal(moved, found)


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_next_to_no_points_give_no_error(n: int) -> None:
    xyz = np.array([[5.0, 5.0, 1.0], [8.0, 5.0, 1.0], [5.0, 9.0, 1.0]])[:n]
    assert len(ptd.classify(xyz.reshape(-1, 3), "auto", kind="dim").classification) == n


def test_a_clump_that_hulls_cut_through_is_no_ground() -> None:
    """Forty points in two cells: no cell remains for the surface."""
    xyz = np.random.default_rng(1).uniform(0, 1, (40, 3)) * (2.0, 1.0, 0.5)
    labels = ptd.classify(xyz, "auto", kind="dim").classification
    assert (labels == 1).all()
