"""Crowns that hang over water, and the water beneath them.

A laser scanner gets returns from a crown over water, and hardly any from the water below. The terrain there is
interpolated from the bank, so water would end where crowns begin. Over land, some pulses pass through a crown and reach
the ground. So connected cells with plants and without ground, next to water and not between cells with ground, are
water. The slope of a bank is continued beneath the crowns, and water ends where the continued bank rises above the
level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.raster import Block
from tiler.grid.checksum import checksum
from tiler.grid.coarse import Bools, padded
from tiler.grid.density import pixel_indices
from tiler.grid.ground import GroundSelection, read_ground, read_objects
from tiler.grid.reach import Floats, box_around, within
from tiler.grid.water_cells import WaterCells
from tiler.grid.water_search import ground_in
from tiler.grid.work import BlockWork
from tiler.store import TileStore, open_store, read_cells

OPEN, HIDDEN, REED = 1, 2, 4
"""Values of cells with plants, and with or without ground beneath them; `REED` is added for low plants."""
CROWN_M = 14.0
"""Largest distance by which water extends beneath crowns."""
MIN_POINTS = 4
"""Least number of points of a cell from which its roughness is known."""
ROUGH_M = 0.4
"""Least RMS distance of points of a crown from the plane through the points of their cell. Roofs, decks and boats are
smoother."""
REED_ROUGH_M, REED_M = 0.2, 3.0
"""Least roughness of reed, and its largest height above the terrain.

