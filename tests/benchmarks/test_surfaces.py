"""Surface models for other programs, and their errors."""

from __future__ import annotations

import shutil
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from affine import Affine

from tests.benchmarks import surfaces


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene of 2 x 3 pixels of 0.5 m whose true terrain is level at 10 m."""
    folder = tmp_path / "dim/semireal"
    folder.mkdir(parents=True)
    with rasterio.open(
        folder / "rows_dtm.tif", "w", driver="GTiff", height=2, width=3, count=1, dtype="float32",
        transform=Affine(0.5, 0, 0, 0, -0.5, 1.0),
    ) as raster:  # fmt: skip
        raster.write(np.full((2, 3), 10.0, np.float32), 1)
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales = np.full(3, 0.001)
    las.xyz = np.array(
        [(0.1, 0.9, 10), (0.2, 0.8, 14), (0.7, 0.9, 11), (0.1, 0.1, 9), (0.7, 0.2, 12)]
    )
    las.write(folder / "rows.laz")
    monkeypatch.setattr(surfaces, "DATA", tmp_path)
    return folder


def test_a_surface_has_the_highest_point_and_no_gap(scene: Path, tmp_path: Path) -> None:
    target = tmp_path / "surface.tif"
    surfaces.surface_of(scene / "rows.laz", scene / "rows_dtm.tif", target)
    with rasterio.open(target) as raster:
        values = raster.read(1)
    assert values.tolist() == [[14, 11, 11], [9, 12, 12]]


def test_the_error_is_that_of_the_terrain(scene: Path) -> None:
    def unchanged(surface: Path, folder: Path) -> Path:
        return Path(shutil.copy(surface, folder / "terrain.tif"))

    (row,) = surfaces.rows_of(["rows"], {"unchanged": unchanged})
    error = np.sqrt(np.mean(np.array([4, 1, 1, -1, 2, 2]) ** 2))
    assert row == ["unchanged", f"{error:.2f} m", f"{error:.2f} m"]
