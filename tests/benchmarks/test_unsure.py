"""The constants of unsure terrain are found again in places that were made with them, and places are judged."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.left_objects import Pixels
from tests.benchmarks.unsure import CORNERS, Sample, fitted, report, sample_of, scored
from tests.tiler.grid.test_unsure_terrain import land, patch, seen_at
from tiler.grid.sigma import LASER
from tiler.grid.unsure_terrain import SEARCHES

N = 4000
SEARCH = SEARCHES[LASER]


def sample(seed: int) -> Sample:
    """Candidates that are wrong with the chance that the model gives them."""
    random = np.random.default_rng(seed)
    measures = random.normal(0, 0.5, (N, 6))
    by = np.array(SEARCH.weights)
    is_wrong = random.random(N) < 1 / (1 + np.exp(-(by[0] + measures @ by[1:])))
    nothing = np.zeros((9, 9))
    known = np.ones(N, bool)
    return Sample(
        str(seed), nothing.astype(int), known, measures, known, is_wrong, nothing, 1.0, SEARCH
    )


def test_known_constants_are_found_again() -> None:
    found = fitted([sample(seed) for seed in range(6)])
    assert found == pytest.approx(SEARCH.weights, rel=0.15)


@pytest.mark.parametrize("error_m", [2.0, 0.0])
def test_a_place_is_wrong_where_heights_are_off(error_m: float) -> None:
    rough_land = patch(100, 100, 14)
    seen, heights = seen_at(rough_land), land(rough_land, 5.0)
    pixels = Pixels(heights, 6 * seen, 6 * ~seen, error_m * rough_land, 1.0)
    one = sample_of("als_forest", pixels, SEARCH)
    score = scored(one, SEARCH.weights)
    assert score.judged == score.places > 0
    assert score.wrong == score.places * (error_m > 0)
    assert score.objects == (error_m > 0)
    assert "| fresh: woods | 1 |" in report(
        [one, one._replace(family="bluff")], [one] * len(CORNERS)
    )
