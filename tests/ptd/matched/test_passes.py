"""What the passes of matched clouds hand to each other, when they apply, and what they start from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ptd.frame import CellLattice, Scale, Window
from ptd.ground.labelling import GROUND, LOW_NOISE, UNCLASSIFIED
from ptd.ground.noise_sums import Roughness
from ptd.matched.cells import cell_heights, raster_of
from ptd.matched.ground_model import Ground, RasterPosition, _heights_above
from ptd.matched.passes import PASSES, CellModel, ObjectPass
from ptd.matched.step import OBJECT, Codes, noise_m
from ptd.matched.surface import Surface
from ptd.matched.survey import MAX_CELL_SIGMA_M, MIN_CELL_SIGMA_M, ReturnStatistics, figures
from ptd.methods.auto.method import Auto, decided
from ptd.passes import Points
from ptd.places import PLACE_M, TREES, everywhere, name_of, value_at
from tests.ptd.alike import alike

MM = Scale()


def survey(
    smoothest_m: float | None, sigma_m: float | None = None, kind: str | None = "dim"
) -> dict[str, Any]:
    found = Roughness(12.0, 0.05, 100, smoothest_m)
    run = {"rgb": True, "sigma_m": sigma_m, "kind": kind}
    density, sigma, cell_sigma = figures(found, run)
    table = alike(density, sigma, cell_sigma)
    return {
        "survey": decided(
            Auto(), found, ReturnStatistics(0, 0, 100, 0), list(table.values()), run
        )[0],
        "places": table,
    }


def test_a_pass_gets_the_heights_of_trees_near_its_window_alone() -> None:
    table = {name_of(c, r): [18.0, 1.0] for c in range(9) for r in range(9)}
    state = {**survey(0.07), TREES: table}
    side = round(PLACE_M * 1000)
    core = Window(4 * side, 4 * side, 5 * side - 1, 5 * side - 1)
    local = {step.name: step.local(state, core, MM) for step in PASSES}
    assert local["surface"][TREES].keys() == {
        name_of(c, r) for c in range(3, 6) for r in range(3, 6)
    }


@pytest.mark.parametrize(
    ("smoothest", "given", "expected"),
    [
        (0.07, None, 0.07),
        (0.07, 0.12, 0.12),
        (None, None, MIN_CELL_SIGMA_M),
        (0.001, None, MIN_CELL_SIGMA_M),
        (0.9, None, MAX_CELL_SIGMA_M),
        (0.07, 0.9, MAX_CELL_SIGMA_M),
    ],
)
def test_noise_is_that_of_the_smoothest_places_within_limits(
    smoothest: float | None, given: float | None, expected: float
) -> None:
    assert value_at(noise_m(survey(smoothest, given), MM), 3, 4) == expected


def test_each_kind_has_passes_of_its_own() -> None:
    def names(state: dict[str, Any]) -> list[str]:
        return [p.name for p in Auto().passes if p.applies(state)]

    matched, laser = names(survey(0.05)), names(survey(0.05, kind="lidar"))
    assert matched == ["survey", "cells", "objects", "inner-objects", "canopy", "surface"]
    assert set(matched) & set(laser) == {"survey"}
    assert not any(p.applies({}) for p in PASSES)


def test_elected_cells_are_those_of_the_bounds_and_are_labelled_by_cell() -> None:
    rng = np.random.default_rng(2)
    xyz = rng.integers(0, (20_000, 20_000, 300), (9000, 3)).T.astype(np.int32)
    elected = CellModel(cell_heights(xyz, Window.everything(), MM, 0.05))
    half = elected.elect(Window(0, 0, 10_000, 20_000))
    assert half.shape[1] == 200
    assert half[0].max() == 9500
    cells = CellLattice.of(1.0, MM)
    raster = raster_of(half, cells)
    codes = rng.integers(1, 4, 200).astype(np.uint8)
    order = rng.permutation(200)
    labels, is_uncertified = Codes(raster, codes, cells).label(Points(half[:, order]))
    assert np.array_equal(labels, codes[order])
    assert not is_uncertified.any()


def test_objects_found_before_stay_objects() -> None:
    rng = np.random.default_rng(3)
    xyz = rng.integers(0, (30_000, 30_000, 100), (9000, 3)).T.astype(np.int32)
    cells = cell_heights(xyz, Window.everything(), MM, 0.05)
    before = np.where(cells[0] < 9000, np.uint8(OBJECT), np.uint8(1))
    everything = Window.everything()
    model = ObjectPass().fit(Points(cells, before), everything, everything, MM, survey(0.05))
    labels, _ = model.label(Points(cells))
    assert (labels[before == OBJECT] == OBJECT).all()
    assert (labels != OBJECT).any()


def test_points_are_ground_within_the_tolerance_about_the_surface_and_low_noise_below() -> None:
    """A flat surface at 10 m, noise 0.1 m: ground to 0.35 m, low noise from 0.9 m below on; half of it in plants."""
    z = np.array([10.0, 10.34, 10.36, 9.66, 9.64, 9.11, 9.09, 3.0, 12.5])
    x = np.round(3000 + 2000 * np.arange(z.size)).astype(np.int32)  # too far apart to vote
    cells = CellLattice.of(1.0, MM)
    at = np.arange(500, 24_000, 1000, dtype=np.int32)
    cx, cy = (a.ravel() for a in np.meshgrid(at, at))
    raster = raster_of(np.stack([cx, cy, np.full_like(cx, 10_000)]), cells)

    def labels(narrowing: float) -> list[int]:
        shape = raster.heights.shape
        found = Surface(np.full(shape, 10.0), np.full(shape, 0.1), np.full(shape, narrowing))
        ground = Ground(
            found,
            RasterPosition(0, 0, 1000.0, raster.column, raster.row),
            MM,
            everywhere(0.1),
            everywhere(0.5),
        )
        return ground.classes(
            x, np.full_like(x, 5300), np.rint(1000 * z).astype(np.int32)
        ).tolist()

    g, u, n = int(GROUND), int(UNCLASSIFIED), int(LOW_NOISE)
    assert labels(1.0) == [g, g, u, g, u, u, n, n, u]
    assert labels(0.5) == [g, u, u, u, u, u, n, n, u]


def test_heights_between_cells_are_those_of_a_plane() -> None:
    row, column = np.mgrid[:6, :8].astype(float)

    def surface(values: np.ndarray, v: list[float], u: list[float]) -> np.ndarray:
        """Of a raster whose first cell is the one at (-2, 3), at places in cells from its centre on."""
        x, y = (
            np.rint(1000 * (np.array(a) + 0.5 + first)).astype(np.int32)
            for a, first in ((u, -2), (v, 3))
        )
        position = RasterPosition(0, 0, 1000.0, -2, 3)
        return -_heights_above(x, y, np.zeros_like(x), values, position, 1000.0, 16_000.0)[0]

    v, u = [0.0, 2.25, 4.99], [0.5, 3.75, 6.99]
    assert np.allclose(surface(2 * row - 3 * column, v, u), 2 * np.array(v) - 3 * np.array(u))
    assert np.isnan(surface(row, [-0.1, 5.0, 2.0], [2.0, 2.0, 7.5])).all()
    row[2, 3] = np.nan
    assert np.isnan(surface(row, [1.5], [2.5])).all()
