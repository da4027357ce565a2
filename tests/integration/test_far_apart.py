"""Points thousands of kilometres from one another: a run follows the points, not the emptiness between them."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import rasterio

from tests.invariants.runs import do


def write_points(path: Path, places: np.ndarray, classes: int = 2) -> Path:
    """A file of points, float64 (3, n), metres."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = np.array([*places[:2, 0], 0.0]), np.full(3, 0.01)
    las = laspy.LasData(header)
    las.x, las.y, las.z = places
    las.classification[:] = classes
    las.return_number[:] = 1
    las.number_of_returns[:] = 1
    path.parent.mkdir(parents=True, exist_ok=True)
    las.write(path)
    return path


def site(
    path: Path, west: float, south: float, side: float = 50.0, number: int = 3000, seed: int = 1
) -> Path:
    """A slope with one point a square metre or more."""
    random = np.random.default_rng(seed)
    x, y = random.random((2, number)) * side
    return write_points(path, np.round(np.stack([x + west, y + south, 100 + 0.1 * x + 0.05 * y]), 2))


def test_four_points_4000_km_apart(tmp_path: Path) -> None:
    """Their buckets' lattice has a thousand million cells."""
    corners = np.array([[0.0, 4e6, 0.0, 4e6], [0.0, 0.0, 4e6, 4e6], [1.0, 2.0, 3.0, 4.0]])
    path = write_points(tmp_path / "four.las", corners)
    result = do(path, tmp_path / "out", method="keep", crs="none", resolution=None, max_edge="20000")
    assert result.exit_code == 0
    assert any("no height at all" in note for note in result.summary["notes"])
    with rasterio.open(tmp_path / "out" / "dtm.tif") as raster:
        assert raster.shape == (201, 201)


def test_coarse_pixels_of_a_wide_extent(tmp_path: Path) -> None:
    """A block of 512 such pixels is wider than what one TIN can be exact for."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 80e3, 800.0), np.arange(0, 2400.0, 800.0)))
    path = write_points(tmp_path / "strip.las", np.stack([x, y, 100 + 0.001 * x]))
    do(path, tmp_path / "out", method="keep", crs="none", resolution="500", max_edge="2000")
    with rasterio.open(tmp_path / "out" / "dtm.tif") as raster:
        heights, (west, _, _, _) = raster.read(1), raster.bounds
    column = np.arange(heights.shape[1])
    filled = heights[2] != -9999
    assert filled.sum() > 0.99 * len(column)
    expected = 100 + 0.001 * (west + 500 * (column + 0.5))
    np.testing.assert_allclose(heights[2][filled], expected[filled], atol=0.005)
