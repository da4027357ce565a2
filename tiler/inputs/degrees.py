"""Recognition of degrees in files without a CRS, whose coordinates are otherwise lengths."""

from __future__ import annotations

from tiler.errors import InputError
from tiler.inputs.sources import SourceInfo

MAX_DEGREES = 180.0
"""Largest absolute coordinate. It is the same for x and y, since some writers swap them."""
MAX_SIDE = 2.0
"""Longest extent of a file in degrees, about 200 km."""
MIN_SIDE = 1e-5
"""Shortest extent for the density, 1 m in degrees: points at almost one position have any density."""
MAX_DENSITY = 1e8
"""Number of points per square unit above which the unit cannot be a length: points that are 0.1 mm
apart have 1e8 per m2. In degrees, 0.1 point per m2 gives 1e9."""


def validate_lengths(info: SourceInfo) -> None:
    """Raise InputError if the coordinates of a file without a CRS are so dense that they must be degrees."""
    if info.bounds is None:
        return
    x0, y0, _, x1, y1, _ = info.bounds
    sides = x1 - x0, y1 - y0
    if max(map(abs, (x0, y0, x1, y1))) > MAX_DEGREES or max(sides) > MAX_SIDE:
        return
    if min(sides) >= MIN_SIDE and info.points > MAX_DENSITY * sides[0] * sides[1]:
        raise InputError(
            f"{info.path}: has no CRS, and its coordinates look like degrees (x {x0:.7g}, y {y0:.7g}); reproject it "
            "to a projected CRS, or give --units m if they are metres"
        )
