"""Coarse lattice: cells of fixed size, in blocks that are anchored at CRS coordinate 0.

Decisions on coarse cells are made block by block, each with a margin of its neighbours. So the
decision at a position does not depend on what else is in the run.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from tiler.core.lattice import Bounds, Lattice
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float32]
Runs = list[list[int]]
"""Runs of neighbouring blocks: first row of pixels, first columns of first and last block (see
`block_runs`)."""


def coarse_raster(lattice: Lattice, extent: Bounds) -> RasterSpec:
    """Return the smallest raster of whole blocks that contains an extent. Blocks are anchored at CRS coordinate 0."""
    size, tight = BLOCK_PIXELS, RasterSpec.covering(lattice, extent)
    west, south = tight.west // size * size, (tight.north - tight.height) // size * size
    east, north = -(-(tight.west + tight.width) // size) * size, -(-tight.north // size) * size
    return RasterSpec(lattice, west, north, north - south, east - west)


def padded(block: Block, pad: int) -> Block:
    """Return a block and ``pad`` cells around it, which may extend beyond the raster."""
    return Block(
        block.row - pad, block.col - pad, block.height + 2 * pad, block.width + 2 * pad
    )


def block_runs(
    cells: Bools, coarse: RasterSpec, spec: RasterSpec, size: int, pad: int = 0
) -> Runs:
    """Find the blocks of a raster within ``pad`` pixels of a set coarse cell.

    Only the cells are visited, since a raster that is mostly empty has far more blocks.

    Parameters
    ----------
    cells : bool, shape (height, width) of ``coarse``
    coarse, spec : RasterSpec
        Rasters of the cells and of the blocks.
    size : int
        Side of a block in pixels.
    pad : int

    Returns
    -------
    list of [int, int, int]
        First row of pixels of each run of neighbouring blocks, and first columns of its first and last block.
    """
    rows: dict[int, list[tuple[int, int]]] = {}
    for row in np.flatnonzero(cells.any(axis=1)).tolist():
        steps = (
            np.flatnonzero(np.diff(cells[row], prepend=False, append=False))
            .reshape(-1, 2)
            .tolist()
        )
        for start, end in steps:
            box = covered(coarse, spec, Block(row, start, 1, end - start), pad)
            if box.height <= 0 or box.width <= 0:
                continue
            run = box.col // size * size, (box.col + box.width - 1) // size * size
            for top in range(box.row // size * size, box.row + box.height, size):
                rows.setdefault(top, []).append(run)
    return [
        [row, first, last] for row in sorted(rows) for first, last in _merged(rows[row], size)
    ]


def _merged(runs: list[tuple[int, int]], size: int) -> list[tuple[int, int]]:
    """Merge the runs of a row that overlap or touch, and return them from west to east."""
    merged_runs: list[tuple[int, int]] = []
    for first, last in sorted(set(runs)):
        if merged_runs and first <= merged_runs[-1][1] + size:
            merged_runs[-1] = merged_runs[-1][0], max(merged_runs[-1][1], last)
        else:
            merged_runs.append((first, last))
    return merged_runs


def blocks_of(runs: Runs, spec: RasterSpec, size: int) -> Iterator[Block]:
    """Yield the blocks that `block_runs` found, row by row from the north-west."""
    for row, first, last in runs:
        for col in range(first, last + 1, size):
            yield spec.block_at(row, col, size)


def covered(coarse: RasterSpec, spec: RasterSpec, cells: Block, pad: int = 0) -> Block:
    """Return the pixels of a raster that coarse cells touch, padded by ``pad`` within the raster."""
    bounds: Bounds = coarse.block_bounds(cells)
    index = spec.lattice.index_of
    left, right = index(bounds.x0) - spec.west, index(bounds.x1 - 1) + 1 - spec.west
    top, bottom = spec.north - 1 - index(bounds.y1 - 1), spec.north - index(bounds.y0)
    left, top = max(left - pad, 0), max(top - pad, 0)
    return Block(
        top, left, min(bottom + pad, spec.height) - top, min(right + pad, spec.width) - left
    )


def blocks_under(
    coarse: RasterSpec, spec: RasterSpec, cells: Block, size: int
) -> Iterator[Block]:
    """Yield the blocks of ``size`` pixels of a raster that overlap coarse cells."""
    yield from spec.blocks_within(coarse.block_bounds(cells), size)
