"""Thresholds from histograms worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.methods.dong2017.histograms import second_difference_jump

JUMPS = [
    # Accumulated 100 180 220 230 239 248 257; its first difference is the histogram, its second
    # -20 -40 -30 -1 0 0: the jump is -40, and -1 is the first after it above a twentieth of
    # that: four bins are ground.
    ([100, 80, 40, 10, 9, 9, 9], 4),
    # The counts may rise first: 50 100 30 5 5: 50 -70 -25 0.
    ([50, 100, 30, 5, 5], 4),
    # A single step: second difference 0 0 -90 0.
    ([100, 100, 100, 10, 10], 4),
    # It falls to the end.
    ([100, 60, 30, 10], 4),
    ([5, 5, 5], None),
    ([1, 2, 3], None),
    ([], None),
]


@pytest.mark.parametrize(("counts", "bins"), JUMPS)
def test_the_second_difference_finds_the_jump(counts: list[int], bins: int | None) -> None:
    assert second_difference_jump(counts) == bins


def test_the_jump_of_normal_noise_on_a_bed_of_facades_is_at_three_sigma() -> None:
    rng = np.random.default_rng(2)
    distances = np.append(abs(rng.normal(0, 0.12, 400_000)), rng.uniform(0, 8, 300_000))
    counts = np.bincount((distances / 0.05).astype(int))[:60]
    found = second_difference_jump(counts.tolist())
    assert found is not None
    assert 0.3 <= found * 0.05 <= 0.45
