"""What stands on steps is found, gabled or half removed; ridges, cones, terraces and embankments are not."""

from __future__ import annotations

import numpy as np
import pytest

from tests.scenes.halls import COLUMNS, PLAIN, ROWS, with_hall
from tiler.plan.roof_check import roofs

CELL_M = 2.0


def half_removed() -> np.ndarray:
    """Of a hall one side was removed, and interpolated as a ramp."""
    heights = with_hall()
    heights[40:70, 50:62] = PLAIN[40:70, 50:62] + 8 * (np.arange(12) + 1) / 13
    return heights


@pytest.mark.parametrize(
    ("heights", "width", "middle"),
    [
        (with_hall(), 60, (55, 65)),
        (with_hall(pitch=0.8), 60, (55, 65)),
        (with_hall(columns=slice(20, 130)), 60, (55, 75)),
        (with_hall(rows=slice(30, 100), columns=slice(40, 120)), 140, (65, 80)),
        (with_hall() + 0.3 * ROWS, 60, (55, 65)),
        (half_removed(), 54, (55, 66)),
    ],
    ids=["level", "gabled", "long", "wide", "on a slope", "half removed"],
)
def test_a_roof_is_found_with_its_place_and_width(
    heights: np.ndarray, width: float, middle: tuple[float, float]
) -> None:
    wide, row, col = max(roofs(heights, CELL_M))  # narrower squares may find parts of it
    assert wide == pytest.approx(width, abs=6)
    assert (row, col) == (pytest.approx(middle[0], abs=3), pytest.approx(middle[1], abs=3))
    assert roofs(heights, CELL_M, 2 * width) == []


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
    ids=["plain", "podium", "pit", "terrace", "ridge", "cone", "embankment", "unknown", "nothing"],
)
def test_terrain_is_no_roof(heights: np.ndarray) -> None:
    assert roofs(heights, CELL_M) == []


def test_unknown_heights_are_no_steps() -> None:
    heights = with_hall()
    heights[:, 84:] = np.nan
    assert len(roofs(heights, CELL_M)) > 0  # the hole begins beyond the ground beside it
    heights[:40], heights[70:] = np.nan, np.nan
    assert roofs(heights, CELL_M) == []
