"""Pixel centres on a TIN, and how far the data around each are known."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.kernel import kernel
from ptd.tin.circles import KnownBounds, Rule

UInt8Array = npt.NDArray[np.uint8]


# Bits of a mark while the facets are scanned.
_NEAR = 1
_FAR = 2
OWNED = 4


class PixelCentres(NamedTuple):
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
def _known_within(
    lattice: PixelCentres, sides: KnownBounds, column: int, row: int, reach: float
) -> bool:
    """Whether the window extends `reach` counts to all four sides of a pixel's centre."""
    x = float(lattice.x0 + column * lattice.step) / lattice.scale
    y = float(lattice.y0 - row * lattice.step) / lattice.scale
    across = x - reach >= sides.west and x + reach <= sides.east
    return across and y - reach >= sides.south and y + reach <= sides.north


@kernel
def mark_near_sides(
    marks: UInt8Array, lattice: PixelCentres, rule: Rule, sides: KnownBounds
) -> None:
    """Set the bits of pixels near unknown data.

    Set `_NEAR` where unknown data could change a pixel without a facet, and `_FAR` where they
    could change one with a facet.
    """
    slack = 1.0 + 2.0**-20
    far = 2.0 * rule.max_radius * slack + 2.0
    near = min(far, math.sqrt(float(rule.max_edge2)) * slack + 2.0)
    for row in range(marks.shape[0]):
        for column in range(marks.shape[1]):
            mark = 0
            if not _known_within(lattice, sides, column, row, near):
                mark |= _NEAR
            if not _known_within(lattice, sides, column, row, far):
                mark |= _FAR
            marks[row, column] = mark


@kernel
def settle_marks(marks: UInt8Array) -> None:
    """Replace the bits of each pixel by its final mark: 1 if unknown data could change it, else 0.

    The circle of a facet that passes reaches at most twice `max_radius` from its pixel, and may
    hold unknown data. A pixel without such a facet could get one from unknown data. But the
    corners of that facet would lie at most the length of its longest edge from the pixel. If
    all of them were known, the circle would be empty of known data too, and the facet would be
    a triangle of this TIN. So a smaller reach suffices there.
    """
    for row in range(marks.shape[0]):
        for column in range(marks.shape[1]):
            mark = marks[row, column]
            asked = _FAR if mark & OWNED else _NEAR
            marks[row, column] = 1 if mark & asked else 0
