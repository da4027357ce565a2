"""Distances of cells from others, in strips: a distance transform of a whole raster takes 50 bytes a cell."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import scipy

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]

STRIP_ROWS = 256
"""Rows at once, or twice the radius where that is more."""


def within(cells: Bools, radius: float) -> Bools:
    """Cells whose centres lie within a radius, in cells, of the centre of one that is set; bool (height, width)."""
    found = np.zeros(cells.shape, np.bool_)
    for rows, distance in _strips(cells, radius):
        np.less_equal(distance, radius, out=found[rows])
    return found


def distances(cells: Bools, radius: float) -> Floats:
    """Distance of each cell from the nearest that is set, in cells; infinite beyond a radius; (height, width)."""
    found = np.full(cells.shape, np.inf)
    for rows, distance in _strips(cells, radius):
        np.copyto(found[rows], distance, where=distance <= radius)
    return found


def _strips(cells: Bools, radius: float) -> Iterator[tuple[slice, Floats]]:
    """Rows with cells that are set near them, and their distances, which are right up to the radius."""
    reach = max(math.floor(radius), 0)
    step = max(STRIP_ROWS, 2 * reach)
    for first in range(0, len(cells), step):
        top = max(first - reach, 0)
        strip = cells[top : first + step + reach]
        if strip.any():
            distance = scipy.ndimage.distance_transform_edt(~strip)[first - top :][:step]
            yield slice(first, first + len(distance)), distance
