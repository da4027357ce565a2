"""Terrain by formula: the truth that a DTM is measured against, at any position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Hill:
    """``height * exp(-d**2 / (2 radius**2))``, d the distance from (x, y); metres."""

    x: float
    y: float
    height: float
    radius: float

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres that the hill adds at each position."""
        squared = (x - self.x) ** 2 + (y - self.y) ** 2
        return np.asarray(self.height * np.exp(squared / (-2.0 * self.radius**2)))


@dataclass(frozen=True)
class Embankment:
    """A dam along a straight line: a crest of full height, slopes down to the terrain on both sides; metres.

    (x, y) is a point of the axis, ``angle_deg`` its direction counter-clockwise from east. A negative
    height makes a cutting or a canal.
    """

    x: float
    y: float
    angle_deg: float
    height: float
    crest_width: float
    slope_width: float

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres that the dam adds at each position."""
        turn = np.radians(self.angle_deg)
        distance = np.abs((y - self.y) * np.cos(turn) - (x - self.x) * np.sin(turn))
        down = np.clip((distance - self.crest_width / 2) / self.slope_width, 0.0, 1.0)
        return np.asarray(self.height * (1.0 - down))


@dataclass(frozen=True)
class Bank:
    """A river bank: the land drops by ``drop`` along a winding line, within about ``4 * width``; metres.

    The line runs from south to north around ``x``, swinging by ``swing`` with the period ``period``; the
    low side is in the east.
    """

    x: float
    drop: float
    width: float
    swing: float
    period: float

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres that the bank takes away at each position (negative in the east)."""
        line = self.x + self.swing * np.sin(2 * np.pi * y / self.period)
        return np.asarray(-self.drop * (0.5 + 0.5 * np.tanh((x - line) / self.width)))


@dataclass(frozen=True)
class Terrain:
    """A tilted plane plus features; all features are summed in their order.

    Attributes
    ----------
    base : float
        Height of the plane at (0, 0), metres.
    slope : (float, float)
        Rise of the plane per metre to the east and to the north.
    features : tuple
        `Hill`, `Embankment`, `Bank`, or anything else with ``height_at(x, y)``.
    """

    base: float = 100.0
    slope: tuple[float, float] = (0.0, 0.0)
    features: tuple[Hill | Embankment | Bank, ...] = ()

    def height_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Floats:
        """True height of the ground, metres, float64 of the broadcast shape of ``x`` and ``y`` (metres)."""
        east, north = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        height = self.base + self.slope[0] * east + self.slope[1] * north
        for feature in self.features:
            height = height + feature.height_at(east, north)
        return np.asarray(height)
