"""Strips of land between a wall and the border of the data, which openings cut off like houses at the border.

A strip continues along the border. A building ends in walls, which the border does not cut. So the
falls and the border around a cell are counted along rays, and the ends of buildings are looked for.
A building that ends only at a corner of the data, and one of which the border shows less than two
cells, cannot be told from a strip; the latter stays an object.
"""

from __future__ import annotations

import numpy as np
import scipy

from ptd.cells import Int32, Int64, Xyz
from ptd.frame import CellLattice, Scale
from ptd.ground.morphology import EMPTY, Bool, CellRaster
from ptd.ground.plateaus import BORDER, FALLS, ROOF_CELL_M, ROOF_VIEW_M, Plateaus, look_around
from ptd.ground.slopes import Boxes
from ptd.ground.summits import on_smooth_surfaces

AROUND_M, LENGTH_M = 60.0, 40.0
"""Half width of the square around a cell in which falls and border are counted, and the least
length of the border there."""
DEPTH = 2
"""Number of cells with a fall along the border, one behind the other, that are the end of a
building, and least mean depth of a strip. The wall of a strip may approach the border at an angle."""
BORDER_SHARE = 0.85
"""Least number of cells at the border, as a multiple of those above a fall."""
NEAR_M = 2 * ROOF_VIEW_M
"""Largest distance from the border of the objects that are looked at. A strip is at most as deep as
half the widest opening; what lies behind it must be seen as well."""
REACH_M = AROUND_M + NEAR_M + 2 * ROOF_CELL_M
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
    smooth = on_smooth_surfaces(points, lost, lost | ground, raster, scale, cell_m)
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
        _with_data(wide),
        none,
        objects.size + 1,
        roof_rule.rays,
    )
    is_strip = np.zeros(heights.size, np.bool_)
    is_strip[objects] = _is_strip(counts[:-1], objects, wide.shape)
    on_strip: Bool = smooth & is_strip[wide.keys]
    return on_strip


def _with_data(raster: CellRaster) -> Bool:
    data = np.zeros(raster.shape[0] * raster.shape[1], np.bool_)
    data[raster.keys] = True
    return data.reshape(raster.shape)


def _near_border(raster: CellRaster) -> Bool:
    """Return a mask of the points near cells without points: bool [n]."""
    size = 2 * round(NEAR_M / ROOF_CELL_M) + 1
    near: Bool = scipy.ndimage.maximum_filter(
        ~_with_data(raster), size=size, mode="constant", cval=True
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
    around = round(AROUND_M / ROOF_CELL_M)

    def total(values: Int32) -> Int64:
        total: Int64 = Boxes(values).totals(around, cells)[:, 0]
        return total

    falls, border = rasters[:4], np.stack([total(side) for side in rasters[4:8]])
    length = border.max(axis=0)
    ends = [
        total(scipy.ndimage.minimum_filter1d(falls[way] + falls[way + 2], DEPTH, axis=way))
        for way in (0, 1)
    ]
    is_strip: Bool = (
        (length >= LENGTH_M / ROOF_CELL_M)
        & (total(rasters[8]) >= DEPTH * length)
        & (border.sum(axis=0) >= BORDER_SHARE * total(falls.sum(axis=0, dtype=np.int32)))
        & (np.where(border.argmax(axis=0) % 2 == 1, *ends) == 0)
    )
    return is_strip
