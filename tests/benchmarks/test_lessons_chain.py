"""The benchmark's composition finds the ground of a plain scene, and of the ISPRS samples as well as it should."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from statistics import mean

import numpy as np
import pytest

from ptd.frame import Scale
from tests.benchmarks.lessons_chain import classify, errors


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A slope with two roofs, a bush and low noise: int32 [3, n] in mm, and what is ground."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, 120, (2, 30_000))
    z = 0.15 * x + rng.normal(0, 0.03, x.size)
    house = (abs(x - 40) < 8) & (abs(y - 40) < 12)
    shed = (abs(x - 90) < 6) & (abs(y - 80) < 6)
    bush = np.hypot(x - 30, y - 90) < 3
    z[house] = 6.0 + 0.15 * 48
    z[shed] += 3.0
    z[bush] += rng.uniform(1.0, 3.0, int(bush.sum()))
    pit = np.zeros(x.size, bool)
    pit[:2] = True
    x[:2], y[:2], z[:2] = 60.0, (60.0, 60.5), -9.0
    ground = ~(house | shed | bush | pit)
    return np.rint(1000 * np.stack([x, y, z])).astype(np.int32), ground


def test_roofs_bushes_and_low_noise_are_no_ground() -> None:
    xyz, ground = scene()
    found = classify(xyz, Scale()) == 2
    assert (found & ~ground).sum() < 0.01 * (~ground).sum()
    assert (ground & ~found).sum() < 0.01 * ground.sum()


def test_feet_and_shifted_local_coordinates_give_the_same_labels() -> None:
    xyz, _ = scene()
    labels = classify(xyz, Scale())
    shift = np.array([[7_654], [-3_210], [0]], np.int32)
    moved = classify(xyz - shift, Scale(origin=(7_654, -3_210)))
    np.testing.assert_array_equal(moved, labels)
    order = np.random.default_rng(0).permutation(labels.size)
    np.testing.assert_array_equal(classify(xyz[:, order], Scale()), labels[order])
    feet = Fraction(3048, 10_000) / 1000
    in_feet = np.rint(xyz / 0.3048).astype(np.int32)
    assert (classify(in_feet, Scale(feet, feet)) != labels).mean() < 0.001


@pytest.mark.slow
def test_errors_on_the_isprs_samples(shared_data: Path) -> None:
    if not (shared_data / "isprs").is_dir():
        pytest.skip("no ISPRS samples: ../shared/data/isprs is absent")
    table = errors(shared_data / "isprs")
    assert len(table) == 8
    assert mean(row["total"] for row in table.values()) < 0.04
