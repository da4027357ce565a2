"""A DTM compared with its truth, and standard errors with errors, worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from tests.tiler.apps.check.rasters import write_heights as raster
from tiler.apps.evaluate import evaluate_dtm, raster_beside, rasters
from tiler.apps.evaluate.heights import SigmaTally
from tiler.errors import ConfigError, InputError


def test_a_dtm_against_its_truth(tmp_path):
    truth = np.arange(12.0).reshape(3, 4)
    mine = truth + np.array([[1, -1, 1, -1], [3, 1, 1, 1], [1, 1, 1, 1]])
    mine[2, 3] = -9999
    truth[0, 0] = -9999
    result = evaluate_dtm(
        raster(tmp_path / "a.tif", mine, 10, 20), raster(tmp_path / "b.tif", truth, 10, 20)
    )
    difference = np.array([-1, 1, -1, 3, 1, 1, 1, 1, 1, 1])
    assert (result["pixels"], result["only_dtm"], result["only_truth"]) == (10, 1, 1)
    assert result["bias"] == pytest.approx(0.8)
    assert result["rmse"] == pytest.approx(np.sqrt(np.mean(difference**2)))
    assert (result["median"], result["nmad"], result["max_abs"]) == (1.0, 0.0, 3.0)


def test_rasters_of_other_extents_are_compared_where_they_overlap(tmp_path):
    truth = np.arange(100.0).reshape(10, 10)
    result = evaluate_dtm(
        raster(tmp_path / "a.tif", truth[2:7, 3:9] + 0.5, 103, 198),
        raster(tmp_path / "b.tif", truth, 100, 200),
    )
    assert (result["pixels"], result["rmse"], result["nmad"]) == (30, 0.5, 0.0)
    wider = evaluate_dtm(
        raster(tmp_path / "c.tif", truth, 100, 200),
        raster(tmp_path / "d.tif", truth[2:7, 3:9], 103, 198),
    )
    assert (wider["pixels"], wider["rmse"]) == (30, 0.0)


@pytest.mark.parametrize(
    ("west", "size", "message"),
    [
        (0.5, 1.0, "one pixel lattice"),
        (0.0, 2.0, "one pixel lattice"),
        (50.0, 1.0, "do not overlap"),
    ],
)
def test_rasters_that_cannot_be_compared_are_refused(tmp_path, west, size, message):
    one = raster(tmp_path / "a.tif", np.ones((4, 4)), 0, 4)
    with pytest.raises(ConfigError, match=message):
        evaluate_dtm(one, raster(tmp_path / "b.tif", np.ones((4, 4)), west, 4, size))


def test_other_files_are_refused(tmp_path):
    (tmp_path / "a.tif").write_text("no raster")
    with pytest.raises(InputError, match="give a readable raster"):
        evaluate_dtm(tmp_path / "a.tif", tmp_path / "a.tif")


def test_missing_pixels_of_the_dtm_lower_the_coverage(tmp_path):
    truth = np.ones((10, 10))
    result = evaluate_dtm(
        raster(tmp_path / "a.tif", truth[:5, :8], 103, 200),
        raster(tmp_path / "b.tif", truth, 100, 200),
    )
    assert (result["pixels"], result["only_truth"], result["only_dtm"]) == (35, 65, 0)
    assert result["coverage"] == 0.35


def test_blocks_change_nothing(tmp_path, monkeypatch):
    rng = np.random.default_rng(3)
    truth = rng.normal(0, 5, (70, 50))
    mine = truth[10:, 7:] + rng.normal(0.1, 0.3, (60, 43))
    mine[rng.random(mine.shape) < 0.1] = -9999
    paths = raster(tmp_path / "a.tif", mine, 7, 60), raster(tmp_path / "b.tif", truth, 0, 70)
    whole = evaluate_dtm(*paths)
    monkeypatch.setattr(rasters, "BLOCK", 16)
    parts = evaluate_dtm(*paths, difference=tmp_path / "d.tif")
    assert (parts.pop("unit"), whole.pop("unit")) == ("metre", "metre")
    assert parts == pytest.approx(whole, rel=1e-12)
    with rasterio.open(tmp_path / "d.tif") as raster_:
        difference = raster_.read(1, masked=True).compressed()
    assert difference.size == whole["pixels"]
    assert np.sqrt(np.mean(difference.astype(float) ** 2)) == pytest.approx(
        whole["rmse"], rel=1e-6
    )
    assert np.median(difference) == pytest.approx(whole["median"], abs=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"crs": "EPSG:25833"}, "bring both into one CRS"),
        ({"unit": "foot"}, "are in foot, those of .* in metre"),
    ],
)
def test_other_systems_are_refused(tmp_path, change, message):
    one = raster(tmp_path / "a.tif", np.ones((4, 4)), 0, 4, **{"crs": "EPSG:25832", **change})
    with pytest.raises(ConfigError, match=message):
        evaluate_dtm(one, raster(tmp_path / "b.tif", np.ones((4, 4)), 0, 4, crs="EPSG:25832"))


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
    assert raster_beside(dtm, "sigma") is None
    sigma = raster(tmp_path / "sigma.tif", np.ones((3, 3)), 0, 3)
    assert raster_beside(dtm, "sigma") == Path(sigma)
    assert raster_beside(tmp_path / "other.tif", "sigma") is None


def test_a_raster_on_another_lattice_is_refused(tmp_path: Path) -> None:
    dtm = raster(tmp_path / "dtm.tif", np.ones((3, 3)), 0, 3)
    other = raster(tmp_path / "s.tif", np.ones((3, 3)), 0.5, 3)
    with pytest.raises(ConfigError, match="one pixel lattice"):
        evaluate_dtm(dtm, dtm, sigma=other)
