"""Which sheets a run writes, and which pixels: none that could hold no height."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyogrio
import pytest
import rasterio

from tests.invariants import clouds
from tests.invariants.runs import do

KEEP = {"method": "keep", "ground_classes": "1", "water": "none"}


def plane(west: float, south: float, side: float = 50.0) -> clouds.Cloud:
    """Points half a metre from one another, up to all four edges."""
    steps = np.arange(0, side + 0.25, 0.5)
    x, y = (axis.ravel() for axis in np.meshgrid(west + steps, south + steps))
    return clouds.Cloud(np.stack((x, y, 100 + x / 10), axis=1), np.full(len(x), 2, np.uint8))


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Six tiles of 50 m, three by two, that share the points on their edges."""
    folder = tmp_path_factory.mktemp("six")
    places = [(x, y) for x in (0.0, 50.0, 100.0) for y in (0.0, 50.0)]
    return [clouds.write(folder / f"{x:.0f}_{y:.0f}.laz", plane(x, y)) for x, y in places]


@pytest.mark.parametrize("tile_size", ["40", "128"])
def test_points_on_the_outer_edge_make_no_row_no_column_and_no_sheet(
    six: list[Path], tmp_path: Path, tile_size: str
) -> None:
    do(six, tmp_path / "whole", tile_size=tile_size, products="dtm,dsm,density,mask", **KEEP)
    for product in ("dtm", "dsm", "density", "mask"):
        with rasterio.open(tmp_path / "whole" / f"{product}.tif") as raster:
            assert raster.shape == (100, 150)
            assert tuple(raster.bounds) == (500_000, 5_400_000, 500_150, 5_400_100)
            assert (
                raster.read(1) != (0 if product in ("density", "mask") else raster.nodata)
            ).all()
    cut = do(six, tmp_path / "cut", tile_size=tile_size, sheets="50", **KEEP)
    names = {f"dtm_{500_000 + x}_{5_400_000 + y}.tif" for x in (0, 50, 100) for y in (0, 50)}
    assert {path.name for path in (tmp_path / "cut/dtm").iterdir()} == names
    assert not [note for note in cut.summary["notes"] if "without a height" in note]
    with rasterio.open(tmp_path / "cut/dtm.vrt") as mosaic:
        assert mosaic.shape == (100, 150)


@pytest.mark.parametrize("edge", ["500100", "500100.001"])
def test_bounds_follow_the_same_rule(six: list[Path], tmp_path: Path, edge: str) -> None:
    bounds = ["500000", "5400000", edge, "5400100"]
    do(six, tmp_path, bounds=bounds, **KEEP)
    with rasterio.open(tmp_path / "dtm.tif") as raster:
        assert raster.shape == (100, 100)
        assert (raster.read(1) != raster.nodata).all()


def test_sheets_without_a_height_are_written_where_they_are_asked_for(tmp_path: Path) -> None:
    """One bucket of points in two corners: the sheets between them hold nothing."""
    parts = [plane(0.0, 0.0, 20.0), plane(100.0, 100.0, 20.0)]
    both = clouds.Cloud(
        np.concatenate([p.xyz for p in parts]), np.concatenate([p.truth for p in parts])
    )
    cloud, out = clouds.write(tmp_path / "in.laz", both), tmp_path / "out"
    how = {**KEEP, "sheets": "20", "max_edge": "10", "products": "dtm,density"}
    first = do(cloud, out, **how)
    full = {"500000_5400000", "500100_5400100"}

    def there(product: str) -> set[str]:
        return {path.stem.removeprefix(f"{product}_") for path in (out / product).iterdir()}

    assert there("dtm") == there("density") == there("stac") == full
    _, _, _, columns = pyogrio.raw.read(out / "sheets.gpkg", layer="dtm", columns=["west"])
    assert set(columns[0]) == {500_000.0, 500_100.0}
    (note,) = [note for note in first.summary["notes"] if "without a height" in note]
    every = do(cloud, out, empty_sheets=True, **how)
    assert there("dtm") == there("density") > full
    assert note.startswith(f"{len(there('dtm')) - 2} sheets")
    assert not [note for note in every.summary["notes"] if "without a height" in note]
    assert do(cloud, out, **how).exit_code == 0
    assert there("dtm") == there("stac") == full
    assert do(cloud, out, **how).did_nothing


def test_a_sheet_over_a_void_that_is_filled_is_written(tmp_path: Path) -> None:
    """No point lies in the sheets in the middle of a lake, but heights do."""
    ring = plane(0.0, 0.0, 200.0)
    far = np.abs(ring.xyz[:, :2] - 100).max(axis=1) > 60
    cloud = clouds.write(tmp_path / "lake.laz", ring.take(far))
    how = {**KEEP, "max_edge": "20", "voids": "fill", "tile_size": "200"}
    do(cloud, tmp_path / "cut", sheets="20", **how)
    do(cloud, tmp_path / "whole", **how)
    with (
        rasterio.open(tmp_path / "cut/dtm.vrt") as mosaic,
        rasterio.open(tmp_path / "whole/dtm.tif") as whole,
    ):
        assert np.array_equal(mosaic.read(1), whole.read(1))


def test_a_run_without_any_height_has_no_sheet(tmp_path: Path) -> None:
    sparse = plane(0.0, 0.0).take(np.arange(101**2) % 5000 == 0)
    cloud = clouds.write(tmp_path / "in.laz", sparse)
    result = do(cloud, tmp_path / "out", sheets="50", max_edge="1", **KEEP)
    assert result.exit_code == 0
    assert any("the terrain model is empty" in note for note in result.summary["notes"])
    assert not list((tmp_path / "out").glob("dtm*"))
    assert (tmp_path / "out/report.html").exists()


def test_rectangles_are_cut_by_width_and_height(six: list[Path], tmp_path: Path) -> None:
    do(six, tmp_path / "whole", **KEEP)
    result = do(six, tmp_path / "cut", sheets="50x20", **KEEP)
    names = {
        f"dtm_{500_000 + x}_{5_400_000 + y}.tif"
        for x in (0, 50, 100)
        for y in range(0, 100, 20)
    }
    assert {path.name for path in (tmp_path / "cut/dtm").iterdir()} == names
    assert result.summary["sheets"] == 15
    with rasterio.open(tmp_path / "whole/dtm.tif") as raster:
        whole, left, top = raster.read(1), raster.bounds.left, raster.bounds.top
    for name in names:
        with rasterio.open(tmp_path / "cut/dtm" / name) as sheet:
            assert sheet.shape == (20, 50)
            col, row = round(sheet.bounds.left - left), round(top - sheet.bounds.top)
            assert np.array_equal(sheet.read(1), whole[row : row + 20, col : col + 50])
    assert do(six, tmp_path / "cut", sheets="50 x 20m", **KEEP).did_nothing