Boats and pontoons are smoother. Trees are higher.
"""
MIN_OPEN = 0.3
"""Least share of the cells with plants around a cell that have ground. With a lower share, a lack of ground is not a
sign of water."""
AMONG_M = 8.0
"""Half the width of gaps between cells with ground up to which cells without ground are land."""
BANK_CELLS = 20
"""Number of the nearest cells of the bank with ground whose plane is continued beneath crowns."""
MAX_QUAY_SLOPE = 0.15
"""Steepest slope of land that ends at an upright bank, as at a quay. All hidden cells next to such land are water."""
LOW_M = 0.15
"""Height of the continued bank above the water up to which a cell is water."""


@dataclass(frozen=True, kw_only=True)
class CrownsBlock(BlockWork):
    """Arguments of `crowns_block`.

    Attributes
    ----------
    sure : tuple of str
        Rasters of the confidence that each cell is water.
    occupancy, ground : str
        Rasters of the points in each cell, and of the heights of the terrain.
    rule : GroundSelection
    """

    sure: tuple[str, ...]
    occupancy: str
    ground: str
    rule: GroundSelection


def crowns_block(store_url: str, work: CrownsBlock) -> dict[str, Any]:
    """Write `OPEN` or `HIDDEN` and `REED` for the cells of a block with plants near water, 0 elsewhere.

    This is a `tiler.schedule.task.Work`. Only buckets with points near water are read.

    Returns
    -------
    dict
        ``filled`` (cells with plants), ``checksum``.
    """
    store, spec = open_store(store_url), work.spec
    size_m = float(spec.lattice.size * store.meta.frame.metres_xy)
    margin = crowns_margin(size_m)
    sure = np.max([read_cells(store, name, spec, padded(work.block, margin)) for name in work.sure], axis=0)
    near_water = within(sure > 0, CROWN_M / size_m)[margin - 1 : 1 - margin, margin - 1 : 1 - margin]
    window = padded(work.block, 1)
    examined = near_water & (read_cells(store, work.occupancy, spec, window) != 0)
    values = np.where(examined, _crowns(store, work, window, examined), 0)[1:-1, 1:-1].astype(np.float32)
    store.write_block(work.name, work.block, values)
    return {"filled": int(np.count_nonzero(values)), "checksum": checksum(values)}


def crowns_margin(size_m: float) -> int:
    """Return the margin around a block, in coarse cells, on which its crowns depend."""
    return math.ceil(CROWN_M / size_m) + 2


def _crowns(store: TileStore, work: CrownsBlock, window: Block, examined: Bools) -> npt.NDArray[np.int64]:
    """Return the value of each cell of a window, see `crowns_block`.

    The values of cells that are not ``examined`` may be wrong.
    """
    frame, spec = store.meta.frame, work.spec
    point_cells, are_objects = [np.empty(0, np.int64)], [np.empty(0, np.bool_)]
    counts = [np.empty((3, 0), np.int32)]
    for cell in store.buckets_within(spec.block_bounds(window)):
        bounds = store.meta.bucket.bounds(cell).intersection(spec.block_bounds(window))
        part = spec.part(window, bounds)
        top, left = part.row - window.row, part.col - window.col
        if not examined[top : top + part.height, left : left + part.width].any():
            continue
        ground, objects = read_ground(store, work.rule, bounds).xyz, read_objects(store, work.rule, bounds)
        for xyz, is_object in ((ground, False), (objects, True)):
            cells = pixel_indices(xyz, frame.origin, spec, window)
            chosen = examined.ravel()[cells]
            point_cells.append(cells[chosen])
            are_objects.append(np.full(int(chosen.sum()), is_object))
            counts.append(xyz[:, chosen])
    xyz, cells = np.concatenate(counts, axis=1), np.concatenate(point_cells)
    terrain = ground_in(store, work.ground, spec, window)
    return plant_kinds(xyz, cells, np.concatenate(are_objects), terrain, frame.metres_z)


def plant_kinds(
    xyz: npt.NDArray[np.int32],
    cells: npt.NDArray[np.int64],
    objects: Bools,
    terrain: Floats,
    metres_z: Fraction,
) -> npt.NDArray[np.int64]:
    """Return the value of each cell, int64 (h, w), see `crowns_block`.

    Parameters
    ----------
    xyz : int32 (3, n)
        Points in counts.
    cells : int64 (n,)
        Number of each point's cell, from 0.
    objects : bool (n,)
        Whether a point is not ground.
    terrain : float64 (h, w)
        Height of the terrain in metres, NaN for none.
    metres_z : Fraction
        Metres per vertical count.
    """
    scale = float(metres_z)

    def rough_cells(chosen: Bools, least: float) -> Bools:
        """Return a mask of the cells that have objects and are mostly rough, by some of the points."""
        rough = (roughness(xyz[:, chosen], cells[chosen], terrain.size) * scale).reshape(terrain.shape)
        return _mostly(rough > least, ~np.isnan(rough)) & has_objects

    has_ground, has_objects = (
        (np.bincount(cells[chosen], minlength=terrain.size) > 0).reshape(terrain.shape)
        for chosen in (~objects, objects)
    )
    tops = np.full(terrain.size, -np.inf)
    np.maximum.at(tops, cells, xyz[2] * scale)
    # Reed may be so low that its lowest points count as ground.
    reed = rough_cells(np.ones_like(objects), REED_ROUGH_M)
    reed &= tops.reshape(terrain.shape) - terrain <= REED_M
    kinds = np.where(has_ground, OPEN, HIDDEN)
    return np.where(rough_cells(objects, ROUGH_M), kinds, 0) + np.where(reed, REED, 0)


def is_hidden(crowns: npt.NDArray[Any]) -> Bools:
    """Return a mask of the cells with crowns and without ground, from the values of `crowns_block`."""
    return np.asarray(crowns % REED == HIDDEN)


def roughness(xyz: npt.NDArray[np.int32], cells: npt.NDArray[np.int64], size: int) -> Floats:
    """Return the RMS of the vertical distances of the points of each cell from their plane, float64 (size,).

    The RMS is in vertical counts. It is NaN for cells with fewer than `MIN_POINTS` points or with points on a line. The
    terms of sums are integers, so the order of points does not matter.

    Parameters
    ----------
    xyz : int32 (3, n)
        Counts.
    cells : int64 (n,)
        Number of each point's cell, from 0.
    size : int
        Number of cells.
    """
    lowest = np.full((3, size), np.iinfo(np.int64).max)
    offsets = xyz.astype(np.int64)
    for axis in range(3):
        np.minimum.at(lowest[axis], cells, offsets[axis])
    x, y, z = offsets - lowest[:, cells]

    def total(values: npt.NDArray[np.int64]) -> Floats:
        return np.bincount(cells, values.astype(np.float64), size).astype(np.float64)

    number = np.bincount(cells, minlength=size).astype(np.float64)
    n = np.maximum(number, 1.0)
    mean_x, mean_y, mean_z = total(x) / n, total(y) / n, total(z) / n
    xx, xy, yy = (
        total(x * x) / n - mean_x**2,
        total(x * y) / n - mean_x * mean_y,
        total(y * y) / n - mean_y**2,
    )
    xz, yz, zz = (
        total(x * z) / n - mean_x * mean_z,
        total(y * z) / n - mean_y * mean_z,
        total(z * z) / n - mean_z**2,
    )
    determinant = xx * yy - xy * xy
    has_plane = (number >= MIN_POINTS) & (determinant > 1e-6 * xx * yy)
    explained = np.divide(
        xz * xz * yy - 2 * xz * yz * xy + yz * yz * xx, determinant, out=np.zeros(size), where=has_plane
    )
    return np.where(has_plane, np.sqrt(np.maximum(zz - explained, 0.0)), np.nan)


def _mostly(chosen: Bools, known: Bools) -> Bools:
    """Return a mask of the cells in whose squares of 3 by 3 cells more than half of the known cells are chosen."""
    square = np.ones((3, 3), np.int64)
    n_chosen = scipy.ndimage.convolve((chosen & known).astype(np.int64), square, mode="constant")
    n_known = scipy.ndimage.convolve(known.astype(np.int64), square, mode="constant")
    return np.asarray(2 * n_chosen > n_known)


def beneath_crowns(cells: WaterCells, crowns: npt.NDArray[Any], wet: Bools, level: Floats) -> Bools:
    """Return a mask of the cells beneath crowns that are water.

    Parameters
    ----------
    cells : WaterCells
        Cells with smoothed heights.
    crowns : float, shape of the cells
        Plants, see `crowns_block`.
    wet : bool, shape of the cells
        Mask of the cells of water.
    level : float64, shape of the cells
        Level of the water near each cell in metres.
    """
    hidden = is_hidden(crowns) & ~wet & cells.domain
    hidden &= _open_share(crowns, round(4 * CROWN_M / cells.size)) >= MIN_OPEN
    bank = ~is_hidden(crowns) & ~wet & (cells.returns > 0) & ~np.isnan(cells.ground)
    if not hidden.any() or not bank.any():
        return np.zeros_like(hidden)
    radius = AMONG_M / cells.size
    hidden &= within(~within(bank, radius), radius)
    hidden = connected(hidden, wet, math.ceil(CROWN_M / cells.size))
    height, slope = continued_bank(np.argwhere(hidden), np.argwhere(bank), (cells.ground - level)[bank])
    hidden[hidden] = (height <= LOW_M) | (slope <= MAX_QUAY_SLOPE * cells.size)
    return connected(hidden, wet, math.ceil(CROWN_M / cells.size))


def _open_share(crowns: npt.NDArray[Any], side: int) -> Floats:
    """Return the share of cells with ground among the cells with plants in a square around each cell.

    The square has ``side`` rows, or one more if that is even.
    """
    odd_side = side // 2 * 2 + 1
    has_ground, has_plants = (
        scipy.ndimage.uniform_filter(mask.astype(np.float64), odd_side, mode="constant")
        for mask in (crowns % REED == OPEN, crowns % REED > 0)
    )
    return np.divide(has_ground, has_plants, out=np.zeros(crowns.shape), where=crowns % REED > 0)


def connected(hidden: Bools, wet: Bools, max_steps: int) -> Bools:
    """Return a mask of the hidden cells that are connected with water by at most ``max_steps`` steps."""
    whole = hidden | wet
    is_connected = np.zeros_like(hidden)
    box = box_around(whole, 0)
    is_connected[box] = scipy.ndimage.binary_dilation(wet[box], iterations=max_steps, mask=whole[box])
    return is_connected & ~wet


def continued_bank(
    cells: npt.NDArray[np.int64], bank: npt.NDArray[np.int64], above: Floats
) -> tuple[Floats, Floats]:
    """Continue planes through the nearest cells of the bank to other cells.

    Parameters
    ----------
    cells : int64 (n, 2)
        Row and column of the other cells.
    bank : int64 (m, 2)
        Row and column of the cells of the bank.
    above : float64 (m,)
        Height of the bank's cells above the water in metres.

    Returns
    -------
    height : float64 (n,)
        Height above the water of the plane at each cell.
    slope : float64 (n,)
        Slope of the plane in metres per cell.
    """
    count = min(BANK_CELLS, len(bank))
    _, near = scipy.spatial.cKDTree(bank).query(cells, k=count)
    near = near.reshape(len(cells), count)
    offsets = (bank[near] - cells[:, None]).astype(np.float64)
    columns = np.concatenate((np.ones((len(cells), count, 1)), offsets), axis=2)
    normal = columns.transpose(0, 2, 1) @ columns + 1e-6 * np.eye(3)
    right = columns.transpose(0, 2, 1) @ above[near][:, :, None]
    plane = np.asarray(np.linalg.solve(normal, right), np.float64)[:, :, 0]
    slope = np.hypot(plane[:, 1], plane[:, 2])
    return plane[:, 0], slope
