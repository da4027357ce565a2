"""Laser scans of water with truth: where it is wet, how high the water stands, and the land beside it, by formula."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tests.invariants import clouds
from tests.invariants.clouds import Cloud

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Field = Callable[[Floats, Floats], Floats]

GROUND, REED, TREE, LOW, WATER, BRIDGE = 2, 3, 5, 7, 9, 17
NOISE_M = 0.03
"""Standard deviation of heights on land."""


@dataclass(frozen=True)
class Basin:
    """One body of water of a scene.

    Attributes
    ----------
    edge : callable
        Metres from the shore at places x, y: negative on the water.
    level : callable
        Height of the water at places.
    returns : callable
        Share of the pulses that come back at places.
    waves : callable
        Standard deviation of heights at places.
    shift : callable
        Metres by which returns lie above the level at places, where a strip was flown at another.
    """

    edge: Field
    level: Field
    returns: Field
    waves: Field
    shift: Field = lambda x, y: np.zeros(np.shape(x))


@dataclass(frozen=True)
class WaterScene:
    """A survey with water of known extent and level.

    Attributes
    ----------
    width, height : float
        Metres, from the south-west corner.
    basins : tuple of Basin
    dry : callable
        Height of land where no water is near.
    bank : float
        Rise of the banks from the shore on, per metre.
    structures : tuple of (west, south, east, north, crest)
        Boxes of masonry in and above water.
    density : float
        Pulses per square metre.
    trees : float
        Metres that crowns reach over the water; 0 where none stand on the banks.
    low : int
        Returns that seem to come from below the water.
    decks : tuple of (west, south, east, north, height)
        Bridges; beneath them is what would be there without.
    reeds : callable or None
        Share of the pulses that reed returns at places, from 0.3 to 2 m above the water that it stands in.
    land_returns : callable
        Share of the pulses on land that come back at places.
    """

    width: float
    height: float
    basins: tuple[Basin, ...]
    dry: Field
    bank: float = 0.4
    structures: tuple[tuple[float, float, float, float, float], ...] = ()
    density: float = 3.0
    trees: float = 0.0
    low: int = 0
    decks: tuple[tuple[float, float, float, float, float], ...] = ()
    reeds: Field | None = None
    land_returns: Field = lambda x, y: np.full(np.shape(x), 0.99)

    def _structure(self, x: Floats, y: Floats) -> Floats:
        """Height of the masonry at places; NaN where there is none."""
        found = np.full(x.shape, np.nan)
        for west, south, east, north, crest in self.structures:
            found[(x >= west) & (x < east) & (y >= south) & (y < north)] = crest
        return found

    def basin_at(self, x: Floats, y: Floats) -> npt.NDArray[np.int64]:
        """Number of the body of water at places, -1 on land."""
        found = np.full(x.shape, -1)
        for i, basin in enumerate(self.basins):
            found[basin.edge(x, y) < 0] = i
        found[~np.isnan(self._structure(x, y))] = -1
        return found

    def wet(self, x: Floats, y: Floats) -> Bools:
        """Whether places are water."""
        return self.basin_at(x, y) >= 0

    def height_at(self, x: Floats, y: Floats) -> Floats:
        """Height of the land, of the masonry, or of the water."""
        found = self.dry(x, y)
        for basin in self.basins:
            edge = basin.edge(x, y)
            level = basin.level(x, y)
            found = np.minimum(found, level + np.maximum(edge, 0) * self.bank)
        built = self._structure(x, y)
        return np.where(np.isnan(built), found, built)

    def shore_m(self, x: Floats, y: Floats) -> Floats:
        """Metres from the nearest shore, negative on the water."""
        return np.min([basin.edge(x, y) for basin in self.basins] or [np.full(x.shape, np.inf)], axis=0)

    def cloud(self, seed: int) -> Cloud:
        """Points of the scene with their true classes."""
        rng = np.random.default_rng(seed)
        x, y = (
            rng.uniform(0, side, round(self.density * self.width * self.height))
            for side in (self.width, self.height)
        )
        z, number = self.height_at(x, y), self.basin_at(x, y)
        returns, spread = self.land_returns(x, y), np.full(x.shape, NOISE_M)
        for i, basin in enumerate(self.basins):
            mine = number == i
            returns[mine] = basin.returns(x[mine], y[mine])
            spread[mine] = basin.waves(x[mine], y[mine])
            z[mine] += basin.shift(x[mine], y[mine])
        label = np.where(number >= 0, WATER, GROUND)
        for west, south, east, north, height in self.decks:
            deck = (x >= west) & (x < east) & (y >= south) & (y < north)
            z[deck], returns[deck], spread[deck], label[deck] = height, 0.99, NOISE_M, BRIDGE
        seen = rng.random(len(x)) < returns
        z = z + spread * rng.standard_normal(len(x))
        if self.reeds is not None:
            reed = (rng.random(len(x)) < self.reeds(x, y)) & (label == WATER)
            z[reed] += rng.uniform(0.3, 2.0, int(reed.sum()))
            label[reed] = REED
            seen |= reed
        crown, top = self._crowns(rng, x, y)
        seen &= ~(crown & (rng.random(len(x)) < 0.75))
        parts = [np.column_stack((x, y, z))[seen], np.column_stack((x, y, top))[crown]]
        labels = [label[seen], np.full(int(crown.sum()), TREE)]
        if self.low:
            wet = rng.choice(np.flatnonzero(number >= 0), self.low)
            parts.append(np.column_stack((x[wet], y[wet], z[wet] - rng.uniform(1, 3, self.low))))
            labels.append(np.full(self.low, LOW))
        xyz = np.round(np.concatenate(parts), 3)
        return Cloud(xyz, np.concatenate(labels).astype(np.uint8))

    def _crowns(self, rng: np.random.Generator, x: Floats, y: Floats) -> tuple[Bools, Floats]:
        """Which pulses a crown returns, and at what height."""
        crown, top = np.zeros(x.shape, np.bool_), np.zeros(x.shape)
        if not self.trees:
            return crown, top
        cx, cy = (
            rng.uniform(0, side, round(self.width * self.height / 25)) for side in (self.width, self.height)
        )
        radius = rng.uniform(2.5, 5.0, len(cx))
        shore = self.shore_m(cx, cy)
        stand = (
            (shore - radius > -self.trees) & (shore < 9) & np.isnan(self._structure(cx, cy)) & (shore > 0.5)
        )
        foot = self.height_at(cx, cy)
        order = np.argsort(x)
        for i in np.flatnonzero(stand):
            first, last = np.searchsorted(x[order], (cx[i] - radius[i], cx[i] + radius[i]))
            near = order[first:last]
            near = near[np.hypot(x[near] - cx[i], y[near] - cy[i]) < radius[i]]
            crown[near] = True
            top[near] = foot[i] + rng.uniform(3, 12, len(near))
        crown &= rng.random(len(x)) < 0.8
        return crown, top

    def write(self, path: Path, seed: int, classes: bool = False) -> Path:
        """A file of the scene; with the class of water if ``classes``, else with none."""
        cloud = self.cloud(seed)
        shown = np.where(cloud.truth == WATER, WATER, 1) if classes else np.ones(len(cloud.truth))
        return clouds.write(path, cloud, classes=shown.astype(np.uint8))


def _constant(value: float) -> Field:
    return lambda x, y: np.full(np.shape(x), value)


def _rolling(height: float, swing: float, length: float) -> Field:
    """Land that rolls by ``swing`` over ``length``."""
    turn = 2 * np.pi / length
    return lambda x, y: (
        height + swing * (np.sin(turn * (x + 0.4 * y)) + np.sin(1.7 * turn * (y - 0.3 * x) + 1)) / 2
    )


def weir() -> WaterScene:
    """A pool, a dam of 3 m with a lock wall and piers, tailwater with waves, trees, a tributary below."""
    dam, pool, tail = 300.0, 143.4, 140.4

    def middle(x: Floats) -> Floats:
        return 130 + 12 * np.sin(2 * np.pi * x / 520)

    def pool_edge(x: Floats, y: Floats) -> Floats:
        return np.maximum(np.abs(y - middle(x)) - 19, x - dam)

    def tail_edge(x: Floats, y: Floats) -> Floats:
        return np.maximum(np.abs(y - middle(x)) - 17, dam + 6 - x)

    def side_edge(x: Floats, y: Floats) -> Floats:
        along, across = y - middle(np.full_like(y, 560.0)), x - 560 - 0.2 * (y - 130)
        return np.maximum(np.abs(across) - 9, -along)

    def below(x: Floats, y: Floats) -> Floats:
        return tail - 0.0005 * (x - dam)

    def side_level(x: Floats, y: Floats) -> Floats:
        return np.maximum(below(np.full_like(x, 560.0), y) + 0.002 * np.maximum(y - 147, 0), 0)

    basins = (
        Basin(pool_edge, _constant(pool), _constant(0.08), _constant(0.03)),
        Basin(side_edge, side_level, _constant(0.04), _constant(0.03)),
        Basin(
            tail_edge, below, lambda x, y: np.where(x < dam + 156, 0.85, 0.05),
            lambda x, y: np.where(x < dam + 156, 0.12, 0.03),
        ),
    )  # fmt: skip
    structures = [(dam, 80.0, dam + 6, 200.0, pool + 0.7), (dam - 40, 117.0, dam + 45, 120.0, pool + 1.2)]
    structures += [(dam - 1, y, dam + 9, y + 2.0, pool + 2.0) for y in (126.0, 133.0, 140.0)]
    return WaterScene(700, 260, basins, _rolling(146.5, 1.2, 180), 0.5, tuple(structures), trees=4.0, low=60)


def meander(length: float = 1500.0) -> WaterScene:
    """A river that falls 1 m per km around bends, with bars, an island of gravel, a ford, a bridge and banks of 2 m."""

    def middle(x: Floats) -> Floats:
        return 150 + 60 * np.sin(2 * np.pi * x / 480)

    def edge(x: Floats, y: Floats) -> Floats:
        slope = 2 * np.pi / 480 * 60 * np.cos(2 * np.pi * x / 480)
        wide = 18 * np.exp(-(((x - 1140) / 90) ** 2))
        river = np.abs(y - middle(x)) / np.hypot(1, slope) - (14 + 3 * np.sin(x / 70) + wide)
        bar = 8 - np.hypot((x - 600) / 2.2, y - middle(np.full_like(x, 600.0)) - 9)
        gravel = 14 - np.hypot((x - 1140) / 3.6, y - middle(x))
        return np.max([river, np.where(bar > 0, bar, -99.0), np.where(gravel > 0, gravel / 6, -99.0)], axis=0)

    def level(x: Floats, y: Floats) -> Floats:
        return 52 - 0.001 * x

    ford = lambda x, y: np.where(np.abs(x - 900) < 30, 0.8, 0.04)  # noqa: E731
    basin = Basin(edge, level, ford, lambda x, y: np.where(np.abs(x - 900) < 30, 0.08, 0.03))
    return WaterScene(
        length, 300, (basin,), lambda x, y: _rolling(54, 0.6, 150)(x, y) - 0.001 * x, 0.3, density=2.0,
        decks=((326.0, 75.0, 335.0, 116.0, 54.4),),
    )  # fmt: skip


def _disk(cx: float, cy: float, radius: float, lobes: float) -> Field:
    def edge(x: Floats, y: Floats) -> Floats:
        angle = np.arctan2(y - cy, x - cx)
        return np.hypot(x - cx, y - cy) - radius * (1 + 0.15 * np.sin(lobes * angle))

    return edge


def lakes() -> WaterScene:
    """Three lakes of different levels: a dam between two, a bank of reed, and one at the border cut by two strips."""
    upper, lower = _disk(140, 180, 70, 3), _disk(300, 180, 75, 4)

    def of_upper(x: Floats, y: Floats) -> Floats:
        return np.maximum(upper(x, y), x - 212)

    def of_lower(x: Floats, y: Floats) -> Floats:
        return np.maximum(lower(x, y), 222 - x)

    def strips(x: Floats, y: Floats) -> Floats:
        return np.where(x < 500, 0.0, 0.4)

    few, calm = _constant(0.05), _constant(0.03)
    basins = (
        Basin(of_upper, _constant(99.0), few, calm),
        Basin(of_lower, _constant(97.0), few, calm),
        Basin(_disk(500, 40, 80, 3), _constant(94.0), _constant(0.15), calm, strips),
    )

    def reeds(x: Floats, y: Floats) -> Floats:
        return np.where((of_upper(x, y) > -6) & (x < 110), 0.9, 0.0)

    dam = ((212.0, 120.0, 222.0, 240.0, 100.2),)
    return WaterScene(
        640, 300, basins, _rolling(102, 1.5, 160), 0.25, dam, density=2.0, trees=2.0, reeds=reeds
    )


def tide() -> WaterScene:
    """A sea seen by two strips at different tides, along a beach."""

    def edge(x: Floats, y: Floats) -> Floats:
        return y - 110 - 15 * np.sin(x / 60) + np.where(x < 200, 0.0, 12.0)

    def level(x: Floats, y: Floats) -> Floats:
        return np.where(x < 200, 1.1, 0.5)

    basin = Basin(edge, level, _constant(0.3), _constant(0.08))
    return WaterScene(400, 260, (basin,), _rolling(5, 0.5, 140), 0.05, density=2.0)


def wet_meadow() -> WaterScene:
    """Flat land that is wet and dark: a third of the pulses comes back in patches, and nothing is water."""

    def returns(x: Floats, y: Floats) -> Floats:
        return np.where(np.sin(x / 30) + np.sin(y / 25) > 0.8, 0.35, 0.99)

    return WaterScene(400, 300, (), _rolling(10, 0.12, 60), density=2.0, land_returns=returns)


SCENES: dict[str, Callable[[], WaterScene]] = {
    f"als_{make.__name__}": make for make in (weir, meander, lakes, tide, wet_meadow)
}
"""Makers by name."""
