"""Columns of simulated points, and the protocol of the sensors that simulate them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from ptd.arrays import Bool, Float64, UInt8, UInt16
from tiler.core.points import GROUND, HIGH_NOISE, LOW_NOISE, UNCLASSIFIED, WATER
from tiler.simulate.objects import (
    BRIDGE,
    BUILDING,
    HIGH_VEGETATION,
    LOW_VEGETATION,
    MEDIUM_VEGETATION,
    TOWER,
    WIRE,
)
from tiler.simulate.site import Site

Box = tuple[float, float, float, float]
"""Half-open box x0, y0, x1, y1 in metres."""

CLASS_NAMES = {
    UNCLASSIFIED: "cars, garden walls",
    GROUND: "ground",
    LOW_VEGETATION: "plants below 1 m",
    MEDIUM_VEGETATION: "plants below 3 m",
    HIGH_VEGETATION: "higher plants",
    BUILDING: "buildings, facades",
    LOW_NOISE: "blunders below the ground",
    WATER: "water",
    WIRE: "wires",
    TOWER: "towers of wires",
    BRIDGE: "bridges",
    HIGH_NOISE: "blunders in the air",
}
"""Descriptions of the ASPRS classes of simulated points."""


@dataclass(frozen=True)
class SimulatedPoints:
    """Columns of ``n`` points.

    Attributes
    ----------
    xyz : float64, shape (n, 3), metres
    label : uint8, shape (n,)
        ASPRS classes of `CLASS_NAMES`.
    number, count : uint8, shape (n,)
        Return number, and number of returns of the pulse.
    angle_deg : float64, shape (n,)
        Scan angle of the pulse.
    rgb : uint16, shape (n, 3), optional
    """

    xyz: Float64
    label: UInt8
    number: UInt8
    count: UInt8
    angle_deg: Float64
    rgb: UInt16 | None = None

    def __len__(self) -> int:
        return len(self.label)

    def take(self, keep: Bool) -> SimulatedPoints:
        """Return the points of a mask, in the same order."""
        columns: list[Any] = [
            None if column is None else column[keep] for column in self._columns
        ]
        return SimulatedPoints(*columns)

    @classmethod
    def joined(cls, parts: list[SimulatedPoints]) -> SimulatedPoints:
        """Return the points of one or more parts, part by part."""
        columns = zip(*(part._columns for part in parts), strict=True)
        whole: list[Any] = [
            None if column[0] is None else np.concatenate(column) for column in columns
        ]
        return cls(*whole)

    @property
    def _columns(self) -> tuple[Any, ...]:
        return self.xyz, self.label, self.number, self.count, self.angle_deg, self.rgb


def alone(xyz: Float64, label: UInt8) -> SimulatedPoints:
    """Return points (metres) that are the only returns of vertical pulses, without colours."""
    one = np.ones(len(label), np.uint8)
    return SimulatedPoints(xyz, label, one, one, np.zeros(len(label)))


class Sensor(Protocol):
    """Sensor that surveys a site patch by patch. The patches are a lattice at (0, 0)."""

    @property
    def patch_m(self) -> float:
        """Side of a patch, metres."""
        ...

    @property
    def reach_m(self) -> float:
        """Distance beyond a site up to which patches must be surveyed, metres."""
        ...

    @property
    def coloured(self) -> bool:
        """True if the points have colours."""
        ...

    @property
    def pulsed(self) -> bool:
        """True if the points are returns of pulses, which have a time."""
        ...

    def survey(self, site: Site, ix: int, iy: int) -> SimulatedPoints:
        """Return the points of a patch, which depend only on the site, the sensor and (ix, iy)."""
        ...


def vegetation_label(label: UInt8, above_ground_m: Float64) -> UInt8:
    """Return labels with low plants split by height above ground: below 1 m, below 3 m, higher."""
    by_height = np.select(
        [above_ground_m < 1.0, above_ground_m < 3.0],
        [LOW_VEGETATION, MEDIUM_VEGETATION],
        HIGH_VEGETATION,
    )
    return np.where(label == LOW_VEGETATION, by_height, label).astype(np.uint8)


def patches(
    sensor: Sensor, side_m: float, north_m: float | None = None, *, rim: bool = True
) -> list[tuple[int, int]]:
    """Return (ix, iy) of the patches with all points of a site, row by row from the south-west.

    The site is ``side_m`` wide, and as long from south to north unless ``north_m`` is given.
    Without ``rim``, patches outside the site are omitted. So the outermost metres of the site
    may have fewer points.
    """
    reach = 0.0
    if rim:
        reach = sensor.reach_m
    low = int(np.floor(-reach / sensor.patch_m))
    columns, rows = (
        range(low, int(np.ceil((extent + reach) / sensor.patch_m)))
        for extent in (side_m, north_m or side_m)
    )
    return [(ix, iy) for iy, ix in itertools.product(rows, columns)]


def survey_patch(site: Site, sensor: Sensor, ix: int, iy: int) -> SimulatedPoints:
    """Return the points of a patch that lie on the site, rounded to millimetres."""
    points = sensor.survey(site, ix, iy)
    xyz = np.round(points.xyz, 3)
    inside = np.all((xyz[:, :2] >= 0) & (xyz[:, :2] < (site.side_m, site.north_m)), axis=1)
    return replace(points, xyz=xyz).take(inside)


def survey(site: Site, sensor: Sensor) -> SimulatedPoints:
    """Return all points of a small site at once."""
    return SimulatedPoints.joined(
        [
            survey_patch(site, sensor, *index)
            for index in patches(sensor, site.side_m, site.north_m)
        ]
    )
