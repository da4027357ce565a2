"""Terrain by formula: the true height, at any position, against which a DTM is compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from tiler.simulate.water_bodies import Waters

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


class TerrainFeature(Protocol):
    """A part of a terrain. `Terrain` sums the parts."""

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres that the feature adds at each position (metres)."""
        ...


@dataclass(frozen=True)
class Line:
    """A straight line through (x, y), in metres. ``angle_deg`` is counter-clockwise from east."""

    x: float
    y: float
    angle_deg: float

    def along_across(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Distance of each position along the line from (x, y), and to the left of the line, in metres."""
        cos, sin = np.cos(np.radians(self.angle_deg)), np.sin(np.radians(self.angle_deg))
        east, north = x - self.x, y - self.y
        return east * cos + north * sin, north * cos - east * sin

    def at(self, along: float, across: float = 0.0) -> tuple[float, float]:
        """The place at a distance along the line and to its left."""
        cos, sin = np.cos(np.radians(self.angle_deg)), np.sin(np.radians(self.angle_deg))
        return float(self.x + along * cos - across * sin), float(self.y + along * sin + across * cos)


@dataclass(frozen=True)
class Hill:
    """A hill of ``height * exp(-d**2 / (2 radius**2))``, d being the distance from (x, y), in metres."""

    x: float
    y: float
    height: float
    radius: float

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres that the hill adds at each position."""
        squared = (x - self.x) ** 2 + (y - self.y) ** 2
        return np.asarray(self.height * np.exp(squared / (-2.0 * self.radius**2)))


@dataclass(frozen=True)
class Waves:
    """Endless rolling land: a sum of sines.

    Attributes
    ----------
    waves : tuple of (amplitude, east, north, phase)
        Amplitude in metres, radians per metre to the east and to the north, phase in radians.
    """

    waves: tuple[tuple[float, float, float, float], ...]

    @classmethod
    def random(cls, rng: np.random.Generator, height: float, length: float, count: int = 6) -> Waves:
        """``count`` waves of 0.4 to 1 ``length`` in any direction, with a sum up to about ``height`` (metres)."""
        rows = []
        for _ in range(count):
            shrink, turn, phase = rng.uniform(0.4, 1.0), rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)
            number = 2 * np.pi / (shrink * length)
            amplitude = height * shrink / count
            rows.append((amplitude, number * np.cos(turn), number * np.sin(turn), phase))
        return cls(tuple(rows))

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres that the waves add at each position."""
        total = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
        for amplitude, east, north, phase in self.waves:
            total += amplitude * np.sin(east * x + north * y + phase)
        return total


@dataclass(frozen=True)
class Ridge:
    """A roof-shaped ridge with a sharp crest along a line, even flanks and hipped ends, in metres."""

    line: Line
    height: float
    half_width: float
    length: float

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres that the ridge adds at each position."""
        along, across = self.line.along_across(x, y)
        flank = 1.0 - np.abs(across) / self.half_width
        end = 1.0 + (self.length / 2 - np.abs(along)) / self.half_width
        return np.asarray(self.height * np.maximum(np.minimum(flank, end), 0.0))


@dataclass(frozen=True)
class Terraces:
    """``steps`` terraces that rise to the left of a line, each ``tread`` long with a face of ``rise`` and ``face``."""

    line: Line
    steps: int
    tread: float
    rise: float
    face: float

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres that the terraces add at each position."""
        _, across = self.line.along_across(x, y)
        return np.asarray(self.rise * _stairs(across / self.tread, self.steps, self.face / self.tread))


@dataclass(frozen=True)
class Cliff:
    """A step of ``height`` within ``width``, up to the left of a winding line, in metres."""

    line: Line
    height: float
    width: float
    swing: float = 0.0
    period: float = 100.0

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres that the cliff adds at each position."""
        along, across = self.line.along_across(x, y)
        across = across + self.swing * np.sin(2 * np.pi * along / self.period)
        return np.asarray(self.height * np.clip(across / self.width, 0.0, 1.0))


