"""The points nearest to the centre of each pixel, exactly, and heights weighted by their inverse distances.

Points are binned by pixel and searched ring by ring. Ties are decided by the points themselves
(distance, then x, y, z), so the result does not depend on order, tile or frame.

Weights are Shepard's (A two-dimensional interpolation function, 1968): twelve neighbours have
weights 1 / d2; a position on a point gets the height of the point. Heights are relative to the
nearest neighbour. They are summed from near to far, and ties in the order of (x, y, z), so they
do not depend on order, tile or frame either.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

from ptd.arrays import Float64, Int32, Int64
from ptd.cells import Xyz
from ptd.kernel import as_int64, kernel
from ptd.tin.gridding import Pixels
from ptd.tin.raster import PixelCentres

NONE = -1
"""Index of a neighbour that does not exist within reach."""


class Nearest(NamedTuple):
    """Result of `nearest_points`.

    Attributes
    ----------
    squared : int64 [rows, columns, k]
        Squared distances in ascending order, in counts squared. They are measured to the centre after its coordinates
        are rounded down to whole counts. 2**63 - 1 for `NONE`.
    points : int32 [rows, columns, k]
        Indices of the points, `NONE` if fewer than k lie within reach.
    """

    squared: Int64
    points: Int32


class _Bins(NamedTuple):
    """Points by pixel, for the raster and as many pixels around it as the search reaches.

    Attributes
    ----------
    starts : int64 [rows * columns + 1]
        Start of each pixel's points in ``order``.
    order : int32
        Indices of the points, pixel by pixel.
    empty : int32 [rows, columns]
        Number of empty rings around each pixel.
    pad : int
        Pixels around the raster on each side.
    """

    starts: Int64
    order: Int32
    empty: Int32
    pad: int


@kernel
def _bin(
    x: Int32, y: Int32, lattice: tuple[int, int, int, int], block: tuple[int, int, int, int]
) -> tuple[Int64, Int32]:
    """Sort points by pixel: the arrays ``starts`` and ``order`` of `_Bins`.

    `lattice` is that of `ptd.frame.CellLattice`; `block` is the western column, the northern row, rows and columns.
    """
    (p, q, ox, oy), (west, north, rows, columns) = lattice, block
    cells = np.empty(x.size, np.int64)
    starts = np.zeros(rows * columns + 1, np.int64)
    for i in range(x.size):
        column = ((as_int64(x[i]) + ox) * q) // p - west
        row = north - ((as_int64(y[i]) + oy) * q) // p
        inside = 0 <= column < columns and 0 <= row < rows
        cells[i] = -1
        if inside:
            cells[i] = row * columns + column
            starts[cells[i] + 1] += 1
    for cell in range(rows * columns):
        starts[cell + 1] += starts[cell]
    free = starts[:-1].copy()
    order = np.empty(starts[-1], np.int32)
    for i in range(x.size):
        if cells[i] >= 0:
            order[free[cells[i]]] = i
            free[cells[i]] += 1
    return starts, order


@kernel
def _before(x: Int32, y: Int32, z: Int32, i: int, j: int) -> bool:
    """Whether point i goes before j at the same distance."""
    if x[i] != x[j]:
        return bool(x[i] < x[j])
    if y[i] != y[j]:
        return bool(y[i] < y[j])
    return bool(z[i] < z[j])


@kernel
def _look_in(
    points: Xyz,
    order: Int32,
    cell: tuple[int, int],
    disk: tuple[int, int, int],
    squared: Int64,
    index: Int32,
    found: int,
) -> int:
    """Merge the points of a cell (first, end) into the ``found`` nearest of a pixel, and return their new number.

    Only points within the disk (x, y, squared radius) count.
    """
    x, y, z = points
    k = index.size
    cx, cy, reach2 = disk
    for j in range(cell[0], cell[1]):
        i = as_int64(order[j])
        dx, dy = as_int64(x[i]) - cx, as_int64(y[i]) - cy
        d2 = dx * dx + dy * dy
        if d2 > reach2 or (found == k and d2 > squared[k - 1]):
            continue
        slot = found if found < k else k - 1
        if (
            found == k
            and d2 == squared[slot]
            and not _before(x, y, z, i, as_int64(index[slot]))
        ):
            continue
        while slot > 0 and (
            squared[slot - 1] > d2
            or (squared[slot - 1] == d2 and _before(x, y, z, i, as_int64(index[slot - 1])))
        ):
            squared[slot], index[slot] = squared[slot - 1], index[slot - 1]
            slot -= 1
        squared[slot], index[slot] = d2, i
        found = min(found + 1, k)
    return found


@kernel
def _search(
    points: Xyz, bins: _Bins, lattice: PixelCentres, reach: float, squared: Int64, index: Int32
) -> None:
    starts, order, empty, pad = bins
    x0, y0, step, scale = lattice
    rows, columns, k = index.shape
    height, width = empty.shape
    size = float(step) / float(scale)
    reach2 = as_int64(math.floor(reach * reach))
    for row in range(rows):
        cy = (y0 - row * step) // scale
        for column in range(columns):
            cx = (x0 + column * step) // scale
            at_row, at_column = row + pad, column + pad
            n_found = as_int64(0)
            near, near_indices = squared[row, column], index[row, column]
            ring = as_int64(empty[at_row, at_column])
            while True:
                # All points nearer than this have been seen; one count allows for the rounded
                # centre.
                seen = (float(ring) - 0.5) * size - 1.0
                if seen > reach or (
                    n_found == k and seen > 0.0 and float(near[k - 1]) < seen * seen
                ):
                    break
                if ring > max(height, width):
                    break
                for r in range(max(at_row - ring, 0), min(at_row + ring, height - 1) + 1):
                    whole = r == at_row - ring or r == at_row + ring
                    c = at_column - ring
                    while c <= at_column + ring:
                        if 0 <= c < width:
                            cell = r * width + c
                            if starts[cell + 1] > starts[cell]:
                                held, disk = (starts[cell], starts[cell + 1]), (cx, cy, reach2)
                                n_found = _look_in(
                                    points, order, held, disk, near, near_indices, n_found
                                )
                        c += 1 if whole or ring == 0 else 2 * ring
                ring += 1


def nearest_points(
    x: Int32, y: Int32, z: Int32, pixels: Pixels, k: int, reach: float
) -> Nearest:
    """The ``k`` nearest points of each pixel centre, within a distance.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts; points farther than ``reach`` from all pixels are ignored.
    pixels : Pixels
        The block of pixels; its origin has to be the points' local 0.
    k : int
        Number of neighbours.
    reach : float
        Largest distance of a neighbour, counts.

    Returns
    -------
    Nearest

    Raises
    ------
    ValueError
        If ``k`` is below 1, or ``reach`` is negative or at least 2**26 counts.
    """
    if k < 1 or not 0 <= reach < 2**26:
        raise ValueError(f"k is {k}, reach {reach} counts: need k >= 1 and 0 <= reach < 2**26")
    squared = np.full((pixels.rows, pixels.columns, k), np.iinfo(np.int64).max, np.int64)
    index = np.full((pixels.rows, pixels.columns, k), NONE, np.int32)
    if x.size == 0 or index.size == 0:
        return Nearest(squared, index)
    pad = math.ceil(reach * pixels.q / pixels.p) + 1
    height, width = pixels.rows + 2 * pad, pixels.columns + 2 * pad
    cells = (pixels.p, pixels.q, pixels.origin_x, pixels.origin_y)
    starts, order = _bin(x, y, cells, (pixels.left - pad, pixels.top + pad, height, width))
    if order.size == 0:
        return Nearest(squared, index)
    occupied = (np.diff(starts) > 0).reshape(height, width)
    empty = scipy.ndimage.distance_transform_cdt(~occupied, metric="chessboard")
    bins = _Bins(starts, order, empty, pad)
    _search(Xyz(x, y, z), bins, pixels.lattice, float(reach), squared, index)
    return Nearest(squared, index)


NEIGHBOURS = 12


def inverse_distance(
    x: Int32, y: Int32, z: Int32, pixels: Pixels, reach: float
) -> tuple[Float64, Float64]:
    """Return heights at pixel centres, and the distance to the farthest neighbour of each.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts.
    pixels : Pixels
    reach : float
        Largest distance of a neighbour in horizontal counts.

    Returns
    -------
    heights : float64 [rows, columns]
        Counts, NaN where no point is within reach.
    distance : float64 [rows, columns]
        Distance of the twelfth neighbour in counts, or ``reach`` if there are fewer.
    """
    squared, points = nearest_points(x, y, z, pixels, NEIGHBOURS, reach)
    there = points != NONE
    near_z = np.where(there, z[points] if z.size else 0, 0).astype(np.float64)
    d2 = np.where(there, squared, 1).astype(np.float64)
    base, on_point = near_z[..., 0], d2[..., 0] == 0.0
    weights, rises = np.zeros(base.shape), np.zeros(base.shape)
    for k in range(NEIGHBOURS):
        weight = there[..., k] / np.where(d2[..., k] == 0.0, 1.0, d2[..., k])
        weights += weight
        rises += weight * (near_z[..., k] - base)
    rise = np.where(on_point, 0.0, rises / np.where(weights > 0, weights, 1.0))
    heights = np.where(there[..., 0], base + rise, np.nan)
    return heights, np.where(there[..., -1], np.sqrt(d2[..., -1]), reach)
