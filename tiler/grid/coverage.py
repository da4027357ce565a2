"""Coarse raster of the extent of the survey, which distinguishes voids inside it from the area outside.

A coarse cell is occupied if it holds a point that counts as surface. Gaps up to a width, 20 m or more where points are
sparse (`gaps_of`), belong to the survey (a closing by a disk of half that width); so does whatever is enclosed, however
wide. What remains is outside. Each block is closed on its own, with a margin; its open areas are joined with those of
its neighbours, which says what is enclosed (`tiler.grid.tasks.survey`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.classes import WATER
from tiler.core.products import BEYOND, BORDER, SURVEYED, VOID
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.grid.checksum import checksum
from tiler.grid.coarse import Bools, block_runs, padded
from tiler.grid.density import pixel_indices
from tiler.grid.ground import surface_points
from tiler.grid.pieces import Piece, cells_of, label_block, part_of
from tiler.grid.reach import box_around, within
from tiler.grid.returns import histograms
from tiler.grid.work import BlockWork, PointsBlock
from tiler.store import open_store, read_cells

WINDOW = 128
"""Side of the windows in coarse cells, anchored at CRS coordinate 0; each window has its own widest gap."""
MIN_GAP = 6
"""Cells: a disk of a smaller diameter is not round."""
ENOUGH_CELLS = 4
"""Mean occupied cells of the squares, half a gap wide, that hold any: where there are so many, gaps are real."""
NO_PIECE = -1.0
"""What a raster of open areas holds where no block was written: all is open there."""


@dataclass(frozen=True, kw_only=True)
class CloseBlock(BlockWork):
    """Work: one block of the raster of the open areas, which lie in no gap of the survey.

    Attributes
    ----------
    occupancy : str
        Name of the raster of occupied cells.
    gap, most_gap : float
        Cells: a gap that belongs to every survey, and the widest that belongs to one of sparse points.
    """

    occupancy: str
    gap: float
    most_gap: float


@dataclass(frozen=True, kw_only=True)
class SurveyBlock(BlockWork):
    """Work: one block of the extent of the survey.

    Attributes
    ----------
    opened : str
        Name of the raster of open areas.
    outside : tuple of Piece
        Open areas of this block and of its neighbours that are not enclosed by the survey.
    empty : tuple of (row, column)
        Those of these blocks that hold nothing and are enclosed.
    pixels : RasterSpec
        Of the products.
    """

    opened: str
    outside: tuple[Piece, ...]
    empty: tuple[tuple[int, int], ...]
    pixels: RasterSpec


def occupancy_block(store_url: str, work: PointsBlock) -> dict[str, Any]:
    """Write one block of the raster of occupied cells; a `tiler.schedule.task.Work`.

    A cell has the number of its points; below 0 where more than half of them are water by the input.

    Returns
    -------
    dict
        ``filled`` (occupied cells), ``water`` (cells that are water by the input); ``returns``: histograms of the
        points in a cell, see `tiler.grid.returns`; ``checksum``.
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
    shape = block.height, block.width
    values = np.where(2 * water > counts, -counts, counts).astype(np.float32).reshape(shape)
    store.write_block(work.name, block, values)
    return {
        "filled": int(np.count_nonzero(values)),
        "water": int((values < 0).sum()),
        "returns": histograms(counts.reshape(shape)),
        "checksum": checksum(values),
    }


def close_block(store_url: str, work: CloseBlock) -> dict[str, Any]:
    """Label the open areas of one block; a `tiler.schedule.task.Work`. Writes their labels, 0 where none is.

    Returns
    -------
    dict
        ``sides`` and ``labels`` (their number), see `tiler.grid.pieces`; ``gaps``: width of each gap in cells that
        windows with points have, and the number of these windows; ``filled``; ``checksum``.
    """
    store, block = open_store(store_url), work.block
    pad = max(WINDOW, 2 * int(np.ceil(work.most_gap / 2)) + 2)
    occupied = read_cells(store, work.occupancy, work.spec, padded(block, pad)) != 0
    gaps = gaps_of(occupied[pad - WINDOW : pad + block.height + WINDOW, pad - WINDOW : pad + block.width + WINDOW],
                   work.gap, work.most_gap)  # fmt: skip
    closed = closed_cells(occupied, gaps, pad)
    labels, sides = label_block(~closed, corners=False)
    values = labels.astype(np.float32)
    store.write_block(work.name, block, values)
    inner = occupied[pad : pad + block.height, pad : pad + block.width]
    held = inner.reshape(len(gaps), WINDOW, -1, WINDOW).any(axis=(1, 3))
    widths, windows = np.unique(gaps[held], return_counts=True)
    return {
        "sides": sides,
        "labels": int(labels.max(initial=0)),
        "gaps": [[float(width), int(n)] for width, n in zip(widths, windows, strict=True)],
        "filled": values.size,
        "checksum": checksum(values),
    }


