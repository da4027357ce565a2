"""Thresholds of a run from its histograms of distances and angles.

Source: Dong 2017 (004), sections 3.3.3 and 3.3.4. The paper shows both by pictures alone; how they are read
here is said below.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

SETTLED_SHARE = 0.05
"""The fall of the counts is over where it is slower than this share of the steepest."""

Int64 = npt.NDArray[np.int64]


def second_difference_jump(counts: Sequence[int]) -> int | None:
    """How many bins the first population of a histogram fills, by the second difference of its accumulated counts.

    Distances of ground to the seeds' TIN are small; on facades the distance "will sharply become big" (3.3.3), and the
    accumulated histogram bends from a steep climb into a slow one. Its second difference, the change of the counts from
    bin to bin, jumps down where the ground thins out and comes back to about zero where it ends: that is the
    threshold. For normal noise the jump is at one sigma and its end, at a twentieth of its depth, at three.

    Parameters
    ----------
    counts : sequence of int
        By bin, the nearest first.

    Returns
    -------
    int or None
        None where the counts never fall.
    """
    change = np.diff(np.asarray(counts, np.int64))
    if change.size == 0 or change.min() >= 0:
        return None
    steepest = int(np.argmin(change))
    settled = np.flatnonzero(-change[steepest:] <= SETTLED_SHARE * -change[steepest])
    return steepest + int(settled[0]) + 1 if settled.size else len(counts)


def outer_contour(counts: Int64, share: float) -> tuple[int, int] | None:
    """Bins below the largest first and second coordinate of a contour that holds a share of a 2-D histogram.

    The contour surrounds the fullest bins that together hold at least `share` of the counts; bins that are as full as
    its emptiest belong to it.

    Parameters
    ----------
    counts : int64 [a, b]
    share : float
        Above 0, at most 1.

    Returns
    -------
    (int, int) or None
        None for an empty histogram.
    """
    total = int(counts.sum())
    if total == 0:
        return None
    falling = np.sort(counts, axis=None)[::-1]
    level = falling[int(np.searchsorted(np.cumsum(falling), share * total))]
    first, second = np.nonzero(counts >= max(int(level), 1))
    return int(first.max()) + 1, int(second.max()) + 1
