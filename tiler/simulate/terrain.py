"""Terrain by formula: the exact height at any position, the reference for a DTM.

Bodies of water with a known shore and level, the banks around them and the masonry that dams them come first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ptd.arrays import Bool, Float64, Int64

Field = Callable[[Float64, Float64], Float64]
"""Function that returns a value at each position x, y in metres."""

FACE_SLOPE = 8.0
"""Rise of the faces of masonry per metre. The height at a vertical face would be ambiguous."""


def constant(value: float) -> Field:
    """Return a field that has the same value everywhere."""
    return lambda x, y: np.full(np.broadcast_shapes(np.shape(x), np.shape(y)), value)


FEW_RETURNS = constant(0.05)
CALM_M = constant(0.02)
NOWHERE = constant(0.0)


@dataclass(frozen=True)
class WaterBody:
    """A lake, a reach of a river, or a part of a sea.

    Attributes
    ----------
    shore : Field
        Distance from the shore in metres, negative on the water.
    level : Field
        Height of the surface in metres.
    bank_slope : float
        Rise of the banks per metre, from the shore on.
    returned : Field
        Share of the laser pulses that the water returns.
    waves_m : Field
        Standard deviation of the heights of its returns, without the sensor's own noise.
    tide_m : Field
        Height of the surface above ``level`` at the time when a position was surveyed.
    reeds : Field
        Share of the pulses that reed in the water returns, 0.3 to 2 m above it.
    low : float
        Share of the pulses that seem to come from 1 to 3 m below the surface.
    """

    shore: Field
    level: Field
    bank_slope: float
    returned: Field = FEW_RETURNS
    waves_m: Field = CALM_M
    tide_m: Field = NOWHERE
    reeds: Field = NOWHERE
    low: float = 0.0


@dataclass(frozen=True)
class Masonry:
    """A dam, a lock wall or a pier: a box with a level crest and steep faces, in metres."""

    west: float
    south: float
    east: float
    north: float
    crest: float

    def height_at(self, x: Float64, y: Float64) -> Float64:
        """Return the height in metres of the crest, or of the faces around it, which have no lower end."""
        beside_x = np.maximum(np.maximum(self.west - x, x - self.east), 0.0)
        beside_y = np.maximum(np.maximum(self.south - y, y - self.north), 0.0)
        return np.asarray(self.crest - FACE_SLOPE * np.maximum(beside_x, beside_y))


@dataclass(frozen=True)
class Waters:
    """All bodies of water of a terrain.

    Attributes
    ----------
    bodies : tuple of WaterBody
        Where two overlap, the later one counts.
    masonry : tuple of Masonry
        Terrain that stands in and above the water.
    lost_on_land : Field, optional
        Share of the pulses that land does not return, as on wet meadows. By default that of the sensor.
    """

    bodies: tuple[WaterBody, ...] = ()
    masonry: tuple[Masonry, ...] = ()
    lost_on_land: Field | None = None

    def body_at(self, x: Float64, y: Float64) -> Int64:
        """Return the index of the body of water at each position, int64, or -1 on land and masonry."""
        index = np.full(x.shape, -1)
        surface = np.full(x.shape, -np.inf)
        for i, body in enumerate(self.bodies):
            wet = body.shore(x, y) < 0
            index[wet] = i
            surface[wet] = body.level(x, y)[wet]
        for block in self.masonry:
            index[block.height_at(x, y) > surface] = -1
        return index

    def shore_m(self, x: Float64, y: Float64) -> Float64:
        """Return the distance from the nearest shore in metres, negative on the water. Masonry is ignored."""
        nearest = np.full(x.shape, np.inf)
        for body in self.bodies:
            nearest = np.minimum(nearest, body.shore(x, y))
        return nearest

    def height_at(self, x: Float64, y: Float64, land: Float64) -> Float64:
        """Return the height of the terrain with water, banks and masonry. ``land`` is the height without them.

        Both are in metres and have the shape of x and y.
        """
        height = land
        for body in self.bodies:
            bank = body.level(x, y) + np.maximum(body.shore(x, y), 0.0) * body.bank_slope
            height = np.minimum(height, bank)
        for block in self.masonry:
            height = np.maximum(height, block.height_at(x, y))
        return np.asarray(height)


class TerrainFeature(Protocol):
    """Part of a terrain. `Terrain` adds the heights of its parts."""

    def height_at(self, x: Float64, y: Float64) -> Float64:
        """Return the metres that the feature adds at each position (metres)."""
        ...


@dataclass(frozen=True)
class Line:
    """Straight line through (x, y) in metres. ``angle_deg`` is counter-clockwise from east."""

    x: float
    y: float
    angle_deg: float

    def along_across(self, x: Float64, y: Float64) -> tuple[Float64, Float64]:
        """Return each position's distance along the line from (x, y) and to its left, metres."""
        cos, sin = np.cos(np.radians(self.angle_deg)), np.sin(np.radians(self.angle_deg))
        east, north = x - self.x, y - self.y
        return east * cos + north * sin, north * cos - east * sin

    def at(self, along: float, across: float = 0.0) -> tuple[float, float]:
        """Return the position at a distance along the line and to its left, metres."""
        cos, sin = np.cos(np.radians(self.angle_deg)), np.sin(np.radians(self.angle_deg))
        return float(self.x + along * cos - across * sin), float(
            self.y + along * sin + across * cos
        )


