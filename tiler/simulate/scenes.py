"""Small scenes by name, as arrays: for tests and for people who want to try a filter."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from tiler.errors import ConfigError
from tiler.simulate.city import Scene, city
from tiler.simulate.objects import Crown, Objects
from tiler.simulate.sensor import AlsSensor, scan
from tiler.simulate.terrain import Bank, Embankment, Hill, Terrain


def _plane(seed: int, side_m: float) -> Scene:
    """A tilted plane, nothing on it."""
    return Scene(Terrain(100.0, (0.05, -0.03)), Objects(), side_m)


def _hills(seed: int, side_m: float) -> Scene:
    """Hills, a dam and a river bank, nothing on them."""
    rng = np.random.Generator(np.random.PCG64(seed))
    hills = []
    for _ in range(6):
        x, y, radius = rng.uniform(0, side_m), rng.uniform(0, side_m), rng.uniform(0.1, 0.3) * side_m
        hills.append(Hill(x, y, rng.uniform(-8, 15), radius))
    dam = Embankment(side_m / 2, side_m * 0.75, 15.0, 4.0, 5.0, 7.0)
    bank = Bank(side_m * 0.8, 5.0, 3.0, side_m * 0.05, side_m)
    return Scene(Terrain(100.0, (0.0, 0.0), (*hills, dam, bank)), Objects(), side_m)


def _forest(seed: int, side_m: float) -> Scene:
    """Trees close together on a hillside."""
    rng = np.random.Generator(np.random.PCG64(seed))
    terrain = Terrain(100.0, (0.25, 0.1), (Hill(side_m / 2, side_m / 2, 10.0, side_m / 4),))
    crowns = []
    for _ in range(int(side_m**2 / 40)):
        x, y = rng.uniform(0, side_m, 2)
        radius, half_height = rng.uniform(1.5, 4.0), rng.uniform(2.0, 7.0)
        z = float(terrain.height_at(x, y)) + rng.uniform(1.0, 4.0) + half_height
        crowns.append(Crown(x, y, z, radius, half_height))
    return Scene(terrain, Objects(crowns=tuple(crowns)), side_m)


SCENES: dict[str, Callable[[int, float], Scene]] = {
    "city": city,
    "plane": _plane,
    "hills": _hills,
    "forest": _forest,
}
"""Builders ``(seed, side_m) -> Scene`` by name."""


def build_scene(kind: str, seed: int, side_m: float) -> Scene:
    """The scene of that name; raises ConfigError for a name that `SCENES` lacks."""
    if kind not in SCENES:
        raise ConfigError(f"unknown scene {kind!r}: choose one of {', '.join(SCENES)}")
    return SCENES[kind](seed, side_m)


def scene_points(
    kind: str = "city", seed: int = 1, side_m: float = 100.0, sensor: AlsSensor | None = None
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.uint8]]:
    """Points of a scene and their true classes.

    Parameters
    ----------
    kind : str
        A name of `SCENES`.
    seed : int
        The same seed gives the same points.
    side_m : float
        Side of the scene, metres.
    sensor : AlsSensor, optional
        Density, noise, blunders.

    Returns
    -------
    xyz : float64, shape (n, 3), metres
    labels : uint8, shape (n,), ASPRS: 1 other, 2 ground, 5 tree, 6 building, 7 low and 18 high noise
    """
    scene = build_scene(kind, seed, side_m)
    rng = np.random.Generator(np.random.PCG64([seed, 1]))
    returns = scan(scene.terrain, scene.objects, sensor or AlsSensor(), (0.0, 0.0, side_m, side_m), rng)
    return returns.xyz, returns.label
