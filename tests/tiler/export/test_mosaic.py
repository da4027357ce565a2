"""A VRT lies where its sheets lie, by GDAL's own reading of it, whichever axis of the CRS comes first."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
import rasterio.shutil

from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.raster import RasterSpec
from tiler.core.units import Units
from tiler.export.output_files import OutFile, ProductInfo, RasterPart
from tiler.export.rasters import write_cog, write_mosaic
from tiler.store import StoreMeta, create_store

SIDE = 64
CORNERS = {
    2193: (1_576_000, 5_180_000),  # north first: New Zealand, Sweden, Poland
    3006: (674_000, 6_580_000),
    2180: (637_000, 487_000),
    25832: (691_000, 5_334_000),  # east first
}


def exported(folder: Path, epsg: int) -> RasterSpec:
    """Two sheets side by side, and a VRT over them."""
    west, north = CORNERS[epsg]
    spec = RasterSpec(Lattice(Fraction(1000)), west, north, SIDE, 2 * SIDE)
    frame = CoordFrame(Units(), (0, 0), pyproj.CRS(epsg).to_wkt())
    meta = StoreMeta(frame, Lattice(Fraction(50_000)), Lattice(Fraction(500)), False)
    store = create_store(str(folder / "store.zarr"), meta)
    store.create_raster("dtm", spec)
    (block,) = spec.blocks(512)
    store.write_block(
        "dtm", block, np.arange(SIDE * 2 * SIDE, dtype=np.float32).reshape(SIDE, -1)
    )
    sheets = [
        (f"{i}", RasterSpec(spec.lattice, west + i * SIDE, north, SIDE, SIDE)) for i in range(2)
    ]
    info = ProductInfo("dtm", {})
    for name, sheet in sheets:
        part = RasterPart(raster="dtm", spec=sheet, fill=-9999.0, whole=spec)
        to = OutFile(str(folder), f"{name}.tif")
        write_cog(store, to=to, info=info, part=part, compress="deflate")
    files = tuple((f"{name}.tif", sheet) for name, sheet in sheets)
    write_mosaic(store, to=OutFile(str(folder), "dtm.vrt"), info=info, sheets=files)
    return spec


def lon_lat(path: Path) -> tuple[float, float]:
    """Of the north-west corner of a raster, as GDAL finds it when it warps what the file says.

    rasterio's own functions look at the CRS alone; GDAL's driver of COGs looks at the order of
    the axes as well.
    """
    warped = path.with_name(f"{path.name}.warped.tif")
    rasterio.shutil.copy(
        path, warped, driver="COG", TILING_SCHEME="GoogleMapsCompatible", ADD_ALPHA="NO"
    )
    with rasterio.open(warped) as raster:
        row, col = (int(i[0]) for i in np.nonzero(raster.read(1) != raster.nodata))
        x, y = rasterio.transform.xy(raster.transform, row, col, offset="ul")
    return pyproj.Transformer.from_crs(3857, 4326, always_xy=True).transform(x, y)


@pytest.mark.parametrize("epsg", CORNERS)
def test_a_mosaic_lies_where_its_sheets_lie(epsg: int, tmp_path: Path) -> None:
    spec = exported(tmp_path, epsg)
    true = pyproj.Transformer.from_crs(epsg, 4326, always_xy=True).transform(
        spec.west, spec.north
    )
    assert lon_lat(tmp_path / "dtm.vrt") == pytest.approx(true, abs=2e-4)
    assert lon_lat(tmp_path / "0.tif") == pytest.approx(true, abs=2e-4)
    with (
        rasterio.open(tmp_path / "dtm.vrt") as mosaic,
        rasterio.open(tmp_path / "0.tif") as sheet,
    ):
        assert mosaic.crs == sheet.crs
        assert mosaic.transform == sheet.transform
        assert np.array_equal(mosaic.read(1)[:, :SIDE], sheet.read(1))


@pytest.mark.parametrize("epsg", CORNERS)
def test_it_says_what_gdal_says_of_a_sheet(epsg: int, tmp_path: Path) -> None:
    exported(tmp_path, epsg)
    rasterio.shutil.copy(tmp_path / "0.tif", tmp_path / "gdal.vrt", driver="VRT")
    ours, theirs = ((tmp_path / name).read_text() for name in ("dtm.vrt", "gdal.vrt"))
    assert ours.count("<SRS ") == 1
    start, end = theirs.index("<SRS "), theirs.index("</SRS>")
    assert theirs[start:end] in ours
