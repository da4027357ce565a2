"""Points that settings leave out of the filter and of the rasters: --returns, --scan-angle and the like."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import rasterio

import tiler

HIGH_M = 30.0
"""Height above the plane of the points that each setting leaves out."""

CASES: dict[str, dict[str, Any]] = {
    "returns": {"returns": "last"},
    "scan_angle": {"scan_angle": 20},
    "source_id": {"source_id": "1-9"},
    "drop_classes": {"drop_classes": [64]},
}


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    """A plane at 100 m of 80 x 80 m, and above it points that stand for what each setting leaves out."""
    side = np.arange(0.25, 80, 0.5)
    x, y = (axis.ravel() for axis in np.meshgrid(side, side))
    n = x.size
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([500_000.0, 5_400_000.0, 0.0])
    points = laspy.ScaleAwarePointRecord.zeros(2 * n, header=header)
    points["x"], points["y"] = np.tile(500_000 + x, 2), np.tile(5_400_000 + y, 2)
    points["z"] = np.repeat([100.0, 100.0 + HIGH_M], n)
    points["return_number"], points["number_of_returns"] = (
        np.repeat([2, 1], n),
        np.full(2 * n, 2),
    )
    points["scan_angle"] = np.repeat([1000, -4000], n)
    points["point_source_id"] = np.repeat([5, 77], n)
    points["classification"] = np.repeat([1, 64], n)
    points["withheld"] = np.repeat([0, 1], n)
    found = laspy.LasData(header)
    found.points = points
    path = tmp_path / "cloud.las"
    found.write(path)
    return path


@pytest.mark.parametrize("name", CASES)
def test_what_is_left_out_is_in_no_raster_but_in_the_clouds(
    cloud: Path, tmp_path: Path, name: str
) -> None:
    out = tmp_path / "out"
    settings = {
        "products": ["dtm", "dsm"],
        "crs": "EPSG:25832",
        "withheld": "keep",
        "classified": "las",
    }
    tiler.run([str(cloud)], out, {**settings, **CASES[name], "in_process": True, "kind": "als"})
    for product in ("dtm", "dsm"):
        with rasterio.open(out / f"{product}.tif") as raster:
            heights = raster.read(1, masked=True)
        assert heights.count() > 6000
        assert np.allclose(heights.compressed(), 100.0, atol=0.01)
    (written,) = (out / "classified").glob("*.las")
    before, after = laspy.read(cloud), laspy.read(written)
    np.testing.assert_array_equal(before.z, after.z)
    high = before.z > 110
    np.testing.assert_array_equal(after.classification[high], before.classification[high])
    assert (after.classification[~high] == 2).all()
    counts = json.loads((out / "run.json").read_text())["counts"]
    assert counts["unselected"] == {name: int(high.sum())}


def test_withheld_points_are_seen_if_they_are_kept(cloud: Path, tmp_path: Path) -> None:
    heights = {}
    for withheld in ("drop", "keep"):
        out = tmp_path / withheld
        settings = {"products": ["dsm"], "crs": "EPSG:25832", "in_process": True, "kind": "als"}
        result = tiler.run([str(cloud)], out, {**settings, "withheld": withheld})
        counts = result.summary["counts"]
        assert counts.get("unselected", {}) == (
            {"withheld": 25_600} if withheld == "drop" else {}
        )
        with rasterio.open(out / "dsm.tif") as raster:
            heights[withheld] = float(np.ma.median(raster.read(1, masked=True)))
    assert heights["drop"] == pytest.approx(100.0, abs=0.01)
    assert heights["keep"] == pytest.approx(100.0 + HIGH_M, abs=0.01)