@dataclass(frozen=True)
class Hill:
    """Hill of ``height * exp(-d**2 / (2 radius**2))`` metres at a distance d from (x, y)."""

    x: float
    y: float
    height: float
    radius: float

    def height_at(self, x: Float64, y: Float64) -> Float64:
        """Return the metres that the hill adds at each position."""
        squared = (x - self.x) ** 2 + (y - self.y) ** 2
        return np.asarray(self.height * np.exp(squared / (-2.0 * self.radius**2)))


@dataclass(frozen=True)
class Waves:
    """Endless rolling land: a sum of sine waves.

    Attributes
    ----------
    waves : tuple of (amplitude, east, north, phase)
        Amplitude in metres, radians per metre to the east and to the north, phase in radians.
    """

    waves: tuple[tuple[float, float, float, float], ...]

    @classmethod
    def random(
        cls, rng: np.random.Generator, height: float, length: float, count: int = 6
    ) -> Waves:
        """Return ``count`` waves 0.4 to 1 ``length`` long, with a sum of up to ``height``, metres."""
        rows = []
        for _ in range(count):
            shrink, turn, phase = (
                rng.uniform(0.4, 1.0),
                rng.uniform(0, 2 * np.pi),
                rng.uniform(0, 2 * np.pi),
            )
            number = 2 * np.pi / (shrink * length)
            amplitude = height * shrink / count
            rows.append((amplitude, number * np.cos(turn), number * np.sin(turn), phase))
        return cls(tuple(rows))

    def height_at(self, x: Float64, y: Float64) -> Float64:
        """Return the metres that the waves add at each position."""
        total = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
        for amplitude, east, north, phase in self.waves:
            total += amplitude * np.sin(east * x + north * y + phase)
        return total


@dataclass(frozen=True)
class Ridge:
    """Roof-shaped ridge with a sharp crest along a line, even flanks and hipped ends, in metres."""

    line: Line
    height: float
    half_width: float
    length: float

    def height_at(self, x: Float64, y: Float64) -> Float64:
        """Return the metres that the ridge adds at each position."""
        along, across = self.line.along_across(x, y)
        flank = 1.0 - np.abs(across) / self.half_width
        end = 1.0 + (self.length / 2 - np.abs(along)) / self.half_width
        return np.asarray(self.height * np.maximum(np.minimum(flank, end), 0.0))


@dataclass(frozen=True)
class Terraces:
    """Terraces that rise to the left of a line, in metres.

    Each of the ``steps`` is ``tread`` long and rises by ``rise`` over its last ``face``.
    """

    line: Line
    steps: int
    tread: float
    rise: float
    face: float

    def height_at(self, x: Float64, y: Float64) -> Float64:
        """Return the metres that the terraces add at each position."""
        _, across = self.line.along_across(x, y)
        return np.asarray(
            self.rise * _stairs(across / self.tread, self.steps, self.face / self.tread)
        )


@dataclass(frozen=True)
class Cliff:
    """Step up of ``height`` within ``width`` to the left of a winding line, in metres."""

    line: Line
    height: float
    width: float
    swing: float = 0.0
    period: float = 100.0

    def height_at(self, x: Float64, y: Float64) -> Float64:
        """Return the metres that the cliff adds at each position."""
        along, across = self.line.along_across(x, y)
        across = across + self.swing * np.sin(2 * np.pi * along / self.period)
        return np.asarray(self.height * np.clip(across / self.width, 0.0, 1.0))


