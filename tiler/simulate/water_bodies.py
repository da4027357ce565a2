"""Bodies of water with a known shore and level, the banks around them, and the masonry that dams them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]
Field = Callable[[Floats, Floats], Floats]
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

    def height_at(self, x: Floats, y: Floats) -> Floats:
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

    def body_at(self, x: Floats, y: Floats) -> Ints:
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

    def shore_m(self, x: Floats, y: Floats) -> Floats:
        """Return the distance from the nearest shore in metres, negative on the water. Masonry is ignored."""
        nearest = np.full(x.shape, np.inf)
        for body in self.bodies:
            nearest = np.minimum(nearest, body.shore(x, y))
        return nearest

    def height_at(self, x: Floats, y: Floats, land: Floats) -> Floats:
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
