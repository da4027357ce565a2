"""Polygon of a body of water, made from its coarse cells, and its kind (lake or river)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import scipy
import shapely

from ptd.arrays import Bool, Float64, Int64
from tiler.core.area import Area
from tiler.core.products import BEYOND
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec
from tiler.core.water import LAKE, RIVER, Water
from tiler.grid.coarse import Piece, box_around, cells_of, components, padded
from tiler.grid.records import GroundSelection
from tiler.grid.river import area_of
from tiler.grid.steps import Counts
from tiler.grid.water_cells import WaterCells
from tiler.grid.water_extent import SPECK_CELLS, smoothed, water_heights
from tiler.grid.water_plants import REED, has_no_bank, is_hidden
from tiler.grid.water_search import SearchRasters, read_search_cells
from tiler.grid.water_shore import (
    BANK_MARGIN,
    MAX_HEIGHT_M,
    NO_DETAILS,
    REACH_CELLS,
    Shore,
    ShoreDetails,
    bank_rises,
    dense_quays,
    heights_above_water,
    highest_near,
    lower_level,
    shore_details,
    shore_polygons,
)
from tiler.store import TileStore, read_cells

ROUND = 1 / 3
"""Water with at most one exit from the survey is a lake if it is at least this round. Other water is a river.

Roundness is 4 pi area / (shore length)^2, which is 1 for a disk.
"""
MIN_LENGTH = 3
"""A river is assumed to be at least this many times as long as the least width of a river.

