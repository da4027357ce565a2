"""Sums per cell, for statistics that are collected piece by piece."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

Cells = npt.NDArray[np.int64]
Figure = TypeVar("Figure", np.int64, np.float64)


def summed(cells: Cells, sums: npt.NDArray[Figure]) -> tuple[Cells, npt.NDArray[Figure]]:
    """Return the distinct cells and the sums of their values.

    The cells are sorted by the last row of ``cells``, then by the row before it, and so on.

    Parameters
    ----------
    cells : int64, shape (k, n)
        Indices of the cell of each value, one row per axis.
    sums : array, shape (m, n)
        Values to add up per cell.
    """
    if cells.shape[1] == 0:
        return cells, sums
    order = np.lexsort(cells)
    cells = cells[:, order]
    first = np.flatnonzero(np.r_[True, np.any(cells[:, 1:] != cells[:, :-1], axis=0)])
    return cells[:, first], np.add.reduceat(sums[:, order], first, axis=1)
