"""Integer frame: coordinates are int32 counts of a thousandth of a unit of the CRS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.units import Units

COUNTS_PER_UNIT = 1000
"""Counts per unit of the CRS, independent of the scales of the files.

A count is a millimetre if the CRS is in metres and 0.3 mm if it is in feet."""

INT32_LIMIT = 2**31 - 1


@dataclass(frozen=True)
class CoordFrame:
    """Frame that gives the int32 counts their meaning.

    An *absolute* count is ``round(coordinate * 1000)``, an int64. The *local* count that is
    stored is the absolute count minus ``origin``. Heights have no origin, since int32 counts
    are enough for heights up to 2147 km. All lattices are anchored at absolute count 0, so the
    origin does not influence results.
    """

    units: Units = field(default_factory=Units)
    origin: tuple[int, int] = (0, 0)
    crs_wkt: str | None = None

    @property
    def metres_xy(self) -> Fraction:
        """Metres in one horizontal count."""
        return self.units.horizontal / COUNTS_PER_UNIT

    @property
    def metres_z(self) -> Fraction:
        """Metres in one vertical count."""
        return self.units.vertical / COUNTS_PER_UNIT

    def counts(self, metres: Fraction) -> Fraction:
        """Convert a horizontal length in metres to an exact number of counts."""
        return metres / self.metres_xy

    def coordinate(self, absolute: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Convert absolute counts to coordinates in units of the CRS, float64."""
        return np.asarray(absolute, dtype=np.float64) / COUNTS_PER_UNIT

    def coordinates(self, xyz: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
        """Convert local counts int32 (3, n) to coordinates in units of the CRS, float64 (n, 3)."""
        return self.coordinate(xyz.T + np.array([*self.origin, 0], dtype=np.int64))

    def to_json(self) -> dict[str, Any]:
        """Return a JSON-able description, which `from_json` reads."""
        return {
            "units": [str(self.units.horizontal), str(self.units.vertical)],
            "origin": list(self.origin),
            "crs_wkt": self.crs_wkt,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> CoordFrame:
        """Return the frame that `to_json` described."""
        horizontal, vertical = (Fraction(u) for u in data["units"])
        x, y = data["origin"]
        return cls(Units(horizontal, vertical), (int(x), int(y)), data["crs_wkt"])
