"""Small clouds that are difficult in windows: int32 [3, n] in counts of a centimetre."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

CM = 100
Cloud = np.ndarray


def _scatter(rng: np.random.Generator, n: int, wide: float, high: float) -> np.ndarray:
    return rng.random((2, n)) * [[wide], [high]]


def _cloud(xy: np.ndarray, z: np.ndarray) -> Cloud:
    return np.rint(np.vstack([xy, z]) * CM).astype(np.int32)


def _hills(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 6 * np.sin(x / 37) + 4 * np.cos(y / 23) + 0.02 * x


def plane(rng: np.random.Generator) -> Cloud:
    xy = _scatter(rng, 6000, 160, 120)
    return _cloud(xy, 0.1 * xy[0] + rng.normal(0, 0.03, 6000))


def lattice(rng: np.random.Generator) -> Cloud:
    """Points on a grid of half a metre: cocircular, and on the edges of facets."""
    xy = np.stack(np.meshgrid(np.arange(0, 130, 2.0), np.arange(0, 110, 2.0))).reshape(2, -1)
    return _cloud(xy, np.round(_hills(*xy) + rng.normal(0, 0.4, xy.shape[1]), 1))


def hills_with_houses(rng: np.random.Generator) -> Cloud:
    xy = _scatter(rng, 8000, 200, 140)
    x, y = xy
    z = _hills(x, y) + rng.normal(0, 0.05, x.size)
    z[(x % 45 < 14) & (y % 37 < 10)] += 7
    trees = rng.random(x.size) < 0.15
    z[trees] += rng.random(trees.sum()) * 12
    z[rng.random(x.size) < 0.002] -= 9
    return _cloud(xy, z)


def voids(rng: np.random.Generator) -> Cloud:
    xy = _scatter(rng, 9000, 220, 160)
    keep = np.ones(9000, bool)
    for _ in range(7):
        centre, radius = rng.random(2) * [220, 160], rng.uniform(8, 35)
        keep &= ((xy - centre[:, None]) ** 2).sum(axis=0) > radius**2
    xy = xy[:, keep]
    return _cloud(xy, _hills(*xy) + rng.normal(0, 0.1, xy.shape[1]))


def river(rng: np.random.Generator) -> Cloud:
    """A void of 90 m between two banks."""
    xy = _scatter(rng, 10000, 260, 120)
    xy = xy[:, np.abs(xy[0] - 130 - 15 * np.sin(xy[1] / 30)) > 45]
    return _cloud(xy, _hills(*xy) + 0.3 * rng.normal(0, 1, xy.shape[1]))


def l_shape(rng: np.random.Generator) -> Cloud:
    xy = _scatter(rng, 12000, 200, 200)
    xy = xy[:, (xy[0] < 60) | (xy[1] < 60)]
    return _cloud(xy, _hills(*xy) + rng.normal(0, 0.1, xy.shape[1]))


def islands(rng: np.random.Generator) -> Cloud:
    parts = [_scatter(rng, 900, 30, 25) + rng.random((2, 1)) * [[220], [180]] for _ in range(6)]
    xy = np.concatenate(parts, axis=1)
    return _cloud(xy, _hills(*xy) + rng.normal(0, 0.2, xy.shape[1]))


def flight_line(rng: np.random.Generator) -> Cloud:
    """One diagonal strip, in scan lines."""
    along, aside = _scatter(rng, 6000, 280, 1)
    aside = 30 * np.round(aside * 40) / 40
    x, y = 0.8 * along - 0.6 * aside + 20, 0.6 * along + 0.8 * aside
    return _cloud(np.stack([x, y]), _hills(x, y) + rng.normal(0, 0.1, x.size))


def blunders(rng: np.random.Generator) -> Cloud:
    """Steps and groups far below the ground: steep facets, and outliers at the border of windows."""
    xy = _scatter(rng, 7000, 180, 120)
    z = 8.0 * (xy[0] // 31 % 2) + 5.0 * (xy[1] // 23 % 2) + rng.normal(0, 0.2, 7000)
    for k in rng.integers(0, 7000, 60):
        near = ((xy - xy[:, k : k + 1]) ** 2).sum(axis=0) < 0.8**2
        z[near] -= rng.uniform(5, 15)
    return _cloud(xy, z)


SCENES: dict[str, Callable[[np.random.Generator], Cloud]] = {
    made.__name__: made
    for made in (
        plane,
        lattice,
        hills_with_houses,
        voids,
        river,
        l_shape,
        islands,
        flight_line,
        blunders,
    )
}
