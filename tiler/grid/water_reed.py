"""Water in reed, through which no pulse reaches the water.

Reed is low, stands in the water, and is connected with open water. Its lowest points may count as ground, so the water
would end where reed begins. As beneath crowns, the slope of the bank behind the reed is continued, and the water ends
where it reaches the level. Plants behind which the bank is flat, and plants far from water, stay land.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.grid.coarse import Bools
from tiler.grid.reach import Floats, within
from tiler.grid.water_cells import WaterCells
from tiler.grid.water_crowns import CROWN_M, LOW_M, REED, connected, continued_bank, is_hidden

BESIDE = 1.5
"""Distance in cells to all neighbours of a cell. Cells beside both reed and water are partly reed."""
MIN_REED_SLOPE = 0.05
"""Least slope of a bank behind reed. The position at which a flatter one reaches the level is not known well."""


def among_reed(cells: WaterCells, crowns: npt.NDArray[Any], wet: Bools, level: Floats) -> Bools:
    """Return a mask of the cells with reed that are water.

    Pulses do not reach the water in reed, and the lowest points of the reed may count as ground. So reed that is
    connected with water is water up to the position at which the slope of the bank behind it reaches the level.
    Parameters are those of `beneath_crowns`.
    """
    reach = math.ceil(CROWN_M / cells.size)
    is_reed, hidden, beside = crowns >= REED, is_hidden(crowns), within(wet, BESIDE)
    reed = is_reed | (within(is_reed, BESIDE) & (hidden | beside))
    reed = connected(reed & ~wet & cells.domain, wet, reach)
    bank = ~is_reed & ~hidden & ~wet & ~beside & (cells.returns > 0) & ~np.isnan(cells.ground)
    bank &= within(reed, CROWN_M / cells.size)
    reed &= within(bank, CROWN_M / cells.size)  # A bank elsewhere says nothing about this reed.
    if not reed.any() or not bank.any():
        return np.zeros_like(reed)
    height, slope = continued_bank(np.argwhere(reed), np.argwhere(bank), (cells.ground - level)[bank])
    reed[reed] = (height <= LOW_M) & (slope > MIN_REED_SLOPE * cells.size)
    return connected(reed, wet, reach)


def without_bank(crowns: npt.NDArray[Any], above: Floats) -> Bools:
    """Return a mask of the cells whose ground, if they are water, is not that of a bank.

    Parameters
    ----------
    crowns : float (h, w)
        Plants, see `crowns_block`.
    above : float64 (h, w)
        Height of the ground above the water in metres.
    """
    return is_hidden(crowns) | ((crowns >= REED) & (above > LOW_M))
