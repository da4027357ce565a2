"""Search of a block for objects left in the terrain and for unsure places: what it reads, and their outlines.

`tiler.grid.object_candidates` and `tiler.grid.unsure_terrain` judge the terrain and the numbers of points. One search
does both, as the points take most of its time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from ptd.gridding.ground_cells import CellWindow, add_counts
from tiler.core.lattice import Lattice
from tiler.core.raster import Block
from tiler.grid.block_surroundings import PixelCells, PointsNear
from tiler.grid.ground import classed
from tiler.grid.object_candidates import (
    RING_CELLS,
    TOUCHING,
    Bools,
    Box,
    Candidates,
    Float64,
    Int64,
    Level,
    Limits,
    candidates,
    chances,
    chosen,
    measures_of,
    near_cells,
    reach_cells,
)
from tiler.grid.steps import Counts
from tiler.grid.unsure_terrain import (
    Shape,
    may_be_unsure,
    shape_of,
    squares_around,
    unsure_places,
)

CELL_M, MAX_CELL_M = 1.0, 2.0
"""Approximate and largest side of the cells in which the terrain is examined. In coarser pixels nothing is found."""
LEAST_PIXEL_M = 0.2
"""Side of the smallest pixels that are examined. The land around a block has too many smaller ones."""
MOST_CHANCE = 0.9
"""Largest chance that is told, as the constants of `Weights` are of simulated scenes."""
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


def left_objects(points: PointsNear, terrain: Float64, *, margin: int) -> tuple[None, Counts]:
    """Find the objects left in the terrain, and the unsure places, whose first cell begins in a block.

    Parameters
    ----------
    points : PointsNear
    terrain : float64 (height + 2 * margin, width + 2 * margin)
        Terrain of the block and of pixels around it.
    margin : int
        See `left_margin`.

    Returns
    -------
    None
    counts : dict
        ``objects``: for each its ``chance``, ``height_m``, ``steep`` and number of ``pixels``. Of its outline, which is
        `WIDER_CELLS` wider, the number of ``ground`` points, and ``rectangles``: first row, first column, last row and
        last column of pixels of runs of its cells. ``unsure``: see `_unsure`.
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
    found, levels = candidates(heights, cell_m, reach_cells(cell_m) - near_cells(cell_m))
    near = PixelCells(spec, block, side, near_cells(cell_m))
    is_here = _is_here(near, block, found.row, found.column)
    is_judged = _nested_with(found, levels, is_here & found.shaped(Limits()))
    squares = _squares(wide, PixelCells(spec, block, side, 0))
    shape = shape_of(heights[squares], cell_m)
    boxes = [squares] if may_be_unsure(shape.rise, cell_m).any() else []
    if is_judged.any():
        boxes.append(_shifted(_hull(found, levels, is_judged), _part(wide, near)))
    if not boxes:
        return None, {"objects": [], "unsure": []}
    counts = _counts(points, wide, _around(boxes))
    unsure = _unsure(wide, squares, block, shape, counts, cell_m)
    ground, objects = (n[_part(wide, near)] for n in counts)
    measures = measures_of(found, levels, ground, objects, cell_m)
    chance = np.where(is_judged, chances(measures), 0.0)
    places = _objects(found, levels, chance, is_here, ground, near)
    return None, {"objects": places, "unsure": unsure}


def _objects(
    found: Candidates,
    levels: list[Level],
    chance: Float64,
    is_here: Bools,
    ground: Int64,
    near: PixelCells,
) -> list[dict[str, Any]]:
    """Return the objects whose first cell begins in a block, with their outlines."""
    places = []
    for i, inside, box in chosen(found, levels, chance):
        if is_here[i]:
            outline, wider = _widened(inside, box)
            places.append(
                {
                    "chance": round(min(float(chance[i]), MOST_CHANCE), 3),
                    "height_m": round(float(found.height_m[i]), 2),
                    "steep": round(float(found.steep[i]), 3),
                    "ground": int(ground[wider][outline].sum()),
                    "pixels": int(inside.sum()) * near.side**2,
                    "rectangles": _rectangles(outline, wider, near.window, near.side),
                }
            )
    return places


