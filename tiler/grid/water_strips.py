"""Lower level of a lake that was scanned at two water levels, in different flight strips.

The lake gets the lower level. At this level, the shore that was found is partly too high on the
bank. So the bank is continued below the higher level, and the shore lies where the bank reaches
the lower level. The lower level is used only if the shore at this level lies in the outermost
cells of the water.
"""

from __future__ import annotations

import numpy as np

from tiler.grid.coarse import Bools, Float64
from tiler.grid.profile import MIN_PIXELS, SMOOTH_M
from tiler.grid.water_shore import BANK_WIDTH_CELLS, SIDES


def bank_rises(ground: Float64, wet: Bools, measured: Bools) -> Float64:
    """Return the rises in metres from the land at the shore to the next cells behind it, float64 (n,).

    Parameters
    ----------
    ground : float64 (h, w)
        Heights of the terrain in metres, NaN if there are none.
    wet : bool (h, w)
        Mask of the water.
    measured : bool (h, w)
        Mask of the cells of water at whose sides rises are measured, at least three cells from the border of the array.
    """
    bank = np.where(wet, np.nan, ground)
    rises_by_side = []
    for axis, step in SIDES:
        next_heights = np.roll(bank, 2 * step, axis)
        rises_by_side.append((next_heights - np.roll(bank, step, axis))[measured])
    rises: Float64 = np.concatenate(rises_by_side)
    return rises[~np.isnan(rises)]


def lower_level(heights: Float64, rises: Float64) -> float | None:
    """Return the lower level of a lake in metres, or None if it has one level or its bank is too flat.

    Parameters
    ----------
    heights : float64 (n,)
        Heights of the returns of the water in metres.
    rises : float64 (n,)
        Result of `bank_rises`.
    """
    if min(len(heights), len(rises)) < MIN_PIXELS:
        return None
    low, high = np.percentile(heights, (25, 75))
    if not SMOOTH_M < high - low <= BANK_WIDTH_CELLS * np.median(rises):
        return None
    return float(low)
