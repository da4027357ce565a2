"""What is inside of the survey: rotated and ragged outlines, islands, strips; holes are not outside."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from tiler.core.lattice import Bounds, Lattice
from tiler.core.products import BEYOND, SURVEYED, VOID
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec
from tiler.grid.coarse import coarse_raster
from tiler.grid.coverage import (
    WINDOW,
    bare_cells,
    closed_cells,
    gap_of,
    gaps_of,
    spacings_of,
    survey_values,
)
from tiler.store import coarse_cells

SIDE = 160
ROW, COL = np.mgrid[:SIDE, :SIDE]


def survey_of(occupied: np.ndarray, gap: float) -> np.ndarray:
    """The survey of some cells as if they were one block, with nothing beyond."""
    height, width = occupied.shape
    pad, size = int(np.ceil(gap)) + 2, -(-max(height, width) // WINDOW) * WINDOW
    square = np.zeros((size + 2 * pad, size + 2 * pad), bool)
    square[pad : pad + height, pad : pad + width] = occupied
    gaps = np.full((size // WINDOW, size // WINDOW), float(gap))
    closed = np.pad(closed_cells(square, gaps, pad), 1)
    enclosed = ndimage.binary_fill_holes(closed) & ~closed
    return survey_values(closed, enclosed, np.zeros_like(closed))[1 : 1 + height, 1 : 1 + width]


def turned(angle_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates along and across a line through the middle."""
    a = np.radians(angle_deg)
    x, y = COL - SIDE / 2, SIDE / 2 - ROW
    return x * np.cos(a) + y * np.sin(a), y * np.cos(a) - x * np.sin(a)


def rectangle(angle_deg: float, long: float, wide: float) -> np.ndarray:
    along, across = turned(angle_deg)
    return (np.abs(along) < long / 2) & (np.abs(across) < wide / 2)


def islands() -> np.ndarray:
    found = np.zeros((SIDE, SIDE), bool)
    for row, col, radius in ((30, 30, 20), (40, 120, 25), (125, 70, 22)):
        found |= (ROW - row) ** 2 + (COL - col) ** 2 < radius**2
    return found


ROW_400, COL_400 = np.mgrid[:400, :400]

OUTLINES = {
    "box": np.ones((SIDE, SIDE), bool),
    "rotated": rectangle(31, 130, 70),
    "strip": rectangle(45, 400, 45),
    "islands": islands(),
    "notch": rectangle(0, 140, 140) & ~((COL > 70) & (ROW < 90)),
}


@pytest.mark.parametrize("bridge", [4, 16])
@pytest.mark.parametrize("name", OUTLINES)
def test_the_outline_is_found_whatever_lies_inside(name: str, bridge: int) -> None:
    outline = OUTLINES[name]
    row, col = {"islands": (40, 120), "notch": (120, 80)}.get(name, (80, 80))
    lake = (ROW - row) ** 2 + (COL - col) ** 2 < 13**2
    # Every third cell without a point.
    ragged = outline & (np.random.default_rng(4).random(outline.shape) < 0.7)
    values = survey_of(ragged & ~lake, bridge)
    inside = values >= SURVEYED
    assert (values[ndimage.binary_erosion(lake, iterations=4)] == VOID).all()
    assert not (values[~ndimage.binary_dilation(lake, iterations=4)] == VOID).any()
    # cells of the border without a point
    assert (outline & (values == BEYOND)).sum() < 0.03 * outline.sum()
    deep = ndimage.binary_erosion(outline, iterations=4)
    assert inside[deep].all()  # the lake as well
    # Beyond the outline only what a gap of that width bridges.
    beyond = ndimage.distance_transform_edt(~outline)
    assert not inside[beyond > bridge / 2].any()
    if name != "box":
        assert inside.sum() < 0.8 * inside.size


def test_sparse_points_have_wider_gaps() -> None:
    """Cells of 2 m, gaps of 20 m, 100 m at most: for points 1, 8 and 60 m apart."""
    rng = np.random.default_rng(6)
    found = []
    for spacing in (0.5, 4, 30):
        occupied = rng.random((400, 400)) < 1 - np.exp(-(spacing**-2))
        gap = gap_of(occupied, 10.0, 50.0)
        found.append(gap)
        deep = survey_of(occupied, gap)[40:-40, 40:-40]
        assert (deep != BEYOND).mean() > 0.99 or spacing == 30
        assert gap_of(occupied & (ROW_400 == COL_400), 10.0, 50.0) >= gap
    assert found == [10, 20, 50]


