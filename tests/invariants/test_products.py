"""The products of a run: on the DTM's grid, the same bytes for any tiling and workers, made again only where needed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rio_cogeo import cog_validate

from tests.invariants import clouds
from tests.invariants.clouds import Cloud
from tests.invariants.runs import all_digests, computed, do
from tests.scenes.small_stores import USUAL_ROW_POINTS, small_stores
from tests.tiler.report import results
from tiler.core.products import FILLED, HOLE, INTERPOLATED, MEASURED, NODATA, PRODUCTS
from tiler.errors import ConfigError

ALL = ",".join(PRODUCTS)
RESOLUTION = "0.3"  # four blocks


@pytest.fixture(scope="module")
def made(quarter_files: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """OUT of a run with all products. Not to be changed."""
    out = tmp_path_factory.mktemp("products") / "out"
    with pytest.MonkeyPatch.context() as patch:
        small_stores(patch)
        do(quarter_files, out, products=ALL, resolution=RESOLUTION)
    return out


def values(out: Path, name: str) -> np.ndarray:
    """Pixels, NaN where there is no value."""
    with rasterio.open(out / f"{name}.tif") as raster:
        pixels = raster.read(1).astype(np.float64)
        if raster.nodata is not None:
            pixels[pixels == raster.nodata] = np.nan
    return pixels


@pytest.mark.parametrize("name", PRODUCTS)
def test_each_is_a_cog_on_the_grid_of_the_dtm(name: str, made: Path) -> None:
    product = PRODUCTS[name]
    assert cog_validate(made / f"{name}.tif", strict=True) == (True, [], [])
    with rasterio.open(made / "dtm.tif") as dtm, rasterio.open(made / f"{name}.tif") as raster:
        assert (raster.shape, raster.transform, raster.crs) == (
            dtm.shape,
            dtm.transform,
            dtm.crs,
        )
        assert raster.dtypes == (product.dtype,)
        assert raster.nodata == product.nodata
        assert raster.descriptions == (product.description,)
        assert raster.overviews(1)
        assert raster.tags()["TILER_METHOD"] == "classic"


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_other_tiles_and_workers_give_the_same_bytes(
    workers: int,
    made: Path,
    quarter_files: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if workers > 1:
        small_stores(monkeypatch, row_points=USUAL_ROW_POINTS)
    changes = {"products": ALL, "resolution": RESOLUTION, "tile_size": "96", "workers": workers}
    do(quarter_files[::-1], tmp_path / "out", **changes)
    assert all_digests(tmp_path / "out") == all_digests(made)
    assert {path.stem for path in made.glob("*.tif")} == set(PRODUCTS)


def test_what_is_done_is_not_done_again(quarter_files: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(quarter_files, out, resolution=RESOLUTION)
    more = do(quarter_files, out, products="dtm,slope", resolution=RESOLUTION)
    assert {k: n for k, n in computed(more).items() if n} == {
        "grid-slope": 4,
        "export": 1,
        "catalogue": 1,
    }
    again = do(quarter_files, out, products="slope,dtm", resolution=RESOLUTION)
    assert again.did_nothing
    other = do(quarter_files, out, products="dtm,slope", resolution=RESOLUTION, max_edge="3")
    assert {"grid-dtm", "grid-slope"} <= {k for k, n in computed(other).items() if n}


def test_density_counts_the_ground(made: Path) -> None:
    ground = json.loads((made / "run.json").read_text())["filter"]["ground"]
    assert values(made, "density").sum() * 0.3**2 == pytest.approx(ground, rel=1e-6)


def test_slope_and_shade_are_where_the_terrain_is(made: Path) -> None:
    terrain = ~np.isnan(values(made, "dtm"))
    for name in ("slope", "hillshade"):
        assert np.array_equal(~np.isnan(values(made, name)), terrain)


def test_the_mask_says_where_heights_come_from(made: Path) -> None:
    mask, terrain = values(made, "mask"), ~np.isnan(values(made, "dtm"))
    assert np.array_equal(np.isin(mask, (MEASURED, INTERPOLATED)), terrain)
    assert np.array_equal(mask == MEASURED, terrain & (values(made, "density") > 0))
    with rasterio.open(made / "mask.tif") as raster:
        assert raster.colormap(1)[HOLE][:3] == PRODUCTS["mask"].colours[HOLE]
        assert raster.tags(1)[f"VALUE_{HOLE}"].startswith("hole")


def test_holes_are_left_filled_or_marked(tmp_path: Path, city: Cloud) -> None:
    cloud = clouds.write(tmp_path / "void.laz", clouds.void(city))
    how = {"max_edge": "20", "products": "dtm,slope", "method": "keep", "ground_classes": "1"}
    for voids in ("leave", "fill", "mark"):
        do(cloud, tmp_path / voids, voids=voids, **how)
    left, filled = values(tmp_path / "leave", "dtm"), values(tmp_path / "fill", "dtm")
    assert {f.stem for f in (tmp_path / "mark").glob("*.tif")} == {"dtm", "slope", "mask"}
    assert np.array_equal(filled, values(tmp_path / "mark", "dtm"), equal_nan=True)
    mask = values(tmp_path / "mark", "mask")
    lake = np.zeros(left.shape, bool)
    lake[60:110, 60:110] = True
    assert np.isnan(left[lake]).all()
    assert not np.isnan(filled[lake]).any()
    assert (mask[lake] == FILLED).all()
    assert np.array_equal(left[~np.isnan(left)], filled[~np.isnan(left)])
    assert not np.isnan(values(tmp_path / "fill", "slope")[lake]).any()


def test_sheets_are_the_raster_cut(
    made: Path, quarter_files: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    names = ("dtm", "distance", "mask")
    options = {"products": ",".join(names), "resolution": RESOLUTION, "sheets": "90"}
    do(quarter_files, out, **options)
    assert not list(out.glob("*.tif"))
    for name in names:
        with (
            rasterio.open(out / f"{name}.vrt") as mosaic,
            rasterio.open(made / f"{name}.tif") as whole,
        ):
            assert (mosaic.crs, mosaic.nodata, mosaic.dtypes) == (
                whole.crs,
                whole.nodata,
                whole.dtypes,
            )
            assert (mosaic.descriptions, mosaic.units) == (whole.descriptions, whole.units)
            left, top = (
                whole.transform.c - mosaic.transform.c,
                mosaic.transform.f - whole.transform.f,
            )
            col, row = round(left / 0.3), round(top / 0.3)
            part = mosaic.read(1)[row : row + whole.height, col : col + whole.width]
            assert np.array_equal(part, whole.read(1))
            if name == "mask":
                assert mosaic.colormap(1)[HOLE][:3] == PRODUCTS["mask"].colours[HOLE]
        sheets = sorted((out / name).glob("*.tif"))
        assert len(sheets) == 9  # 192 m from (500000, 5400000), which is no multiple of 90
        for path in sheets[:2]:
            assert cog_validate(path, strict=True) == (True, [], [])
            with rasterio.open(path) as sheet:
                assert sheet.shape == (300, 300)
                assert path.stem == f"{name}_{sheet.bounds.left:.0f}_{sheet.bounds.bottom:.0f}"
    assert do(quarter_files, out, **options).did_nothing
    shown = results.read(out / "report.html").data["pictures"]
    assert [picture["name"] for picture in shown] == ["hillshade", "dtm", "mask"]
    (out / "dtm" / sheets[0].name.replace("mask", "dtm")).unlink()
    assert computed(do(quarter_files, out, **options))["export"] == 1


def test_sheets_of_parts_of_pixels_are_refused(
    quarter_files: list[Path], tmp_path: Path
) -> None:
    line = r"--sheets 10 m is not a whole number of pixels of 3 m; use --sheets 9 or"
    with pytest.raises(ConfigError, match=line):
        do(quarter_files, tmp_path, resolution="3", sheets="10")


def test_the_nodata_value_is_that_of_files_and_sheets(
    quarter_files: list[Path], tmp_path: Path
) -> None:
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    options = {"resolution": "1", "products": "dtm,hillshade", "max_edge": "3"}
    do(quarter_files, whole, **options)
    usual = values(whole, "dtm")
    again = do(quarter_files, whole, nodata=-999999, **options)
    assert {k for k, n in computed(again).items() if n} == {"export", "catalogue"}
    assert computed(again)["export"] == 1  # the hillshade is of greys
    do(quarter_files, cut, nodata=-999999, sheets="90", **options)
    with rasterio.open(whole / "dtm.tif") as raster, rasterio.open(cut / "dtm.vrt") as mosaic:
        assert raster.nodata == mosaic.nodata == -999999
        assert np.isnan(usual).any()
        assert NODATA not in raster.read(1)
        assert NODATA not in mosaic.read(1)
    assert np.array_equal(values(whole, "dtm"), usual, equal_nan=True)
    with rasterio.open(cut / "hillshade.vrt") as shade:
        assert shade.nodata == 0
