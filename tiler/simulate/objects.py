"""Objects on the terrain, and the rays that meet them.

A ray is a line from above with its height z as the parameter: ``x = ax + lx * z``, ``y = ay +
ly * z``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ptd.arrays import Float64, Indices
from tiler.simulate.terrain import Line

LOW_VEGETATION, MEDIUM_VEGETATION, HIGH_VEGETATION = 3, 4, 5
BUILDING = 6
WIRE, TOWER = 14, 15
BRIDGE = 17


@dataclass(frozen=True)
class Rays:
    """Columns of ``n`` rays, float64, shape (n,), in metres.

    ``lx`` and ``ly`` are metres per metre of height. ``level`` is a height near most hits, which shortens searches.
    """

    ax: Float64
    ay: Float64
    lx: Float64
    ly: Float64
    level: float = 0.0

    def __len__(self) -> int:
        return len(self.ax)

    @cached_property
    def steepest(self) -> float:
        """Largest horizontal shift of a ray in metres per metre of height."""
        return float(np.hypot(self.lx, self.ly).max(initial=0.0))

    def at(self, z: Float64, index: Indices | slice = slice(None)) -> tuple[Float64, Float64]:
        """Return the positions x, y of the rays (or of ``index``) at the heights z."""
        return self.ax[index] + self.lx[index] * z, self.ay[index] + self.ly[index] * z

    def near(self, x: float, y: float, z: float, radius: float) -> Indices:
        """Return the ascending indices of the rays within ``radius`` of (x, y) at height z."""
        order, sorted_x = self._from_west
        shift = radius + self.steepest * abs(z - self.level)
        index = order[slice(*np.searchsorted(sorted_x, (x - shift, x + shift)))]
        px, py = self.ax[index] + self.lx[index] * z, self.ay[index] + self.ly[index] * z
        return np.sort(index[(px - x) ** 2 + (py - y) ** 2 <= radius**2])

    @cached_property
    def _from_west(self) -> tuple[Indices, Float64]:
        """Indices of the rays from west to east at `level`, and their positions x."""
        x = self.ax + self.lx * self.level
        order = np.argsort(x, kind="stable")
        return order, x[order]


@dataclass(frozen=True)
class Solid:
    """Opaque convex body: a box, a gabled house or a sloping deck.

    Attributes
    ----------
    x, y : float
        Centre of the footprint, metres.
    angle_deg : float
        Direction of the length (and of the ridge), counter-clockwise from east.
    length, width : float
        Sides of the footprint, metres.
    base, top : float
        Heights of the underside (in the ground) and of the flat roof or the ridge, metres.
    pitch : float
        Rise of the roof per metre across. A flat roof has 0.
    label : int
        ASPRS class of its points.
    tilt : float
        Rise of underside and top per metre along. ``base`` and ``top`` are the heights at the centre.
    """

    x: float
    y: float
    angle_deg: float
    length: float
    width: float
    base: float
    top: float
    pitch: float = 0.0
    label: int = BUILDING
    tilt: float = 0.0

    @property
    def radius(self) -> float:
        """Half of the footprint's diagonal, metres."""
        return float(np.hypot(self.length, self.width) / 2)

    def distance(self, x: float, y: float) -> float:
        """Return the distance in metres from a position to the footprint, 0 inside."""
        east, north, turn = x - self.x, y - self.y, math.radians(self.angle_deg)
        along = east * math.cos(turn) + north * math.sin(turn)
        across = north * math.cos(turn) - east * math.sin(turn)
        return math.hypot(
            max(abs(along) - self.length / 2, 0.0), max(abs(across) - self.width / 2, 0.0)
        )

    def hit(self, rays: Rays) -> tuple[Indices, Float64]:
        """Return indices of the rays that meet the body, and the heights of entry, metres."""
        height = self.top - self.base + abs(self.tilt) * self.length / 2
        index = rays.near(self.x, self.y, self.top, self.radius + height * rays.steepest + 0.01)
        if not len(index):
            return index, np.empty(0)
        cos, sin = np.cos(np.radians(self.angle_deg)), np.sin(np.radians(self.angle_deg))
        ax, ay = rays.ax[index] - self.x, rays.ay[index] - self.y
        lx, ly = rays.lx[index], rays.ly[index]
        au, av, lu, lv = (
            ax * cos + ay * sin,
            ay * cos - ax * sin,
            lx * cos + ly * sin,
            ly * cos - lx * sin,
        )
        # A convex body is an intersection of half-spaces, which bound z from above or below.
        high, low = np.full(len(index), np.inf), np.full(len(index), -np.inf)
        half_spaces = [
            (-self.tilt, 0.0, 1.0, self.top),
            (self.tilt, 0.0, -1.0, -self.base),
            (1.0, 0.0, 0.0, self.length / 2),
            (-1.0, 0.0, 0.0, self.length / 2),
            (0.0, 1.0, 0.0, self.width / 2),
            (0.0, -1.0, 0.0, self.width / 2),
        ]
        if self.pitch:
            half_spaces += [(0.0, self.pitch, 1.0, self.top), (0.0, -self.pitch, 1.0, self.top)]
        for nu, nv, nz, distance in half_spaces:
            along = nu * lu + nv * lv + nz
            room = distance - nu * au - nv * av
            with np.errstate(divide="ignore", invalid="ignore"):
                crossing = room / along
            high = np.where(along > 0, np.minimum(high, crossing), high)
            low = np.where(along < 0, np.maximum(low, crossing), low)
            low = np.where((along == 0) & (room < 0), np.inf, low)
        inside = high > low
        return index[inside], high[inside]


