"""Ground points in counts: rough terrain, a plane, and outlines with holes and islands."""

from __future__ import annotations

import numpy as np


def scattered(n: int, side: int, seed: int = 3) -> np.ndarray:
    """Points in a square of ``side`` counts, rough terrain."""
    rng = np.random.default_rng(seed)
    xy = rng.integers(0, side, (n, 2))
    z = 20_000 + 4_000 * np.sin(xy[:, 0] / 9_000) + 3_000 * np.cos(xy[:, 1] / 7_000)
    z += rng.integers(-60, 60, n)
    return np.column_stack((xy, np.round(z))).astype(np.int64)


def plane_points(n: int, side: int, shift: tuple[int, int] = (0, 0)) -> np.ndarray:
    """Points of z = 50 units + (x - x0) / 4 - (y - y0) / 8, a whole number of counts at each of them."""
    xy = 8 * np.random.default_rng(5).integers(0, side // 8, (n, 2))
    z = 50_000 + xy[:, 0] // 4 - xy[:, 1] // 8
    return np.column_stack((xy + np.array(shift), z)).astype(np.int64)


def void(xyz: np.ndarray) -> np.ndarray:
    """A river of 45 m and a round hole."""
    x, y = xyz[:, 0], xyz[:, 1]
    return xyz[
        (np.abs(x - 70_000 - y // 5) > 22_000)
        & ((x - 25_000) ** 2 + (y - 95_000) ** 2 > 18_000**2)
    ]


def l_shape(xyz: np.ndarray) -> np.ndarray:
    return xyz[(xyz[:, 0] < 70_000) | (xyz[:, 1] < 60_000)]


def islands(xyz: np.ndarray) -> np.ndarray:
    x, y = xyz[:, 0] % 70_000, xyz[:, 1] % 90_000
    return xyz[(x - 30_000) ** 2 + (y - 30_000) ** 2 < 14_000**2]
