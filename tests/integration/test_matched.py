"""A matched cloud through the whole job: what is decided for it, told, and gridded."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio

import ptd
from cli.main import main
from tests.scenes.village import village


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The village of the filter's tests as a file, in UTM 32N."""
    path = tmp_path_factory.mktemp("matched") / "village.laz"
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([500_000.0, 5_000_000.0, 0.0])
    file = laspy.LasData(header)
    x, y, z = village()[0].T
    file.x, file.y, file.z = x + 500_000.0, y + 5_000_000.0, z
    file.return_number[:] = file.number_of_returns[:] = 1
    file.write(path)
    return path


def ran(cloud: Path, out: Path, *options: object) -> dict:
    arguments = ("run", cloud, "-o", out, "--crs", "EPSG:32632", "--in-process", "-q", *options)
    assert main([str(a) for a in arguments]) == 0
    return json.loads((out / "run.json").read_text())


def test_what_is_decided_of_a_matched_cloud_is_told_and_done(
    cloud: Path, tmp_path: Path
) -> None:
    found = ran(cloud, tmp_path / "out")
    assert (found["configuration"]["surface"], found["configuration"]["erode"]) == (
        "median",
        "0.5",
    )
    assert any(
        "the surface is the median height of each cell half a pixel wide" in note
        for note in found["notes"]
    )
    labels = np.asarray(laspy.read(tmp_path / "out/classified/village.laz").classification)
    assert np.array_equal(labels, ptd.classify(village()[0], kind="dim").classification)
    with rasterio.open(tmp_path / "out/dtm.tif") as raster:
        heights = raster.read(1, masked=True)
        rows, columns = np.indices(heights.shape)
        x, y = raster.transform @ (columns + 0.5, rows + 0.5)
    x, y = x - 500_000.0, y - 5_000_000.0
    error = heights - (0.1 * x + 3.0 / (1.0 + np.exp(-(y - 60.0) / 2.0)))
    assert np.sqrt((error**2).mean()) < 0.15


def test_the_classes_of_a_matched_cloud_can_be_kept(cloud: Path, tmp_path: Path) -> None:
    found = ran(
        cloud, tmp_path / "out", "--method", "keep", "--kind", "dim", "--ground-classes", 0
    )
    assert (found["state"], found["configuration"]["surface"]) == ("done", None)


@pytest.mark.slow
def test_what_the_user_says_of_the_surface_is_obeyed(cloud: Path, tmp_path: Path) -> None:
    found = ran(cloud, tmp_path / "out", "--surface", "all", "--erode", 0)
    assert (found["configuration"]["surface"], found["configuration"]["erode"]) == ("all", "0")
    assert not any("the surface is" in note for note in found["notes"])
    said = ran(cloud, tmp_path / "laser", "--kind", "als")
    assert said["configuration"]["surface"] is None
    assert any(
        "laser scanning (given by --kind or the preset)" in note for note in said["notes"]
    )
