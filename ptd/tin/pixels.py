"""Pixel centres on a TIN, and how much of the data around each the window holds."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.kernel import kernel
from ptd.tin.circles import Rule, Sides

UInt8Array = npt.NDArray[np.uint8]


_NEAR, _FAR, OWNED = 1, 2, 4  # of a mark while the facets are scanned


class Lattice(NamedTuple):
    """Pixel centres: int64, in local units of 1 / `scale` count.

    Attributes
    ----------
    x0, y0
        Centre of pixel (0, 0).
    step
        Distance of the centres; columns go to the east, rows to the south.
    scale
        Units in a count, less than 2**10.
    """

    x0: int
    y0: int
    step: int
    scale: int


@kernel
def _known_within(lattice: Lattice, sides: Sides, column: int, row: int, reach: float) -> bool:
    """Whether the window holds everything within `reach` counts of a pixel's centre, in x and in y."""
    x = float(lattice.x0 + column * lattice.step) / lattice.scale
    y = float(lattice.y0 - row * lattice.step) / lattice.scale
    across = x - reach >= sides.west and x + reach <= sides.east
    return across and y - reach >= sides.south and y + reach <= sides.north


@kernel
def mark_near_sides(marks: UInt8Array, lattice: Lattice, rule: Rule, sides: Sides) -> None:
    """Note for each pixel whether unknown sides of the window are near enough to change it: `_NEAR`, `_FAR`, both."""
    slack = 1.0 + 2.0**-20
    far = 2.0 * rule.max_radius * slack + 2.0
    near = min(far, math.sqrt(float(rule.max_edge2)) * slack + 2.0)
    for row in range(marks.shape[0]):
        for column in range(marks.shape[1]):
            mark = 0 if _known_within(lattice, sides, column, row, near) else _NEAR
            marks[row, column] = mark | (0 if _known_within(lattice, sides, column, row, far) else _FAR)


@kernel
def settle_marks(marks: UInt8Array) -> None:
    """Turn these notes into the final mark of each pixel: 1 if something unknown could change it, else 0.

    A pixel whose facet passes: that facet's circle, which reaches at most twice `max_radius` from the pixel, may hold
    unknown data. A pixel without one: unknown data could give it a facet. But the corners of that lie within its
    longest edge of the pixel, and were they all known, it would be a triangle of the window as well: empty of all data,
    its circle is empty of the window's. So a smaller reach suffices.
    """
    for row in range(marks.shape[0]):
        for column in range(marks.shape[1]):
            mark = marks[row, column]
            asked = _FAR if mark & OWNED else _NEAR
            marks[row, column] = 1 if mark & asked else 0
