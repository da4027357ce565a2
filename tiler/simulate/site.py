"""Site of a survey: terrain and its objects, made block by block on demand.

A `Plot` is one block of land, on which buildings, trees, hedges, walls and cars are placed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tiler.core.points import UNCLASSIFIED
from tiler.simulate.objects import BUILDING, Crown, Objects, PlantPatch, Solid
from tiler.simulate.randomness import BLOCKS, generator
from tiler.simulate.terrain import Line, Terrain

STEEPEST_HOUSE = 0.3
"""Rise of the ground per metre above which houses are not built."""


class Plot:
    """Objects on a square block. Lengths are metres, angles degrees counter-clockwise from east.

    Methods that return a bool place nothing and return False if the ground is not suitable.

    Parameters
    ----------
    rng : numpy.random.Generator
        Random numbers of this block.
    terrain : Terrain
    x, y, side : float
        Centre and side of the block.
    landmarks : Objects
        Objects whose solids keep other objects away.
    street : float
        Width of the streets along the edges of the block.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        terrain: Terrain,
        x: float,
        y: float,
        side: float,
        landmarks: Objects,
        street: float = 0.0,
    ) -> None:
        self.rng, self.terrain, self.x, self.y, self.side = rng, terrain, x, y, side
        self.street = street
        self._far = landmarks
        self._solids: list[Solid] = []
        self._crowns: list[Crown] = []
        self._patches: list[PlantPatch] = []

    def objects(self) -> Objects:
        """Return all objects that were placed so far."""
        return Objects(tuple(self._solids), tuple(self._crowns), tuple(self._patches))

    def pick(self, edge: float = 0.0) -> tuple[float, float]:
        """Return a random position at least ``edge`` from the edges of the block, or its centre."""
        reach = max(self.side / 2 - edge, 0.0)
        dx, dy = self.rng.uniform(-reach, reach, 2)
        return self.x + float(dx), self.y + float(dy)

    def ground(self, x: float, y: float) -> float:
        """Return the height of the terrain."""
        return float(self.terrain.height_at(x, y))

    def slope(self, radius: float = 10.0) -> float:
        """Return the mean rise per metre within ``radius`` of the centre of the block."""
        low, high = self.terrain.range_around(self.x, self.y, radius)
        return (high - low) / (2.8 * radius)

    def free(self, x: float, y: float, radius: float) -> bool:
        """Return whether a circle is dry and clear of the solids of landmarks and of the block."""
        steps = np.linspace(-radius, radius, 5)
        if self.terrain.wet_at(x + steps[None, :], y + steps[:, None]).any():
            return False
        return all(
            solid.distance(x, y) > radius for solid in (*self._far.solids, *self._solids)
        )

    def box(
        self,
        x: float,
        y: float,
        angle: float,
        length: float,
        width: float,
        height: float,
        pitch: float = 0.0,
        label: int = BUILDING,
    ) -> None:
        """Place a solid with eaves ``height`` above the highest ground below it."""
        low, high = self.terrain.range_around(x, y, 0.35 * float(np.hypot(length, width)))
        top = high + height + pitch * width / 2
        self._solids.append(
            Solid(x, y, angle, length, width, low - 1.0, top, pitch=pitch, label=label)
        )

    def thing(
        self, x: float, y: float, angle: float, length: float, width: float, tall: float
    ) -> None:
        """Place an unclassified solid that rises to ``tall`` above the ground at its centre."""
        low = self.ground(x, y)
        self._solids.append(
            Solid(x, y, angle, length, width, low - 1.0, low + tall, label=UNCLASSIFIED)
        )

    def level(self, x: float, y: float, radius: float, most: float) -> bool:
        """Return whether the ground within a radius rises by at most ``most``."""
        low, high = self.terrain.range_around(x, y, radius)
        return high - low <= most

    def house(self, x: float, y: float, angle: float) -> bool:
        """Place a flat or gabled house of 1-3 storeys, with or without garage and shed."""
        length, width = self.rng.uniform(9, 16), self.rng.uniform(7, 11)
        height, pitch = self.rng.uniform(3, 7.5), float(self.rng.choice([0.0, 0.5, 0.7, 0.9]))
        even = self.level(x, y, length / 2, STEEPEST_HOUSE * length * 1.4)
        if not even or not self.free(x, y, 0.6 * length):
            return False
        self.box(x, y, angle, length, width, height, pitch)
        axis = Line(x, y, angle)
        if self.rng.random() < 0.5:
            self.box(*axis.at(length / 2 + 1.7), angle, 3.4, 6.0, 2.5)
        if self.rng.random() < 0.4:
            self.box(
                *axis.at(0.0, width / 2 + self.rng.uniform(5, 8)), angle, 3.0, 2.5, 2.1, 0.3
            )
        return True

    def terrace(self, x: float, y: float, angle: float, length: float, depth: float) -> bool:
        """Place adjoining houses about 5.5 m wide, with gardens, low sheds and some hedges."""
        if not self.free(x, y, 0.4 * length):
            return False
        axis = Line(x, y, angle)
        houses = max(2, round(length / 5.5))
        width = length / houses
        height, pitch = self.rng.uniform(5.0, 6.5), self.rng.uniform(0.6, 1.0)
        shed, garden = self.rng.uniform(2.3, 3.2), self.rng.uniform(8.0, 10.0)
        for house in range(houses):
            along = (house + 0.5) * width - length / 2
            step = self.rng.uniform(-0.6, 0.6)
            self.box(*axis.at(along), angle, width, depth, height + step, pitch)
            self.box(*axis.at(along, depth / 2 + garden), angle, width, 3.0, shed)
            if self.rng.random() < 0.5:
                fence = axis.at(along + width / 2, (depth + garden) / 2)
                self.hedge(*fence, angle + 90.0, garden - 2.0)
        return True

    def dugout(self, x: float, y: float) -> None:
        """Place a garage or cellar in a slope, if it is steep enough and free.

        Its flat roof is 0.1 to 0.6 m above the highest ground below it.
        """
        length, width = self.rng.uniform(5, 14), self.rng.uniform(5, 8)
        radius = 0.35 * float(np.hypot(length, width))
        if not self.level(x, y, radius, 0.8) and self.free(x, y, 0.5 * length):
            self.box(
                x, y, float(self.rng.uniform(0, 180)), length, width, self.rng.uniform(0.1, 0.6)
            )

    def flats(self, x: float, y: float, angle: float) -> bool:
        """Place a flat-roofed or gabled building of 3-7 storeys."""
        length, width = self.rng.uniform(16, 32), self.rng.uniform(10, 14)
        pitch = float(self.rng.choice([0.0, 0.0, 0.6]))
        if not self.level(x, y, length / 2, 4.0) or not self.free(x, y, 0.5 * length):
            return False
        self.box(x, y, angle, length, width, self.rng.uniform(9, 21), pitch)
        return True

    def courtyard(self, depth: float, closed: bool) -> bool:
        """Place four wings (three if not ``closed``) around a yard, along the edges of the block."""
        outer = self.side / 2 - self.street - 2.0
        if not self.level(self.x, self.y, outer, 5.0) or not self.free(
            self.x, self.y, 1.2 * outer
        ):
            return False
        height, pitch = self.rng.uniform(9, 18), float(self.rng.choice([0.0, 0.7]))
        middle = outer - depth / 2
        wings = [
            (0.0, middle, 0.0),
            (0.0, -middle, 0.0),
            (middle, 0.0, 90.0),
            (-middle, 0.0, 90.0),
        ]
        if not closed:
            wings.pop()
        for dx, dy, angle in wings:
            self.box(self.x + dx, self.y + dy, angle, 2 * outer, depth, height, pitch)
        if self.rng.random() < 0.5:
            self.box(self.x, self.y, 0.0, 6.0, 4.0, 2.8)
        return True

    def podium(self) -> bool:
        """Place a low base that nearly fills the block, a terrace south of it and a tower on it."""
        side = self.side - 2 * self.street - 6.0
        if not self.level(self.x, self.y, side / 2, 4.0) or not self.free(
            self.x, self.y, 0.7 * side
        ):
            return False
        self.box(self.x, self.y, 0.0, side, 0.8 * side, self.rng.uniform(3.5, 7))
        self.box(
            self.x,
            self.y - 0.45 * side,
            0.0,
            0.6 * side,
            0.1 * side,
            self.rng.uniform(0.7, 1.5),
        )
        tower = self.rng.uniform(0.3, 0.5) * side
        self.box(self.x + 0.15 * side, self.y, 0.0, tower, tower, self.rng.uniform(18, 35))
        return True

    def hall(self, length: float, width: float) -> bool:
        """Place a flat or slightly pitched hall with ventilators and a loading ramp."""
        angle = float(self.rng.choice([0.0, 90.0, self.rng.uniform(0, 180)]))
        if not self.level(self.x, self.y, 0.35 * length, 5.0) or not self.free(
            self.x, self.y, 0.5 * length
        ):
            return False
        pitch = float(self.rng.choice([0.0, 0.0, 0.08]))
        self.box(self.x, self.y, angle, length, width, self.rng.uniform(6, 11), pitch)
        top = self._solids[-1].top
        for _ in range(4):
            dx, dy = self.rng.uniform(-0.25, 0.25, 2) * width
            x, y = self.x + float(dx), self.y + float(dy)
            self._solids.append(Solid(x, y, angle, 3.0, 2.0, top - 1.0, top + 1.2))
        self.box(
            *Line(self.x, self.y, angle).at(0.0, width / 2 + 2.0), angle, 0.4 * length, 4.0, 1.1
        )
        return True

    def tree(
        self,
        x: float,
        y: float,
        tall: float,
        dense: bool = False,
        widest: float = 6.0,
        rooted: float = 0.6,
    ) -> None:
        """Place a broad or, if ``dense``, a conifer-like tree of height ``tall`` on free ground.

        The radius of its crown is at most ``widest``. The ground must be free within ``rooted``
        times that radius.
        """
        radii, clearances, spacing, stop = (0.2, 0.38), (0.15, 0.35), 1.6, 0.3
        if dense:
            radii, clearances, spacing, stop = (0.12, 0.2), (0.05, 0.15), 0.9, 0.45
        radius = min(self.rng.uniform(*radii) * tall, widest)
        clear = self.rng.uniform(*clearances) * tall
        if self.free(x, y, rooted * radius):
            half = (tall - clear) / 2
            z = self.ground(x, y) + clear + half
            self._crowns.append(Crown(x, y, z, radius, half, spacing, stop))

    def trees(self, low: int, high: int, tall: tuple[float, float] = (4.0, 14.0)) -> None:
        """Place ``low`` to ``high`` trees at random positions of the block."""
        for _ in range(self.rng.integers(low, high + 1)):
            x, y = self.pick(1.0)
            self.tree(x, y, self.rng.uniform(*tall))

    def wood(self, spacing: float, tall: tuple[float, float], dense: float) -> None:
        """Place a closed wood with a tree per square of about ``spacing``, and with undergrowth.

        ``tall`` is the range of heights, and ``dense`` the share of conifers.
        """
        count = max(1, round(self.side / spacing))
        step = self.side / count
        for place in range(count * count):
            dx, dy = self.rng.uniform(0.1, 0.9, 2)
            x = self.x - self.side / 2 + (place % count + dx) * step
            y = self.y - self.side / 2 + (place // count + dy) * step
            conifer = bool(self.rng.random() < dense)
            self.tree(float(x), float(y), self.rng.uniform(*tall), conifer, widest=0.75 * step)
        self.undergrowth(self.rng.uniform(0.1, 0.5), self.rng.uniform(0.4, 1.2))

    def undergrowth(self, cover: float, height: float) -> None:
        """Place plants of a field, a fallow or brambles on the whole block."""
        self._patches.append(
            PlantPatch(self.x, self.y, 0.0, self.side, self.side, height, cover, square=True)
        )

    def bushes(self, low: int, high: int, height: tuple[float, float] = (0.2, 1.0)) -> None:
        """Place ``low`` to ``high`` beds or bushes up to 8 m long, on free ground."""
        for _ in range(self.rng.integers(low, high + 1)):
            x, y = self.pick(2.0)
            length, width = self.rng.uniform(1.5, 8), self.rng.uniform(1, 4)
            angle = self.rng.uniform(0, 180)
            tall = self.rng.uniform(*height)
            cover = self.rng.uniform(0.3, 0.95)
            if self.free(x, y, 0.0):
                self._patches.append(PlantPatch(x, y, angle, length, width, tall, cover))

    def hedge(self, x: float, y: float, angle: float, length: float) -> None:
        """Place a trimmed, dense hedge of 0.8 to 2 m."""
        tall = self.rng.uniform(0.8, 2.0)
        self._patches.append(PlantPatch(x, y, angle, length, 0.9, tall, 0.9, square=True))

    def wall(self, x: float, y: float, angle: float, length: float) -> None:
        """Place a garden wall 0.3 m wide and 0.6 to 2 m high, in pieces that follow the ground."""
        tall = self.rng.uniform(0.6, 2.0)
        pieces = max(1, round(length / 4.0))
        for piece in range(pieces):
            px, py = Line(x, y, angle).at((piece + 0.5) * length / pieces - length / 2)
            if self.free(px, py, 0.2):
                self.thing(px, py, angle, length / pieces, 0.3, tall)

    def car(self, x: float, y: float, angle: float) -> None:
        """Place a car with body and cabin or, sometimes, a van, on free ground."""
        if not self.free(x, y, 0.5):
            return
        if self.rng.random() < 0.15:
            self.thing(x, y, angle, 4.4, 1.8, self.rng.uniform(1.9, 2.6))
        else:
            self.thing(x, y, angle, 4.4, 1.8, 0.9)
            self.thing(x, y, angle, 2.3, 1.6, self.rng.uniform(1.4, 1.7))

    def street_cars(self, share: float) -> None:
        """Place parked cars along the south and the west edge of the block."""
        edge = self.side / 2 - min(1.5, self.street / 2)
        for place in range(int(self.side / 8)):
            along = -self.side / 2 + 6.0 + 7.0 * place
            if self.rng.random() < share:
                self.car(self.x + along, self.y - edge, 0.0)
            if self.rng.random() < share / 2:
                self.car(self.x - edge, self.y + along, 90.0)

    def trailers(self) -> None:
        """Place rows of trailers and containers on the whole block, with some gaps."""
        reach = self.side / 2 - self.street - 8.0
        for y in np.arange(-reach, reach + 0.1, 26.0):
            for x in np.arange(-reach, reach + 0.1, 3.6):
                px, py = self.x + float(x), self.y + float(y)
                if self.rng.random() < 0.6 and self.free(px, py, 1.2):
                    self.thing(px, py, 90.0, 13.6, 2.5, self.rng.uniform(2.6, 4.0))

    def parking(self) -> None:
        """Place rows of cars on the whole block, with some gaps."""
        reach = self.side / 2 - self.street - 3.0
        for y in np.arange(-reach, reach + 0.1, 6.0):
            for x in np.arange(-reach, reach + 0.1, 2.8):
                if self.rng.random() < 0.6:
                    self.car(self.x + float(x), self.y + float(y), 90.0)


BLOCK_REACH_M = 15.0
"""Distance in metres by which the objects of a block may reach beyond it."""

KEPT_BLOCKS = 256
"""Number of blocks kept in memory, which bounds the memory for a city of any size."""


@dataclass(frozen=True)
class Site:
    """Terrain and its objects, with x from 0 to ``side_m`` and y from 0 to ``north_m`` metres.

    Attributes
    ----------
    terrain : Terrain
    side_m : float
    seed : int
        Seed of the random numbers of blocks and sensors.
    fill : callable, optional
        Function that places objects on a `Plot`. With None, blocks are bare.
    block_m : float
        Side of a block in metres. Blocks are a lattice at (0, 0).
    landmarks : Objects
        Objects that extend across blocks: bridges and power lines.
    street_m : float
        Width of the asphalt along the edges of the blocks, metres.
    green : float
        Share of lawn on open ground. The rest is soil.
    """

    terrain: Terrain
    side_m: float
    seed: int = 0
    fill: Callable[[Plot], None] | None = None
    block_m: float = 50.0
    landmarks: Objects = field(default_factory=Objects)
    street_m: float = 0.0
    green: float = 0.6
    north_m: float = 0.0
    _blocks: dict[tuple[int, int], Objects] = field(
        default_factory=dict, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        if not self.north_m:
            object.__setattr__(self, "north_m", self.side_m)

    def objects_near(self, x0: float, y0: float, x1: float, y1: float) -> Objects:
        """Return all objects that may reach into a box (metres).

        Their order depends only on the box.
        """
        objects = self.landmarks.touching(x0, y0, x1, y1)
        if self.fill is None:
            return objects
        low_x, low_y, high_x, high_y = (
            int(np.floor(edge / self.block_m))
            for edge in (
                x0 - BLOCK_REACH_M,
                y0 - BLOCK_REACH_M,
                x1 + BLOCK_REACH_M,
                y1 + BLOCK_REACH_M,
            )
        )
        for iy in range(low_y, high_y + 1):
            for ix in range(low_x, high_x + 1):
                objects = objects + self._block(ix, iy).touching(x0, y0, x1, y1)
        return objects

    def _block(self, ix: int, iy: int) -> Objects:
        if (ix, iy) not in self._blocks:
            if len(self._blocks) >= KEPT_BLOCKS:
                del self._blocks[next(iter(self._blocks))]
            centre = (ix + 0.5) * self.block_m, (iy + 0.5) * self.block_m
            rng = generator(self.seed, BLOCKS, ix, iy)
            plot = Plot(rng, self.terrain, *centre, self.block_m, self.landmarks, self.street_m)
            if self.fill is not None:
                self.fill(plot)
            self._blocks[ix, iy] = plot.objects()
        return self._blocks[ix, iy]
