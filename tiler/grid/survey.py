"""Coarse raster of the extent of the survey, which distinguishes voids inside it from the area outside.

A coarse cell is occupied if it holds a point that counts as surface. Gaps up to a width, 20 m or more (`gap_of`),
belong to the survey (a closing by a disk of half that width); so does whatever is enclosed, however wide. What remains
is outside: it reaches the raster's border. Being run-wide, it carries no certificate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.classes import WATER
from tiler.core.lattice import Bounds
from tiler.core.products import BEYOND, BORDER, SURVEYED, VOID
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec
from tiler.grid.checksum import checksum
from tiler.grid.density import pixel_indices
from tiler.grid.ground import surface_points
from tiler.grid.reach import within
from tiler.grid.work import PointsBlock
from tiler.store import TileStore, open_store

Bools = npt.NDArray[np.bool_]
Runs = list[list[int]]
"""Blocks of a raster: first row of pixels, first and last column of a run of neighbours (see `block_runs`)."""


@dataclass(frozen=True)
class MakeSurvey:
    """Work: the whole raster of the extent of the survey.

    Attributes
    ----------
    name : str
    spec : RasterSpec
        Of the coarse cells.
    occupancy : str
        Name of the raster of occupied cells.
    gap, most_gap : float
        Cells: a gap that belongs to every survey, and the widest that belongs to one of sparse points.
    pixels : RasterSpec
        Of the products.
    """

    name: str
    spec: RasterSpec
    occupancy: str
    gap: float
    most_gap: float
    pixels: RasterSpec


def occupancy_block(store_url: str, work: PointsBlock) -> dict[str, Any]:
    """Write one block of the raster of occupied cells; a `tiler.schedule.task.Work`.

    A cell has the number of its points; below 0 where more than half of them are water by the input.

    Returns
    -------
    dict
        ``occupied`` cells; ``checksum``.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    rule, bounds = work.rule, spec.block_bounds(block)
    counts, water = np.zeros((2, block.height * block.width), np.int64)
    for cell in store.buckets_within(bounds):
        points, chosen = surface_points(store, rule, cell)
        chosen &= points.inside(bounds, store.meta.frame.origin)
        places = pixel_indices(points.xyz[:, chosen], store.meta.frame.origin, spec, block)
        counts += np.bincount(places, minlength=len(counts))
        if points.classification is not None:
            water += np.bincount(places[points.classification[chosen] == WATER], minlength=len(counts))
    values = (
        np.where(2 * water > counts, -counts, counts).astype(np.float32).reshape(block.height, block.width)
    )
    store.write_block(work.name, block, values)
    return {"occupied": int(np.count_nonzero(values)), "checksum": checksum(values)}


def survey_raster(store_url: str, work: MakeSurvey) -> dict[str, Any]:
    """Write the whole raster of the survey, see `tiler.core.products.BEYOND`; a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``gap`` (cells); ``inside`` and ``cells``; ``blocks``: `block_runs` of the products' blocks that hold some of
        its inside; ``checksum``.
    """
    store, spec = open_store(store_url), work.spec
    occupied = store.read_block(work.occupancy, Block(0, 0, spec.height, spec.width)) != 0
    gap = gap_of(occupied, work.gap, work.most_gap)
    found = survey_of(occupied, gap).astype(np.float32)
    for b in spec.blocks(BLOCK_PIXELS):
        store.write_block(work.name, b, found[b.row : b.row + b.height, b.col : b.col + b.width])
    inside = found >= SURVEYED
    return {
        "gap": gap,
        "inside": int(inside.sum()),
        "cells": found.size,
        "blocks": block_runs(inside, spec, work.pixels, BLOCK_PIXELS),
        "checksum": checksum(found),
    }


LEAST_GAP = 6
"""Cells: a disk of a smaller diameter is not round."""
ENOUGH_CELLS = 4
"""Mean occupied cells of the squares, half a gap wide, that hold any: where there are so many, gaps are real."""


