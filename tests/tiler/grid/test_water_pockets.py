"""Pockets beside water: low terrain that higher terrain closes off is water, other low terrain is not."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from tiler.core.area import Area
from tiler.core.lattice import Bounds
from tiler.core.water import LAKE, Water
from tiler.grid.water_level import POCKET_PIXELS, Beside, pockets, with_pixels

PIXEL, LEVEL, NOISE = 10_000, 1_000_000, 1_000
"""In counts; water stands west of column 10."""
SHAPE = (30, 40)
BODY = Water(1, LAKE, Area.rectangle(Bounds(0, 0, 10 * PIXEL, SHAPE[0] * PIXEL)), level=LEVEL)


def beside(depth: np.ndarray) -> Beside:
    """Pixels beside the water, from the depths of all pixels below its level, in counts."""
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    wet = cols < 10
    distance = scipy.ndimage.distance_transform_cdt(~wet, "chessboard").astype(np.int64)
    near = ~wet & (distance <= POCKET_PIXELS)
    x, y = (2 * cols[near] + 1) * PIXEL // 2, (2 * (SHAPE[0] - rows[near]) - 1) * PIXEL // 2
    return Beside(
        np.stack((x, y, LEVEL - depth[near])), np.stack((rows[near], cols[near])), distance[near]
    )  # fmt: skip


def joined(depth: np.ndarray) -> np.ndarray:
    """Mask of the raster with the pixels that join the water."""
    pixels, found = beside(depth), np.zeros(SHAPE, np.bool_)
    found[tuple(pixels.pixels[:, pockets(BODY, pixels, NOISE)])] = True
    return found


@pytest.fixture
def depth() -> np.ndarray:
    """Banks that rise above the water everywhere."""
    return np.full(SHAPE, -5_000)


def test_banks_above_the_water_stay(depth: np.ndarray) -> None:
    assert not joined(depth).any()


def test_a_pocket_that_is_closed_off_joins_with_its_shallow_pixels(depth: np.ndarray) -> None:
    depth[5:8, 10:13] = 500
    depth[6, 11] = 2_000
    assert np.argwhere(joined(depth)).tolist() == [
        [r, c] for r in (5, 6, 7) for c in (10, 11, 12)
    ]


@pytest.mark.parametrize(
    ("rows", "cols", "deep"),
    [
        (slice(5, 8), slice(10, 10 + POCKET_PIXELS), 5_000),
        (slice(5, 8), slice(10, 13), NOISE),
        (slice(5, 8), slice(11, 14), 5_000),
    ],
    ids=["goes on", "within the noise", "apart from the water"],
)
def test_other_low_terrain_stays(
    rows: slice, cols: slice, deep: int, depth: np.ndarray
) -> None:
    depth[rows, cols] = deep
    assert not joined(depth).any()


def test_pockets_that_touch_at_a_corner_are_one(depth: np.ndarray) -> None:
    depth[5, 10], depth[6, 11] = 500, 5_000
    assert np.argwhere(joined(depth)).tolist() == [[5, 10], [6, 11]]


def test_the_polygon_holds_the_pixels_and_no_others(depth: np.ndarray) -> None:
    depth[5:8, 10:12] = 5_000
    pixels = beside(depth)
    mask = pockets(BODY, pixels, NOISE)
    area = with_pixels(BODY, pixels.xyz[:2, mask], float(PIXEL)).area
    assert np.array_equal(area.inside(*pixels.xyz[:2]), mask)
    assert len(area.polygons) == 1, "the pixels hang together with the water"
