"""Facts of `tiler info` about clouds, rasters and folders with known content."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest
import rasterio.shutil

from cli.main import main
from tests.tiler.apps.check.rasters import write_heights
from tiler.apps.clouds import density_map
from tiler.apps.info import describe
from tiler.errors import InputError


def write_cloud(
    path: Path, side: float = 100.0, per_m2: int = 4, crs: str | None = "EPSG:25832"
) -> None:
    """A square of points on a regular lattice, every tenth of class 2, the first withheld."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 0.001)
    if crs is not None:
        header.add_crs(pyproj.CRS(crs))
    step = 1 / np.sqrt(per_m2)
    axis = np.arange(step / 2, side, step)
    cloud = laspy.LasData(header)
    x, y = (v.ravel() for v in np.meshgrid(axis, axis))
    cloud.x, cloud.y, cloud.z = x, y, np.full(x.size, 7.0)
    cloud.classification = np.where(np.arange(x.size) % 10, 1, 2)
    cloud.withheld = np.arange(x.size) == 0
    cloud.write(path)


def test_cloud(tmp_path: Path) -> None:
    path = tmp_path / "a.laz"
    write_cloud(path)
    facts = describe(str(path))
    known = {"kind": "cloud", "points": 40_000, "format": "LAZ", "las_version": "1.4"}
    assert facts.items() >= known.items()
    assert facts["classes"] == {"1": 36_000, "2": 4_000}
    inner = np.array(facts["density_map"]["per_m2"])[1:-1, 1:-1]
    assert np.median(inner) == pytest.approx(4, rel=0.1)
    assert inner.shape[0] <= 22
    assert inner.shape[1] <= 62
    assert facts["withheld_points"] == 1
    assert facts["density_per_m2"] == pytest.approx(4.0, rel=0.02)
    assert facts["crs"] == "ETRS89 / UTM zone 32N"
    assert facts["horizontal_unit"] == "metre"
    json.dumps(facts)


def test_density_counts_only_places_with_points(tmp_path: Path) -> None:
    path = tmp_path / "a.las"
    write_cloud(path, side=100, per_m2=100, crs=None)
    cloud = laspy.read(path)
    cloud.points = cloud.points[(np.asarray(cloud.x) < 25) | (np.asarray(cloud.y) < 25)]
    cloud.write(path)
    assert describe(str(path))["density_per_m2"] == pytest.approx(100, rel=0.05)


def test_density_is_per_square_metre_whatever_the_unit(tmp_path: Path) -> None:
    path = tmp_path / "feet.laz"
    write_cloud(path, crs="EPSG:2913")  # Oregon North, international feet
    facts = describe(str(path))
    assert facts["horizontal_unit"] == "foot"
    assert facts["density_per_m2"] == pytest.approx(4 / 0.3048**2, rel=0.02)


def test_cloud_without_points(tmp_path: Path) -> None:
    path = tmp_path / "empty.las"
    laspy.LasData(laspy.LasHeader(point_format=6, version="1.4")).write(path)
    facts = describe(str(path))
    assert facts["points"] == 0
    assert facts["bounds"] is None


def test_raster(tmp_path: Path) -> None:
    heights = np.arange(20, dtype=np.float32).reshape(4, 5)
    heights[0, 0] = -9999
    facts = describe(
        str(write_heights(tmp_path / "dtm.tif", heights, 100, 200, 2, "EPSG:25832"))
    )
    assert (facts["kind"], facts["width"], facts["height"], facts["nodata"]) == (
        "raster",
        5,
        4,
        -9999,
    )
    assert facts["bounds"] == [100, 192, 110, 200]
    assert facts["crs"] == "ETRS89 / UTM zone 32N (EPSG:25832)"
    assert facts["vertical_unit"] == "metre"
    valid = heights.ravel()[1:].astype(float)
    assert facts["heights"] == pytest.approx(
        {
            "valid": 0.95,
            "minimum": 1,
            "maximum": 19,
            "mean": valid.mean(),
            "deviation": valid.std(),
        }
    )
    json.dumps(facts)


