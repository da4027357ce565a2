"""Extent of the outer contour of a 2-D histogram (Dong 2018, 2.5.3 and figure 5)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_JOINED = np.array([[1, 1, 0], [1, 1, 1], [0, 1, 1]])
"""Neighbours along the axes and along the diagonal that splits a square into triangles."""
_STEPS = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1)]


def contour_reach(counts: npt.NDArray[np.int64], level: float) -> tuple[float, float] | None:
    """Return the largest first and second coordinate of the contour around the fullest bin.

    Counts are values at the middles of their bins and are interpolated over triangles, two per
    square, as the paper does with scattered points. Beyond the histogram they are 0. If there
    are several contours at the level, the one around the fullest bin counts (the first of equal
    bins), because islands farther out are other populations.

    Parameters
    ----------
    counts : int64 [a, b]
    level : float
        Level of the contour, above 0.

    Returns
    -------
    (float, float) or None
        Coordinates in bins from the origin; None if no bin reaches the level.
    """
    from scipy.ndimage import label

    high = np.pad(counts, 1) >= level
    values = np.pad(counts, 1).astype(np.float64)
    peak = np.unravel_index(int(np.argmax(values)), values.shape)
    if not high[peak]:
        return None
    parts, _ = label(high, _JOINED)
    rows, columns = np.nonzero(parts == parts[peak])
    reach = [0.0, 0.0]
    for down, right in _STEPS:
        within, beyond = values[rows, columns], values[rows + down, columns + right]
        out = np.flatnonzero(beyond < level)
        if out.size:
            share = (within[out] - level) / (within[out] - beyond[out])
            # The pad adds one bin, and the value is at the middle of its bin.
            reach[0] = max(reach[0], float((rows[out] + down * share).max()) - 0.5)
            reach[1] = max(reach[1], float((columns[out] + right * share).max()) - 0.5)
    return reach[0], reach[1]