def gap_of(occupied: Bools, gap: float, most: float) -> float:
    """Cells of the widest gap that belongs to a survey: the usual one, doubled until points are not sparse in it.

    Parameters
    ----------
    occupied : bool, shape (height, width)
    gap, most : float
        Cells: the usual one, and the widest.
    """
    gap = max(gap, LEAST_GAP)
    rows, cols = np.nonzero(occupied)
    while gap < most and len(rows):
        side = int(gap / 2)
        squares = np.unique(rows // side * occupied.shape[1] + cols // side).size
        if len(rows) >= ENOUGH_CELLS * squares:
            break
        gap *= 2
    return min(gap, most)


def survey_of(occupied: Bools, gap: float) -> npt.NDArray[np.uint8]:
    """Values of the cells of a survey, see `tiler.core.products.BEYOND`.

    Parameters
    ----------
    occupied : bool, shape (height, width)
    gap : float
        Cells; gaps up to this width belong to the survey. Of wider ones those that are enclosed are voids.
    """
    radius = gap / 2
    pad = int(np.ceil(radius)) + 1
    closed = np.pad(occupied, pad)
    if closed.any():
        grown = within(closed, radius)
        closed |= ~within(~grown, radius)
    whole = scipy.ndimage.binary_fill_holes(closed)
    inner = scipy.ndimage.binary_erosion(whole, np.ones((3, 3), np.bool_))
    values = np.select([inner & ~closed, inner, whole], [VOID, SURVEYED, BORDER], BEYOND)
    found: npt.NDArray[np.uint8] = values[pad:-pad, pad:-pad].astype(np.uint8)
    return found


def block_runs(cells: Bools, coarse: RasterSpec, spec: RasterSpec, size: int, pad: int = 0) -> Runs:
    """The blocks of a raster that some coarse cells touch, or come within ``pad`` pixels of.

    Follows the cells: a raster that is mostly empty has far more blocks than these.

    Parameters
    ----------
    cells : bool, shape (height, width) of ``coarse``
    coarse, spec : RasterSpec
        Of the cells, and of the raster.
    size : int
        Of a block in pixels.
    pad : int

    Returns
    -------
    list of [int, int, int]
        First row of pixels of some blocks, first and last column of those that are neighbours in this row.
    """
    rows: dict[int, list[tuple[int, int]]] = {}
    for row in np.flatnonzero(cells.any(axis=1)).tolist():
        steps = np.flatnonzero(np.diff(cells[row], prepend=False, append=False)).reshape(-1, 2).tolist()
        for start, end in steps:
            box = covered(coarse, spec, Block(row, start, 1, end - start), pad)
            if box.height <= 0 or box.width <= 0:
                continue
            run = box.col // size * size, (box.col + box.width - 1) // size * size
            for top in range(box.row // size * size, box.row + box.height, size):
                rows.setdefault(top, []).append(run)
    return [[row, first, last] for row in sorted(rows) for first, last in _merged(rows[row], size)]


def _merged(runs: list[tuple[int, int]], size: int) -> list[tuple[int, int]]:
    """Runs of a row from west to east, merged where they overlap or touch."""
    found: list[tuple[int, int]] = []
    for first, last in sorted(set(runs)):
        if found and first <= found[-1][1] + size:
            found[-1] = found[-1][0], max(found[-1][1], last)
        else:
            found.append((first, last))
    return found


def blocks_of(runs: Runs, spec: RasterSpec, size: int) -> Iterator[Block]:
    """The blocks that `block_runs` found, row by row from the north-west."""
    for row, first, last in runs:
        for col in range(first, last + 1, size):
            yield spec.block_at(row, col, size)


def coarse_cells(coarse: RasterSpec, spec: RasterSpec, block: Block) -> tuple[npt.NDArray[np.int64], ...]:
    """Row and column of the coarse cell at each pixel's centre: int64 (height,) and (width,).

    The outermost cell where a centre lies beyond them, as it may where the sides do not divide one another.
    """
    p, q = spec.lattice.p, spec.lattice.q
    x = ((2 * (spec.west + block.col + np.arange(block.width, dtype=np.int64)) + 1) * p) // (2 * q)
    y = ((2 * (spec.north - 1 - block.row - np.arange(block.height, dtype=np.int64)) + 1) * p) // (2 * q)
    rows, cols = coarse.north - 1 - coarse.lattice.index(y), coarse.lattice.index(x) - coarse.west
    return np.clip(rows, 0, coarse.height - 1), np.clip(cols, 0, coarse.width - 1)


def coarse_values(
    store: TileStore, name: str, coarse: RasterSpec, spec: RasterSpec, block: Block
) -> npt.NDArray[np.float32]:
    """Values of a coarse raster at a block's pixels, float32 (height, width)."""
    rows, cols = coarse_cells(coarse, spec, block)
    top, left = int(rows.min()), int(cols.min())
    window = Block(top, left, int(rows.max()) - top + 1, int(cols.max()) - left + 1)
    return store.read_block(name, window)[np.ix_(rows - top, cols - left)]


def covered(coarse: RasterSpec, spec: RasterSpec, cells: Block, pad: int = 0) -> Block:
    """The pixels of a raster that some coarse cells touch, and ``pad`` more around them, as far as it reaches."""
    bounds: Bounds = coarse.block_bounds(cells)
    index = spec.lattice.index_of
    left, right = index(bounds.x0) - spec.west, index(bounds.x1 - 1) + 1 - spec.west
    top, bottom = spec.north - 1 - index(bounds.y1 - 1), spec.north - index(bounds.y0)
    left, top = max(left - pad, 0), max(top - pad, 0)
    return Block(top, left, min(bottom + pad, spec.height) - top, min(right + pad, spec.width) - left)