@dataclass(frozen=True)
class Basin:
    """Round pit with a flat floor: a quarry with benches or, if ``water``, a pond, in metres.

    Attributes
    ----------
    x, y, radius : float
        Centre and outer edge.
    depth : float
        Depth of the floor.
    wall_width : float
        Distance from the edge to the floor.
    benches : int
        Number of steps on the way down. Each is half bench and half face.
    water : bool
        True if the floor is the surface of water.
    """

    x: float
    y: float
    radius: float
    depth: float
    wall_width: float
    benches: int = 1
    water: bool = False

    def _inward(self, x: Float64, y: Float64) -> Float64:
        return np.asarray(self.radius - np.hypot(x - self.x, y - self.y))

    def height_at(self, x: Float64, y: Float64) -> Float64:
        """Return the metres, 0 or negative, that the pit adds at each position."""
        down = _stairs(self._inward(x, y) * self.benches / self.wall_width, self.benches, 0.5)
        return np.asarray(-self.depth / self.benches * down)

    def wet_at(self, x: Float64, y: Float64) -> Bool:
        """Return a mask of the positions on water."""
        return np.asarray((self._inward(x, y) > self.wall_width) & self.water)


@dataclass(frozen=True)
class Embankment:
    """Endless dam along a straight line, with a level crest and a slope on each side, in metres.

    (x, y) is a point of the axis, and ``angle_deg`` its direction counter-clockwise from east.
    A negative height makes a cutting or a canal.
    """

    x: float
    y: float
    angle_deg: float
    height: float
    crest_width: float
    slope_width: float

    def height_at(self, x: Float64, y: Float64) -> Float64:
        """Return the metres that the dam adds at each position."""
        _, across = Line(self.x, self.y, self.angle_deg).along_across(x, y)
        down = np.clip((np.abs(across) - self.crest_width / 2) / self.slope_width, 0.0, 1.0)
        return np.asarray(self.height * (1.0 - down))


@dataclass(frozen=True)
class Bank:
    """River bank: a drop within about ``4 * width`` across a winding line, in metres.

    The line runs from south to north around ``x``, and swings by ``swing`` with the period
    ``period``. Its east side is the low side.
    """

    x: float
    drop: float
    width: float
    swing: float
    period: float

    def height_at(self, x: Float64, y: Float64) -> Float64:
        """Return the metres, negative, that the bank adds at each position."""
        line = self.x + self.swing * np.sin(2 * np.pi * y / self.period)
        return np.asarray(-self.drop * (0.5 + 0.5 * np.tanh((x - line) / self.width)))


@dataclass(frozen=True)
class River:
    """River along a winding line, with a bank on each side, in metres.

    Its floor is the surface of the water.
    """

    line: Line
    width: float
    depth: float
    bank_width: float
    swing: float = 0.0
    period: float = 300.0

    def _outside(self, x: Float64, y: Float64) -> Float64:
        """Return the distance from the edge of the water in metres, negative on the water."""
        along, across = self.line.along_across(x, y)
        across = across + self.swing * np.sin(2 * np.pi * along / self.period)
        return np.asarray(np.abs(across) - self.width / 2)

    def height_at(self, x: Float64, y: Float64) -> Float64:
        """Return the metres, 0 or negative, that the river adds at each position."""
        return np.asarray(
            -self.depth * (1.0 - np.clip(self._outside(x, y) / self.bank_width, 0.0, 1.0))
        )

    def wet_at(self, x: Float64, y: Float64) -> Bool:
        """Return a mask of the positions on water."""
        return np.asarray(self._outside(x, y) < 0.0)


@dataclass(frozen=True)
class Terrain:
    """Sum of a tilted plane and features, in the order of the features.

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

    def height_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Float64:
        """Return the height of the ground in metres, float64 of the broadcast shape of x and y."""
        east, north = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        height = self.base + self.slope[0] * east + self.slope[1] * north
        for feature in self.features:
            height = height + feature.height_at(east, north)
        if self.waters is not None:
            height = self.waters.height_at(east, north, height)
        return np.asarray(height)

    def wet_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Bool:
        """Return a mask of the positions on water, of the broadcast shape of x and y (metres)."""
        east, north = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        wet = np.zeros(east.shape, np.bool_)
        for feature in self.features:
            if isinstance(feature, River | Basin):
                wet |= feature.wet_at(east, north)
        if self.waters is not None:
            wet |= self.waters.body_at(east, north) >= 0
        return wet

    def range_around(self, x: float, y: float, radius: float) -> tuple[float, float]:
        """Return the lowest and highest ground in metres around a position.

        Heights are taken on a 9 x 9 lattice in the square of ``2 * radius`` around it.
        """
        steps = np.linspace(-radius, radius, 9)
        heights = self.height_at(x + steps[None, :], y + steps[:, None])
        return float(heights.min()), float(heights.max())


def _stairs(t: Float64, steps: int, face: float) -> Float64:
    """Return the height of ``steps`` stairs, each 1 high and 1 long, at the distances ``t``.

    The last ``face`` (a share) of each step rises, and the rest is level.
    """
    t = np.clip(t, 0.0, steps)
    whole = np.floor(t)
    return np.asarray(whole + np.clip((t - whole - (1.0 - face)) / face, 0.0, 1.0))
