"""Roofs left in a terrain are found, gabled or partly removed; ridges, cones, terraces and embankments are none."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.frame import CellLattice, Scale
from ptd.ground.morphology import CellRaster
from ptd.ground.plateaus import ROOF_STEPS_M, Plateaus, on_plateaus
from ptd.ground.remaining_roofs import remaining_roofs
from tests.scenes.halls import COLUMNS, PLAIN, ROWS, with_hall


def partly_removed() -> np.ndarray:
    """Of a hall one side was removed, and interpolated from the ground beside it."""
    heights = with_hall()
    heights[40:70, 50:56] = PLAIN[40:70, 50:56]
    return heights


def with_ramps() -> np.ndarray:
    """Of a low hall the DTM interpolates the walls over three cells, as between sparse points."""
    heights = with_hall(4.0)
    for away, height in ((1, 2.8), (2, 1.4)):
        edge = np.zeros(heights.shape, bool)
        edge[40 - away : 70 + away, 50 - away : 80 + away] = True
        edge[41 - away : 69 + away, 51 - away : 79 + away] = False
        heights[edge] = PLAIN[edge] + height
    return heights


def with_annexe() -> np.ndarray:
    """A flat roof 56 m wide with a parapet, and beside it one that is 1.2 m lower."""
    heights = with_hall(10.0, slice(40, 68), slice(50, 78))
    heights[40:68, 78:90] = PLAIN[40:68, 78:90] + 8.8
    rim = np.zeros(heights.shape, bool)
    rim[40:68, 50:78] = True
    rim[41:67, 51:77] = False
    heights[rim] += 1.2
    return heights


@pytest.mark.parametrize(
    ("heights", "width", "middle"),
    [
        (with_hall(), 60, (55, 65)),
        (with_hall(pitch=0.8), 60, (55, 65)),
        (with_hall(columns=slice(20, 130)), 60, (55, 75)),
        (with_hall(rows=slice(30, 100), columns=slice(40, 120)), 140, (65, 80)),
        (with_hall() + 0.3 * ROWS, 60, (55, 65)),
        (partly_removed(), 48, (55, 68)),
        (with_annexe(), 56, (54, 64)),
        (with_ramps(), 62, (55, 65)),
    ],
    ids=[
        "level",
        "gabled",
        "long",
        "wide",
        "on a slope",
        "partly removed",
        "with an annexe",
        "with ramps",
    ],
)
def test_a_roof_is_found_with_its_place_and_width(
    heights: np.ndarray, width: float, middle: tuple[float, float]
) -> None:
    roof = max(remaining_roofs(heights))  # an annexe is one of its own
    assert roof.width_m == pytest.approx(width, abs=4)
    assert (roof.row, roof.column) == (
        pytest.approx(middle[0], abs=2),
        pytest.approx(middle[1], abs=2),
    )
    assert remaining_roofs(heights, min_width_m=2 * width) == []


ridge = np.abs(COLUMNS - 75)


@pytest.mark.parametrize(
    "heights",
    [
        PLAIN,
        with_hall(1.5),
        with_hall(-8.0),
        with_hall(columns=slice(50, 150)),
        -0.8 * ridge,
        np.maximum(0, 30 - np.hypot(ROWS - 60, COLUMNS - 75)),
        np.clip(40 - ridge, 0, 8),
        np.full((9, 9), np.nan),
        PLAIN[:0],
    ],
    ids=[
        "plain",
        "podium",
        "pit",
        "terrace",
        "ridge",
        "cone",
        "embankment",
        "unknown",
        "nothing",
    ],
)
def test_terrain_is_no_roof(heights: np.ndarray) -> None:
    assert remaining_roofs(heights, min_width_m=10.0) == []


def test_a_roof_among_unknown_heights_is_none() -> None:
    heights = with_hall()
    heights[:, 84:] = np.nan
    assert len(remaining_roofs(heights)) == 1  # on three sides it is seen to fall
    heights[:40], heights[70:] = np.nan, np.nan
    assert remaining_roofs(heights) == []


@pytest.mark.parametrize(
    "heights", [with_hall(), with_hall(pitch=0.8), partly_removed(), with_annexe()]
)
def test_what_is_found_is_what_the_filter_removes(heights: np.ndarray) -> None:
    """One point a cell; the cells of the roofs that are found are those of the points that are taken out."""
    x, y = ((2000 * c + 1000).ravel().astype(np.int32) for c in (COLUMNS, ROWS))
    z = np.rint(1000 * heights).ravel().astype(np.int32)
    raster, ground = CellRaster(x, y, CellLattice(2000, 1, 0, 0)), np.ones(z.size, bool)
    for step_m in ROOF_STEPS_M:
        ground &= ~on_plateaus(z, ground, ~ground, raster, Plateaus.of(Scale(), 240.0, step_m))
    terrain = np.where(ground.reshape(heights.shape), heights, PLAIN)
    assert 0 < (~ground).sum() < 2000
    assert remaining_roofs(heights)
    assert remaining_roofs(terrain) == []
