"""Closed canopy through the whole job: bridged and marked, or left without heights, and told."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio

from cli.main import main
from tests.scenes.canopies import Canopy

WOOD = Canopy(hilly=True, clearings=True, side_m=160.0)
EAST, NORTH = 500_000, 5_000_000


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wood with four clearings as a file, in UTM 32N."""
    path = tmp_path_factory.mktemp("canopy") / "wood.laz"
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([EAST, NORTH, 0.0])
    file = laspy.LasData(header)
    x, y, z = WOOD.points().xyz.T
    file.x, file.y, file.z = x + EAST, y + NORTH, z
    file.write(path)
    return path


def ran(
    cloud: Path, out: Path, *options: object, pixel_m: int = 1
) -> tuple[dict, np.ndarray, np.ndarray]:
    """run.json, the heights (NaN where there are none), and the mask."""
    given = (
        "--crs",
        "EPSG:32632",
        "--kind",
        "dim",
        "--products",
        "dtm,mask",
        "--classified",
        "none",
    )
    arguments = (
        "run",
        cloud,
        "-o",
        out,
        *given,
        "--resolution",
        pixel_m,
        "--in-process",
        "-q",
        *options,
    )
    assert main([str(a) for a in arguments]) == 0
    with rasterio.open(out / "dtm.tif") as dtm, rasterio.open(out / "mask.tif") as mask:
        heights = dtm.read(1, masked=True).astype(np.float64).filled(np.nan)
        return json.loads((out / "run.json").read_text()), heights, mask.read(1)


def truth(shape: tuple[int, ...]) -> np.ndarray:
    rows, columns = np.indices(shape)
    return WOOD.site().terrain.height_at(columns + 0.5, shape[0] - rows - 0.5)


def test_a_canopy_is_bridged_and_marked_and_told(cloud: Path, tmp_path: Path) -> None:
    run, heights, mask = ran(cloud, tmp_path / "out")
    share = run["canopy"]["share"]
    assert share == run["statistics"]["canopy"]["canopy"]["share"]
    assert share == pytest.approx(WOOD.share(), rel=1 / 3)
    beyond = np.isnan(heights)  # where no ground is seen on one side
    assert ((mask == 6) | beyond).mean() == pytest.approx(share, abs=0.1)
    assert np.isfinite(heights[mask == 6]).all()
    errors = np.abs(heights - truth(heights.shape))
    assert errors[mask == 1].mean() < 1.0
    assert errors[mask == 6].mean() < 1.2  # hills of 12 m below trees of 14 to 22 m
    page = (tmp_path / "out/report.html").read_text()
    for (x, y), doubt in zip(run["canopy"]["places"], run["canopy_doubts"], strict=True):
        west, south, east, north = doubt["place"]
        assert EAST - 64 < west < x < east < EAST + WOOD.side_m + 64
        assert NORTH - 64 < south < y < north < NORTH + WOOD.side_m + 64
        assert "hides the ground" in doubt["text"]
        assert "roofs" in doubt["text"]
        assert doubt["text"] in page
        assert f'data-place="{west:.10g},{south:.10g},{east:.10g},{north:.10g}"' in page
    assert "canopy, bridged" in page


def test_unsure_terrain_of_a_photogrammetric_cloud_is_listed(
    cloud: Path, tmp_path: Path
) -> None:
    """Objects are searched in laser scans only, and neither if the kind of the cloud is not decided."""
    run, _, _ = ran(cloud, tmp_path / "out")
    assert run["unsure"]
    assert run["left_objects"] == []
    assert all(0.5 <= place["chance"] <= 0.9 for place in run["unsure"])
    assert "unsure terrain" in (tmp_path / "out/report.html").read_text()
    made = '"event": "task_done", "stage": "grid-dtm-left"'
    assert made in (tmp_path / "out/events.jsonl").read_text()
    given = ("--crs", "EPSG:32632", "--method", "keep", "--ground-classes", "0", "--in-process")
    out = tmp_path / "kept"
    assert main(["run", str(cloud), "-o", str(out), *given, "-q"]) == 0
    assert made not in (out / "events.jsonl").read_text()


def test_a_canopy_has_heights_where_facets_are_too_long(cloud: Path, tmp_path: Path) -> None:
    _, _, usual = ran(cloud, tmp_path / "out")
    _, heights, mask = ran(cloud, tmp_path / "short", "--max-edge", 10)
    assert (mask == 6).sum() > 0.8 * (usual == 6).sum()
    assert np.abs(heights - truth(heights.shape))[mask == 6].mean() < 1.2


def test_terrain_stays_where_crowns_give_no_height(cloud: Path, tmp_path: Path) -> None:
    """Pixels of 20 m are wider than the edge of a wood in which trees are measured."""
    _, heights, mask = ran(cloud, tmp_path / "out", pixel_m=20)
    assert (mask == 6).sum() >= 15
    assert np.isfinite(heights[mask == 6]).all()


def test_a_canopy_may_be_left_without_heights(cloud: Path, tmp_path: Path) -> None:
    _, filled, mask = ran(cloud, tmp_path / "fill")
    run, heights, void = ran(cloud, tmp_path / "void", "--canopy", "void")
    assert not (void == 6).any()
    assert np.isnan(heights[mask == 6]).all()
    assert np.array_equal(heights[mask == 1], filled[mask == 1], equal_nan=True)
    assert run["canopy"]["mode"] == "void"


def test_an_area_does_not_change_what_is_in_it(cloud: Path, tmp_path: Path) -> None:
    _, whole, mask = ran(cloud, tmp_path / "whole")
    bounds = EAST + 30, NORTH + 20, EAST + 110, NORTH + 90
    _, heights, part_mask = ran(cloud, tmp_path / "part", "--bounds", *bounds)
    part = np.s_[70:140, 30:110]
    assert (mask[part] == 6).mean() > 0.5
    assert np.array_equal(mask[part], part_mask)
    assert np.array_equal(whole[part], heights, equal_nan=True)


@pytest.mark.slow
def test_tiles_do_not_show(cloud: Path, tmp_path: Path) -> None:
    _, heights, mask = ran(cloud, tmp_path / "whole", "--tile-size", 1000)
    _, other_heights, other_mask = ran(cloud, tmp_path / "tiles", "--tile-size", 64)
    assert np.array_equal(mask, other_mask)
    assert np.array_equal(heights, other_heights, equal_nan=True)
