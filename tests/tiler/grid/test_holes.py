"""Holes are told by cells, and cells that touch are one void, wherever blocks end."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy

from tiler.core.lattice import Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.grid.coarse import padded
from tiler.grid.tasks.findings import voids_of
from tiler.grid.voids import CELL_PIXELS, hole_cells

SIZES = (1, 1, 5, 40, 40, 90, 9, 2, 600)


@pytest.mark.parametrize("seed", range(5))
def test_voids_are_connected_cells_whatever_the_blocks_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    spec = RasterSpec(Lattice(Fraction(1000)), 7, 3000, 900, 1100)
    holes = np.zeros((900, 1100), bool)
    for row, col, size in zip(*rng.integers(0, 900, (2, 9)), SIZES, strict=True):
        holes[row : row + size, col : col + rng.integers(1, 60)] = True
    outside = np.pad(rng.random(holes.shape) < 1e-4, 1)
    cells = [
        cell
        for block in spec.blocks(512)
        for cell in hole_cells(part(holes, block), block, part(outside, padded(block, 1), 1))
    ]
    found = voids_of(cells, spec, 4.0)
    assert sum(void.pixels for void in found) == holes.sum()
    assert found == sorted(found, key=lambda void: -void.pixels)
    for x, y in (void.at for void in found):
        assert holes[int(3000 - y), int(x - 7)]
    expected = []
    cell_holes = np.pad(holes, ((0, -900 % CELL_PIXELS), (0, -1100 % CELL_PIXELS)))
    pooled = cell_holes.reshape(
        -1, CELL_PIXELS, cell_holes.shape[1] // CELL_PIXELS, CELL_PIXELS
    ).any(axis=(1, 3))
    number, count = scipy.ndimage.label(pooled, np.ones((3, 3)))
    of_pixel = np.kron(number, np.ones((CELL_PIXELS, CELL_PIXELS), int))[:900, :1100] * holes
    at_border = scipy.ndimage.binary_dilation(outside, np.ones((3, 3)))[1:-1, 1:-1]
    for i in range(1, count + 1):
        rows, cols = np.nonzero(of_pixel == i)
        west, north = 7 + cols.min(), 3000 - rows.min()
        bounds = [west, 3000 - rows.max() - 1, 7 + cols.max() + 1, north]
        expected.append((len(rows), bounds, bool(at_border[rows, cols].any())))
    assert sorted((void.pixels, void.bounds, void.at_border) for void in found) == sorted(
        expected
    )


def part(holes: np.ndarray, block: Block, margin: int = 0) -> np.ndarray:
    """The pixels of a block in an array that begins ``margin`` pixels before the raster."""
    row, col = block.row + margin, block.col + margin
    return holes[row : row + block.height, col : col + block.width]


@pytest.mark.parametrize(
    ("hole", "outside", "at_border"),
    [
        ((100, 100), (101, 101), True),
        ((100, 100), (102, 102), False),
        ((511, 100), (512, 101), True),  # of the next block
        ((512, 512), (511, 511), True),  # of the block before
        ((0, 100), (-1, 100), True),  # beyond the raster
        ((1, 100), (-1, 100), False),
    ],
)
def test_a_void_is_at_the_border_if_it_touches_a_pixel_outside_the_survey(
    hole: tuple[int, int], outside: tuple[int, int], at_border: bool
) -> None:
    spec = RasterSpec(Lattice(Fraction(1000)), 7, 3000, 600, 600)
    holes, beyond = np.zeros((600, 600), bool), np.zeros((602, 602), bool)
    holes[hole] = beyond[outside[0] + 1, outside[1] + 1] = True
    cells = [
        cell
        for block in spec.blocks(512)
        for cell in hole_cells(part(holes, block), block, part(beyond, padded(block, 1), 1))
    ]
    (void,) = voids_of(cells, spec, 1.0)
    assert void.at_border == at_border


@pytest.mark.parametrize("block_pixels", [96, 512])
def test_gaps_that_are_one_void_are_told_at_a_pixel_of_the_largest(block_pixels: int) -> None:
    spec = RasterSpec(Lattice(Fraction(1000)), 7, 3000, 600, 600)
    holes = np.zeros((600, 600), bool)
    holes[100:130, 100:160] = holes[140:400, 150:400] = True
    cells = [
        cell
        for block in spec.blocks(block_pixels)
        for cell in hole_cells(part(holes, block), block, np.zeros((602, 602), bool))
    ]
    (void,) = voids_of(cells, spec, 1.0)
    assert abs(void.at[0] - (7 + 275)) < CELL_PIXELS
    assert abs(void.at[1] - (3000 - 270)) < CELL_PIXELS


def test_no_holes_are_no_voids() -> None:
    spec = RasterSpec(Lattice(Fraction(1000)), 0, 64, 64, 64)
    (block,) = spec.blocks(512)
    outside = np.ones((66, 66), bool)
    assert hole_cells(np.zeros((64, 64), bool), block, outside) == voids_of([], spec, 4.0) == []
