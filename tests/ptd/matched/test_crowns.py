"""Terrain that looks like the crowns of a closed canopy is told from what is rough, smooth or steep in other ways."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.matched.crowns import crowns, residuals

SIDE = 240
ROWS, COLUMNS = np.indices((SIDE, SIDE), np.float64)
RNG = np.random.default_rng(3)


def canopy() -> np.ndarray:
    """Crowns of 3 to 5 m radius and up to 3 m height, one beside the other, on a gentle slope."""
    heights = np.zeros((SIDE, SIDE))
    for _ in range(3000):
        row, column = RNG.uniform(0, SIDE, 2)
        radius, top = RNG.uniform(3, 5), RNG.uniform(1.5, 3)
        away = np.hypot(ROWS - row, COLUMNS - column) / radius
        heights = np.maximum(heights, top * (1 - away**2))
    return heights + 0.1 * COLUMNS


def smooth(sigma: float, height: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(RNG.normal(0, 1, (SIDE, SIDE)), sigma)
    return height * noise / noise.std()


def test_most_of_a_canopy_looks_like_crowns() -> None:
    found = crowns(canopy())
    assert found.n_tested == 100
    assert len(found.found) > 70


@pytest.mark.parametrize(
    "heights",
    [
        0.6 * COLUMNS,
        smooth(25, 15.0),  # hills
        smooth(0.7, 0.5),  # rocks and rough grass
        0.1 * RNG.normal(0, 1, (SIDE, SIDE)),
        np.where((ROWS // 4) % 2 == 0, 0.0, 0.4),  # furrows and hedges
        20 / (1 + np.exp((COLUMNS - 120 - 8 * np.sin(ROWS / 20)) / 3)),  # a rounded cliff
        np.floor(COLUMNS / 30) * 1.5,  # terraces
    ],
)
def test_other_terrain_does_not(heights: np.ndarray) -> None:
    found = crowns(heights)
    assert found.n_tested == 100
    assert len(found.found) <= 5


def test_what_has_no_heights_is_not_looked_at() -> None:
    heights = canopy()
    heights[:, : SIDE // 2] = np.nan
    found = crowns(heights)
    assert found.n_tested == 50
    assert min(column for _, column in found.found) >= SIDE // 2
    assert crowns(np.full((SIDE, SIDE), np.nan)).n_tested == 0


@pytest.mark.parametrize("shape", [(1, 512), (512, 1), (1, 1), (2, 30)])
def test_a_raster_of_a_row_is_no_error(shape: tuple[int, int]) -> None:
    """A block at the edge of the terrain may have one row of pixels."""
    assert crowns(RNG.normal(0, 5, shape)).found == []
    assert crowns(np.zeros(shape)).found == []


def test_residuals_are_those_of_planes_by_least_squares() -> None:
    heights = smooth(3, 2.0) + 0.3 * ROWS
    heights[50:53, 60:63] = np.nan
    found = residuals(heights, 9)
    for row, column in ((50, 58), (100, 100), (17, 201)):
        window = heights[row - 4 : row + 5, column - 4 : column + 5]
        held = np.isfinite(window)
        y, x = np.indices(window.shape)
        places = np.stack([x[held], y[held], np.ones(held.sum())], axis=1)
        _, squares, *_ = np.linalg.lstsq(places, window[held], rcond=None)
        assert found[row, column] == pytest.approx(
            np.sqrt(squares[0] / (held.sum() - 3)), rel=1e-6
        )
