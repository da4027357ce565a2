"""The least errors: plants as far above the true terrain as noise reaches are told, what differs in nothing is not."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.best_possible import best_labels
from tests.benchmarks.scorecard_scenes import Cloud


@pytest.mark.parametrize(("height_m", "least", "most"), [(0.2, 0.0, 0.03), (0.0, 0.2, 0.3)])
def test_strips_of_plants_are_told_by_their_neighbours_if_they_rise(
    height_m: float, least: float, most: float
) -> None:
    """A quarter of the area, at 20 points/m2 with 0.1 m of noise: one point alone would be wrong at one in six."""
    rng = np.random.default_rng(1)
    x, y = 80 * rng.random((2, 128_000))
    plants = x % 20 < 5
    xyz = np.stack([x, y, 0.1 * x + height_m * plants + rng.normal(0, 0.1, x.size)], axis=1)
    classes = np.where(plants, 3, 2).astype(np.uint8)
    found = best_labels(Cloud(xyz, classes, truth=lambda x, y: 0.1 * x))
    assert least <= ((found == 2) == plants).mean() < most


def test_without_the_true_terrain_nothing_is_told() -> None:
    with pytest.raises(ValueError, match="true terrain is not known"):
        best_labels(Cloud(np.zeros((1, 3)), np.zeros(1, np.uint8)))
