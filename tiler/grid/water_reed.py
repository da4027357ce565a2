"""Water in reed, through which no pulse reaches the water.

Reed is low, stands in the water, and is connected with open water. The lowest points of reed
may count as ground, so the water would end where reed begins. As beneath crowns, the slope of
the bank behind the reed is continued, and the water ends where the continued bank reaches the
level. Low plants stay land if the bank behind them is flat, or if they are far from water.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.grid.coarse import Bools, Float64, within
from tiler.grid.continued_bank import continued_bank
from tiler.grid.water_cells import WaterCells
from tiler.grid.water_crowns import CROWN_M, LOW_M, REED, connected, is_hidden

BESIDE = 1.5
"""Cells are next to each other if their centres are at most this far apart, in cells. Diagonal
neighbours are, too."""
MIN_REED_SLOPE = 0.05
"""The bank behind reed is steeper than this.

It is not known well where a flatter bank reaches the level.
"""


def among_reed(
    cells: WaterCells, crowns: npt.NDArray[Any], wet: Bools, level: Float64
) -> Bools:
    """Return a mask of the cells with reed that are water.

    Reed that is connected with water is water up to the line at which the continued bank
    reaches the level. Parameters are those of `tiler.grid.water_crowns.beneath_crowns`.
    """
    reach = math.ceil(CROWN_M / cells.size_m)
    is_reed, hidden, beside = crowns >= REED, is_hidden(crowns), within(wet, BESIDE)
    # Cells next to reed are partly reed if they are hidden or next to water.
    reed = is_reed | (within(is_reed, BESIDE) & (hidden | beside))
    reed = connected(reed & ~wet & cells.domain, wet, reach)
    bank = ~is_reed & ~hidden & ~wet & ~beside & (cells.returns > 0) & ~np.isnan(cells.ground)
    bank &= within(reed, CROWN_M / cells.size_m)
    # Reed without a bank nearby cannot be decided.
    reed &= within(bank, CROWN_M / cells.size_m)
    if not reed.any() or not bank.any():
        return np.zeros_like(reed)
    above = (cells.ground - level)[bank]
    height, slope = continued_bank(
        np.argwhere(reed), np.argwhere(bank), above, CROWN_M / cells.size_m
    )
    reed[reed] = (height <= LOW_M) & (slope > MIN_REED_SLOPE * cells.size_m)
    return connected(reed, wet, reach)


def has_no_bank(crowns: npt.NDArray[Any], above: Float64) -> Bools:
    """Return a mask of the cells whose ground height is not that of the bank. It is valid only for cells of water.

    In hidden cells, the ground is interpolated. In cells of reed, ground above the water comes
    from plants.

    Parameters
    ----------
    crowns : float (h, w)
        Values of plants, see `tiler.grid.water_crowns.plants_near_water`.
    above : float64 (h, w)
        Height of the ground above the water in metres.
    """
    return is_hidden(crowns) | ((crowns >= REED) & (above > LOW_M))
