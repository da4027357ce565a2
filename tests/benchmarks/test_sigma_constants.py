"""The constants of the standard error are found again in errors that were made with them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tests.benchmarks.sigma_constants import (
    GIVEN,
    NAMES,
    POINTS,
    Sample,
    fitted,
    report,
    scored,
)
from tests.benchmarks.sigma_scenes import Pixels
from tiler.core.products import CANOPY, MEASURED, WATER
from tiler.grid.sigma import MATCHED, WEIGHTS, Measures, standard_error_m


def sample(name: str, seed: int) -> Sample:
    """Pixels whose errors have the spread that the model of matched clouds says."""
    random = np.random.default_rng(seed)
    measures = np.abs(random.normal(0, (0.2, 2.0, 0.3, 0.3, 0.4, 0.4), (2 * POINTS, 6))).T
    mask = random.choice([MEASURED, CANOPY, WATER], 2 * POINTS, p=[0.8, 0.1, 0.1]).astype(
        np.float32
    )
    sigma = standard_error_m(Measures(*measures), mask, MATCHED)
    known = SimpleNamespace(name=name, kind="dim", group="simulated")
    return Sample(known, Pixels(measures, mask, random.normal(0, sigma)))


def test_known_constants_are_found_again() -> None:
    samples = [sample(str(seed), seed) for seed in range(12)]
    found = dict(zip(NAMES, fitted(samples, GIVEN["dim"]), strict=True))
    for name in ("roughness", "gap_slope", "trend_gap", "canopy"):
        assert found[name] == pytest.approx(getattr(WEIGHTS[MATCHED], name), rel=0.25), name
    left_out = scored(samples[0], fitted(samples[1:], GIVEN["dim"]))
    assert left_out["predicted"] == pytest.approx(left_out["true"], rel=0.1)
    shares = [left_out[f"within_{k}"] for k in (1, 2, 3)]
    assert shares == pytest.approx([0.683, 0.954, 0.997], abs=0.03)


def test_each_scene_has_a_row() -> None:
    told = report([sample(str(seed), seed) for seed in range(3)], "dim")
    assert "of 2 in 3 of 3 scenes" in told
    assert told.count("| 0 |") == 1