def test_each_window_has_the_gap_of_its_points() -> None:
    """Dense points in the west, sparse ones in the east, which do not change what the west gets."""
    rng = np.random.default_rng(6)
    shape = (3 * WINDOW, 10 * WINDOW)
    dense, sparse = (rng.random(shape) < 1 - np.exp(-(spacing**-2)) for spacing in (0.5, 4))
    both = np.where(np.arange(shape[1]) < 5 * WINDOW, dense, sparse)
    gaps = gaps_of(both, 10.0, 50.0)
    assert gaps.shape == (1, 8)
    assert gaps[0, :3].tolist() == [10, 10, 10]
    assert gaps[0, -3:].tolist() == [20, 20, 20]
    assert (
        gaps_of(np.where(np.arange(shape[1]) < 5 * WINDOW, dense, False), 10.0, 50.0)[0, :3]
        == 10
    ).all()


def bare_of(counts: np.ndarray, gap: float = 10) -> np.ndarray:
    """Places without returns of some cells with numbers of points, one block of one window without neighbours."""
    around = np.pad(counts, WINDOW).astype(np.float32)
    spacings = spacings_of(around, np.full((1, 1), gap))
    return bare_cells(around != 0, spacings, WINDOW)


@pytest.mark.parametrize("per_cell", [0.25, 1, 4, 40])
def test_a_gap_is_bare_if_it_is_wider_than_four_spacings(per_cell: float) -> None:
    """Also in gaps of random points, nothing is bare."""
    rng = np.random.default_rng(5)
    counts = rng.poisson(per_cell, (WINDOW, WINDOW))
    assert not bare_of(counts)[4:-4, 4:-4].any()
    limit = max(3, 4 / np.sqrt(per_cell))
    for width in (*range(1, 8), 12):
        strip = (COL[:WINDOW, :WINDOW] >= 60) & (COL[:WINDOW, :WINDOW] < 60 + width)
        strip &= (ROW[:WINDOW, :WINDOW] > 30) & (ROW[:WINDOW, :WINDOW] < 70)
        found = bare_of(np.where(strip, 0, counts))[4:-4, 4:-4]
        strip = strip[4:-4, 4:-4]
        if width >= limit + 1:
            assert found[strip].mean() > 0.8
        # Random points near the strip may be missing, too.
        if width <= limit / 2:
            assert not found.any()
        assert not (found & ~ndimage.binary_dilation(strip, iterations=3)).any()


def test_a_strip_fills_a_third_of_its_box() -> None:
    assert 0.3 < (survey_of(OUTLINES["strip"], 16) >= SURVEYED).mean() < 0.37


def test_a_river_to_the_border_is_inside_if_the_terrain_bridges_it() -> None:
    river = np.abs(ROW - 80) < 5
    assert (survey_of(~river, 12)[5:-5, 5:-5] >= SURVEYED).all()
    assert (survey_of(~river, 6)[80] == BEYOND).all()


def test_the_cells_of_the_outline_are_not_inside() -> None:
    inside = survey_of(OUTLINES["rotated"], 8) >= SURVEYED
    assert not (inside & ~ndimage.binary_erosion(OUTLINES["rotated"])).any()


@pytest.mark.parametrize("shape", [(1, 1), (2, 5), (40, 1)])
def test_small_and_empty_rasters(shape: tuple[int, int]) -> None:
    for value in (True, False):
        assert survey_of(np.full(shape, value), 16.0).shape == shape
    assert not survey_of(np.zeros(shape, bool), 16.0).any()


@pytest.mark.parametrize("bounds", [Bounds(0, 0, 61_600, 60_000), Bounds(0, 0, 60_000, 61_600)])
def test_the_cell_of_a_pixel_does_not_depend_on_where_the_cells_end(bounds: Bounds) -> None:
    """Centres of pixels of 1.5 m that lie beyond cells of 2 m: in the east, and in the north."""
    fine = RasterSpec.covering(Lattice(Fraction(1500)), bounds)
    tight, wide = (
        RasterSpec.covering(Lattice(Fraction(2000)), found)
        for found in (bounds, Bounds(-9000, -7000, 90_000, 80_000))
    )
    for block in fine.blocks(BLOCK_PIXELS):
        for of_tight, of_wide, moved in zip(
            coarse_cells(tight, fine, block),
            coarse_cells(wide, fine, block),
            (wide.north - tight.north, tight.west - wide.west),
            strict=True,
        ):
            assert (of_tight + moved == of_wide).all()


@given(st.integers(-10_000, 10_000), st.integers(-10_000, 10_000), st.integers(1, 5000))
def test_blocks_of_coarse_cells_are_anchored_at_0(x: int, y: int, side: int) -> None:
    bounds = Bounds(x, y, x + side, y + side)
    spec = coarse_raster(Lattice(Fraction(2)), bounds)
    assert [v % BLOCK_PIXELS for v in (spec.west, spec.north, spec.height, spec.width)] == [
        0
    ] * 4
    held = spec.block_bounds(Block(0, 0, spec.height, spec.width))
    assert (held.x0 <= bounds.x0, held.y0 <= bounds.y0) == (True, True)
    assert (held.x1 >= bounds.x1, held.y1 >= bounds.y1) == (True, True)
    assert spec.height <= side // 2 + 1 + 2 * BLOCK_PIXELS
