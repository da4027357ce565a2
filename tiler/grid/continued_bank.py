"""Heights of the bank where it is not seen, from planes through the nearest cells of the bank."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

from tiler.grid.coarse import Float64

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

Indices = npt.NDArray[np.int64]


def continued_bank(
    cells: Indices, bank: Indices, above: Float64, reach: float
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


def _nearest(
    tree: scipy.spatial.cKDTree, cells: Indices, reach: float
) -> tuple[npt.NDArray[np.bool_], Indices]:
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


def _planes(
    offsets: Indices, heights: Float64, used: npt.NDArray[np.bool_]
) -> tuple[Float64, Float64]:
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