@dataclass(frozen=True)
class Basin:
    """A round pit with a flat floor: a quarry with benches or, if ``water``, a pond. Lengths are in metres.

    Attributes
    ----------
    x, y, radius : float
        Centre and outer edge.
    depth : float
        Depth of the floor.
    wall_width : float
        Distance from the edge to the floor.
    benches : int
        Number of steps on the way down; each is half bench and half face.
    water : bool
        Whether the floor is the surface of water.
    """

    x: float
    y: float
    radius: float
    depth: float
    wall_width: float
    benches: int = 1
    water: bool = False

    def _inward(self, x: Floats, y: Floats) -> Floats:
        return np.asarray(self.radius - np.hypot(x - self.x, y - self.y))

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres (negative) that the pit removes at each position."""
        down = _stairs(self._inward(x, y) * self.benches / self.wall_width, self.benches, 0.5)
        return np.asarray(-self.depth / self.benches * down)

    def wet_at(self, x: Floats, y: Floats) -> Bools:
        """Whether each position is water."""
        return np.asarray((self._inward(x, y) > self.wall_width) & self.water)


@dataclass(frozen=True)
class Embankment:
    """A dam along a straight line, with a crest of full height and slopes on both sides, in metres.

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
        _, across = Line(self.x, self.y, self.angle_deg).along_across(x, y)
        down = np.clip((np.abs(across) - self.crest_width / 2) / self.slope_width, 0.0, 1.0)
        return np.asarray(self.height * (1.0 - down))


@dataclass(frozen=True)
class Bank:
    """A river bank: the land drops by ``drop`` along a winding line, within about ``4 * width``, in metres.

    The line runs from south to north around ``x``, swinging by ``swing`` with the period ``period``; the
    low side is in the east.
    """

    x: float
    drop: float
    width: float
    swing: float
    period: float

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres (negative in the east) that the bank removes at each position."""
        line = self.x + self.swing * np.sin(2 * np.pi * y / self.period)
        return np.asarray(-self.drop * (0.5 + 0.5 * np.tanh((x - line) / self.width)))


@dataclass(frozen=True)
class River:
    """A river with a bank on each side along a winding line, in metres. Its floor is the surface of the water."""

    line: Line
    width: float
    depth: float
    bank_width: float
    swing: float = 0.0
    period: float = 300.0

    def _outside(self, x: Floats, y: Floats) -> Floats:
        """Distance from the edge of the water in metres, negative on the water."""
        along, across = self.line.along_across(x, y)
        across = across + self.swing * np.sin(2 * np.pi * along / self.period)
        return np.asarray(np.abs(across) - self.width / 2)

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Metres (negative) that the river removes at each position."""
        return np.asarray(-self.depth * (1.0 - np.clip(self._outside(x, y) / self.bank_width, 0.0, 1.0)))

    def wet_at(self, x: Floats, y: Floats) -> Bools:
        """Whether each position is water."""
        return np.asarray(self._outside(x, y) < 0.0)


@dataclass(frozen=True)
class Terrain:
    """A tilted plane plus features, which are summed in their order.

    Attributes
    ----------
    base : float
        Height of the plane at (0, 0), metres.
    slope : (float, float)
        Rise of the plane per metre to the east and to the north.
    features : tuple of TerrainFeature
    waters : Waters, optional
        Bodies of water whose levels do not depend on the plane and the features.
    """

    base: float = 100.0
    slope: tuple[float, float] = (0.0, 0.0)
    features: tuple[TerrainFeature, ...] = ()
    waters: Waters | None = None

    def height_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Floats:
        """True height of the ground, metres, float64 of the broadcast shape of ``x`` and ``y`` (metres)."""
        east, north = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        height = self.base + self.slope[0] * east + self.slope[1] * north
        for feature in self.features:
            height = height + feature.height_at(east, north)
        if self.waters is not None:
            height = self.waters.height_at(east, north, height)
        return np.asarray(height)

    def wet_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Bools:
        """Whether each position is water, bool of the broadcast shape of ``x`` and ``y`` (metres)."""
        east, north = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        wet = np.zeros(east.shape, np.bool_)
        for feature in self.features:
            if isinstance(feature, River | Basin):
                wet |= feature.wet_at(east, north)
        if self.waters is not None:
            wet |= self.waters.body_at(east, north) >= 0
        return wet

    def range_around(self, x: float, y: float, radius: float) -> tuple[float, float]:
        """Lowest and highest ground of a 9 x 9 lattice within ``radius`` of a position, in metres."""
        steps = np.linspace(-radius, radius, 9)
        heights = self.height_at(x + steps[None, :], y + steps[:, None])
        return float(heights.min()), float(heights.max())


def _stairs(t: Floats, steps: int, face: float) -> Floats:
    """Stairs of height 1 and length 1 from 0 to ``steps``. The last ``face`` of each length goes up."""
    t = np.clip(t, 0.0, steps)
    whole = np.floor(t)
    return np.asarray(whole + np.clip((t - whole - (1.0 - face)) / face, 0.0, 1.0))
