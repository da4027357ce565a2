"""Water beneath crowns that hang over it, and in reed, to where the bank that is continued beneath them rises.

A laser scanner gets returns from a crown over water, and hardly any from the water below. The terrain beneath such
crowns is interpolated from the bank, so water would end where crowns begin. Over land, some pulses pass through a
crown and reach the ground. So cells with crowns and without ground are water if they are connected with open water
and do not lie between cells with ground. The slope of the bank is continued beneath the crowns, and water ends where
the continued bank rises above the level.

Reed is low, stands in the water, and is connected with open water. The lowest points of reed may count as ground, so
the water would end where reed begins. As beneath crowns, the slope of the bank behind the reed is continued, and the
water ends where the continued bank reaches the level. Low plants stay land if the bank behind them is flat, or if
they are far from water.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import scipy

from ptd.arrays import AnyArray, Bool, Float32, Float64, Int32, Int64, UInt8
from tiler.core.raster import Block
from tiler.grid.block_surroundings import PointsNear, pixel_indices
from tiler.grid.coarse import box_around, padded, within, within_square
from tiler.grid.ground import read_ground_and_objects
from tiler.grid.steps import Counts, Position
from tiler.grid.water_cells import WaterCells

N_BANK_CELLS = 20
"""The bank is continued by a plane through this many of its cells with ground, the nearest
ones."""
MAX_TIES = 23
"""Up to this many more cells are used if they are as far away as the last of the nearest cells.

At most 24 cells of a lattice have the same distance from another cell, up to a distance of 40
cells.
"""
MIN_VARIANCE = 0.05
"""Cells of the bank define a plane if their variance is larger than this in each direction, in
square cells. Those of two adjacent rows have 0.25, those of a single row 0."""
AT_ONCE = 8192
"""Number of cells whose planes are fitted at a time, which limits memory to about 30 MiB."""


def continued_bank(
    cells: Int64, bank: Int64, above: Float64, reach: float
) -> tuple[Float64, Float64]:
    """Extrapolate the bank to other cells. Each cell has its own plane through the nearest cells of the bank.

    Parameters
    ----------
    cells : int64 (n, 2)
        Row and column of the cells to which the bank is continued.
    bank : int64 (m, 2)
        Row and column of the cells of the bank, by rows.
    above : float64 (m,)
        Height of the cells of the bank above the water in metres.
    reach : float
        Cells of the bank that are farther away than this are not used, in cells.

    Returns
    -------
    height : float64 (n,)
        Height of the plane above the water at each cell, in metres, and infinity if there is no plane.
    slope : float64 (n,)
        Slope of the plane in metres per cell, and infinity if there is no plane.
    """
    height, slope = np.full((2, len(cells)), np.inf)
    if not len(bank):
        return height, slope
    tree = scipy.spatial.cKDTree(bank)
    for start in range(0, len(cells), AT_ONCE):
        part = slice(start, start + AT_ONCE)
        used, near = _nearest(tree, cells[part], reach)
        height[part], slope[part] = _planes(bank[near] - cells[part, None], above[near], used)
    return height, slope


def _nearest(tree: scipy.spatial.cKDTree, cells: Int64, reach: float) -> tuple[Bool, Int64]:
    """Return the indices of the nearest cells of the bank, and a mask of those that are used: shape (n, k)."""
    k = range(1, N_BANK_CELLS + MAX_TIES + 1)
    found = tree.query(cells, k=k, distance_upper_bound=reach + 1e-6)
    distance, near = np.asarray(found[0]), np.asarray(found[1])
    # Cells at the same distance are all used. The tree would choose some of them, depending on
    # cells far away.
    used = np.isfinite(distance) & (distance <= distance[:, N_BANK_CELLS - 1, None])
    # The tree's order of these cells depends on cells far away as well, and the order changes
    # the last bits of sums.
    near = np.sort(np.where(used, near, tree.n), axis=1)
    return near < tree.n, np.where(near < tree.n, near, 0)


def _planes(offsets: Int64, heights: Float64, used: Bool) -> tuple[Float64, Float64]:
    """Return height and slope of the planes through the used cells at offsets, at the offset 0."""
    number = np.maximum(used.sum(axis=1), 1)

    def mean(values: Float64) -> Float64:
        return np.asarray(np.where(used, values, 0.0).sum(axis=1) / number, np.float64)

    y, x, z = offsets[:, :, 0].astype(np.float64), offsets[:, :, 1].astype(np.float64), heights
    mean_x, mean_y, mean_z = mean(x), mean(y), mean(z)
    x, y, z = x - mean_x[:, None], y - mean_y[:, None], z - mean_z[:, None]
    xx, xy, yy, xz, yz = mean(x * x), mean(x * y), mean(y * y), mean(x * z), mean(y * z)
    area = xx * yy - xy * xy
    is_plane = area > MIN_VARIANCE * (xx + yy)
    area[~is_plane] = 1.0
    east, north = (xz * yy - yz * xy) / area, (yz * xx - xz * xy) / area
    height = np.where(is_plane, mean_z - east * mean_x - north * mean_y, np.inf)
    return height, np.where(is_plane, np.hypot(east, north), np.inf)


CROWN_WITH_GROUND = 1
"""Value of a cell with a crown and with ground."""
HIDDEN = 2
"""Value of a cell with a crown and without ground."""
REED = 4
"""Value of a cell with reed. The value of a cell with both a crown and reed is the sum."""
CROWN_M = 14.0
"""Water extends at most this far beneath crowns, in metres."""
MIN_POINTS = 4
"""The roughness of a cell is known only if the cell has at least this many points."""
ROUGH_M = 0.4
"""Cells of a crown are rougher than this, in metres. Roofs, decks and boats are smoother.

