"""Usual number of returns in a coarse cell, from histograms of blocks."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

LEVELS = 5
"""Number of levels: single cells, and cells merged 2 x 2, 4 x 4, ..."""
BINS_PER_OCTAVE = 16
"""Bins of the logarithm of a count. Each bin of counts up to 20 contains a single count."""

Histogram = list[list[int]]
"""Bin and number of cells, for the cells with returns."""


def merged(values: npt.NDArray[Any], times: int) -> npt.NDArray[Any]:
    """Return the cells in squares of ``times`` by ``times``, shape (height / times, width / times, times ** 2)."""
    rows, cols = (side // times for side in values.shape)
    squares: npt.NDArray[Any] = (
        values.reshape(rows, times, cols, times).swapaxes(1, 2).reshape(rows, cols, -1)
    )
    return squares


def histograms(counts: npt.NDArray[np.int64]) -> list[Histogram]:
    """Return histograms of the returns per cell of a block, one for each level of merging.

    Parameters
    ----------
    counts : int64, shape (height, width)
    """
    level_histograms = []
    for level in range(LEVELS):
        sums = merged(counts, 1 << level).sum(axis=2)
        bins = np.rint(np.log2(sums[sums > 0]) * BINS_PER_OCTAVE).astype(np.int64)
        bin_numbers, cells = np.unique(bins, return_counts=True)
        level_histograms.append(
            [[int(b), int(n)] for b, n in zip(bin_numbers, cells, strict=True)]
        )
    return level_histograms


def usual_returns(found: Iterable[list[Histogram]], enough: float) -> tuple[int, float] | None:
    """Find how many cells to merge so that a cell without returns is significant.

    Parameters
    ----------
    found : iterable of list of Histogram
        The `histograms` of some blocks.
    enough : float
        Least median of the cells with returns.

    Returns
    -------
    (int, float) or None
        Number of cells to merge along a side, and the median of the merged cells with returns; None if no level has a
        large enough median.
    """
    blocks = list(found)
    for level in range(LEVELS):
        bins = np.array([pair for block in blocks for pair in block[level]], np.int64).reshape(
            -1, 2
        )
        if not len(bins):
            return None
        bins = bins[np.argsort(bins[:, 0], kind="stable")]
        cumulative = np.cumsum(bins[:, 1])
        median = float(
            2 ** (bins[np.searchsorted(cumulative, cumulative[-1] / 2), 0] / BINS_PER_OCTAVE)
        )
        if median >= enough:
            return 1 << level, median
    return None