@dataclass(frozen=True)
class Crown:
    """Crown of a tree: an ellipsoid that pulses enter. Lengths are metres.

    ``spacing`` is the mean distance of consecutive returns. ``stop`` is the probability that a return ends the pulse.
    """

    x: float
    y: float
    z: float
    radius: float
    half_height: float
    spacing: float = 1.6
    stop: float = 0.3

    def chord(self, rays: Rays) -> tuple[Indices, Float64, Float64]:
        """Return indices of the rays that meet the crown, and heights of entry and exit, metres."""
        index = rays.near(
            self.x, self.y, self.z, self.radius + self.half_height * rays.steepest + 0.01
        )
        px, py = rays.at(np.full(len(index), self.z), index)
        ratio = (self.radius / self.half_height) ** 2
        px, py, lx, ly = px - self.x, py - self.y, rays.lx[index], rays.ly[index]
        a = lx**2 + ly**2 + ratio
        b = px * lx + py * ly
        root = b**2 - a * (px**2 + py**2 - self.radius**2)
        met = root > 0
        a, b, reach = a[met], b[met], np.sqrt(root[met])
        return index[met], self.z + (reach - b) / a, self.z - (reach + b) / a


@dataclass(frozen=True)
class PlantPatch:
    """Low vegetation in an ellipse or, if ``square``, in a rectangle. Lengths are metres.

    ``cover`` is the share of pulses that hit the plants, at heights up to ``height`` above the ground.
    """

    x: float
    y: float
    angle_deg: float
    length: float
    width: float
    height: float
    cover: float = 0.5
    square: bool = False

    @property
    def radius(self) -> float:
        """Half of the footprint's diagonal, metres."""
        return float(np.hypot(self.length, self.width) / 2)

    def inside(self, x: Float64, y: Float64) -> Float64:
        """Return the depth in the footprint: 1 at the centre, 0 at the edge, negative outside."""
        along, across = Line(self.x, self.y, self.angle_deg).along_across(x, y)
        u, v = 2 * along / self.length, 2 * across / self.width
        if self.square:
            return np.asarray(1.0 - np.maximum(np.abs(u), np.abs(v)))
        return np.asarray(1.0 - np.hypot(u, v))


@dataclass(frozen=True)
class Wire:
    """Wire that sags between two points. Lengths are metres.

    A pulse that passes within ``reach`` of the wire returns there and continues.
    """

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    sag: float
    reach: float = 0.2

    @property
    def x(self) -> float:
        """East coordinate of the middle, metres."""
        return (self.start[0] + self.end[0]) / 2

    @property
    def y(self) -> float:
        """North coordinate of the middle, metres."""
        return (self.start[1] + self.end[1]) / 2

    @property
    def radius(self) -> float:
        """Half of the span, metres."""
        return float(np.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]) / 2)

    def hit(self, rays: Rays) -> tuple[Indices, Float64]:
        """Return indices of the rays that hit the wire, and the heights of their returns, metres."""
        angle = float(
            np.degrees(np.arctan2(self.end[1] - self.start[1], self.end[0] - self.start[0]))
        )
        line = Line(self.x, self.y, angle)
        index = rays.near(self.x, self.y, self.start[2], self.radius + 10.0)
        z = np.full(len(index), (self.start[2] + self.end[2]) / 2)
        for _ in range(4):
            along, across = line.along_across(*rays.at(z, index))
            t = along / (2 * self.radius)
            z = (self.start[2] + self.end[2]) / 2 + (self.end[2] - self.start[2]) * t
            z = z - self.sag * (1.0 - 4.0 * t**2)
        met = (np.abs(across) < self.reach) & (np.abs(t) < 0.5)
        return index[met], z[met]


@dataclass(frozen=True)
class Objects:
    """Objects on a terrain, in a fixed order."""

    solids: tuple[Solid, ...] = ()
    crowns: tuple[Crown, ...] = ()
    patches: tuple[PlantPatch, ...] = ()
    wires: tuple[Wire, ...] = ()

    def __add__(self, other: Objects) -> Objects:
        """Return the objects of both, with the objects of ``other`` last."""
        return Objects(*(a + b for a, b in zip(self._kinds, other._kinds, strict=True)))

    def touching(self, x0: float, y0: float, x1: float, y1: float) -> Objects:
        """Return the objects that may reach into a box (metres), in the same order."""

        def near(thing: Solid | Crown | PlantPatch | Wire) -> bool:
            far = thing.radius
            return x0 - far <= thing.x <= x1 + far and y0 - far <= thing.y <= y1 + far

        return Objects(*(tuple(filter(near, things)) for things in self._kinds))

    @property
    def _kinds(self) -> tuple[tuple[Any, ...], ...]:
        return self.solids, self.crowns, self.patches, self.wires