The roughness of a cell is the RMS distance of its points from the plane through them.
"""
REED_ROUGH_M = 0.2
"""Cells of reed are rougher than this, in metres. Boats and pontoons are smoother."""
REED_M = 3.0
"""Reed is at most this high above the terrain, in metres. Trees are higher."""
MIN_GROUND_SHARE = 0.3
"""A lack of ground is a sign of water only if at least this share of the cells with crowns
nearby have ground."""
AMONG_M = 8.0
"""Hidden cells in a gap between cells with ground are land if the gap is narrower than twice
this, in metres."""
BANK_M = 24.0
"""Cells of the bank farther from hidden cells than this are not used, in metres."""
MAX_QUAY_SLOPE = 0.15
"""If the continued bank is at most this steep, the bank is assumed to be upright, as at a quay.

Then hidden cells are water at any height of the continued bank.
"""
LOW_M = 0.15
"""A hidden cell is water if the continued bank is at most this high above the water there, in
metres."""


def plants_near_water(
    sure: Float32,
    planes: Float32,
    occupancy: Float32,
    ground: Float64,
    points: PointsNear,
    place: Position,
    *,
    margin: int,
) -> tuple[Float32, Counts]:
    """Return the kinds of plants in the cells of a block that are near water.

    The value of a cell is `CROWN_WITH_GROUND` or `HIDDEN` for a crown, `REED` for reed, the sum
    for both, or 0.

    Parameters
    ----------
    sure, planes : float32 (height + 2 margin, width + 2 margin)
        Confidences that each cell is water.
    occupancy : float32 (height + 2, width + 2)
        Number of points in each cell, negative in cells that are water by the input.
    ground : float64 (height + 2, width + 2)
        Heights of the terrain.
    points : PointsNear
    place : Position
    margin : int
        See `crowns_margin`.
    """
    # The window has a margin of one cell, because `plant_kinds` compares each cell with its
    # neighbours.
    near_water = within(np.maximum(sure, planes) > 0, CROWN_M / place.pixel_m)[
        margin - 1 : 1 - margin, margin - 1 : 1 - margin
    ]
    examined = near_water & (occupancy != 0)
    kinds = _crowns(points, padded(place.block, 1), examined, ground * place.unit_m)
    return np.where(examined, kinds, 0)[1:-1, 1:-1].astype(np.float32), {}


def crowns_margin(size_m: float) -> int:
    """Return the margin around a block, in coarse cells, on which its crowns depend."""
    return math.ceil(CROWN_M / size_m) + 2


def _crowns(points: PointsNear, window: Block, examined: Bool, terrain: Float64) -> Int64:
    """Return the value of each cell of a window, see `plants_near_water`.

    Only the values of ``examined`` cells are right, because only buckets with such cells are
    read.
    """
    store, frame, spec = points.store, points.frame, points.spec
    point_cells, are_objects = [np.empty(0, np.int64)], [np.empty(0, np.bool_)]
    xyz_parts = [np.empty((3, 0), np.int32)]
    for bucket in store.buckets_within(spec.block_bounds(window)):
        bounds = store.meta.bucket.bounds(bucket).intersection(spec.block_bounds(window))
        part = spec.part(window, bounds)
        top, left = part.row - window.row, part.col - window.col
        if not examined[top : top + part.height, left : left + part.width].any():
            continue
        ground, objects = read_ground_and_objects(store, points.rule, bounds)
        for xyz, is_object in ((ground, False), (objects, True)):
            cells = pixel_indices(xyz, frame.origin, spec, window)
            chosen = examined.ravel()[cells]
            point_cells.append(cells[chosen])
            are_objects.append(np.full(int(chosen.sum()), is_object))
            xyz_parts.append(xyz[:, chosen])
    xyz, cells = np.concatenate(xyz_parts, axis=1), np.concatenate(point_cells)
    return plant_kinds(xyz, cells, np.concatenate(are_objects), terrain, frame.metres_z)


def plant_kinds(
    xyz: Int32,
    cells: Int64,
    objects: Bool,
    terrain: Float64,
    metres_z: Fraction,
) -> Int64:
    """Return the value of each cell, int64 (h, w), see `plants_near_water`.

    Parameters
    ----------
    xyz : int32 (3, n)
        Points in counts.
    cells : int64 (n,)
        Number of each point's cell, from 0.
    objects : bool (n,)
        Mask of the points that are not ground.
    terrain : float64 (h, w)
        Height of the terrain in metres, NaN if there is none.
    metres_z : Fraction
        Metres per vertical count.
    """
    scale = float(metres_z)

    def cells_with(chosen: Bool) -> Bool:
        """Return a mask of the cells with chosen points."""
        return (np.bincount(cells[chosen], minlength=terrain.size) > 0).reshape(terrain.shape)

    has_ground = cells_with(~objects)
    has_objects = cells_with(objects)

    def rough_cells(chosen: Bool, limit: float) -> Bool:
        """Return a mask of the cells that have objects, and around which most cells are rougher than ``limit``.

        Roughness is measured with the chosen points.
        """
        rough = (roughness(xyz[:, chosen], cells[chosen], terrain.size) * scale).reshape(
            terrain.shape
        )
        return _mostly(rough > limit, ~np.isnan(rough)) & has_objects

    tops = np.full(terrain.size, -np.inf)
    np.maximum.at(tops, cells, xyz[2] * scale)
    # Reed may be so low that its lowest points count as ground.
    is_low = has_objects & (tops.reshape(terrain.shape) - terrain <= REED_M)
    reed = is_low & rough_cells(within_square(is_low, 1).ravel()[cells], REED_ROUGH_M)
    kinds = np.where(has_ground, CROWN_WITH_GROUND, HIDDEN)
    return np.where(rough_cells(objects, ROUGH_M), kinds, 0) + np.where(reed, REED, 0)


def is_hidden(crowns: AnyArray) -> Bool:
    """Return a mask of the cells with crowns and without ground, from the values of `plants_near_water`."""
    return np.asarray((crowns == HIDDEN) | (crowns == HIDDEN + REED))


def roughness(xyz: Int32, cells: Int64, size: int) -> Float64:
    """Return the RMS vertical distance of the points of each cell from the plane through them, float64 (size,).

    The RMS is in vertical counts. It is NaN for cells with fewer than `MIN_POINTS` points, or
    if the points lie on a line. Only integers are added, so the order of the points does not
    matter.

    Parameters
    ----------
    xyz : int32 (3, n)
        Counts.
    cells : int64 (n,)
        Number of each point's cell, from 0.
    size : int
        Number of cells.
    """
    has_points = np.zeros(size, np.bool_)
    has_points[cells] = True
    # Most cells have no points, so the cells with points are numbered anew.
    cells = (np.cumsum(has_points) - 1)[cells]
    count = int(has_points.sum())
    lowest = np.full((3, count), np.iinfo(np.int64).max)
    offsets = xyz.astype(np.int64)
    for axis in range(3):
        np.minimum.at(lowest[axis], cells, offsets[axis])
    x, y, z = offsets - lowest[:, cells]

    def total(values: Int64) -> Float64:
        return np.bincount(cells, values.astype(np.float64), count).astype(np.float64)

    n = np.bincount(cells, minlength=count).astype(np.float64)
    mean_x, mean_y, mean_z = total(x) / n, total(y) / n, total(z) / n
    xx = total(x * x) / n - mean_x**2
    xy = total(x * y) / n - mean_x * mean_y
    yy = total(y * y) / n - mean_y**2
    xz = total(x * z) / n - mean_x * mean_z
    yz = total(y * z) / n - mean_y * mean_z
    zz = total(z * z) / n - mean_z**2
    determinant = xx * yy - xy * xy
    has_plane = (n >= MIN_POINTS) & (determinant > 1e-6 * xx * yy)
    explained = np.divide(
        xz * xz * yy - 2 * xz * yz * xy + yz * yz * xx,
        determinant,
        out=np.zeros(count),
        where=has_plane,
    )
    rough = np.full(size, np.nan)
    rough[has_points] = np.where(has_plane, np.sqrt(np.maximum(zz - explained, 0.0)), np.nan)
    return rough


def _mostly(chosen: Bool, known: Bool) -> Bool:
    """Return a mask of the cells for which more than half of the known cells around are chosen, in 3 by 3 cells."""

    def number(mask: Bool) -> UInt8:
        """Return the number of cells of a mask in the 3 by 3 cells around each cell."""
        cells = np.pad(mask.astype(np.uint8), 1)
        rows = cells[:-2] + cells[1:-1] + cells[2:]
        return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:])

    return np.asarray(2 * number(chosen & known) > number(known))


def beneath_crowns(cells: WaterCells, crowns: AnyArray, wet: Bool, level: Float64) -> Bool:
    """Return a mask of the cells beneath crowns that are water.

    Parameters
    ----------
    cells : WaterCells
        Cells with smoothed heights.
    crowns : float, shape of the cells
        Values of plants, see `plants_near_water`.
    wet : bool, shape of the cells
        Mask of the water.
    level : float64, shape of the cells
        Level of the water near each cell in metres.
    """
    hidden = is_hidden(crowns) & ~wet & cells.domain
    hidden &= _ground_share(crowns, round(4 * CROWN_M / cells.size_m)) >= MIN_GROUND_SHARE
    bank = ~is_hidden(crowns) & ~wet & (cells.returns > 0) & ~np.isnan(cells.ground)
    if not hidden.any() or not bank.any():
        return np.zeros_like(hidden)
    radius = AMONG_M / cells.size_m
    # Cells in narrow gaps between cells of the bank are land.
    hidden &= within(~within(bank, radius), radius)
    hidden = connected(hidden, wet, math.ceil(CROWN_M / cells.size_m))
    reach = BANK_M / cells.size_m
    bank &= within(hidden, reach)
    above = (cells.ground - level)[bank]
    height, slope = continued_bank(np.argwhere(hidden), np.argwhere(bank), above, reach)
    hidden[hidden] = (height <= LOW_M) | (slope <= MAX_QUAY_SLOPE * cells.size_m)
    return connected(hidden, wet, math.ceil(CROWN_M / cells.size_m))


def _ground_share(crowns: AnyArray, side: int) -> Float64:
    """Return the share of cells with ground among the cells with crowns, in a square around each cell.

    The square has ``side`` rows and columns, or one more if that is even.
    """
    odd_side = side // 2 * 2 + 1

    has_ground = (crowns == CROWN_WITH_GROUND) | (crowns == CROWN_WITH_GROUND + REED)
    has_crown = has_ground | is_hidden(crowns)
    ground_share, crown_share = (
        scipy.ndimage.uniform_filter(mask.astype(np.float64), odd_side, mode="constant")
        for mask in (has_ground, has_crown)
    )
    return np.divide(ground_share, crown_share, out=np.zeros(crowns.shape), where=has_crown)


def connected(hidden: Bool, wet: Bool, max_steps: int) -> Bool:
    """Return a mask of the hidden cells that a path of at most ``max_steps`` neighbouring cells connects with water."""
    whole = hidden | wet
    is_connected = np.zeros_like(hidden)
    box = box_around(whole, 0)
    is_connected[box] = scipy.ndimage.binary_dilation(
        wet[box], iterations=max_steps, mask=whole[box]
    )
    return is_connected & ~wet


BESIDE = 1.5
"""Cells are next to each other if their centres are at most this far apart, in cells. Diagonal
neighbours are, too."""
MIN_REED_SLOPE = 0.05
"""The bank behind reed is steeper than this.

