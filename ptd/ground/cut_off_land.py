"""Land that openings cut off like houses: ridges, summits, land between pits, and strips at the border of the data.

An opening cuts off a sharp ridge like a house, because both are high and narrow. They differ at
their edges: a house ends at its walls, whereas the slopes of a ridge continue. So a cell that
was taken for an object is terrain if the surface through the cells around it is smooth and
steep, and if objects nearby continue the ground at most of their edges. At the ends of a bridge
the deck continues the road, but most of its edges are sides, below which the ground lies.

Land between pits is cut off, too, if each disk on it touches a pit. It is level, so it is terrain
only near a pit: ground from which higher cells are seen nearby in all directions, unlike from a
street or a stream. Edges above a pit do not count.

A strip between a wall and the border continues along the border. A building ends in walls, which the border does not
cut. So the falls and the border around a cell are counted along rays, and the ends of buildings are looked for. A
building that ends only at a corner of the data, and one of which the border shows less than two cells, cannot be told
from a strip; the latter stays an object.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Float64, Int32, Int64, UInt8
from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale
from ptd.ground.morphology import EAST, EMPTY, NORTH, CellRaster
from ptd.ground.plateaus import BORDER, FALLS, ROOF_CELL_M, ROOF_VIEW_M, Plateaus, look_around
from ptd.ground.slopes import MOMENTS, Boxes, add_point, fit_plane
from ptd.kernel import as_int64, kernel

PLANES = ((1, 6), (2, 9))
"""Half widths in cells of the squares through whose cells a plane is fitted, and how many cells
each needs. The second is used where the first has too few."""
ROUGH_M, ROUGH_SLOPE = 0.15, 0.1
"""Largest scatter of cells about the plane of a smooth surface: metres, plus this multiple of
the slope. A cell on it lies at most `OFF` times as far from the plane."""
OFF = 2.0
STEEP = 0.3
"""Smallest slope of cells that are terrain. Crops and low shrubs on level ground are as
smooth."""
SIDE_CELLS, SIDE_M = 3, 1.2
"""A cell is beside ground below if ground within this many cells is lower, by more than this
height, than the plane of the cell at its lowest there."""
SHARE, LEAST = 0.75, 10
"""Least share and least number of the edges nearby that continue the ground."""
REACH_CELLS = 1 + PLANES[-1][0]
"""Distance in cells from an edge beyond which heights do not change it. It includes the plane of
the ground beside the edge, and is not less than `SIDE_CELLS`."""
RIM_CELLS = 2
"""Width in cells of the rim of a pit, where the plane of a cell includes cells within the pit."""
PIT_CELLS = 8
"""Distance in cells within which the higher cells around the bottom of a pit are seen."""
PIT_REACH_CELLS = SIDE_CELLS + PIT_CELLS + RIM_CELLS
"""The same distance if land between pits is looked for."""

_UNKNOWN, _ROUGH, _LEVEL, _STEEP = range(4)
"""Kinds of surface at a cell: not known yet, rough, smooth, and smooth and steep."""
_FALLS, _CONTINUES, _PIT = range(3)
"""Kinds of edges."""


class _Limits(NamedTuple):
    """Lengths above in horizontal counts, and the length of a cell and of a vertical count in them."""

    rough: float
    side: float
    cell: float
    z_ratio: float

    @classmethod
    def of(cls, scale: Scale, cell_m: float) -> _Limits:
        return cls(
            scale.counts(ROUGH_M), scale.counts(SIDE_M), scale.counts(cell_m), scale.z_ratio
        )


@kernel
def _plane(
    slots: Int32, points: Xyz, row: int, column: int, z_ratio: float
) -> tuple[float, float, float]:
    """Return slope, height above the cell's point, and scatter of the plane through the cells around a cell.

    The height and the scatter are in horizontal counts. The scatter is infinite if no plane can be fitted.
    """
    x, y, z = points
    own = slots[row, column]
    for reach, enough in PLANES:
        sums = np.zeros(MOMENTS, np.int64)
        for r in range(max(row - reach, 0), min(row + reach + 1, slots.shape[0])):
            for c in range(max(column - reach, 0), min(column + reach + 1, slots.shape[1])):
                i = slots[r, c]
                if i >= 0:
                    add_point(
                        sums,
                        as_int64(x[i]) - x[own],
                        as_int64(y[i]) - y[own],
                        as_int64(z[i]) - z[own],
                    )
        if sums[0] >= enough:
            east, north, height, squares = fit_plane(sums, z_ratio)
            if squares >= 0.0:
                return math.hypot(east, north), height, math.sqrt(squares / (sums[0] - 3))
    return 0.0, 0.0, math.inf


@kernel
def _surface(
    slots: Int32,
    points: Xyz,
    row: int,
    column: int,
    limits: _Limits,
    known: UInt8,
    slopes: Float64,
) -> int:
    """Return the kind of surface at a cell, and keep it and the slope by point."""
    own = slots[row, column]
    if known[own] == _UNKNOWN:
        slope, height, scatter = _plane(slots, points, row, column, limits.z_ratio)
        rough = limits.rough * (1.0 + ROUGH_SLOPE / ROUGH_M * slope)
        slopes[own], known[own] = slope, _ROUGH
        if scatter <= rough and abs(height) <= OFF * rough:
            known[own] = _STEEP if slope >= STEEP else _LEVEL
    return int(known[own])


@kernel
def _is_beside_smooth(
    slots: Int32,
    points: Xyz,
    row: int,
    column: int,
    ground: Bool,
    limits: _Limits,
    known: UInt8,
    slopes: Float64,
) -> bool:
    """Return whether the surface is smooth at a ground cell next to a cell."""
    for r in range(max(row - 1, 0), min(row + 2, slots.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, slots.shape[1])):
            i = slots[r, c]
            if (
                i >= 0
                and ground[i]
                and _surface(slots, points, r, c, limits, known, slopes) >= _LEVEL
            ):
                return True
    return False


@kernel
def _is_pit(slots: Int32, z: Int32, row: int, column: int, rise: float) -> bool:
    """Return whether a cell higher by ``rise`` is seen from a cell in all eight directions."""
    bottom = as_int64(z[slots[row, column]])
    for way in range(8):
        seen = False
        for steps in range(1, PIT_CELLS + 1):
            r, c = row + steps * NORTH[way], column + steps * EAST[way]
            if r < 0 or c < 0 or r >= slots.shape[0] or c >= slots.shape[1]:
                break
            i = slots[r, c]
            if i >= 0 and as_int64(z[i]) - bottom > rise:
                seen = True
                break
        if not seen:
            return False
    return True


@kernel
def _edges(
    keys: Int64,
    slots: Int32,
    points: Xyz,
    lost: Bool,
    ground: Bool,
    limits: _Limits,
    pits: bool,
) -> tuple[Int32, UInt8]:
    """Return the kind of edge at each lost cell (`EMPTY` for none), and the kinds of surface that are known."""
    rows, columns = slots.shape
    edges = np.full(keys.size, EMPTY, np.int32)
    known, slopes = np.zeros(keys.size, np.uint8), np.zeros(keys.size, np.float64)
    for k in range(keys.size):
        if not lost[k]:
            continue
        row, column = divmod(keys[k], columns)
        lowest, beside, at_row, at_column = EMPTY, False, row, column
        for r in range(max(row - SIDE_CELLS, 0), min(row + SIDE_CELLS + 1, rows)):
            for c in range(max(column - SIDE_CELLS, 0), min(column + SIDE_CELLS + 1, columns)):
                i = slots[r, c]
                if i >= 0 and ground[i]:
                    if points.z[i] < lowest:
                        lowest, at_row, at_column = points.z[i], r, c
                    beside |= abs(r - row) <= 1 and abs(c - column) <= 1
        if (
            lowest == EMPTY
            or _surface(slots, points, row, column, limits, known, slopes) < _LEVEL
        ):
            continue
        fall = (as_int64(points.z[k]) - lowest) * limits.z_ratio
        if fall > limits.side + slopes[k] * math.sqrt(2.0) * SIDE_CELLS * limits.cell:
            rise = limits.side / limits.z_ratio
            is_pit = pits and _is_pit(slots, points.z, at_row, at_column, rise)
            edges[k] = _PIT if is_pit else _FALLS
        elif beside and _is_beside_smooth(
            slots, points, row, column, ground, limits, known, slopes
        ):
            edges[k] = _CONTINUES
    return edges, known


@kernel
def _smooth(
    keys: Int64,
    slots: Int32,
    points: Xyz,
    chosen: Bool,
    limits: _Limits,
    known: UInt8,
    least: int,
) -> Bool:
    """Return a mask of the chosen cells whose kind of surface is ``least`` or a later one (`_LEVEL`, `_STEEP`)."""
    smooth, slopes = np.zeros(keys.size, np.bool_), np.zeros(keys.size, np.float64)
    for k in range(keys.size):
        if chosen[k]:
            row, column = divmod(keys[k], slots.shape[1])
            smooth[k] = _surface(slots, points, row, column, limits, known, slopes) >= least
    return smooth


@kernel
def _beside(
    keys: Int64, slots: Int32, z: Int32, chosen: Bool, found: Bool, step: float
) -> Bool:
    """Return a mask of the chosen cells next to a found one whose height differs by at most ``step``."""
    beside = np.zeros(keys.size, np.bool_)
    for k in range(keys.size):
        if not chosen[k]:
            continue
        row, column = divmod(keys[k], slots.shape[1])
        for r in range(max(row - 1, 0), min(row + 2, slots.shape[0])):
            for c in range(max(column - 1, 0), min(column + 2, slots.shape[1])):
                i = slots[r, c]
                if i >= 0 and found[i] and abs(as_int64(z[i]) - z[k]) <= step:
                    beside[k] = True
    return beside


def on_summits(
    points: Xyz,
    lost: Bool,
    ground: Bool,
    raster: CellRaster,
    scale: Scale,
    cell_m: float,
    around: int,
    between_pits: bool = False,
) -> Bool:
    """Find the cells that openings cut off ridges and summits: bool [n].

    The result of a cell depends on points up to ``around + REACH_CELLS`` cells away, or `PIT_REACH_CELLS`.

    Parameters
    ----------
    points : Xyz
        Lowest point of each cell, in counts. No two points share a cell.
    lost, ground : bool [n]
        Masks of the cells that openings cut off, and of the ground. Other cells (low outliers) are not looked at.
    raster : CellRaster
        Raster of the points.
    scale : Scale
    cell_m : float
        Size of the cells in metres.
    around : int
        Distance in cells, along rows and columns, of the edges that count: half the width of the widest object.
    between_pits : bool
        Whether to find level land between pits as well.
    """
    slots, limits = _slots(raster, lost | ground), _Limits.of(scale, cell_m)
    edges, known = _edges(raster.keys, slots, points, lost, ground, limits, between_pits)
    if not (edges == _CONTINUES).any():
        return np.zeros(lost.size, np.bool_)
    boxes = Boxes(raster.lowest(edges, edges <= _CONTINUES))
    continued, n_edges = boxes.totals(around, raster.keys).T
    near: Bool = lost & (continued >= np.maximum(SHARE * n_edges, LEAST))
    found = _smooth(raster.keys, slots, points, near, limits, known, _STEEP)
    pits = edges == _PIT
    if pits.any():
        _, n_pits = Boxes(raster.lowest(edges, pits)).totals(around, raster.keys).T
        near &= n_pits > 0
        found |= _smooth(raster.keys, slots, points, near, limits, known, _LEVEL)
        for _ in range(RIM_CELLS):
            step = OFF * scale.counts_z(ROUGH_M)
            found |= _beside(raster.keys, slots, points.z, near, found | ground, step)
    return found


def _slots(raster: CellRaster, among: Bool) -> Int32:
    """Return the index of the point of each cell, -1 without one: int32 [rows, columns]."""
    slots = np.full(raster.shape[0] * raster.shape[1], -1, np.int32)
    seen = np.flatnonzero(among)
    slots[raster.keys[seen]] = seen
    return slots.reshape(raster.shape)


def without_thin(found: Bool, raster: CellRaster, reach: int) -> Bool:
    """Return the found cells without thin strips, which may be the sides of buildings: bool [n].

    A cell stays if it lies in the square of ``reach`` cells to all sides of a found cell, and half of this square was
    found. Cells farther than twice the reach do not change the result.
    """
    if not found.any():
        return found
    ones = np.ones(found.size, np.int32)
    n_found = Boxes(raster.lowest(ones, found)).totals(reach, raster.keys)[:, 1]
    core = found & (2 * n_found >= (2 * reach + 1) ** 2)
    if not core.any():
        return core
    n_core = Boxes(raster.lowest(ones, core)).totals(reach, raster.keys)[:, 1]
    return found & (n_core > 0)


STRIP_AROUND_M, STRIP_LENGTH_M = 60.0, 40.0
"""Half width of the square around a cell in which falls and border are counted, and the least
length of the border there."""
STRIP_DEPTH = 2
"""Number of cells with a fall along the border, one behind the other, that are the end of a
building, and least mean depth of a strip. The wall of a strip may approach the border at an angle."""
STRIP_BORDER_SHARE = 0.85
"""Least number of cells at the border, as a multiple of those above a fall."""
STRIP_NEAR_M = 2 * ROOF_VIEW_M
"""Largest distance from the border of the objects that are looked at. A strip is at most as deep as
half the widest opening; what lies behind it must be seen as well."""
STRIP_REACH_M = STRIP_AROUND_M + STRIP_NEAR_M + 2 * ROOF_CELL_M
"""Distance in metres beyond which points do not change the result of `on_strips`."""


def on_strips(
    points: Xyz,
    lost: Bool,
    ground: Bool,
    cells: CellLattice,
    cell_m: float,
    roof_rule: Plateaus,
    scale: Scale,
) -> Bool:
    """Find the cells on strips of land at the border among those that openings cut off: bool [n].

    Parameters
    ----------
    points : Xyz
        Lowest point of each cell, in counts.
    lost, ground : bool [n]
        Masks of the cells that openings cut off, and of the ground.
    cells : CellLattice
        The lattice of the points.
    cell_m : float
        Size of its cells in metres.
    roof_rule : Plateaus
        Rule of the rays.
    scale : Scale
    """
    wide = CellRaster(points.x, points.y, CellLattice.of(ROOF_CELL_M, scale))
    lost = lost & _near_border(wide)
    if not lost.any():
        return lost
    raster = CellRaster(points.x, points.y, cells)
    slots, limits = _slots(raster, lost | ground), _Limits.of(scale, cell_m)
    known = np.zeros(lost.size, np.uint8)
    smooth = _smooth(raster.keys, slots, points, lost, limits, known, _LEVEL)
    heights, below = (wide.lowest(points.z, mask).ravel() for mask in (smooth, ground))
    objects, is_ground = np.flatnonzero(heights != EMPTY), (heights == EMPTY) & (below != EMPTY)
    if not objects.size:
        return smooth
    # Each cell of an object is a surface of its own, so that it has its own counts.
    surface = np.full(heights.size, -1, np.int32)
    surface[objects], surface[is_ground] = np.arange(objects.size), objects.size
    none = np.zeros(wide.shape, np.bool_)
    counts, _ = look_around(
        np.where(is_ground, below, heights).reshape(wide.shape),
        surface.reshape(wide.shape),
        none,
        wide.occupied(),
        none,
        objects.size + 1,
        roof_rule.rays,
    )
    is_strip = np.zeros(heights.size, np.bool_)
    is_strip[objects] = _is_strip(counts[:-1], objects, wide.shape)
    return smooth & is_strip[wide.keys]


def _near_border(raster: CellRaster) -> Bool:
    """Return a mask of the points near cells without points: bool [n]."""
    size = 2 * round(STRIP_NEAR_M / ROOF_CELL_M) + 1
    near: Bool = scipy.ndimage.maximum_filter(
        ~raster.occupied(), size=size, mode="constant", cval=True
    )
    return near.ravel()[raster.keys]


def _is_strip(counts: Int64, cells: Int64, shape: tuple[int, int]) -> Bool:
    """Return whether each cell lies on a strip, from its counts (`look_around`): bool [n]."""
    # Falls to the east, north, west and south, border there, cells.
    rasters = np.zeros((9, *shape), np.int32)
    flat = rasters.reshape(9, -1)
    flat[:4, cells], flat[4:8, cells] = (
        counts[:, FALLS : FALLS + 4].T,
        counts[:, BORDER : BORDER + 4].T,
    )
    flat[8, cells] = 1
    around = round(STRIP_AROUND_M / ROOF_CELL_M)

    def total(values: Int32) -> Int64:
        return Boxes(values).totals(around, cells)[:, 0]

    falls, border = rasters[:4], np.stack([total(side) for side in rasters[4:8]])
    length = border.max(axis=0)
    ends = [
        total(
            scipy.ndimage.minimum_filter1d(falls[way] + falls[way + 2], STRIP_DEPTH, axis=way)
        )
        for way in (0, 1)
    ]
    is_strip: Bool = (
        (length >= STRIP_LENGTH_M / ROOF_CELL_M)
        & (total(rasters[8]) >= STRIP_DEPTH * length)
        & (border.sum(axis=0) >= STRIP_BORDER_SHARE * total(falls.sum(axis=0, dtype=np.int32)))
        & (np.where(border.argmax(axis=0) % 2 == 1, *ends) == 0)
    )
    return is_strip
