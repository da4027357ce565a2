"""What stands on the terrain; each object tells where a ray meets it.

A ray is a line that comes from above, written by its height z: ``x = ax + lx * z``, ``y = ay + ly * z``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from tiler.core.classes import UNCLASSIFIED

Floats = npt.NDArray[np.float64]
BUILDING = 6
TREE = 5


@dataclass(frozen=True)
class Rays:
    """``n`` rays; all columns float64, shape (n,), metres (``lx``, ``ly``: metres per metre of height)."""

    ax: Floats
    ay: Floats
    lx: Floats
    ly: Floats

    def __len__(self) -> int:
        return len(self.ax)

    @cached_property
    def steepest(self) -> float:
        """Most metres that a ray moves per metre of height."""
        return float(np.hypot(self.lx, self.ly).max(initial=0.0))

    def at(self, z: Floats, index: npt.NDArray[np.intp] | slice = slice(None)) -> tuple[Floats, Floats]:
        """Positions x, y of the rays (of ``index``) at the heights z."""
        return self.ax[index] + self.lx[index] * z, self.ay[index] + self.ly[index] * z

    def near(self, x: float, y: float, z: float, radius: float) -> npt.NDArray[np.intp]:
        """Indices of the rays that pass (x, y) within ``radius`` at height z."""
        px, py = self.at(np.full(len(self), z))
        return np.flatnonzero((px - x) ** 2 + (py - y) ** 2 <= radius**2)


@dataclass(frozen=True)
class Solid:
    """A box or a gabled house: a convex body, opaque.

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
        Rise of the roof per metre across; 0 makes a flat roof.
    label : int
        ASPRS class of its points.
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

    @property
    def radius(self) -> float:
        """Half of the footprint's diagonal, metres."""
        return float(np.hypot(self.length, self.width) / 2)

    def hit(self, rays: Rays) -> tuple[npt.NDArray[np.intp], Floats]:
        """Which rays meet the body (indices), and at which height they enter it (metres)."""
        height = self.top - self.base
        index = rays.near(self.x, self.y, self.top, self.radius + height * rays.steepest + 0.01)
        cos, sin = np.cos(np.radians(self.angle_deg)), np.sin(np.radians(self.angle_deg))
        ax, ay = rays.ax[index] - self.x, rays.ay[index] - self.y
        lx, ly = rays.lx[index], rays.ly[index]
        au, av, lu, lv = ax * cos + ay * sin, ay * cos - ax * sin, lx * cos + ly * sin, ly * cos - lx * sin
        # A convex body is an intersection of half-spaces; each bounds z inside the body from above or below.
        high, low = np.full(len(index), self.top), np.full(len(index), self.base)
        half_spaces = [(1.0, 0.0, 0.0, self.length / 2), (-1.0, 0.0, 0.0, self.length / 2),
                       (0.0, 1.0, 0.0, self.width / 2), (0.0, -1.0, 0.0, self.width / 2)]  # fmt: skip
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
    """The crown of a tree: an ellipsoid that a pulse gets into; metres.

    ``spacing`` is the mean way between two returns in it.
    """

    x: float
    y: float
    z: float
    radius: float
    half_height: float
    spacing: float = 1.6
    label: int = TREE

    def chord(self, rays: Rays) -> tuple[npt.NDArray[np.intp], Floats, Floats]:
        """Which rays meet the crown (indices), and the heights where they enter and leave it (metres)."""
        index = rays.near(self.x, self.y, self.z, self.radius + self.half_height * rays.steepest + 0.01)
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
class Shrubs:
    """Low vegetation: within ``radius`` half of the pulses end up to ``height`` above ground; metres."""

    x: float
    y: float
    radius: float
    height: float
    label: int = UNCLASSIFIED


@dataclass(frozen=True)
class Objects:
    """All that stands on a terrain, in a fixed order."""

    solids: tuple[Solid, ...] = ()
    crowns: tuple[Crown, ...] = ()
    shrubs: tuple[Shrubs, ...] = ()

    def touching(self, x0: float, y0: float, x1: float, y1: float, reach: float) -> Objects:
        """Return only those that come within ``reach`` of a box, in the same order; all metres."""

        def near(thing: Solid | Crown | Shrubs) -> bool:
            far = thing.radius + reach
            return x0 - far <= thing.x <= x1 + far and y0 - far <= thing.y <= y1 + far

        return Objects(
            tuple(s for s in self.solids if near(s)),
            tuple(c for c in self.crowns if near(c)),
            tuple(s for s in self.shrubs if near(s)),
        )