An area is left out if it is smaller than both the smallest lake and a river of the least length
and width.
"""
SIMPLER = 0.15
"""A simplified polygon is at most this far from the shore, in cells."""
ONE_EXIT = 5
"""Cells of water at the border of the survey belong to the same exit if they are at most this
far apart, in cells."""
MAX_BAY_M = 100.0
"""Bays of the border of the survey up to this width are filled with water, in metres."""


@dataclass(frozen=True)
class BodyCells:
    """Cells of a body of water, and what its shape is made from.

    Attributes
    ----------
    pieces : tuple of Piece
        Pieces of the body of water.
    water : str
        Raster of the labels of water.
    crowns : str
        Raster of the plants near water.
    sources : SearchRasters
    rule : GroundSelection
    coarse : RasterSpec
        Raster of the coarse cells.
    island_m2 : float
        Least area of an island to keep.
    """

    pieces: tuple[Piece, ...]
    water: str
    crowns: str
    sources: SearchRasters
    rule: GroundSelection
    coarse: RasterSpec
    island_m2: float


def describe_body(
    store: TileStore,
    *,
    cells: BodyCells,
    confidence: float,
    lake_m2: float,
    river_width_m: float,
) -> Counts:
    """Describe a body of water, block by block.

    Parameters
    ----------
    store : TileStore
    cells : BodyCells
    confidence : float
        Confidence that this is water.
    lake_m2 : float
        Least area of a lake.
    river_width_m : float
        Least width of a river.

    Returns
    -------
    dict
        ``body``: the water without a level and with the number 0 (`Water.to_json`), or None if it is too small.
    """
    coarse = cells.coarse
    size_m = float(coarse.lattice.size * store.meta.frame.metres_xy)
    border_cells = [np.empty((0, 2), np.int64)]
    n_border_sides, n_cells = 0, 0
    for block, body_mask in _blocks(store, cells):
        beyond = (
            read_cells(store, cells.sources.domain, coarse, padded(block, 1), float(BEYOND))
            == BEYOND
        )
        border_mask, n_sides = _survey_border(body_mask, beyond)
        border_cells.append(np.argwhere(border_mask) + (block.row, block.col))
        n_border_sides += n_sides
        n_cells += int(body_mask[1:-1, 1:-1].sum())
    side = float(coarse.lattice.size)
    exits = _exits(np.concatenate(border_cells))
    bays = _bays(store, cells, exits, MAX_BAY_M / size_m)
    whole = _whole(store, cells, bays, None)
    outline = shapely.get_exterior_ring(shapely.get_parts(whole))
    # Where water leaves the survey, the outline of its cells is not shore.
    length_m = (float(shapely.length(outline).sum()) / side - n_border_sides) * size_m
    area_m2 = n_cells * size_m**2
    kind, width_m = _kind(area_m2, length_m, size_m, len(exits))
    small = area_m2 < lake_m2 if kind == LAKE else width_m < river_width_m
    body = None
    if not small:
        lower_level_m = _lower_level(store, cells) if kind == LAKE else None
        if lower_level_m is not None:
            whole = _whole(store, cells, bays, lower_level_m)
        # The details of the shore are added after the kind is decided, because they make the
        # shore longer.
        detailed = _detailed(store, cells, whole, lower_level_m)
        body = Water(0, kind, _area(detailed, side), confidence=confidence).to_json()
    return {"body": body}


def _whole(store: TileStore, body: BodyCells, bays: Any, lower_level_m: float | None) -> Any:
    """Return the shape of a body as drawn from coarse cells, in counts.

    If ``lower_level_m`` is not None, higher levels are lowered to it.
    """
    side = float(body.coarse.lattice.size)
    min_area = body.island_m2 / float(store.meta.frame.metres_xy) ** 2
    of_blocks = (
        _polygons(store, body, block, lower_level_m) for block, _ in _blocks(store, body)
    )
    polygons = list(chain.from_iterable(of_blocks))
    water = _without_islands(shapely.union_all(polygons), min_area)
    # Small islands are removed before bays are added. So land that is enclosed only after a bay
    # was added stays, unless it is a speck.
    return _without_islands(shapely.union(water, bays), SPECK_CELLS * side**2)


def _detailed(
    store: TileStore, body: BodyCells, whole: Any, lower_level_m: float | None
) -> Any:
    """Return the shape of a body with the details of its shore, without specks."""
    side = float(body.coarse.lattice.size)
    details = [_details(store, body, block, lower_level_m) for block, _ in _blocks(store, body)]
    water = shapely.union_all([whole, *(shore.wet for shore in details)])
    water = shapely.difference(water, shapely.union_all([shore.dry for shore in details]))
    detailed = _without_specks(
        _without_islands(water, SPECK_CELLS * side**2), SPECK_CELLS * side**2
    )
    return whole if shapely.is_empty(detailed) else detailed


def _lower_level(store: TileStore, body: BodyCells) -> float | None:
    """Return the lower level of a lake with two levels in metres, or None (see `tiler.grid.water_shore`)."""
    heights, rises = [np.empty(0)], [np.empty(0)]
    for block, body_mask in _blocks(store, body):
        window = padded(block, 3)
        wet = cells_of(store, body.water, body.coarse, window, body.pieces)
        in_block = np.pad(body_mask, 2)
        cells = read_search_cells(store, body.sources, body.coarse, window)
        crowns = read_cells(store, body.crowns, body.coarse, window)
        is_measured = (cells.returns > 0) & (crowns == 0) & ~np.isnan(cells.ground)
        is_measured &= scipy.ndimage.binary_erosion(wet, np.ones((3, 3), np.bool_))
        heights.append(cells.ground[in_block & is_measured])
        rises.append(bank_rises(cells.ground, wet, in_block))
    return lower_level(np.concatenate(heights), np.concatenate(rises))


def _blocks(store: TileStore, body: BodyCells) -> Iterator[tuple[Block, Bool]]:
    """Yield the blocks of a body, each with a mask of its cells and an empty margin of one cell."""
    for row, col in sorted({(piece.row, piece.col) for piece in body.pieces}):
        block = body.coarse.block_at(row, col, BLOCK_PIXELS)
        yield block, np.pad(cells_of(store, body.water, body.coarse, block, body.pieces), 1)


def _survey_border(body: Bool, beyond: Bool) -> tuple[Bool, int]:
    """Return a mask of the cells of water at the border of the survey, and the number of their sides on the border."""
    border_mask = np.zeros_like(body)
    n_sides = 0
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        edge = body & np.roll(beyond, step, axis)
        n_sides += int(edge.sum())
        border_mask |= edge
    return border_mask[1:-1, 1:-1], n_sides


def _exits(cells: Int64) -> list[Int64]:
    """Group the cells of water at the border of the survey, int64 (n, 2), into exits."""
    if not len(cells):
        return []
    near = scipy.spatial.cKDTree(cells).query_pairs(ONE_EXIT, p=math.inf)
    return [cells[sorted(group)] for group in components(range(len(cells)), near)]


def _bays(store: TileStore, body: BodyCells, exits: list[Int64], max_width: float) -> Any:
    """Return the bays at the exits of the water, as a shape in absolute counts.

    Bays are places outside the survey between the cells of one exit. They are the union of
    triangles between the corners of these cells, minus the land. Triangles with edges longer
    than ``max_width`` cells are left out.
    """
    coarse, side = body.coarse, float(body.coarse.lattice.size)
    corners = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]])
    triangles_by_exit = [np.empty(0, object)]
    for cells in exits:
        points = (cells[:, None, ::-1] + corners).reshape(-1, 2)
        triangles_by_exit.append(
            shapely.get_parts(shapely.delaunay_triangles(shapely.multipoints(points)))
        )
    triangles = np.concatenate(triangles_by_exit)
    edges = np.diff(shapely.get_coordinates(triangles).reshape(-1, 4, 2), axis=1)
    lengths = np.hypot(edges[:, :, 0], edges[:, :, 1])
    bays = shapely.union_all(triangles[lengths.max(axis=1, initial=0.0) <= max_width])
    if shapely.is_empty(bays):
        return bays
    land = [np.empty(0, object)]
    for block, _ in _blocks(store, body):
        window = padded(block, math.ceil(max_width))
        domain = read_cells(store, body.sources.domain, coarse, window, float(BEYOND)) != BEYOND
        water = cells_of(store, body.water, coarse, window, body.pieces)
        cells = np.argwhere(domain & ~water) + (window.row, window.col)
        row, col = cells[shapely.intersects_xy(bays, cells[:, 1], cells[:, 0])].T
        land.append(shapely.box(col - 0.5, row - 0.5, col + 0.5, row + 0.5))
    bays = shapely.difference(bays, shapely.union_all(np.concatenate(land)))
    west, north = coarse.west + 0.5, coarse.north - 0.5
    return shapely.transform(
        bays, lambda at: np.stack((west + at[:, 0], north - at[:, 1]), axis=1) * side
    )


def _kind(area_m2: float, shore_m: float, size_m: float, n_exits: int) -> tuple[str, float]:
    """Return the kind, lake or river, and the mean width in metres.

    A river has a long shore for its area, or it leaves the survey at two or more exits.
    """
    length = max(shore_m, size_m)
    is_river = n_exits > 1 or 4 * math.pi * area_m2 / length**2 < ROUND
    return (RIVER if is_river else LAKE), 2 * area_m2 / length


class _Surroundings(NamedTuple):
    """Water of a block and its surroundings, in the coarse cells of a window.

    Attributes
    ----------
    cells : WaterCells
        Cells of the box with smoothed heights, also in the water.
    wet : bool
        Mask of the water in the window.
    box : tuple of slice
        Rows and columns of the window in which water and its shore lie.
    level : float64 or None
        Level of the water near each cell of the box in metres, None if it is not known.
    no_bank : bool
        Mask of the cells of the box whose ground is not bank.
    field : float64
        Result of `heights_above_water` for the window.
    """

    cells: WaterCells
    wet: Bool
    box: tuple[slice, slice]
    level: Float64 | None
    no_bank: Bool
    field: Float64


def _surroundings(
    store: TileStore, body: BodyCells, block: Block, lower_level_m: float | None
) -> _Surroundings:
    """Return the water of a block and its surroundings, in a window with a margin of `REACH_CELLS`."""
    window = padded(block, REACH_CELLS)
    wet = cells_of(store, body.water, body.coarse, window, body.pieces)
    box = box_around(wet, REACH_CELLS)
    rows, cols = box
    around = Block(window.row + rows.start, window.col + cols.start, *wet[box].shape)
    cells = read_search_cells(store, body.sources, body.coarse, around)
    crowns = read_cells(store, body.crowns, body.coarse, around)
    smooth = smoothed(cells.ground)
    level = water_heights(
        cells.with_ground(smooth), wet[box] & ~is_hidden(crowns) & (crowns < REED)
    )
    # The ground in hidden cells and high ground in reed are not bank.
    no_bank = wet[box] & (
        is_hidden(crowns) if level is None else has_no_bank(crowns, smooth - level)
    )
    field = np.full(wet.shape, MAX_HEIGHT_M)
    bank = cells.with_ground(np.where(no_bank, np.nan, smooth))
    final = (
        level if level is None or lower_level_m is None else np.minimum(level, lower_level_m)
    )
    field[box] = heights_above_water(bank, wet[box], final, lower_level_m is not None)
    return _Surroundings(cells.with_ground(smooth), wet, box, level, no_bank, field)


def _polygons(
    store: TileStore, body: BodyCells, block: Block, lower_level_m: float | None
) -> list[Any]:
    """Return polygons of the water of a block in absolute counts. They overlap with those of neighbouring blocks."""
    around = _surroundings(store, body, block, lower_level_m)
    rows, cols = _cut(around, REACH_CELLS - 1)
    return shore_polygons(around.field[rows, cols], body.coarse, _part(block, rows, cols))


def _details(
    store: TileStore, body: BodyCells, block: Block, lower_level_m: float | None
) -> ShoreDetails:
    """Return the details of the shore of a block. They overlap with those of neighbouring blocks."""
    around = _surroundings(store, body, block, lower_level_m)
    cells, wet, box, level, no_bank, field = around
    if level is None:
        return NO_DETAILS
    levels = np.where(no_bank, np.nan, highest_near(level))
    is_dense_quay = dense_quays(cells, wet[box], level)
    rows, cols = _cut(around, REACH_CELLS - BANK_MARGIN)
    in_box = (
        slice(rows.start - box[0].start, rows.stop - box[0].start),
        slice(cols.start - box[1].start, cols.stop - box[1].start),
    )
    shore = Shore(field[rows, cols], levels[in_box], is_dense_quay[in_box])
    return shore_details(store, body.rule, body.coarse, _part(block, rows, cols), shore)


def _cut(around: _Surroundings, spare: int) -> tuple[slice, slice]:
    """Return the rows and columns of the box, without the outermost ``spare`` cells of the window.

    Beyond the box there is no shore.
    """
    height, width = around.wet.shape
    rows, cols = around.box
    return (
        slice(max(rows.start, spare), min(rows.stop, height - spare)),
        slice(max(cols.start, spare), min(cols.stop, width - spare)),
    )


def _part(block: Block, rows: slice, cols: slice) -> Block:
    """Return the cells in some rows and columns of the window around a block."""
    top, left = block.row - REACH_CELLS, block.col - REACH_CELLS
    return Block(
        top + rows.start, left + cols.start, rows.stop - rows.start, cols.stop - cols.start
    )


def _without_specks(shape: Any, min_area: float) -> Any:
    """Remove the parts of a shape with an area below ``min_area``, but keep the largest part."""
    parts = shapely.get_parts(shape)
    areas = shapely.area(parts)
    return shapely.union_all(parts[(areas >= min_area) | (areas == areas.max(initial=0.0))])


def _without_islands(shape: Any, min_area: float) -> Any:
    """Return a shape without holes that have an area below ``min_area``."""
    polygons = []
    for polygon in shapely.get_parts(shape):
        holes = [ring for ring in polygon.interiors if shapely.Polygon(ring).area >= min_area]
        polygons.append(shapely.Polygon(polygon.exterior, holes))
    return shapely.union_all(polygons)


def _area(shape: Any, side: float) -> Area:
    """Return the polygons of a body of water as an `Area` with a simplified shore."""
    # Vertices on straight lines are removed first, so that they do not influence the result.
    shape = shapely.normalize(shapely.simplify(shape, 0.0))
    return area_of(shapely.simplify(shape, SIMPLER * side))
