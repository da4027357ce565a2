"""A small matched cloud with one of each: hall, houses, crown, hedge, bank and blunders."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.matched import bent_hull, surface
from ptd.matched.hull import Envelope
from ptd.passes import Points

SIDE_M, DENSITY_M2, NOISE_M = 90.0, 12.0, 0.06


def village(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Slope, bank, hall, two houses, a crown, a hedge and blunders, seen from above: metres, and true classes."""
    rng = np.random.default_rng(seed)
    n = round(DENSITY_M2 * SIDE_M**2)
    x, y = SIDE_M * rng.random((2, n))
    ground = 0.1 * x + 3.0 / (1.0 + np.exp(-(y - 60.0) / 2.0))
    z, truth = ground.copy(), np.full(n, 2)
    for (west, east, south, north), height in (
        ((10, 45, 8, 34), 8.0),
        ((60, 70, 10, 22), 5.0),
        ((20, 30, 70, 80), 6.0),
    ):
        inside = (x > west) & (x < east) & (y > south) & (y < north)
        z[inside], truth[inside] = 0.1 * west + height + 3.0 * (north > 65), 6
    crown = np.hypot(x - 65.0, y - 70.0)
    z[crown < 5] = (ground + 4.0 + np.sqrt(np.maximum(25 - crown**2, 0.0)))[crown < 5]
    hedge = (abs(y - 45.0) < 0.8) & (x > 50)
    z[hedge] = ground[hedge] + 1.5
    truth[(crown < 5) | hedge] = 5
    z += rng.normal(0.0, NOISE_M, n)
    low = rng.choice(n, 40, replace=False)
    z[low] -= rng.uniform(1.5, 12.0, low.size)
    truth[low] = 7
    return np.stack([x, y, z], axis=1), truth


def counts(xyz: np.ndarray) -> Points:
    return Points(np.rint(1000 * xyz.T).astype(np.int32))


def short_sighted_surface(patch: pytest.MonkeyPatch) -> None:
    """Let the ground's surface see less far, so that small scenes have places beyond its reach."""
    near = {
        "STIFF": Envelope(0.04, 2.0),
        "PLIABLE": Envelope(0.08, 2.0),
        "RIDGES": (Envelope(0.3, 2.0),),
        "CONTRAST_M": 2.0,
        "RIDGE_M": 2.0,
        "TERRAIN_M": 2.0,
    }
    for name, value in near.items():
        patch.setattr(bent_hull, name, value)
    patch.setattr(surface, "ROUNDS", 2)
    patch.setattr(surface, "EXTENDED_M", (1.0, 2.0))
