"""Flaws of the terrain: places far above all returns or far below them, remaining roofs, and crowns."""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction
from itertools import chain
from typing import NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Float32, Float64
from ptd.gridding.above_ground import NOTHING
from ptd.ground.plateaus import ROOF_CELL_M, reach_m, remaining_roofs
from ptd.matched.crowns import BLOCK, Crowns, crowns
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.products import OUTLINED
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec, north_west
from tiler.core.units import length_text
from tiler.grid.block_surroundings import EditsNear, PointsNear, WatersNear
from tiler.grid.coarse import label_block, padded, padded_within
from tiler.grid.steps import Counts
from tiler.store import TileStore

ABOVE_M = 1.0
"""Height above the highest return of its pixel from which terrain counts as wrong."""
MIN_PLACE_M2 = Fraction(10)
"""Least area of a place. In smaller ones, the returns are often noise that the filter missed."""
BELOW_M = 2.0
"""Height of the lowest return of a pixel above the terrain from which the terrain counts as below all returns."""
CELLS_PER_BLOCK = 4
"""Number of cells along the side of a block in which pixels below all returns are counted."""


def above(
    points: PointsNear,
    terrain: Float64,
    waters: WatersNear,
    edits: EditsNear,
    *,
    reach: int,
    spike: Fraction,
    least: int,
    above_m: float,
) -> tuple[None, Counts]:
    """Find the places in a block where the terrain lies above all returns.

    Places are pixels that touch at sides or corners. Those count that are large enough or that touch a side of the
    block, as they may continue in the next one.

    Parameters
    ----------
    points : PointsNear
    terrain : float64 (height + 2, width + 2)
        Terrain of the block and of one pixel on each side.
    waters : WatersNear
    edits : EditsNear
    reach, spike
        See `PointsNear.returns`.
    least : int
        Number of pixels of the smallest place.
    above_m : float
        Height above the highest return of its pixel from which terrain counts as wrong, in metres.

    Returns
    -------
    None
    counts : dict
        ``wrong``: number of pixels in which the terrain is above all returns, also of those in places that are too
        small. ``labels``, ``sides``: number of places, and their labels along the sides of the block (see
        `tiler.grid.coarse`). ``places``: [pixels, spans, height] of each place, with the rows of its pixels (see
        `_spans`) and the largest height of its terrain above the returns in metres. ``cells``: see `_cells`.
    """
    heights_m, below_m = heights_above(
        points, terrain, waters.inside | edits.flat, reach, spike
    )
    wrong = heights_m > above_m
    labels, sides = label_block(_listed(wrong, least), corners=True)
    numbers = np.arange(1, int(labels.max(initial=0)) + 1)
    sizes = np.bincount(labels.ravel(), minlength=len(numbers) + 1)[1:]
    largest = scipy.ndimage.maximum(heights_m, labels, numbers) if len(numbers) else ()
    places, block = [], points.block
    boxes = scipy.ndimage.find_objects(labels)
    for number, size, height, box in zip(numbers, sizes, largest, boxes, strict=True):
        spans = _spans(
            labels[box] == number, block.row + box[0].start, block.col + box[1].start
        )
        places.append([int(size), spans, round(float(height), 3)])
    return None, {
        "wrong": int(np.count_nonzero(wrong)),
        "labels": len(places),
        "sides": sides,
        "places": places,
        "cells": _cells(block, below_m),
    }


