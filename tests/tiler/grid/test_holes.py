"""Holes are told by cells, and cells that touch are one void, wherever blocks end."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy

from tiler.core.lattice import Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.grid.holes import CELL_PIXELS, hole_cells
from tiler.grid.tasks.voids import voids_of

SIZES = (1, 1, 5, 40, 40, 90, 9, 2, 600)


@pytest.mark.parametrize("seed", range(5))
def test_voids_are_connected_cells_whatever_the_blocks_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    spec = RasterSpec(Lattice(Fraction(1000)), 7, 3000, 900, 1100)
    holes = np.zeros((900, 1100), bool)
    for row, col, size in zip(*rng.integers(0, 900, (2, 9)), SIZES, strict=True):
        holes[row : row + size, col : col + rng.integers(1, 60)] = True
    cells = [
        cell for block in spec.blocks(512) for cell in hole_cells(part(holes, block), block)
    ]
    found = voids_of(cells, spec, 4.0)
    assert sum(void.pixels for void in found) == holes.sum()
    assert found == sorted(found, key=lambda void: -void.pixels)
    expected = []
    padded = np.pad(holes, ((0, -900 % CELL_PIXELS), (0, -1100 % CELL_PIXELS)))
    pooled = padded.reshape(-1, CELL_PIXELS, padded.shape[1] // CELL_PIXELS, CELL_PIXELS).any(
        axis=(1, 3)
    )
    number, count = scipy.ndimage.label(pooled, np.ones((3, 3)))
    of_pixel = np.kron(number, np.ones((CELL_PIXELS, CELL_PIXELS), int))[:900, :1100] * holes
    for i in range(1, count + 1):
        rows, cols = np.nonzero(of_pixel == i)
        west, north = 7 + cols.min(), 3000 - rows.min()
        expected.append((len(rows), [west, 3000 - rows.max() - 1, 7 + cols.max() + 1, north]))
    assert sorted((void.pixels, void.bounds) for void in found) == sorted(expected)


def part(holes: np.ndarray, block: Block) -> np.ndarray:
    return holes[block.row : block.row + block.height, block.col : block.col + block.width]


def test_no_holes_are_no_voids() -> None:
    spec = RasterSpec(Lattice(Fraction(1000)), 0, 64, 64, 64)
    (block,) = spec.blocks(512)
    assert hole_cells(np.zeros((64, 64), bool), block) == voids_of([], spec, 4.0) == []
