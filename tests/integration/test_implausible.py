"""Results that cannot be true have a warning with a setting that helps, and right results have none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import rasterio

from cli.main import main
from tests.tiler.report import results

SIDE = 660
"""Side of the scenes in metres. They hold four whole squares of 256 m in which warnings are decided."""
EAST, NORTH = 500_000, 5_400_000
RIGHT_M = 0.3
"""Maximum error of nine tenths of the points of a terrain that counts as right."""
X, Y = np.random.default_rng(3).uniform(0, SIDE, (2, 90_000))
FEW = np.random.default_rng(4).random(X.size)
"""Random number of each point, by which few are chosen."""
LAND = 100 + 0.02 * X + 2 * np.sin(Y / 60)
PLATEAU = (np.abs(X - 330) < 240) & (np.abs(Y - 330) < 240)


def write(path: Path, z: np.ndarray, classes: np.ndarray) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([EAST, NORTH, 0.0])
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = X + EAST, Y + NORTH, z
    cloud.classification = classes.astype(np.uint8)
    cloud.return_number = cloud.number_of_returns = np.ones(X.size, np.uint8)
    cloud.write(path)
    return path


def ran(
    cloud: Path, out: Path, *options: str
) -> tuple[list[dict[str, Any]], dict[str, Any], float]:
    """Return implausible results, run.json, and the error that nine tenths of the points do not exceed."""
    usual = (
        "--crs",
        "EPSG:32632",
        "--kind",
        "als",
        "--resolution",
        "2",
        "--classified",
        "none",
    )
    given = ("run", str(cloud), "-o", str(out), *usual, "--in-process", "-q", "--overwrite")
    assert main([*given, *options]) == 0
    run = json.loads((out / "run.json").read_text())
    with rasterio.open(out / "dtm.tif") as dtm:
        heights = dtm.read(1, masked=True).astype(np.float64).filled(np.nan)
        rows, cols = rasterio.transform.rowcol(dtm.transform, X + EAST, Y + NORTH)
    with laspy.open(cloud) as file:
        away = heights[rows, cols] - TRUTH[cloud.name](file.read().z)
    return run["implausible"], run, float(np.nanpercentile(np.abs(away), 90))


TRUTH = {
    "low.las": lambda z: LAND,
    "strip.las": lambda z: LAND,
    "plateau.las": lambda z: z,
    "sparse.las": lambda z: LAND,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Clouds whose results are wrong with some settings."""
    made = tmp_path_factory.mktemp("implausible")
    low = FEW < 0.005
    write(made / "low.las", LAND - np.where(low, 12, 0), np.where(low, 2, 1))
    strip = low & (X < 400)
    write(made / "strip.las", LAND - np.where(strip, 12, 0), np.where(strip | (X > 400), 2, 1))
    write(made / "plateau.las", LAND + np.where(PLATEAU, 20, 0), np.ones(X.size))
    seen = (X < 290) | (FEW < 0.02)
    crowns = LAND + 5 + 10 * np.random.default_rng(5).random(X.size)
    write(made / "sparse.las", np.where(seen, LAND, crowns), np.where(seen, 2, 5))
    return made


@pytest.mark.parametrize(
    ("cloud", "wrong", "right", "what", "why", "remedy"),
    [
        (
            "low.las",
            ("--method", "keep"),
            ("--method", "auto"),
            "too little ground",
            "of the points are ground, and all returns lie more than 2 m above the terrain in 99.",
            "use --method auto",
        ),
        (
            "strip.las",
            ("--method", "keep"),
            ("--method", "auto"),
            "terrain below all returns",
            "nearly all returns lie more than 2 m above the terrain, in ",
            "use --method auto",
        ),
        (
            "plateau.las",
            ("--set", "roof_size=1000", "--voids", "fill"),
            ("--set", "roof_size=200", "--voids", "fill"),
            "terrain below all returns",
            "above the terrain, in 1 of 9 squares of 256 m",
            "use a lower --set roof_size (it is 1000 m) or max_building_size (it is 36 m)",
        ),
        (
            "sparse.las",
            ("--method", "keep", "--max-edge", "8"),
            ("--method", "keep", "--max-edge", "50"),
            "mostly void survey",
            "has no height, because its ground points are farther apart than --max-edge 8 m",
            "use --voids fill, or a larger --max-edge",
        ),
    ],
)  # fmt: skip
def test_result_that_cannot_be_true_has_a_warning_whose_setting_helps(
    cloud: str, wrong: Any, right: Any, what: str, why: str, remedy: str, folder: Path,
    tmp_path: Path,
) -> None:  # fmt: skip
    (result,), run, error = ran(folder / cloud, tmp_path / "out", *wrong)
    assert result["what"] == what
    assert why in result["why"]
    assert remedy in result["remedy"]
    assert f"{result['why']}: {result['remedy']}" in run["warnings"]
    assert [p["what"] for p in run["problems"]].count(what) == 1
    page = results.read(tmp_path / "out" / "report.html")
    assert result["why"] in page.texts["problems"]
    assert error > RIGHT_M or what == "mostly void survey"
    found, _, error = ran(folder / cloud, tmp_path / "out", *right)
    assert found == []
    assert error < RIGHT_M


@pytest.mark.parametrize("scene", ["city", "forest", "als_lakes", "dim_forest"])
def test_right_results_have_no_such_warning(scene: str, tmp_path: Path) -> None:
    cloud = tmp_path / "cloud.laz"
    size = ("--size", "130") if scene.startswith("dim") else ("--size", "280")
    assert main(["simulate", str(cloud), "--scene", scene, *size, "-q"]) == 0
    given = ("run", str(cloud), "-o", str(tmp_path / "out"), "--classified", "none")
    assert main([*given, "--in-process", "-q"]) == 0
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["implausible"] == []


def test_filled_voids_are_no_longer_void(folder: Path, tmp_path: Path) -> None:
    options = ("--method", "keep", "--max-edge", "8", "--voids", "fill")
    found, run, _ = ran(folder / "sparse.las", tmp_path / "out", *options)
    assert found == []
    assert run["voids"]["pixels"] < 0.2 * run["voids"]["surveyed_pixels"]
