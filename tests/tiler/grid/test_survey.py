"""What is inside of the survey: rotated and ragged outlines, islands, strips; holes are not outside."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy import ndimage

from tiler.core.lattice import Bounds, Lattice
from tiler.core.products import BEYOND, SURVEYED, VOID
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.grid.survey import coarse_cells, gap_of, survey_of

SIDE = 160
ROW, COL = np.mgrid[:SIDE, :SIDE]


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
    assert (outline & (values == BEYOND)).sum() < 0.03 * outline.sum()  # cells of the border without a point
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
def test_each_pixel_has_a_coarse_cell_where_the_sides_do_not_divide(bounds: Bounds) -> None:
    """Centres of pixels of 1.5 m beyond cells of 2 m: in the east, and in the north."""
    fine, coarse = (RasterSpec.covering(Lattice(Fraction(size)), bounds) for size in (1500, 2000))
    for block in fine.blocks(BLOCK_PIXELS):
        rows, cols = coarse_cells(coarse, fine, block)
        assert (rows.min(), cols.min()) == (0, 0)
        assert (rows.max(), cols.max()) == (coarse.height - 1, coarse.width - 1)