def _unsure(
    wide: PixelCells,
    part: Box,
    block: Block,
    shape: Shape,
    counts: tuple[Int64, Int64],
    cell_m: float,
) -> list[dict[str, Any]]:
    """Return the unsure places in a part of the cells whose first cell begins in a block.

    Each has its ``chance``, mean ``rise_m``, ``gap_m`` and ``tilt``, share of ``objects``, number of ``pixels``, and
    ``rectangles`` as objects have.
    """
    ground, objects = (n[part] for n in counts)
    rows, columns = part
    corner = wide.north + rows.start, wide.west + columns.start
    found = unsure_places(shape, ground, objects, cell_m, corner)
    first = np.array([(p.row + rows.start, p.column + columns.start) for p in found])
    is_here = _is_here(wide, block, *first.reshape(-1, 2).T)
    return [
        {
            "chance": round(min(place.chance, MOST_CHANCE), 3),
            "rise_m": round(place.rise_m, 2),
            "gap_m": round(place.gap_m, 1),
            "tilt": round(place.tilt, 2),
            "objects": round(place.objects, 2),
            "pixels": int(place.cells.sum()) * wide.side**2,
            "rectangles": _rectangles(
                place.cells, _shifted(place.box, part), wide.window, wide.side
            ),
        }
        for place, here in zip(found, is_here, strict=True)
        if here
    ]


def _is_here(cells: PixelCells, block: Block, row: Int64, column: Int64) -> Bools:
    """Return a mask of the cells that begin in a block."""
    row = np.maximum(cells.window.row + row * cells.side, 0) - block.row
    column = np.maximum(cells.window.col + column * cells.side, 0) - block.col
    is_here: Bools = (row >= 0) & (row < block.height) & (column >= 0) & (column < block.width)
    return is_here


def _part(wide: PixelCells, cells: PixelCells) -> Box:
    """Return the rows and columns of some cells among those of a wider margin."""
    top, left = cells.north - wide.north, cells.west - wide.west
    rows, columns = (n // cells.side for n in (cells.window.height, cells.window.width))
    return slice(top, top + rows), slice(left, left + columns)


def _shifted(box: Box, part: Box) -> Box:
    """Return a box of the cells of a part as one of all cells."""
    return tuple(
        slice(own.start + whole.start, own.stop + whole.start)
        for own, whole in zip(box, part, strict=True)
    )


def _squares(wide: PixelCells, own: PixelCells) -> Box:
    """Return the cells that decide on the unsure places that may begin in those of a block."""
    ends = (
        squares_around(first, pixels // own.side)
        for first, pixels in (
            (own.north, own.window.height),
            (own.west, own.window.width),
        )
    )
    return tuple(
        slice(first - corner, stop - corner)
        for (first, stop), corner in zip(ends, (wide.north, wide.west), strict=True)
    )


def _around(boxes: list[Box]) -> Box:
    """Return the box around some."""
    return tuple(
        slice(min(part.start for part in parts), max(part.stop for part in parts))
        for parts in zip(*boxes, strict=True)
    )


def _nested_with(found: Candidates, levels: list[Level], some: Bools) -> Bools:
    """Return a mask of the candidates in the same widest candidate as one of some, which decide on each other."""
    widest = np.zeros((2, len(found.level)), np.int64)
    for i, level in reversed(list(enumerate(levels))):
        label = level.labels[found.row, found.column]
        widest = np.where(label > 0, (np.full_like(label, i), label), widest)
    number = widest[0] * (widest[1].max(initial=0) + 1) + widest[1]
    is_among: Bools = np.isin(number, number[some])
    return is_among


def _hull(found: Candidates, levels: list[Level], some: Bools) -> Box:
    """Return the rows and columns of some candidates and of the land around them."""
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
    # For eroded ground, objects around the bounds are held. Those of all buckets may not fit into memory.
    for cell in points.store.buckets_within(bounds):
        its = bounds.intersection(points.store.meta.bucket.bounds(cell))
        for bucket in classed(points.store, points.rule, its, objects=True):
            add_counts(ground, bucket.xyz, window, bucket.is_ground)
            add_counts(objects, bucket.xyz, window, bucket.is_object)
    return ground, objects


def _widened(inside: Bools, box: Box) -> tuple[Bools, Box]:
    """Return cells with those around them, and the box of all."""
    padded = np.pad(inside, WIDER_CELLS)
    wide = scipy.ndimage.binary_dilation(padded, TOUCHING, WIDER_CELLS)
    return wide, tuple(slice(p.start - WIDER_CELLS, p.stop + WIDER_CELLS) for p in box)


def _rectangles(inside: Bools, box: Box, window: Block, side: int) -> list[list[int]]:
    """Return first row, first column, last row and last column of pixels of each run of cells in a row."""
    steps = np.diff(np.pad(inside, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (rows, firsts), (_, ends) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    top = window.row + (rows + box[0].start) * side
    left, right = (window.col + (n + box[1].start) * side for n in (firsts, ends))
    runs: list[list[int]] = np.column_stack((top, left, top + side - 1, right - 1)).tolist()
    return runs
