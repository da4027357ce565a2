"""The first threshold of a run from its histogram of distances.

Source: Dong 2017 (004), section 3.3.3. The paper shows it by a picture alone; how it is read here is said below.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

SETTLED_SHARE = 0.05
"""The fall of the counts is over where it is slower than this share of the steepest."""


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
