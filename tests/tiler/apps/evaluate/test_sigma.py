"""Standard errors of a DTM judged by its true errors, worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.tiler.apps.check.rasters import write_heights as raster
from tiler.apps.evaluate import evaluate_dtm, sigma_beside
from tiler.apps.evaluate.heights import SigmaTally
from tiler.errors import ConfigError


def judged(
    tmp_path: Path, error: np.ndarray, sigma: np.ndarray, truth: np.ndarray | None = None
) -> dict:
    truth = np.full(error.shape, 50.0) if truth is None else truth
    paths = [
        raster(tmp_path / f"{name}.tif", values, 10, 20)
        for name, values in (("dtm", truth + error), ("truth", truth), ("sigma", sigma))
    ]
    return evaluate_dtm(paths[0], paths[1], sigma=paths[2])["sigma"]


def test_normal_errors_of_known_spread_lie_within_it_as_often_as_theory_says(
    tmp_path: Path,
) -> None:
    random = np.random.default_rng(1)
    sigma = random.choice([0.1, 0.5, 2.0], (300, 300))
    found = judged(tmp_path, random.normal(0, sigma), sigma)
    shares = [found[f"within_{k}"] for k in (1, 2, 3)]
    assert shares == pytest.approx([0.6827, 0.9545, 0.9973], abs=0.005)
    assert found["predicted_rmse"] == pytest.approx(found["rmse"], rel=0.02)
    assert 0.5 < found["area"] < found["area_at_best"] < 1


def test_an_order_that_is_known_and_one_that_is_not(tmp_path: Path) -> None:
    error = np.zeros((10, 10))
    error[0] = 1.0  # a tenth of the pixels holds all of the error
    right = judged(tmp_path, error, np.where(error > 0, 1.0, 0.1))
    assert right["area"] == right["area_at_best"] == pytest.approx(0.95)
    assert right["in_first_tenth"] == pytest.approx(1.0)
    even = judged(tmp_path, error, np.full((10, 10), 0.3))
    assert even["area"] == pytest.approx(0.5)
    assert even["in_first_tenth"] == pytest.approx(0.1)
    wrong = judged(tmp_path, error, np.where(error > 0, 0.1, 1.0))
    assert wrong["area"] == pytest.approx(0.05)


def test_classes_of_slope_have_figures_of_their_own(tmp_path: Path) -> None:
    column = np.arange(40.0)
    # level, then 45 degrees
    truth = np.where(column < 20, 50.0, 50.0 + (column - 20)) * np.ones((30, 1))
    error = np.where(column < 20, 0.1, 0.4) * np.ones((30, 1))
    found = judged(tmp_path, error, np.full((30, 40), 0.2), truth)
    level, _, _, steep = found["by_slope"]
    assert (level["rmse"], steep["rmse"]) == (
        pytest.approx(0.1, rel=1e-3),
        pytest.approx(0.4, rel=1e-3),
    )
    assert level["predicted_rmse"] == pytest.approx(0.2, rel=1e-3)
    assert sum(row["pixels"] for row in found["by_slope"]) == found["pixels"] == 1200


def test_pixels_without_a_standard_error_are_not_judged(tmp_path: Path) -> None:
    sigma = np.full((5, 5), 0.5)
    sigma[0] = -9999
    assert judged(tmp_path, np.full((5, 5), 0.1), sigma)["pixels"] == 20
    assert SigmaTally().summary()["rmse"] is None
    assert SigmaTally().summary()["area"] is None


def test_the_raster_beside_the_dtm_is_found(tmp_path: Path) -> None:
    dtm = raster(tmp_path / "dtm.tif", np.ones((3, 3)), 0, 3)
    assert sigma_beside(dtm) is None
    sigma = raster(tmp_path / "sigma.tif", np.ones((3, 3)), 0, 3)
    assert sigma_beside(dtm) == Path(sigma)
    assert sigma_beside(tmp_path / "other.tif") is None


def test_a_raster_on_another_lattice_is_refused(tmp_path: Path) -> None:
    dtm = raster(tmp_path / "dtm.tif", np.ones((3, 3)), 0, 3)
    other = raster(tmp_path / "s.tif", np.ones((3, 3)), 0.5, 3)
    with pytest.raises(ConfigError, match="one pixel lattice"):
        evaluate_dtm(dtm, dtm, sigma=other)
