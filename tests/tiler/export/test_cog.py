"""The COG: valid, complete, true to the store, and the same bytes each time."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
import zarr
from rio_cogeo import cog_validate

from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.raster import NODATA, RasterSpec
from tiler.core.units import FOOT, US_SURVEY_FOOT, Units
from tiler.errors import ProcessingError
from tiler.export.output_files import OutFile, ProductInfo, RasterFileRecord, RasterPart
from tiler.export.rasters import Statistics, write_cog
from tiler.store import StoreMeta, TileStore, create_store

TAGS = {
    "TILER_VERSION": "0.1.0",
    "TILER_METHOD": "classic",
    "TILER_PARAMETERS": json.dumps({"angle_deg": 6.0}),
    "TILER_INPUTS": "0123456789abcdef",
}
PROJ_UUID = "f17cb550-5864-4468-aeb7-f3180cfb622f"
"""Identifier of the Zarr convention ``proj``."""
SPEC = RasterSpec(Lattice(Fraction(1000)), west=637_000, north=852_000, height=1300, width=1100)


def hills(spec: RasterSpec) -> np.ndarray:
    """Smooth heights with a hole and an empty corner."""
    row, col = np.mgrid[: spec.height, : spec.width]
    heights = (100 + 20 * np.sin(row / 90) + 0.05 * col).astype(np.float32)
    heights[(row - 400) ** 2 + (col - 300) ** 2 < 90**2] = NODATA
    heights[700:, 900:] = NODATA
    return heights


def filled_store(
    folder: Path, spec: RasterSpec, heights: np.ndarray, frame: CoordFrame
) -> TileStore:
    meta = StoreMeta(frame, Lattice(Fraction(50_000)), Lattice(Fraction(500)), has_rgb=False)
    store = create_store(str(folder / "store.zarr"), meta)
    store.create_raster("dtm", spec)
    for b in spec.blocks(512):
        store.write_block("dtm", b, heights[b.row : b.row + b.height, b.col : b.col + b.width])
    return store


def export(
    folder: Path,
    store: TileStore,
    spec: RasterSpec,
    compress: str = "deflate",
    product: str = "dtm",
    nodata: float | None = None,
) -> RasterFileRecord:
    to, info = OutFile(str(folder), "dtm.tif"), ProductInfo(product, TAGS, nodata)
    part = RasterPart(raster="dtm", spec=spec, fill=NODATA)
    return write_cog(store, to=to, info=info, part=part, compress=compress)


def frame_of(code: str | None, units: Units | None = None) -> CoordFrame:
    return CoordFrame(
        units or Units(), (0, 0), None if code is None else pyproj.CRS(code).to_wkt()
    )


@pytest.fixture
def store(tmp_path: Path) -> TileStore:
    return filled_store(tmp_path, SPEC, hills(SPEC), frame_of("EPSG:25832"))


@pytest.mark.parametrize("code", ["EPSG:25832", "EPSG:25832+5783", "EPSG:4979", None])
def test_the_raster_of_the_store_gives_the_position_of_the_file(
    tmp_path: Path, code: str | None
) -> None:
    store = filled_store(tmp_path, SPEC, hills(SPEC), frame_of(code))
    export(tmp_path, store, SPEC)
    array = zarr.open_array(tmp_path / "store.zarr" / "rasters" / "dtm", mode="r")
    attributes = array.attrs.asdict()
    declared = {entry["uuid"] for entry in attributes["zarr_conventions"]}
    with rasterio.open(tmp_path / "dtm.tif") as cog:
        assert attributes["spatial:transform"] == list(cog.transform[:6])
        assert attributes["spatial:bbox"] == list(cog.bounds)
        assert attributes["spatial:shape"] == list(cog.shape) == list(array.shape)
        assert attributes["spatial:dimensions"] == list(array.metadata.dimension_names)
        assert array.fill_value == cog.nodata
        assert ("proj:wkt2" in attributes) == (PROJ_UUID in declared) == (cog.crs is not None)
        if cog.crs is not None:
            assert rasterio.CRS.from_wkt(attributes["proj:wkt2"]) == cog.crs


@pytest.mark.parametrize("compress", ["deflate", "zstd"])
def test_it_is_a_valid_cog_with_everything_in_it(tmp_path, store, compress):
    record = export(tmp_path, store, SPEC, compress)
    path = tmp_path / "dtm.tif"
    valid, errors, warnings = cog_validate(path, strict=True)
    assert (valid, errors, warnings) == (True, [], [])
    heights = hills(SPEC)
    good = heights != np.float32(NODATA)
    with rasterio.open(path) as cog:
        assert np.array_equal(cog.read(1), heights)
        assert cog.dtypes == ("float32",)
        assert cog.nodata == NODATA
        assert cog.crs.to_epsg() == 25832
        assert cog.transform[:6] == (1, 0, 637_000, 0, -1, 852_000)
        assert cog.block_shapes == [(512, 512)]
        assert cog.overviews(1) == [2, 4]
        assert cog.units == ("metre",)
        assert cog.descriptions == ("terrain height",)
        tags, band, structure = cog.tags(), cog.tags(1), cog.tags(ns="IMAGE_STRUCTURE")
    assert tags.items() >= TAGS.items()
    assert tags["AREA_OR_POINT"] == "Area"
    assert set(tags) == {*TAGS, "AREA_OR_POINT"}
    assert structure["COMPRESSION"] == compress.upper()
    assert structure["PREDICTOR"] == "3"
    truth = heights[good].astype(np.float64)
    for name, value in (
        ("MINIMUM", truth.min()),
        ("MAXIMUM", truth.max()),
        ("MEAN", truth.mean()),
        ("STDDEV", truth.std()),
    ):
        assert float(band[f"STATISTICS_{name}"]) == pytest.approx(value, rel=1e-12)
    assert float(band["STATISTICS_VALID_PERCENT"]) == pytest.approx(100 * good.mean(), rel=1e-3)
    assert (record.pixels, record.valid) == (heights.size, int(good.sum()))
    assert record.bytes == path.stat().st_size
    assert [p.name for p in tmp_path.iterdir() if p.is_file()] == ["dtm.tif"]


def test_overviews_average_valid_pixels_only(tmp_path, store):
    export(tmp_path, store, SPEC)
    with rasterio.open(tmp_path / "dtm.tif", OVERVIEW_LEVEL=0) as cog:
        overview = cog.read(1)
    blocks = hills(SPEC).reshape(SPEC.height // 2, 2, SPEC.width // 2, 2).astype(np.float64)
    blocks[blocks == NODATA] = np.nan
    full = ~np.isnan(blocks).any(axis=(1, 3))
    assert np.abs(overview - blocks.mean(axis=(1, 3)))[full].max() < 1e-4
    assert overview[overview != NODATA].min() > 70


def test_the_same_content_is_the_same_bytes(tmp_path, store):
    one = export(tmp_path, store, SPEC)
    first = (tmp_path / "dtm.tif").read_bytes()
    other = tmp_path / "elsewhere"
    other.mkdir()
    (other / ".tiler-dtm.tif.cog.partial").write_bytes(b"left by a killed run")
    two = export(other, filled_store(other, SPEC, hills(SPEC), frame_of("EPSG:25832")), SPEC)
    assert (other / "dtm.tif").read_bytes() == first
    assert replace(one, state=None) == replace(two, state=None)  # of which the time is a part
    assert [p.name for p in other.iterdir() if p.is_file()] == ["dtm.tif"]


@pytest.mark.parametrize(
    ("code", "units", "label"),
    [
        ("EPSG:2992", Units(FOOT, FOOT), "foot"),
        ("EPSG:6339+5703", Units(), "metre"),
        ("EPSG:2263+6360", Units(US_SURVEY_FOOT, US_SURVEY_FOOT), "US survey foot"),
        ("EPSG:2056+5728", Units(), "metre"),
        (None, Units(), "metre"),
    ],
)
def test_the_crs_and_the_vertical_unit_are_kept(tmp_path, code, units, label):
    spec = RasterSpec(Lattice(Fraction(1000, 3)), west=-4, north=9, height=21, width=33)
    store = filled_store(
        tmp_path, spec, np.full((21, 33), 7, np.float32), frame_of(code, units)
    )
    export(tmp_path, store, spec)
    with rasterio.open(tmp_path / "dtm.tif") as cog:
        assert cog.units == (label,)
        if code is None:
            assert cog.crs is None
        else:
            kept, true = pyproj.CRS(cog.crs.to_wkt()), pyproj.CRS(code)
            assert kept.is_compound == true.is_compound
            assert kept.equals(true, ignore_axis_order=True) or kept.name == true.name
        assert cog.transform.a == pytest.approx(1 / 3)


def test_a_raster_without_a_height_is_written(tmp_path):
    spec = RasterSpec(Lattice(Fraction(1000)), 0, 0, 600, 520)
    empty = np.full((600, 520), NODATA, np.float32)
    record = export(tmp_path, filled_store(tmp_path, spec, empty, frame_of("EPSG:25832")), spec)
    assert (record.valid, record.min) == (0, None)
    with rasterio.open(tmp_path / "dtm.tif") as cog:
        assert np.all(cog.read(1) == NODATA)
        # what GDAL takes for "no georeference" elsewhere
        assert cog.transform[:6] == (1, 0, 0, 0, -1, 0)


@pytest.mark.processes
def test_the_distribution_s_gdal_reads_it(tmp_path, store):
    gdalinfo = shutil.which("gdalinfo")
    if gdalinfo is None:
        pytest.skip("no gdalinfo here")
    export(tmp_path, store, SPEC)
    info = json.loads(subprocess.check_output([gdalinfo, "-json", str(tmp_path / "dtm.tif")]))
    assert info["size"] == [1100, 1300]
    assert info["metadata"]["IMAGE_STRUCTURE"]["LAYOUT"] == "COG"
    assert info["bands"][0]["noDataValue"] == NODATA
    assert info["bands"][0]["unit"] == "metre"


def test_a_folder_that_is_not_there_is_one_line(tmp_path, store):
    with pytest.raises(
        ProcessingError,
        match=r"cannot be written .*check free space and permissions, then run again$",
    ):
        export(tmp_path / "missing", store, SPEC)


def test_statistics_merge():
    heights = np.random.default_rng(1).normal(1000, 3, (4, 50)).astype(np.float32)
    merged = Statistics()
    for part in heights:
        merged = merged.merged(part)
    assert merged.n == 200
    assert merged.mean == pytest.approx(heights.mean(dtype=np.float64), rel=1e-13)
    assert merged.squares / 200 == pytest.approx(heights.astype(np.float64).var(), rel=1e-12)
    assert Statistics().merged(np.full(3, NODATA, np.float32)).tags(3) == {
        "STATISTICS_VALID_PERCENT": "0"
    }


@pytest.mark.parametrize("product", ["dtm", "slope"])
def test_the_file_has_the_nodata_value_that_was_asked_for(product, tmp_path, store):
    usual = export(tmp_path, store, SPEC)
    with rasterio.open(tmp_path / "dtm.tif") as raster:
        expected = raster.read(1, masked=True)
        coarse = raster.read(1, masked=True, out_shape=(SPEC.height // 2, SPEC.width // 2))
    other = export(tmp_path, store, SPEC, product=product, nodata=-999999.0)
    with rasterio.open(tmp_path / "dtm.tif") as raster:
        assert raster.nodata == -999999.0
        found = raster.read(1, masked=True)
        overview = raster.read(1, masked=True, out_shape=(SPEC.height // 2, SPEC.width // 2))
        assert NODATA not in raster.read(1)
    np.testing.assert_array_equal(found.mask, expected.mask)
    np.testing.assert_array_equal(found.compressed(), expected.compressed())
    np.testing.assert_array_equal(overview.compressed(), coarse.compressed())
    assert all(
        getattr(usual, name) == getattr(other, name) for name in ("valid", "min", "max", "mean")
    )
    assert cog_validate(tmp_path / "dtm.tif", strict=True) == (True, [], [])
