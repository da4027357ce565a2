"""Heights of the bank where it is not seen, from planes through the nearest cells of the bank."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

from tiler.grid.reach import Floats

N_BANK_CELLS = 20
"""The bank is continued by a plane through this many of its cells with ground, the nearest ones."""
MAX_TIES = 16
"""Up to this many more cells are used if they are as far away as the last of the nearest cells."""


def continued_bank(
    cells: npt.NDArray[np.int64], bank: npt.NDArray[np.int64], above: Floats
) -> tuple[Floats, Floats]:
    """Extrapolate the bank to other cells. Each cell has its own plane through the nearest cells of the bank.

    Parameters
    ----------
    cells : int64 (n, 2)
        Row and column of the cells to which the bank is continued.
    bank : int64 (m, 2)
        Row and column of the cells of the bank.
    above : float64 (m,)
        Height of the cells of the bank above the water in metres.

    Returns
    -------
    height : float64 (n,)
        Height of the plane above the water at each cell, in metres.
    slope : float64 (n,)
        Slope of the plane in metres per cell.
    """
    if not len(cells) or not len(bank):
        return np.full(len(cells), np.inf), np.full(len(cells), np.inf)
    count = min(N_BANK_CELLS + MAX_TIES, len(bank))
    nearest = scipy.spatial.cKDTree(bank).query(cells, k=range(1, count + 1))
    distance, near = np.asarray(nearest[0]), np.asarray(nearest[1])
    # Cells at the same distance are all used. The tree would choose some of them, depending on cells far away.
    used = distance <= distance[:, min(N_BANK_CELLS, count) - 1, None]
    offsets = (bank[near] - cells[:, None]).astype(np.float64)
    columns = np.concatenate((np.ones((len(cells), count, 1)), offsets), axis=2) * used[:, :, None]
    normal = columns.transpose(0, 2, 1) @ columns + 1e-6 * np.eye(3)
    right = columns.transpose(0, 2, 1) @ above[near][:, :, None]
    plane = np.asarray(np.linalg.solve(normal, right), np.float64)[:, :, 0]
    slope = np.hypot(plane[:, 1], plane[:, 2])
    return plane[:, 0], slope
