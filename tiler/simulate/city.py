"""A city of blocks: streets, houses, a hall, parks, trees and cars, on hills with a dam and a river bank."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiler.core.classes import UNCLASSIFIED
from tiler.simulate.objects import Crown, Objects, Shrubs, Solid
from tiler.simulate.terrain import Bank, Embankment, Hill, Terrain

BLOCK_M = 50.0
"""Side of a block, the streets around it included."""


@dataclass(frozen=True)
class Scene:
    """Terrain and what stands on it; x and y run from 0 to ``side_m`` metres."""

    terrain: Terrain
    objects: Objects
    side_m: float


def city(seed: int, side_m: float) -> Scene:
    """The city of a seed.

    Parameters
    ----------
    seed : int
    side_m : float
        Side of the square that it fills, metres, at least two blocks.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    terrain = city_terrain(rng, side_m)
    solids: list[Solid] = []
    crowns: list[Crown] = []
    shrubs: list[Shrubs] = []
    blocks = int(side_m // BLOCK_M)
    hall = (blocks // 3, blocks // 2)
    for row in range(blocks):
        for column in range(blocks):
            x, y = (column + 0.5) * BLOCK_M, (row + 0.5) * BLOCK_M
            house = _hall(rng, terrain, x, y) if (column, row) == hall else _house(rng, terrain, x, y)
            if house is not None:
                solids.append(house)
            crowns += _trees(rng, terrain, x, y, house)
            shrubs += _shrubs(rng, x, y)
            solids += _cars(rng, terrain, x, y)
    return Scene(terrain, Objects(tuple(solids), tuple(crowns), tuple(shrubs)), side_m)


def city_terrain(rng: np.random.Generator, side_m: float) -> Terrain:
    """Gentle hills, one dam across, a river bank in the east."""
    hills = [
        Hill(rng.uniform(0, side_m), rng.uniform(0, side_m), rng.uniform(-6, 14), rng.uniform(60, 160))
        for _ in range(max(4, int(8 * (side_m / 600) ** 2)))
    ]
    dam = Embankment(side_m / 2, side_m * 0.78, 12.0, height=5.0, crest_width=6.0, slope_width=9.0)
    bank = Bank(side_m * 0.86, drop=6.0, width=4.0, swing=side_m * 0.04, period=side_m * 0.9)
    return Terrain(base=120.0, slope=(0.01, -0.006), features=(*hills, dam, bank))


def _ground_range(terrain: Terrain, x: float, y: float, radius: float) -> tuple[float, float]:
    """Lowest and highest ground within ``radius``."""
    around = np.linspace(-radius, radius, 9)
    heights = terrain.height_at(x + around[None, :], y + around[:, None])
    return float(heights.min()), float(heights.max())


def _house(rng: np.random.Generator, terrain: Terrain, x: float, y: float) -> Solid | None:
    """A flat or gabled house of 5-30 m within the block around (x, y); None in a park or on a slope."""
    length, width = rng.uniform(9, 30), rng.uniform(5, 14)
    angle = float(rng.choice([0.0, 0.0, 90.0, rng.uniform(0, 180)]))
    storeys, pitch = rng.uniform(3, 14), float(rng.choice([0.0, rng.uniform(0.3, 0.9)]))
    shift_x, shift_y = rng.uniform(-3, 3, 2)
    park = rng.random() < 0.2
    low, high = _ground_range(terrain, x + shift_x, y + shift_y, 0.6 * length)
    if park or high - low > 4.0:
        return None
    top = high + storeys + pitch * width / 2
    return Solid(x + shift_x, y + shift_y, angle, length, width, base=low - 1.0, top=top, pitch=pitch)


def _hall(rng: np.random.Generator, terrain: Terrain, x: float, y: float) -> Solid:
    """One flat hall that nearly fills its block."""
    low, high = _ground_range(terrain, x, y, 25.0)
    return Solid(x, y, 0.0, 50.0, 36.0, base=low - 1.0, top=high + rng.uniform(7, 10))


def _trees(
    rng: np.random.Generator, terrain: Terrain, x: float, y: float, house: Solid | None
) -> list[Crown]:
    """Trees of a block, more in a park; none reaches into the house."""
    trees = []
    for _ in range(rng.integers(12, 25) if house is None else rng.integers(2, 8)):
        tx, ty = x + rng.uniform(-23, 23), y + rng.uniform(-23, 23)
        radius, half_height, clear = rng.uniform(1.5, 4.5), rng.uniform(1.5, 5.0), rng.uniform(0.5, 3.0)
        if house is None or np.hypot(tx - house.x, ty - house.y) > house.radius + radius:
            ground = float(terrain.height_at(tx, ty))
            trees.append(Crown(tx, ty, ground + clear + half_height, radius, half_height))
    return trees


def _shrubs(rng: np.random.Generator, x: float, y: float) -> list[Shrubs]:
    """Up to three patches of low vegetation."""
    return [
        Shrubs(
            x + rng.uniform(-22, 22), y + rng.uniform(-22, 22),
            radius=rng.uniform(1, 5), height=rng.uniform(0.3, 1.2),
        )
        for _ in range(rng.integers(0, 4))
    ]  # fmt: skip


def _cars(rng: np.random.Generator, terrain: Terrain, x: float, y: float) -> list[Solid]:
    """Parked cars along the street at the south edge of the block."""
    cars = []
    for place in np.flatnonzero(rng.random(6) < 0.35):
        cx, cy = x - 20 + 8.0 * place, y - 24.0
        ground = float(terrain.height_at(cx, cy))
        size = {"length": 4.4, "width": 1.8, "base": ground - 1.0, "top": ground + rng.uniform(1.4, 1.9)}
        cars.append(Solid(cx, cy, 0.0, **size, label=UNCLASSIFIED))
    return cars
