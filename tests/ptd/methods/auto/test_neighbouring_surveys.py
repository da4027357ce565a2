"""A survey beside another one: each place gets what it gets alone, but near the border that they share."""

from __future__ import annotations

import numpy as np
import pytest

import ptd
from ptd.ground.noise_sums import REACH_M

LENGTH_M, WIDTH_M = 1400.0, 8.0
SURFACE_SEES_M = 1000.0
"""What the passes of matched clouds see beyond the figures of a place: seldom as much."""


def survey(
    seed: int, density: float, noise_m: float, west: float = 0.0, length_m: float = LENGTH_M
) -> tuple[np.ndarray, np.ndarray]:
    """A strip of rough ground with boxes, and low plants on a tenth of it; which points are ground."""
    rng = np.random.default_rng(seed)
    x, y = rng.random((2, round(length_m * WIDTH_M * density))) * [[length_m], [WIDTH_M]]
    x += west
    box = (x % 37 < 9) & (abs(y - 4) < 2.5)
    plant = ~box & (rng.random(x.size) < 0.1)
    z = 0.05 * x + 4.0 * box + 0.3 * plant + rng.normal(0, noise_m, x.size)
    return np.stack([x, y, z], axis=1), ~box & ~plant


def error(labels: np.ndarray, ground: np.ndarray) -> float:
    return float(((labels == 2) != ground).mean())


def assert_each_as_alone(
    surveys: list[tuple[np.ndarray, np.ndarray]], kind: str, beyond_m: float, as_good: float
) -> list[str]:
    """Surveys that meet at x = 0: alike beyond some distance, as good everywhere but for a share; what is told."""
    both = ptd.classify(np.concatenate([xyz for xyz, _ in surveys]), kind=kind)
    parts = np.split(both.classification, [len(surveys[0][0])])
    for (xyz, ground), labels in zip(surveys, parts, strict=True):
        alone = ptd.classify(xyz, kind=kind).classification
        inside = abs(xyz[:, 0]) > beyond_m
        assert inside.mean() > 0.3
        assert np.array_equal(labels[inside], alone[inside])
        assert error(labels, ground) < error(alone, ground) + as_good
    notes: list[str] = both.decisions["statistics"]["notes"]
    return notes


def test_a_dense_laser_scan_beside_a_sparse_one() -> None:
    """20 and 1 points/m2: 0.12 m from the surface and 0.24 m."""
    surveys = [survey(1, 20.0, 0.03), survey(2, 1.0, 0.08, -LENGTH_M)]
    notes = assert_each_as_alone(surveys, "lidar", REACH_M, 0.01)
    assert any("0.12 to 0.24 m + 0.5 to 1 m x slope" in note for note in notes)


def test_matched_clouds_of_two_noise_levels() -> None:
    beyond = REACH_M + SURFACE_SEES_M
    length = beyond + 1000.0
    surveys = [survey(3, 4.0, 0.03, 0.0, length), survey(4, 4.0, 0.16, -length, length)]
    notes = assert_each_as_alone(surveys, "dim", beyond, 0.01)
    assert any("noise of the place 0.03 to 0.1" in note for note in notes)


@pytest.mark.parametrize("kind", ["lidar", "dim"])
def test_a_survey_far_away_changes_nothing(kind: str) -> None:
    """7.6 km away, of another density and noise."""
    near, _ = survey(5, 5.0, 0.05, 150.0)
    far, _ = survey(6, 1.0, 0.2, 600.0)
    alone = ptd.classify(near, kind=kind).classification
    both = ptd.classify(
        np.concatenate([near, far + (7600.0, 0.0, 9.0)]), kind=kind
    ).classification
    assert np.array_equal(both[: len(near)], alone)
