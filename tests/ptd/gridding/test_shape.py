"""Slope and shading: true on planes to the last pixel, GDAL's inside, no seam, feet and metres."""

from __future__ import annotations

import shutil
import subprocess
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import rasterio

from ptd.gridding.shape import gradients, multidirectional_hillshade, slope_deg
from tests.tiler.grid.conftest import make_block
from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.products import PRODUCTS, Read
from tiler.core.raster import NODATA, RasterSpec
from tiler.core.units import FOOT, METRE, Units
from tiler.grid.derived import hillshade, slope
from tiler.store import StoreMeta, create_store

HOLE = np.nan


def padded(heights: np.ndarray) -> np.ndarray:
    return np.pad(heights, 1, constant_values=np.nan)


def plane(rows: int, columns: int, east: float, north: float) -> np.ndarray:
    row, col = np.mgrid[:rows, :columns].astype(np.float64)
    return 7 + east * col - north * row


def hills(rows: int, columns: int) -> np.ndarray:
    row, col = np.mgrid[:rows, :columns].astype(np.float64)
    heights = 100 + 9 * np.sin(row / 11) + 7 * np.cos(col / 13) + 0.1 * col
    heights[(row - 40) ** 2 + (col - 30) ** 2 < 64] = np.nan
    return heights


@pytest.mark.parametrize(
    ("east", "north"), [(0.0, 0.0), (0.5, 0.0), (0.0, -1.0), (-0.75, 0.25)]
)
@pytest.mark.parametrize("shape", ["full", "ragged", "corner", "hole"])
def test_a_plane_is_exact_to_its_last_pixel(east: float, north: float, shape: str) -> None:
    heights = plane(12, 17, east, north)
    row, col = np.mgrid[:12, :17]
    if shape == "ragged":
        heights[row + col < 9] = HOLE
    if shape == "corner":
        heights[(row > 5) & (col > 5)] = HOLE
    if shape == "hole":
        heights[5:7, 4:9] = HOLE
    e, n = gradients(padded(heights), 1.0)
    valid = ~np.isnan(heights)
    assert np.array_equal(np.isnan(e), ~valid)
    # A tip of which a direction has neither neighbour is level that way.
    known = padded(heights)
    left, right = ~np.isnan(known[1:-1, :-2]), ~np.isnan(known[1:-1, 2:])
    up, down = ~np.isnan(known[:-2, 1:-1]), ~np.isnan(known[2:, 1:-1])
    whole = valid & (left | right) & (up | down)
    assert whole.sum() > 0.95 * valid.sum()
    assert np.abs(e - east)[whole].max() < 1e-12
    assert np.abs(n - north)[whole].max() < 1e-12
    truth = np.degrees(np.arctan(np.hypot(east, north)))
    assert np.abs(slope_deg(e, n) - truth)[whole].max() < 1e-9


def test_a_line_of_single_pixels_is_level_across() -> None:
    heights = np.full((5, 9), HOLE)
    heights[2] = plane(1, 9, 0.5, 0.0)
    e, n = gradients(padded(heights), 1.0)
    assert np.allclose(e[2], 0.5)
    assert np.all(n[2] == 0)


def test_level_ground_and_the_sides_of_the_light() -> None:
    zero = np.zeros((1, 1))
    assert multidirectional_hillshade(zero, zero)[0, 0] == 181
    facing = multidirectional_hillshade(np.array([1.0, -1.0]), np.array([-1.0, 1.0]))
    assert facing[0] > 220  # falls to the northwest, where the suns are
    assert facing[1] < 60
    assert np.isnan(multidirectional_hillshade(np.array([np.nan]), zero[0])).all()


@pytest.mark.processes
@pytest.mark.parametrize("kind", ["hillshade", "slope"])
def test_gdal_says_the_same(kind: str, tmp_path: Path) -> None:
    gdaldem = shutil.which("gdaldem")
    if gdaldem is None:
        pytest.skip("no gdaldem here")
    heights = hills(90, 110)
    source, target = tmp_path / "dtm.tif", tmp_path / "out.tif"
    grid = {"transform": rasterio.Affine(2, 0, 500, 0, -2, 900), "crs": "EPSG:25832"}
    values = {"height": 90, "width": 110, "count": 1, "dtype": "float32", "nodata": NODATA}
    with rasterio.open(source, "w", driver="GTiff", **grid, **values) as raster:
        raster.write(np.where(np.isnan(heights), NODATA, heights).astype(np.float32), 1)
    options = ["-multidirectional"] if kind == "hillshade" else []
    subprocess.run(
        [gdaldem, kind, str(source), str(target), *options], check=True, capture_output=True
    )
    with rasterio.open(target) as raster:
        theirs = raster.read(1).astype(np.float64)
        theirs[theirs == raster.nodata] = np.nan
    e, n = gradients(padded(heights.astype(np.float32).astype(np.float64)), 2.0)
    ours = multidirectional_hillshade(e, n) if kind == "hillshade" else slope_deg(e, n)
    both = ~np.isnan(theirs)
    assert both.mean() > 0.9
    assert not np.isnan(ours[both]).any()
    assert np.abs(ours - theirs)[both].max() <= (1 if kind == "hillshade" else 1e-3)


@pytest.mark.parametrize("product", ["hillshade", "slope"])
def test_blocks_do_not_show_and_units_count(product: str, tmp_path: Path) -> None:
    heights = hills(600, 530)
    # The same slopes: heights in feet over metres, and in metres over feet.
    found = []
    cases = ((Units(), 1.0), (Units(METRE, FOOT), 1 / 0.3048), (Units(FOOT, METRE), 0.3048))
    for number, (units, scale) in enumerate(cases):
        meta = StoreMeta(
            CoordFrame(units), Lattice(Fraction(50_000)), Lattice(Fraction(500)), has_rgb=False
        )
        store = create_store(str(tmp_path / f"{number}.zarr"), meta)
        spec, fill = (
            RasterSpec(Lattice(Fraction(1000)), -100, 400, 600, 530),
            PRODUCTS[product].nodata,
        )
        store.create_raster("dtm", spec)
        store.create_raster(product, spec, fill)
        values = np.where(np.isnan(heights), NODATA, heights * scale).astype(np.float32)
        for b in spec.blocks(512):
            store.write_block(
                "dtm", b, values[b.row : b.row + b.height, b.col : b.col + b.width]
            )
        for b in spec.blocks(512):
            reads = {"terrain": Read("raster:dtm", 1), "place": Read("place")}
            work = hillshade if product == "hillshade" else slope
            make_block(store, product, work, reads, spec, b, fill)
        found += [store.read_block(product, b) for b in spec.blocks(1024)]
    e, n = gradients(padded(heights.astype(np.float32).astype(np.float64)), 1.0)
    truth = (multidirectional_hillshade if product == "hillshade" else slope_deg)(e, n).astype(
        np.float32
    )
    truth = np.where(np.isnan(truth), fill, truth).astype(np.float32)
    assert found[0].tobytes() == truth.tobytes()
    for other in found[1:]:
        assert np.abs(other - truth).max() <= (1 if product == "hillshade" else 1e-3)
