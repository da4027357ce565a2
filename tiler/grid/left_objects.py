"""Search of a block for objects left in the terrain and for unsure places: what it reads, and their outlines.

`tiler.grid.object_candidates` and `tiler.grid.unsure_terrain` judge the terrain and the numbers of points. One search
does both, as the points take most of its time.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Float64, Int64
from ptd.gridding.ground_cells import CellWindow, add_counts
from tiler.core.lattice import Lattice
from tiler.core.raster import Block
from tiler.grid.block_surroundings import PixelCells, PointsNear
from tiler.grid.ground import classed
from tiler.grid.object_candidates import (
    MOST_CHANCE,
    RING_CELLS,
    TOUCHING,
    Box,
    Candidates,
    Level,
    Limits,
    candidates,
    chances,
    chosen,
    measures_of,
    near_cells,
    reach_cells,
)
from tiler.grid.sigma import LASER
from tiler.grid.steps import Counts
from tiler.grid.unsure_terrain import SEARCHES, may_be_unsure, shape_of, unsure_places

CELL_M, MAX_CELL_M = 1.0, 2.0
"""Approximate and largest side of the cells in which the terrain is examined. In coarser pixels nothing is found."""
LEAST_PIXEL_M = 0.2
"""Side of the smallest pixels that are examined. The land around a block has too many smaller ones."""
WIDER_CELLS = 2
"""Number of cells by which the outline is wider. Points beside the place would span the object again after an edit."""


def left_margin(pixel_m: float) -> int:
    """Return the margin in pixels around a block that `left_objects` needs."""
    side = _side(pixel_m)
    return 0 if side is None else (reach_cells(side * pixel_m) + 1) * side


def _side(pixel_m: float) -> int | None:
    """Return the side of a cell in pixels, or None if pixels are too small or too coarse."""
    side = max(round(CELL_M / pixel_m), 1)
    return side if pixel_m >= LEAST_PIXEL_M and side * pixel_m <= MAX_CELL_M else None


def left_objects(
    points: PointsNear, terrain: Float64, kind: str, *, margin: int
) -> tuple[None, Counts]:
    """Find the objects left in the terrain, and the unsure places, whose first cell begins in a block.

    In photogrammetric clouds, the search for objects finds too much that is right, so it is left out.

    Parameters
    ----------
    points : PointsNear
    terrain : float64 (height + 2 * margin, width + 2 * margin)
        Terrain of the block and of pixels around it.
    kind : str
        Kind of the clouds, one of `SEARCHES`.
    margin : int
        See `left_margin`.

    Returns
    -------
    None
    counts : dict
        ``objects``: for each its ``chance``, ``height_m``, ``steep`` and number of ``pixels``. Of its outline, which is
        `WIDER_CELLS` wider, the number of ``ground`` points, and ``rectangles``: first row, first column, last row and
        last column of pixels of runs of its cells.
        ``unsure``: for each what `unsure_places` tells, its number of ``pixels`` and ``rectangles``.
    """
    spec, block, frame = points.spec, points.block, points.frame
    pixel_m = float(spec.lattice.size * frame.metres_xy)
    side = _side(pixel_m)
    if side is None:
        return None, {"objects": [], "unsure": []}
    cell_m = side * pixel_m
    wide = PixelCells(spec, block, side, reach_cells(cell_m))
    top, left = wide.window.row - block.row + margin, wide.window.col - block.col + margin
    pixels = terrain[top : top + wide.window.height, left : left + wide.window.width]
    heights = wide.means(pixels, ~np.isnan(pixels)) * float(frame.units.vertical)
    cells = PixelCells(spec, block, side, near_cells(cell_m))
    judged = _judged(heights, cell_m, cells, block) if kind == LASER else None
    row, column = cells.north - wide.north, cells.west - wide.west
    shape = shape_of(heights[row:-row, column:-column], cell_m)
    box: Box = tuple(slice(0, n) for n in shape.rise.shape)
    if not may_be_unsure(shape.rise, cell_m, SEARCHES[kind]).any():
        if judged is None or not judged.mask.any():
            return None, {"objects": [], "unsure": []}
        box = _hull(judged)
    ground, objects = _counts(points, cells, box)
    places = []
    if judged is not None:
        places = _objects(judged, ground, objects, cells, block, cell_m)
    corner = cells.north, cells.west
    unsure = [
        {
            **place.told,
            "pixels": int(place.cells.sum()) * side**2,
            "rectangles": _rectangles(place.cells, place.box, cells.window, side),
        }
        for place in unsure_places(shape, ground, objects, cell_m, SEARCHES[kind], corner)
        if _is_here(cells, block, place.row, place.column)
    ]
    return None, {"objects": places, "unsure": unsure}


class _Judged(NamedTuple):
    """Candidates of a block, with a mask of those that begin in it or decide on one that does."""

    found: Candidates
    levels: list[Level]
    mask: Bool


def _judged(heights: Float64, cell_m: float, cells: PixelCells, block: Block) -> _Judged:
    """Return the candidates for objects among the cells near a block."""
    found, levels = candidates(heights, cell_m, reach_cells(cell_m) - near_cells(cell_m))
    begin_here = _is_here(cells, block, found.row, found.column)
    mask = _nested_with(found, levels, begin_here & found.shaped(Limits()))
    return _Judged(found, levels, mask)


def _objects(
    judged: _Judged,
    ground: Int64,
    objects: Int64,
    cells: PixelCells,
    block: Block,
    cell_m: float,
) -> list[Counts]:
    """Return what `left_objects` tells of the objects that begin in a block."""
    found, levels, mask = judged
    measures = measures_of(found, levels, ground, objects, cell_m)
    chance = np.where(mask, chances(measures), 0.0)
    return [
        {
            "chance": round(min(float(chance[i]), MOST_CHANCE), 3),
            "height_m": round(float(found.height_m[i]), 2),
            "steep": round(float(found.steep[i]), 3),
            "ground": int(ground[wider][outline].sum()),
            "pixels": int(inside.sum()) * cells.side**2,
            "rectangles": _rectangles(outline, wider, cells.window, cells.side),
        }
        for i, inside, own in chosen(found, levels, chance)
        if _is_here(cells, block, found.row[i], found.column[i])
        for outline, wider in [_widened(inside, own)]
    ]


def _is_here(cells: PixelCells, block: Block, row: Any, column: Any) -> Any:
    """Return whether cells begin in a block. Those that begin before the raster count as its first."""
    row = np.maximum(cells.window.row + row * cells.side, 0) - block.row
    column = np.maximum(cells.window.col + column * cells.side, 0) - block.col
    return (row >= 0) & (row < block.height) & (column >= 0) & (column < block.width)


def _nested_with(found: Candidates, levels: list[Level], some: Bool) -> Bool:
    """Return a mask of the candidates in the same widest candidate as one of some, which decide on each other."""
    widest = np.zeros((2, len(found.level)), np.int64)
    for i, level in reversed(list(enumerate(levels))):
        label = level.labels[found.row, found.column]
        widest = np.where(label > 0, (np.full_like(label, i), label), widest)
    number = widest[0] * (widest[1].max(initial=0) + 1) + widest[1]
    return np.isin(number, number[some])


def _hull(judged: _Judged) -> Box:
    """Return the rows and columns of the judged candidates and of the land around them."""
    found, levels, some = judged
    boxes = [scipy.ndimage.find_objects(level.labels) for level in levels]
    rows, columns = zip(
        *(boxes[found.level[i]][found.label[i] - 1] for i in np.flatnonzero(some)), strict=True
    )
    shape = levels[0].labels.shape
    return tuple(
        slice(
            max(min(part.start for part in parts) - RING_CELLS, 0),
            min(max(part.stop for part in parts) + RING_CELLS, size),
        )
        for parts, size in zip((rows, columns), shape, strict=True)
    )


def _counts(points: PointsNear, cells: PixelCells, box: Box) -> tuple[Int64, Int64]:
    """Count the ground points and the others in each cell of a box, 0 elsewhere."""
    pixels, side, spec = cells.window, cells.side, points.spec
    rows, columns = box
    part = Block(
        pixels.row + rows.start * side,
        pixels.col + columns.start * side,
        (rows.stop - rows.start) * side,
        (columns.stop - columns.start) * side,
    )
    lattice = Lattice(spec.lattice.size * side)
    shape = pixels.height // side, pixels.width // side
    place = cells.west, -cells.north - 1, *shape
    window = CellWindow(lattice.p, lattice.q, *place, *points.frame.origin)
    ground, objects = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    bounds = spec.block_bounds(part)
    for bucket in classed(points.store, points.rule, bounds, objects=True):
        add_counts(ground, bucket.xyz, window, bucket.is_ground)
        add_counts(objects, bucket.xyz, window, bucket.is_object)
    return ground, objects


def _widened(inside: Bool, box: Box) -> tuple[Bool, Box]:
    """Return cells with those around them, and the box of all."""
    padded = np.pad(inside, WIDER_CELLS)
    wide = scipy.ndimage.binary_dilation(padded, TOUCHING, WIDER_CELLS)
    return wide, tuple(slice(p.start - WIDER_CELLS, p.stop + WIDER_CELLS) for p in box)


def _rectangles(inside: Bool, box: Box, window: Block, side: int) -> list[list[int]]:
    """Return first row, first column, last row and last column of pixels of each run of cells in a row."""
    steps = np.diff(np.pad(inside, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (rows, firsts), (_, ends) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    top = window.row + (rows + box[0].start) * side
    left, right = (window.col + (n + box[1].start) * side for n in (firsts, ends))
    runs: list[list[int]] = np.column_stack((top, left, top + side - 1, right - 1)).tolist()
    return runs
