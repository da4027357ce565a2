"""Checkpoints over the surfaces of `tests.tiler.apps.check.rasters`."""

from __future__ import annotations

import numpy as np

from tiler.apps.check import Checkpoints


def checkpoints(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    kinds: list[str] | None = None,
    crs: str | None = None,
) -> Checkpoints:
    n = len(z)
    return Checkpoints(
        np.array([x, y], float),
        np.asarray(z, float),
        tuple(kinds or ["NVA"] * n),
        ("",) * n,
        tuple(str(i) for i in range(n)),
        crs,
    )


def scattered(n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.random.default_rng(seed).uniform(1, 39, (2, n))
    return x, y
