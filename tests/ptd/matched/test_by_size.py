"""Cells of two sizes in one survey: each place as if the whole survey had the cells of that place, in any tiles."""

from __future__ import annotations

import numpy as np
import pytest

import ptd
from ptd.frame import Scale, Window
from ptd.matched.cells import cell_heights
from ptd.matched.passes import SurfacePass
from ptd.matched.step import size_of_cells
from ptd.matched.survey import (
    BOTH,
    CELL_SIZE,
    CELL_SIZES_M,
    SIZES_AROUND,
    cell_sizes,
    with_cell_sizes,
)
from ptd.methods.auto.method import Auto
from ptd.passes import Points
from ptd.places import PLACE_M, name_of
from tests.ptd.tiling import classify_tiled

MM = Scale()


def strip(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A matched cloud, 1600 m x 16 m, of 8 points/m2 to the west and 1 to the east; which points are boxes'."""
    rng = np.random.default_rng(seed)
    x, y = rng.random((2, 1600 * 16 * 8)) * [[1600.0], [16.0]]
    kept = (x < 800.0) | (rng.random(x.size) < 0.125)
    x, y = x[kept], y[kept]
    box = (x % 40 < 9) & (abs(y - 8) < 5)
    z = 0.03 * x + 5.0 * box + rng.normal(0, 0.05, x.size)
    return np.stack([x, y, z], axis=1), box


def test_sides_follow_the_density_and_both_are_made_where_they_meet() -> None:
    table = with_cell_sizes(
        {name_of(c, 0): [8.0 if c < 0 else 1.0, None, 0.05] for c in range(-9, 9)}
    )
    assert [table[name_of(c, 0)][CELL_SIZE] for c in (-9, -1, 0, 8)] == [1.0, 1.0, 2.0, 2.0]
    assert [c for c in range(-9, 9) if table[name_of(c, 0)][BOTH]] == list(
        range(-SIZES_AROUND, SIZES_AROUND)
    )
    assert cell_sizes(table) == CELL_SIZES_M
    assert cell_sizes({name_of(0, 0): table[name_of(8, 0)]}) == (2.0,)


def test_cells_are_made_as_far_as_the_passes_after_them_see() -> None:
    matched = [step for step in Auto().passes if step.elected and step.kind == "dim"]
    reach = sum(step.influence_radius_m or 0.0 for step in matched)
    assert isinstance(Auto().passes[-1], SurfacePass)
    assert reach <= SIZES_AROUND * PLACE_M


@pytest.mark.parametrize("size_m", CELL_SIZES_M)
def test_the_middle_of_a_cell_tells_its_size(size_m: float) -> None:
    xyz = np.random.default_rng(1).integers(0, 30_000, (3, 4000)).astype(np.int32)
    scale = Scale(origin=(-123_457, 77))
    cells = cell_heights(xyz, Window.everything(), scale, 0.05, size_m)
    assert set(size_of_cells(Points(cells), scale)) == {size_m}


def test_boxes_are_told_on_both_sides_and_tiles_do_not_show() -> None:
    xyz, box = strip()
    counts = np.ascontiguousarray(np.rint(1000 * xyz).T.astype(np.int32))
    whole, _, state = classify_tiled(Points(counts), MM, Auto(), None, kind="dim")
    assert {figures[CELL_SIZE] for figures in state["places"].values()} == set(CELL_SIZES_M)
    for half in (xyz[:, 0] < 800.0, xyz[:, 0] >= 800.0):
        assert (whole[half & ~box] == 2).mean() > 0.97
        assert (whole[half & box] == 2).mean() < 0.03
    tiled, marks, _ = classify_tiled(Points(counts), MM, Auto(), 173.0, kind="dim")
    assert np.array_equal(tiled, whole)
    assert not marks.any()


@pytest.mark.parametrize("size_m", CELL_SIZES_M)
def test_a_place_gets_what_it_would_get_if_all_cells_had_its_size(
    size_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    xyz, _ = strip(2)
    mixed = ptd.classify(xyz, kind="dim")
    own = {
        name: figures[CELL_SIZE]
        for name, figures in mixed.decisions["statistics"]["places"].items()
    }
    monkeypatch.setattr("ptd.matched.survey.cell_size_m", lambda density_m2: size_m)
    alike = ptd.classify(xyz, kind="dim").classification
    column = np.floor(xyz[:, 0] / PLACE_M).astype(int)
    of_size = np.array([own[name_of(c, 0)] == size_m for c in range(7)])[column]
    assert of_size.mean() > 0.1
    assert np.array_equal(mixed.classification[of_size], alike[of_size])
