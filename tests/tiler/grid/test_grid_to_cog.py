"""Store -> grid -> COG: a tilted plane is exact to a millimetre at the pixel centres of the file."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pyproj
import pytest
import rasterio

from tiler.core.lattice import CoordFrame
from tiler.core.raster import NODATA
from tiler.core.units import FOOT, METRE, Units
from tiler.export.output_files import OutFile, ProductInfo, RasterPart
from tiler.export.rasters import write_cog

SIDE = 600_000


@pytest.mark.parametrize(
    ("code", "unit", "origin", "size"),
    [
        ("EPSG:25832", METRE, (500_000_000, 5_400_000_000), Fraction(1000)),
        ("EPSG:25832", METRE, (499_123_457, 5_399_000_003), Fraction(500)),
        ("EPSG:2992", FOOT, (637_000_000, 851_000_000), Fraction(3000)),
    ],
    ids=["metres", "another-origin", "feet"],
)
def test_a_plane_in_the_file(make_scene, tmp_path, code, unit, origin, size):
    low = np.array(
        [500_000_000, 5_400_000_000] if unit == METRE else [637_000_000, 851_000_000]
    )
    xy = 8 * np.random.default_rng(2).integers(0, SIDE // 8, (30_000, 2))
    xyz = np.column_stack((xy + low, 50_000 + xy[:, 0] // 4 - xy[:, 1] // 8)).astype(np.int64)
    frame = CoordFrame(Units(unit, unit), origin, pyproj.CRS(code).to_wkt())
    scene = make_scene(xyz, frame=frame, bucket=100_000)
    files = []
    for name, halo in (("a", 2_000), ("b", 100_000)):
        spec = scene.grid_into_store(name, size, halo=halo)
        out = tmp_path / name
        out.mkdir()
        write_cog(
            scene.store,
            to=OutFile(str(out), f"{name}.tif"),
            info=ProductInfo("dtm", {"TILER_METHOD": "keep"}),
            part=RasterPart(raster=name, spec=spec, fill=NODATA),
            compress="deflate",
        )
        files.append(out / f"{name}.tif")
    assert files[0].read_bytes() == files[1].read_bytes()
    with rasterio.open(files[0]) as cog:
        heights = cog.read(1)
        rows, cols = np.indices(heights.shape)
        x, y = rasterio.transform.xy(cog.transform, rows.ravel(), cols.ravel())
        assert cog.units == ("metre" if unit == METRE else "foot",)
    truth = 50 + (np.asarray(x) - low[0] / 1000) / 4 - (np.asarray(y) - low[1] / 1000) / 8
    valid = heights.ravel() != np.float32(NODATA)
    assert valid.mean() > 0.97
    assert np.abs(heights.ravel() - truth)[valid].max() < 0.001