It is not known well where a flatter bank reaches the level.
"""


def among_reed(cells: WaterCells, crowns: AnyArray, wet: Bool, level: Float64) -> Bool:
    """Return a mask of the cells with reed that are water.

    Reed that is connected with water is water up to the line at which the continued bank
    reaches the level. Parameters are those of `beneath_crowns`.
    """
    reach = math.ceil(CROWN_M / cells.size_m)
    is_reed, hidden, beside = crowns >= REED, is_hidden(crowns), within(wet, BESIDE)
    # Cells next to reed are partly reed if they are hidden or next to water.
    reed = is_reed | (within(is_reed, BESIDE) & (hidden | beside))
    reed = connected(reed & ~wet & cells.domain, wet, reach)
    bank = ~is_reed & ~hidden & ~wet & ~beside & (cells.returns > 0) & ~np.isnan(cells.ground)
    bank &= within(reed, CROWN_M / cells.size_m)
    # Reed without a bank nearby cannot be decided.
    reed &= within(bank, CROWN_M / cells.size_m)
    if not reed.any() or not bank.any():
        return np.zeros_like(reed)
    above = (cells.ground - level)[bank]
    height, slope = continued_bank(
        np.argwhere(reed), np.argwhere(bank), above, CROWN_M / cells.size_m
    )
    reed[reed] = (height <= LOW_M) & (slope > MIN_REED_SLOPE * cells.size_m)
    return connected(reed, wet, reach)


def has_no_bank(crowns: AnyArray, above: Float64) -> Bool:
    """Return a mask of the cells whose ground height is not that of the bank. It is valid only for cells of water.

    In hidden cells, the ground is interpolated. In cells of reed, ground above the water comes
    from plants.

    Parameters
    ----------
    crowns : float (h, w)
        Values of plants, see `plants_near_water`.
    above : float64 (h, w)
        Height of the ground above the water in metres.
    """
    return is_hidden(crowns) | ((crowns >= REED) & (above > LOW_M))
