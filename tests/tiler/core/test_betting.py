"""Upper bound of a mean: rarely violated at any moment, and not much larger than that of a fixed number of draws."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import beta

from tiler.core.betting import upper_bound

SAMPLES, DRAWS = 300, 150
Draw = Callable[[np.random.Generator], np.ndarray]
DISTRIBUTIONS: dict[str, tuple[float, Draw]] = {
    "rare": (0.02, lambda rng: rng.random(DRAWS) < 0.02),
    "some": (0.3, lambda rng: rng.random(DRAWS) < 0.3),
    "mostly": (0.9, lambda rng: rng.random(DRAWS) < 0.9),
    "quarters": (0.19, lambda rng: rng.choice([0, 0.25, 1], DRAWS, p=[0.65, 0.2133333, 0.1366667])),
    "narrow": (0.25, lambda rng: rng.beta(2, 6, DRAWS)),
}  # fmt: skip


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_bound_is_violated_at_any_moment_in_few_samples(name: str) -> None:
    """The bound never increases, so the worst moment to stop is the last one."""
    mean, draw = DISTRIBUTIONS[name]
    rng = np.random.default_rng(7)
    violated = sum(upper_bound(draw(rng)) < mean for _ in range(SAMPLES))
    assert violated <= 0.05 * SAMPLES + 3 * np.sqrt(0.05 * 0.95 * SAMPLES)


def test_without_objects_the_bound_is_near_that_of_a_fixed_number_of_draws() -> None:
    assert upper_bound(100 * [0.0]) <= 0.035
    for number in (10, 30, 100, 1000):
        best = 1 - 0.05 ** (1 / number)
        assert best < upper_bound(number * [0.0]) < 1.25 * best


@pytest.mark.parametrize(("number", "ones"), [(60, 2), (300, 3), (300, 30), (1000, 500)])
def test_with_objects_the_bound_is_near_that_of_a_fixed_number_of_draws(
    number: int, ones: int
) -> None:
    best = beta.ppf(0.95, ones + 1, number - ones)
    rng = np.random.default_rng(3)
    bounds = [upper_bound(rng.permutation(np.arange(number) < ones)) for _ in range(20)]
    assert ones / number < np.mean(bounds) < 1.35 * best


@given(st.lists(st.floats(0, 1), max_size=40))
def test_the_bound_does_not_increase_with_further_draws(values: list[float]) -> None:
    bounds = [upper_bound(values[:number]) for number in range(0, len(values) + 1, 5)]
    assert bounds[0] == 1
    assert bounds == sorted(bounds, reverse=True)
    assert all(0 <= bound <= 1 for bound in bounds)


def test_the_bound_of_ones_is_one() -> None:
    assert upper_bound(50 * [1.0]) == 1
