"""The constants of objects left are found again in candidates that were made with them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.left_objects import Sample, fitted, report, sample_of, scored
from tiler.grid.object_candidates import Candidates, Measures, Weights, chances

N = 3000


def sample(name: str, seed: int) -> Sample:
    """Candidates that are right with the chance that the model gives them."""
    random = np.random.default_rng(seed)
    measures = Measures(
        random.random(N), random.uniform(0, 0.35, N), random.uniform(0, 2, N), np.ones(N, bool)
    )
    is_right = random.random(N) < chances(measures)
    no_cells = Candidates(*(np.zeros(N, kind) for kind in [int] * 4 + [float] * 4))
    return Sample(
        name, no_cells, [], measures, is_right, np.ones(N, bool), np.zeros((9, 9)), 1.0
    )


def test_known_constants_are_found_again() -> None:
    found = fitted([sample(str(seed), seed) for seed in range(6)])
    for name in ("objects", "slope", "border_ground"):
        assert getattr(found, name) == pytest.approx(getattr(Weights(), name), rel=0.2), name


def test_a_box_that_is_left_is_an_object_that_is_found() -> None:
    box, noise = np.zeros((120, 120), bool), np.random.default_rng(1).random((120, 120))
    box[50:60, 40:55] = True
    heights, hidden = 100 + 4.0 * box, box & (noise < 0.9)
    wrong = sample_of("box", heights, 2 * ~hidden, 2 * hidden, 4.0 * box, 1.0)
    assert scored(wrong, Weights()) == (1, 1, 1, 0, 2400, 2400)
    right = sample_of("hill", heights, 2 * ~hidden, 2 * hidden, 0.0 * box, 1.0)
    assert scored(right, Weights()) == (0, 0, 1, 1, 0, 0)
    told = report([wrong, wrong._replace(name="other box")])
    assert "| all | 2 | 2 | 2 | 0 | 4800 | 4800 |" in told
