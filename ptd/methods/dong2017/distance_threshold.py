"""The first threshold of a run from its histogram of distances.

Source: Dong 2017 (004), section 3.3.3. The paper only shows a picture; `second_difference_jump`
explains how it is read here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

SETTLED_SHARE = 0.05
"""Share of the steepest fall. The counts have settled where they fall by less."""


def second_difference_jump(counts: Sequence[int]) -> int | None:
    """Number of bins of the first population of a histogram, by the second difference of its accumulated counts.

    Distances of ground to the seeds' TIN are small. On facades the distance "will sharply
    become big" (3.3.3), and the accumulated histogram bends from a steep climb to a slow one.
    Its second difference is the change of the counts from bin to bin. It jumps down where the
    ground thins out, and returns to about zero where the ground ends, which is the threshold.
    For normal noise it jumps at one sigma, and returns to a twentieth of its depth at three
    sigma.

    Parameters
    ----------
    counts : sequence of int
        Counts by bin, from near to far.

    Returns
    -------
    int or None
        None if the counts never fall.
    """
    change = np.diff(np.asarray(counts, np.int64))
    if change.size == 0 or change.min() >= 0:
        return None
    steepest = int(np.argmin(change))
    settled = np.flatnonzero(-change[steepest:] <= SETTLED_SHARE * -change[steepest])
    if not settled.size:
        return len(counts)
    return steepest + int(settled[0]) + 1
