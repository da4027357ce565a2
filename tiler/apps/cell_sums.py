"""Sums by cell, for figures that are collected piece by piece."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

Cells = npt.NDArray[np.int64]
Figure = TypeVar("Figure", np.int64, np.float64)


def summed(cells: Cells, sums: npt.NDArray[Figure]) -> tuple[Cells, npt.NDArray[Figure]]:
    """The distinct cells, sorted by the last row, then the row before it, with the sums of their figures.

    Parameters
    ----------
    cells : int64, shape (k, n)
    sums : array, shape (m, n)
    """
    if cells.shape[1] == 0:
        return cells, sums
    order = np.lexsort(cells)
    cells = cells[:, order]
    first = np.flatnonzero(np.r_[True, np.any(cells[:, 1:] != cells[:, :-1], axis=0)])
    return cells[:, first], np.add.reduceat(sums[:, order], first, axis=1)
