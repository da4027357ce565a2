"""The producer's ground, gridded: the producer's own DTM."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from cli.main import main

NODATA = -9999.0


@pytest.fixture(scope="module")
def tiles(shared_data: Path) -> Path:
    folder = shared_data / "ign" / "tiles50m"
    if not folder.is_dir():
        pytest.skip("no tiles with a DTM: ../shared/data/ign/tiles50m is absent")
    return folder


@pytest.fixture(scope="module")
def terrain(tiles: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("ign") / "out"
    arguments = "--method keep --ground-classes 2 --resolution 0.5 --in-process -q"
    assert main(["run", str(tiles), "-o", str(out), *arguments.split()]) == 0
    return out / "dtm.tif"


def pairs(
    terrain: Path, tiles: Path, east: float, north: float
) -> tuple[np.ndarray, np.ndarray]:
    """Heights of both at the producer's pixel centres, ours looked up (east, north) metres away."""
    ours, theirs = [], []
    with rasterio.open(terrain) as mine:
        heights, ours_at = mine.read(1), mine.transform
    for path in sorted(tiles.glob("*.tif")):
        with rasterio.open(path) as raster:
            truth = raster.read(1)
            rows, cols = np.nonzero(truth != raster.nodata)
            at, truth = raster.transform, truth[rows, cols]
        x, y = at.c + (cols + 0.5) * at.a + east, at.f + (rows + 0.5) * at.e + north
        col, row = (x - ours_at.c) / ours_at.a - 0.5, (y - ours_at.f) / ours_at.e - 0.5
        c0, r0 = np.floor(col + 1e-6).astype(int), np.floor(row + 1e-6).astype(int)
        keep = (c0 >= 0) & (r0 >= 0) & (c0 + 1 < heights.shape[1]) & (r0 + 1 < heights.shape[0])
        c0, r0, u, v = c0[keep], r0[keep], (col[keep] - c0[keep]), (row[keep] - r0[keep])
        corners = np.stack([heights[r0 + i, c0 + j] for i in (0, 1) for j in (0, 1)])
        weights = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
        known = (corners != NODATA).all(axis=0)
        ours.append((corners * weights).sum(axis=0)[known])
        theirs.append(truth[keep][known])
    return np.concatenate(ours), np.concatenate(theirs)


def rmse(terrain: Path, tiles: Path, east: float = 0.0, north: float = 0.0) -> float:
    ours, theirs = pairs(terrain, tiles, east, north)
    assert len(ours) > 50_000
    return float(np.sqrt(np.mean((ours - theirs.astype(np.float64)) ** 2)))


def test_it_is_the_producers_dtm(terrain: Path, tiles: Path) -> None:
    assert rmse(terrain, tiles) <= 0.05


@pytest.mark.parametrize(
    "shift", [(-0.25, 0.0), (0.0, 0.25), (0.25, 0.25), (-0.25, -0.25), (-0.25, 0.25)]
)
def test_it_does_not_fit_better_half_a_pixel_away(
    shift: tuple[float, float], terrain: Path, tiles: Path
) -> None:
    """Not to the east or south: the producer took its heights at the south-east corners of its pixels.

    There a TIN of its ground points gives them exactly (median difference 0), at the centres it
    does not.
    """
    assert rmse(terrain, tiles, *shift) > rmse(terrain, tiles)