@pytest.mark.parametrize("name", ["text.txt", "folder", "nowhere.laz", "broken.laz"])
def test_other_files_are_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "text.txt").write_text("no raster")
    (tmp_path / "broken.laz").write_bytes(b"LASF" + bytes(30))
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=name) as caught:
        describe(str(tmp_path / name))
    assert "\n" not in str(caught.value)


def test_a_folder_of_clouds_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.LAZ").touch()
    with pytest.raises(
        InputError, match="holds clouds; give one of them, or see `tiler plan` for all"
    ):
        describe(str(tmp_path))


def test_size_of_a_mosaic_is_that_of_its_files(tmp_path: Path) -> None:
    tif, vrt = tmp_path / "dtm.tif", tmp_path / "dtm.vrt"
    write_heights(tif, np.zeros((400, 500), np.float32), 100, 200, 2, "EPSG:25832")
    rasterio.shutil.copy(tif, vrt, driver="VRT")
    facts = describe(str(vrt))
    assert facts["size_bytes"] == tif.stat().st_size + vrt.stat().st_size
    assert facts["source_files"] == 1
    assert facts["compression"] is None
    assert "source_files" not in describe(str(tif))


def test_a_result_has_the_words_and_figures_of_its_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = {
        "counts": {"participating": 7},
        "filter": {"marked": 1, "overlap_work": 5.197998047},
        "quarantined": [{"path": "b.laz", "error": "b.laz: cut short"}],
        "failed_tasks": [
            {"stage": "filter0", "title": "filter", "key": "0_0", "error": "killed"}
        ],
        "outputs": {"dtm.tif": 2048},
        "seconds": 205.2,
        "peak_rss_bytes": 280_776_704,
        "plan": {"metres_per_unit": {"horizontal": 0.3048}},
        "dtm": {"filled": 5, "marked": 2, "resolution_m": 0.6096},
        "voids": {"surveyed_pixels": 8, "pixels": 3, "asked_pixels": 0},
        "problems": [{"what": "void inside the survey"}] * 2,
    }
    (tmp_path / "run.json").write_text(json.dumps(run))
    assert main(["info", str(tmp_path)]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    for line in (
        "used by the filter 7",
        "label not certified 1",
        "pixels with a height 5",
        "with a height 62.5 % of the area that was read",
        "problems 2: void inside the survey (2)",
        "left out b.laz: cut short",
        "failed filter 0_0: killed",
        "work with halos 5.20 times",
        "dtm.tif 2.0 KiB",
        "pixel 2 ft",
        "time 3:25 min",
        "memory 267.8 MiB at most in one process",
    ):
        assert line in lines
    assert describe(str(tmp_path))["dtm"]["filled"] == 5


def test_result_folder(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text('{"state": "done", "counts": {"stored": 7}, "plan": {}}')
    facts = describe(str(tmp_path))
    known = {"kind": "result", "state": "done", "counts": {"stored": 7}, "dtm": None}
    assert facts.items() >= known.items()
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(InputError, match=r"not valid JSON .*; .* again with --force"):
        describe(str(tmp_path))


def test_the_map_of_density_is_north_up_and_keeps_every_point() -> None:
    counts = np.zeros((10, 300), np.int64)
    counts[0, 0], counts[9, 299], counts[4, 100] = 50, 5, 7
    found = density_map(counts, 2.0)
    per_m2 = np.array(found["per_m2"])
    # five cells of 2 m wide, ten high
    assert (found["width_m"], found["height_m"]) == (10.0, 20.0)
    assert per_m2.shape == (1, 60)
    assert (per_m2.sum() * 200) == pytest.approx(62, abs=0.3)
    two = np.array(density_map(counts.T.copy(), 1.0)["per_m2"])
    assert two[-1, 0] > 0  # row 0 of the counts is the southern one
    assert two[0, -1] > 0