def _spans(inside: Bool, row: int, col: int) -> list[list[int]]:
    """Return row, first and last column of each row of neighbouring pixels. The corner of ``inside`` is at row, col."""
    steps = np.diff(np.pad(inside, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (rows, firsts), (_, ends) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    spans: list[list[int]] = np.column_stack(
        (rows + row, firsts + col, ends - 1 + col)
    ).tolist()
    return spans


def _cells(block: Block, below_m: Float64) -> list[list[int]]:
    """Return row and column of each cell, its number of known pixels, and of those below all returns."""
    side, cells = BLOCK_PIXELS // CELLS_PER_BLOCK, []
    for row in range(0, block.height, side):
        for col in range(0, block.width, side):
            part = below_m[row : row + side, col : col + side]
            if known := int(np.count_nonzero(~np.isnan(part))):
                counts = known, int(np.count_nonzero(part > BELOW_M))
                cells.append([block.row + row, block.col + col, *counts])
    return cells


def heights_above(
    points: PointsNear, wider: Float64, excluded: Bool, reach: int, spike: Fraction
) -> tuple[Float64, Float64]:
    """Return the metres of the terrain of each pixel above the highest return, and below the lowest one.

    The terrain is that at the lowest corner of the pixel for the first, at the highest for the second.

    Pixels without a return or without terrain have 0 and NaN. So have ``excluded`` pixels: those of water, whose low
    returns are noise, and of edits that set a height. Other parameters are those of `above`.
    """
    highest, lowest = points.returns(points.block, reach, spike)
    returns, terrain = highest[..., 2], wider[1:-1, 1:-1]
    known = (returns != NOTHING) & ~np.isnan(terrain) & ~excluded
    half, metres = _half_rise(wider), float(points.frame.units.vertical)
    above = terrain - half - returns / COUNTS_PER_UNIT
    below = lowest / COUNTS_PER_UNIT - terrain - half
    return np.where(known, above * metres, 0.0), np.where(known, below * metres, np.nan)


def _half_rise(wider: Float64) -> Float64:
    """Return by how much the terrain falls from the centre of each pixel to its lowest corner.

    The only return of a pixel may lie there. The larger of the two steps to the neighbours
    counts along each axis; pixels without terrain have no step. ``wider`` has one pixel more on
    each side than the result, and NaN where there is no terrain.
    """
    centre = wider[1:-1, 1:-1]
    rise = np.zeros_like(centre)
    for before, after in (
        (wider[:-2, 1:-1], wider[2:, 1:-1]),
        (wider[1:-1, :-2], wider[1:-1, 2:]),
    ):
        step = np.fmax(np.abs(centre - before), np.abs(centre - after))
        rise += np.nan_to_num(step) / 2
    return rise


def min_pixels(pixel_m2: Fraction) -> int:
    """Return the number of pixels of the smallest place."""
    return math.ceil(MIN_PLACE_M2 / pixel_m2)


def _listed(wrong: Bool, least: int) -> Bool:
    """Return the mask of the places with at least ``least`` pixels and of those at a side of the block."""
    labels, sides = label_block(wrong, corners=True)
    listed = np.bincount(labels.ravel()) >= least
    listed[[label for side in sides.values() for label, _ in side]] = True
    listed[0] = False
    return listed[labels]


TOO_WIDE = 0.8
"""Share of ``max_building_size`` from which the width of a roof in the terrain causes a
warning."""
PART_CELLS = 500
"""Side in cells of the parts in which terrain is examined. One part is in memory at a time."""
STRIP_ROWS = 512
"""Rows of pixels of a part that are read in one batch."""


class Advice(NamedTuple):
    """Warning about a position in the terrain, with x and y in units of the CRS."""

    text: str
    x: float
    y: float


def find_roofs(
    store: TileStore,
    *,
    spec: RasterSpec,
    filled: tuple[str, ...],
    building_m: float,
    roof_m: float | None,
    waters: str | None,
) -> Counts:
    """Search for roofs on a worker, which has loaded the kernels. The ``advice`` is a warning, or None.

    The arguments are those of `roofs_in_terrain`, with ``filled`` as the names of blocks.
    """
    blocks = (spec.block_named(key, BLOCK_PIXELS) for key in filled)
    return {
        "advice": roofs_in_terrain(store, OUTLINED, spec, blocks, building_m, roof_m, waters)
    }


def roofs_in_terrain(
    store: TileStore,
    name: str,
    spec: RasterSpec,
    filled: Iterable[Block],
    building_m: float,
    roof_m: float | None = None,
    waters: str | None = None,
) -> Advice | None:
    """Return a warning if the terrain has a roof that is too wide for the settings, else None.

    Parameters
    ----------
    store : TileStore
    name : str
        Name of the raster of the terrain.
    spec : RasterSpec
    filled : iterable of Block
        Blocks with heights. Other blocks are not examined.
    building_m : float
        Setting ``max_building_size`` of the method in metres.
    roof_m : float, optional
        Widest roof for which the method itself searches, in metres.
    waters : str, optional
        Key in the store of bodies of water. Their heights do not count, because land next to water is higher and would
        look like a roof.
    """
    frame = store.meta.frame
    pixel = float(spec.lattice.size * frame.metres_xy)
    times = max(int(ROOF_CELL_M / pixel), 1)
    core, pad = PART_CELLS * times, math.ceil(reach_m(pixel * times) / pixel / times) * times
    widest, where = 0.0, None
    parts = {
        part
        for block in filled
        for part in spec.blocks_within(spec.block_bounds(padded(block, pad)), core)
    }
    for block in sorted(parts, key=north_west):
        window = padded_within(block, pad, spec)
        part = _part(store, name, waters, spec, window, times)
        heights = np.where(part == np.float32(NODATA), np.nan, part) * float(
            frame.units.vertical
        )
        for roof in remaining_roofs(heights, pixel * times, TOO_WIDE * building_m):
            if roof.width_m > widest:
                widest = roof.width_m
                row, column = int(roof.row * times), int(roof.column * times)
                where = window.row + row, window.col + column
    if where is None:
        return None
    x, y = _place(spec, *where)
    unit = frame.units.horizontal
    setting, metres = "max_building_size", building_m
    if roof_m is not None and widest > roof_m:
        setting, metres = "roof_size", roof_m
    suggested_m = math.ceil(1.2 * max(widest, metres) / 10) * 10
    wide = length_text(round(widest), unit)
    text = (
        f"the terrain holds what looks like a roof {wide} wide, at x {x:.0f}, y {y:.0f}, and {setting} "
        f"is {length_text(metres, unit)}; if it is one, use --set {setting}={suggested_m}"
    )
    return Advice(text, x, y)


def _place(spec: RasterSpec, row: int, col: int) -> tuple[float, float]:
    a, _, x, _, e, y = spec.transform(COUNTS_PER_UNIT)
    return x + a * col, y + e * row


def _part(
    store: TileStore, name: str, waters: str | None, spec: RasterSpec, part: Block, times: int
) -> Float64:
    """Return the thinned heights of a part, read strip by strip. Water has none."""
    step = max(STRIP_ROWS // times, 1) * times
    last = part.row + part.height
    rows = []
    for row in range(part.row, last, step):
        strip = Block(row, part.col, min(step, last - row), part.width)
        heights = store.read_block(name, strip)
        bodies = store.waters(waters, spec.block_bounds(strip))
        if bodies is not None:
            heights[bodies.inside(spec, strip)] = NODATA
        rows.append(thinned(heights, times))
    return np.concatenate(rows)


def thinned(heights: Float32, times: int) -> Float64:
    """Return the height of one pixel per ``times`` by ``times``. Unlike averaging, thinning keeps steep edges."""
    return heights[times // 2 :: times, times // 2 :: times].astype(np.float64)


CELL_M, MAX_CELL_M = 1.0, 1.25
"""Approximate and largest side of the cells for the search. Finer pixels are thinned, coarser
pixels hide crowns."""
MIN_SHARE, MIN_BLOCKS = 0.1, 10
"""Least share of the terrain and least number of blocks (0.06 ha each) that look like crowns
for a warning."""


def find_crowns(store: TileStore, *, spec: RasterSpec, names: tuple[str, ...]) -> Counts:
    """Search blocks of the terrain for crowns: ``n_tested`` and ``found`` of `ptd.matched.crowns.Crowns`."""
    blocks = [spec.block_named(name, BLOCK_PIXELS) for name in names]
    parts = [crowns_in_block(store, OUTLINED, spec, block) for block in blocks]
    return {
        "n_tested": sum(part.n_tested for part in parts),
        "found": list(chain.from_iterable(part.found for part in parts)),
    }


def crowns_in_block(store: TileStore, name: str, spec: RasterSpec, block: Block) -> Crowns:
    """Find the positions in a block of the terrain that look like crowns, as pixels of the raster.

    Parameters
    ----------
    store : TileStore
    name : str
        Name of the raster of the terrain.
    spec : RasterSpec
    block : Block
    """
    times = _thinning(store, spec)
    if times is None:
        return Crowns(0, [])
    heights = thinned(store.read_block(name, block), times)
    metres = np.where(heights == np.float32(NODATA), np.nan, heights)
    cells = crowns(metres * float(store.meta.frame.units.vertical))
    top, left = (first + BLOCK * times // 2 for first in (block.row, block.col))
    pixels = [(top + row * times, left + column * times) for row, column in cells.found]
    return Crowns(cells.n_tested, pixels)


def crown_advice(parts: Iterable[Crowns], spec: RasterSpec) -> Advice | None:
    """Return a warning if `MIN_SHARE` of the terrain and `MIN_BLOCKS` blocks look like crowns, else None."""
    looked_at = 0
    pixels: list[tuple[int, int]] = []
    for part in parts:
        looked_at += part.n_tested
        pixels += part.found
    if len(pixels) < max(MIN_SHARE * looked_at, MIN_BLOCKS):
        return None
    x, y = _place(spec, *pixels[len(pixels) // 2])
    text = (
        f"{100 * len(pixels) / looked_at:.0f} % of the terrain looks like crowns of a closed canopy and may be metres "
        f"too high, as around x {x:.0f}, y {y:.0f}; remove these areas (--edits, action void) or survey them with LiDAR"
    )
    return Advice(text, x, y)


def _thinning(store: TileStore, spec: RasterSpec) -> int | None:
    """Return the number of pixels along a cell of about a metre, or None if pixels are too coarse."""
    pixel = float(spec.lattice.size * store.meta.frame.metres_xy)
    times = max(round(CELL_M / pixel), 1)
    return times if pixel * times <= MAX_CELL_M else None
