"""Spreads are compared with numpy's own figures."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.apps.difference_statistics import SpreadTally, spread


def expected(d: np.ndarray) -> dict[str, float]:
    median = np.median(d)
    return {
        "rmse": np.sqrt(np.mean(d**2)),
        "bias": d.mean(),
        "median": median,
        "nmad": 1.4826 * np.median(np.abs(d - median)),
        "p5": np.percentile(d, 5),
        "p25": np.percentile(d, 25),
        "p75": np.percentile(d, 75),
        "p95": np.percentile(d, 95),
        "p95_abs": np.percentile(np.abs(d), 95),
        "max_abs": np.abs(d).max(),
    }


@pytest.mark.parametrize("n", [1, 2, 19, 1000])
def test_a_spread_follows_its_definition(n: int) -> None:
    d = np.random.default_rng(n).normal(0.3, 1.0, n)
    assert spread(d) == pytest.approx(expected(d), rel=1e-12, abs=1e-12)


def test_a_tally_equals_the_spread_up_to_its_step() -> None:
    d = np.random.default_rng(5).normal(-0.2, 0.5, (40, 500))
    tally = SpreadTally()
    for part in d:
        tally.add(part)
    found = tally.summary()
    assert found == pytest.approx(expected(d), abs=1.5 * tally.step)
    assert [found["rmse"], found["bias"]] == pytest.approx(
        [expected(d)[k] for k in ("rmse", "bias")], rel=1e-9
    )


def test_a_tally_that_grows_too_large_gets_coarser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tiler.apps.difference_statistics.MAX_STEPS", 300)
    d = np.random.default_rng(6).uniform(-5, 5, 20_000)
    tally = SpreadTally()
    for part in np.split(d, 20):
        tally.add(part)
    assert tally.step == pytest.approx(0.1)
    assert tally.summary() == pytest.approx(expected(d), abs=0.15)


def test_no_differences_have_no_spread() -> None:
    assert spread(np.empty(0)) == SpreadTally().summary() == dict.fromkeys(expected(np.ones(1)))