def gaps_of(occupied: Bools, gap: float, most: float) -> npt.NDArray[np.float64]:
    """Widest gap that belongs to the survey in each window: the usual one, doubled until points are not sparse in it.

    A window is judged with the eight windows around it.

    Parameters
    ----------
    occupied : bool, shape (height, width)
        Cells of whole windows; the outermost windows serve as neighbours.
    gap, most : float
        Cells: the usual gap, and the widest.

    Returns
    -------
    float64, shape (height / 128 - 2, width / 128 - 2)
    """
    rows, cols = (side // WINDOW - 2 for side in occupied.shape)
    found = np.full((rows, cols), min(max(gap, MIN_GAP), most))
    for row, col in np.ndindex(rows, cols):
        near = occupied[row * WINDOW : (row + 3) * WINDOW, col * WINDOW : (col + 3) * WINDOW]
        found[row, col] = gap_of(near, gap, most)
    return found


def gap_of(occupied: Bools, gap: float, most: float) -> float:
    """Cells of the widest gap that belongs to a survey: the usual one, doubled until points are not sparse in it.

    Parameters
    ----------
    occupied : bool, shape (height, width)
    gap, most : float
        Cells: the usual one, and the widest.
    """
    gap = max(gap, MIN_GAP)
    rows, cols = np.nonzero(occupied)
    while gap < most and len(rows):
        side = int(gap / 2)
        squares = np.unique(rows // side * occupied.shape[1] + cols // side).size
        if len(rows) >= ENOUGH_CELLS * squares:
            break
        gap *= 2
    return min(gap, most)


def closed_cells(occupied: Bools, gaps: npt.NDArray[np.float64], pad: int) -> Bools:
    """Cells of a block that hold points or lie in a gap that belongs to the survey.

    Parameters
    ----------
    occupied : bool, shape (height + 2 pad, width + 2 pad)
    gaps : float64, shape (height / 128, width / 128)
        See `gaps_of`.
    pad : int
        Cells around the block.
    """
    closed = occupied[pad : len(occupied) - pad, pad : occupied.shape[1] - pad].copy()
    if not occupied.any():
        return closed
    wide = np.kron(gaps, np.ones((WINDOW, WINDOW)))
    for gap in np.unique(gaps):
        radius = gap / 2
        filled = within(occupied, radius)
        part = box_around(filled, 1)  # beyond it nothing is filled
        filled[part] = ~within(~filled[part], radius)
        closed |= filled[pad : len(occupied) - pad, pad : occupied.shape[1] - pad] & (wide == gap)
    return closed


def survey_block(store_url: str, work: SurveyBlock) -> dict[str, Any]:
    """Write one block of the survey, see `tiler.core.products.BEYOND`; a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``inside`` and ``cells``; ``blocks``: `block_runs` of the products' blocks that hold some of its inside;
        ``filled``; ``checksum``.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    window = padded(block, 1)
    opened = read_cells(store, work.opened, spec, window, NO_PIECE)
    enclosed = (opened > 0) & ~cells_of(store, work.opened, spec, window, work.outside)
    for place in work.empty:
        enclosed[part_of(window, *place)] = True
    found = survey_values(opened == 0, enclosed)[1:-1, 1:-1].astype(np.float32)
    store.write_block(work.name, block, found)
    inside = found >= SURVEYED
    return {
        "inside": int(inside.sum()),
        "cells": found.size,
        "blocks": block_runs(inside, spec.window(block), work.pixels, BLOCK_PIXELS),
        "filled": int(np.count_nonzero(found)),
        "checksum": checksum(found),
    }


def survey_values(closed: Bools, enclosed: Bools) -> npt.NDArray[np.uint8]:
    """Values of the cells of a survey, see `tiler.core.products.BEYOND`.

    Parameters
    ----------
    closed, enclosed : bool, shape (height, width)
        Cells with points and of narrow gaps, and those that are enclosed by such.
    """
    whole = closed | enclosed
    inner = scipy.ndimage.binary_erosion(whole, np.ones((3, 3), np.bool_))
    values = np.select([inner & ~closed, inner, whole], [VOID, SURVEYED, BORDER], BEYOND)
    found: npt.NDArray[np.uint8] = values.astype(np.uint8)
    return found
