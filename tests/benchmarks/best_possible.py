"""How well labels of simulated matched clouds can be at all, with the true terrain for a surface.

``python tests/benchmarks/best_possible.py [dim_park ...]``

For each point its height above the true terrain is known, the mean of such heights around it at
two sizes, and how rough it is there. How often points alike are ground is counted in the
squares of one colour of a chessboard, points in the squares of the other colour get the more
frequent class, and the other way round. A filter has to find the terrain as well, and knows no
such counts: its errors are larger.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import ndimage

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.benchmarks.scorecard_scenes import Cloud, simulated
from tiler.apps.evaluate import IGNORED, evaluate_labels

SCENES = (
    "dim_city", "dim_halls", "dim_village", "dim_park", "dim_area_city", "dim_area_suburb", "dim_mountain",
    "dim_drone",
)  # fmt: skip
SQUARE_M = 10.0
PIXEL_M = 0.25
SIZES = (3, 7)
"""Pixels on a side of the squares over which heights are averaged."""
MAX_DISTANCE_M = 1.0
"""What lies farther from the terrain has no part in means and is no ground."""
HEIGHT_BINS, ROUGH_BINS = 24, 8

Array = np.ndarray


def around(cloud: Cloud, height: Array) -> tuple[list[Array], Array]:
    """Mean heights around each point at all sizes, and the standard deviation at the largest."""
    column, row = (np.maximum(c / PIXEL_M, 0).astype(int) for c in cloud.xyz[:, :2].T)
    shape, near = (row.max() + 1, column.max() + 1), np.abs(height) < MAX_DISTANCE_M
    pixel, n_pixels = (row * shape[1] + column)[near], shape[0] * shape[1]
    sums = [
        np.bincount(pixel, height[near] ** power, n_pixels).reshape(shape) for power in range(3)
    ]
    means = []
    for size in SIZES:
        n, total, squares = (ndimage.uniform_filter(s, size, mode="constant") for s in sums)
        mean = total / np.maximum(n, 1e-9)
        means.append(mean[row, column])
    rough = np.sqrt(np.maximum(squares / np.maximum(n, 1e-9) - mean**2, 0.0))
    return means, rough[row, column]


def best_labels(cloud: Cloud) -> Array:
    """Classes by the more frequent one of points alike in the other squares."""
    if cloud.truth is None:
        raise ValueError("the true terrain is not known")
    height = cloud.xyz[:, 2] - cloud.truth(*cloud.xyz[:, :2].T)
    means, rough = around(cloud, height)
    edges = np.linspace(-0.4, 0.8, HEIGHT_BINS - 1)
    alike = np.digitize(means[0], edges)
    for mean in means[1:]:
        alike = alike * HEIGHT_BINS + np.digitize(mean, edges)
    steps = np.quantile(rough, np.linspace(0, 1, ROUGH_BINS + 1)[1:-1])
    alike = alike * ROUGH_BINS + np.digitize(rough, steps)
    alike = alike * 3 + np.digitize(height, (0.0, 0.2))
    black = np.floor(cloud.xyz[:, :2] / SQUARE_M).sum(axis=1) % 2 == 0
    ground, near = cloud.classification == 2, np.abs(height) < MAX_DISTANCE_M
    counted, labels = (
        near & ~np.isin(cloud.classification, IGNORED),
        np.ones(len(height), np.uint8),
    )
    for here in (black, ~black):
        votes = np.bincount(
            alike[counted & ~here], 2.0 * ground[counted & ~here] - 1.0, alike.max() + 1
        )
        labels[here & near & (votes[alike] > 0)] = 2
    return labels


def main(names: Sequence[str]) -> None:
    """Measure and print."""
    for name in names:
        cloud = simulated(name)
        errors = evaluate_labels(best_labels(cloud), cloud.classification, IGNORED)
        print(
            name,
            " / ".join(f"{100 * errors[k]:.2f}" for k in ("type_1", "type_2", "total")),
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:] or SCENES)
