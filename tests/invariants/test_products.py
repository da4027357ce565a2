"""The products of a run: on the DTM's grid, the same bytes for any tiling and workers, made again only where needed."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rio_cogeo import cog_validate

from tests.invariants.runs import computed, do
from tiler.core.products import PRODUCTS

ALL = ",".join(PRODUCTS)
RESOLUTION = "0.3"  # four blocks


def digests(out: Path) -> dict[str, str]:
    return {f.name: hashlib.blake2b(f.read_bytes()).hexdigest() for f in sorted(out.glob("*.tif"))}


@pytest.fixture(scope="module")
def made(quarter_files: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """OUT of a run with all products. Not to be changed."""
    out = tmp_path_factory.mktemp("products") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tiler.plan.BUCKET_POINTS", 1000)
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
        assert (raster.shape, raster.transform, raster.crs) == (dtm.shape, dtm.transform, dtm.crs)
        assert raster.dtypes == (product.dtype,)
        assert raster.nodata == product.nodata
        assert raster.descriptions == (product.description,)
        assert raster.overviews(1)
        assert raster.tags()["TILER_METHOD"] == "classic"


def test_other_tiles_and_workers_give_the_same_bytes(
    made: Path, quarter_files: list[Path], tmp_path: Path
) -> None:
    do(quarter_files[::-1], tmp_path / "out", products=ALL, resolution=RESOLUTION, tile_size="96", workers=2)
    assert digests(tmp_path / "out") == digests(made)
    assert len(digests(made)) == len(PRODUCTS)


def test_what_is_done_is_not_done_again(quarter_files: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(quarter_files, out, resolution=RESOLUTION)
    more = do(quarter_files, out, products="dtm,slope", resolution=RESOLUTION)
    assert {k: n for k, n in computed(more).items() if n} == {"grid-slope": 4, "export": 1}
    again = do(quarter_files, out, products="slope,dtm", resolution=RESOLUTION)
    assert again.did_nothing
    other = do(quarter_files, out, products="dtm,slope", resolution=RESOLUTION, max_edge="3")
    assert {"grid-dtm", "grid-slope"} <= {k for k, n in computed(other).items() if n}


def test_density_counts_the_ground(made: Path) -> None:
    import json

    ground = json.loads((made / "run.json").read_text())["filter"]["ground"]
    assert values(made, "density").sum() * 0.3**2 == pytest.approx(ground, rel=1e-6)


def test_slope_and_shade_are_where_the_terrain_is(made: Path) -> None:
    terrain = ~np.isnan(values(made, "dtm"))
    for name in ("slope", "hillshade"):
        assert np.array_equal(~np.isnan(values(made, name)), terrain)
