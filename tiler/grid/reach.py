"""Cells within a distance of others, in strips: a distance transform of a whole raster takes 50 bytes a cell."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import scipy

Bools = npt.NDArray[np.bool_]

STRIP_ROWS = 256
"""Rows at once, or twice the radius where that is more."""


def within(cells: Bools, radius: float) -> Bools:
    """Cells whose centres lie within a radius, in cells, of the centre of one that is set; bool (height, width)."""
    found = np.zeros(cells.shape, np.bool_)
    reach = max(math.floor(radius), 0)
    step = max(STRIP_ROWS, 2 * reach)
    for first in range(0, len(cells), step):
        top = max(first - reach, 0)
        strip = cells[top : first + step + reach]
        if strip.any():
            rows = scipy.ndimage.distance_transform_edt(~strip)[first - top :][:step]
            np.less_equal(rows, radius, out=found[first : first + step])
    return found
