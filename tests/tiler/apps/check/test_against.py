"""Comparison with an earlier DTM: known changes on equal pixels, other pixels and other units, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
import rasterio

import tiler
from tests.tiler.apps.check.rasters import tilted, write_heights, write_surface
from tiler.apps.check import accuracy, against
from tiler.apps.check.against import AgainstOptions, compare
from tiler.errors import ConfigError, InputError
from tiler.report.accuracy import accuracy_content


def compared(new: Path, old: Path, **options: Any) -> Any:
    settings = {"change_m": 0.5, "difference": None, **options}
    return compare(new, AgainstOptions(old, **settings))


def dug(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The plane with a pit 2 m deep of 10 m x 6 m, and a heap 1 m high of 4 m x 4 m far from it."""
    pit = (x > 4) & (x < 14) & (y > 40) & (y < 46)
    heap = (x > 100) & (x < 104) & (y > 100) & (y < 104)
    return tilted(x, y) - 2.0 * pit + 1.0 * heap


def test_changes_are_found_where_they_are(tmp_path: Path) -> None:
    old = write_surface(tmp_path / "old.tif", tilted, side=160)
    new = write_surface(tmp_path / "new.tif", dug, side=160, holes=((0, 0), (0, 1)))
    found = compared(new, old, difference=tmp_path / "d.tif")
    assert found["all"]["pixels"] == 160 * 160 - 2
    assert (found["only_new"], found["only_old"]) == (0, 2)
    assert found["changed_pixels"] == 60 + 16
    pit, heap = found["places"]
    assert (pit["pixels"], pit["area_m2"], found["number_of_places"]) == (60, 60.0, 2)
    assert pit["mean_m"] == pytest.approx(-2, abs=1e-4)
    assert pit["largest_m"] == pytest.approx(2, abs=1e-4)
    assert pit["volume_m3"] == pytest.approx(120, abs=0.01)
    assert heap["mean_m"] == pytest.approx(1, abs=1e-4)
    assert pit["bounds"] == [4, 40, 14, 46]
    assert heap["bounds"] == [100, 100, 104, 104]
    with rasterio.open(tmp_path / "d.tif") as difference, rasterio.open(new) as raster:
        assert difference.transform == raster.transform
        heights = difference.read(1, masked=True)
    assert heights.mask.sum() == 2
    assert float(heights[160 - 43, 10]) == pytest.approx(-2, abs=1e-4)
    assert float(np.abs(heights).sum()) == pytest.approx(136, abs=0.1)


@pytest.mark.parametrize(
    ("size", "shift"), [(1.0, 0.0), (0.5, 0.0), (2.0, 0.0), (1.0, 0.3), (3.0, 0.7)]
)
def test_other_pixels_of_the_same_plane_give_no_change(
    size: float, shift: float, tmp_path: Path
) -> None:
    old = write_surface(
        tmp_path / "old.tif", tilted, side=300, size=size, west=shift - 60, south=shift - 60
    )
    new = write_surface(tmp_path / "new.tif", tilted, side=30)
    found = compared(new, old)
    assert found["all"]["pixels"] == 900
    assert found["all"]["max_abs"] < 2e-4
    assert not found["places"]


def test_windows_are_divided_without_a_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = write_surface(tmp_path / "old.tif", dug, side=320, size=0.5)
    new = write_surface(tmp_path / "new.tif", tilted, side=40, size=4.0)
    whole = compared(new, old)
    monkeypatch.setattr(accuracy, "MAX_WINDOW", 500)
    assert compared(new, old) == whole


def test_equal_pixels_are_compared_exactly(tmp_path: Path) -> None:
    heights = np.random.default_rng(1).normal(300, 40, (700, 90)).astype(np.float32)
    old = write_heights(tmp_path / "old.tif", heights, west=-20, north=30)
    new = write_heights(tmp_path / "new.tif", heights[40:, 5:], west=-15, north=-10)
    found = compared(new, old)
    assert found["all"]["pixels"] == 660 * 85
    assert found["all"]["max_abs"] == 0


def test_another_crs_and_unit_are_converted(tmp_path: Path) -> None:
    """A level raster in feet, 600 m wide, in the zone beside."""
    zones = pyproj.Transformer.from_crs(25833, 25832, always_xy=True)
    x, y = zones.transform(200_300, 5_400_300)
    old = write_surface(
        tmp_path / "old.tif",
        lambda x, y: np.full(x.shape, 100 / 0.3048),
        west=200_000,
        south=5_400_000,
        side=600,
        crs="EPSG:25833",
        unit="foot",
    )
    new = write_surface(
        tmp_path / "new.tif",
        lambda x, y: np.full(x.shape, 101.0),
        west=round(x) - 500,
        south=round(y) - 500,
        side=1000,
        crs="EPSG:25832",
    )
    found = compared(new, old)
    assert found["all"]["pixels"] > 300_000
    assert found["all"]["bias"] == pytest.approx(1, abs=1e-4)
    assert found["unit"] == "metre"


def test_slopes_and_sources_divide_the_pixels(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    new = write_surface(out / "dtm.tif", tilted, side=40)
    old = write_surface(tmp_path / "old.tif", lambda x, y: tilted(x, y) - 0.1, side=40)
    found = compared(new, old)
    assert set(found["by_slope"]) == {"15 to 30 degrees"}
    assert found["by_source"] == {}
    values = np.ones((40, 40), np.uint8)
    values[:10] = 5
    profile = {"driver": "GTiff", "width": 40, "height": 40, "count": 1, "dtype": "uint8"}
    with rasterio.open(new) as raster:
        profile |= {"crs": raster.crs, "transform": raster.transform, "nodata": 0}
    with rasterio.open(out / "mask.tif", "w", **profile) as mask:
        mask.write(values, 1)
    found = compared(new, old)
    numbers = {name.partition(":")[0]: v["pixels"] for name, v in found["by_source"].items()}
    assert numbers == {"measured": 1200, "water": 400}
    assert all(v["bias"] == pytest.approx(0.1, abs=1e-4) for v in found["by_source"].values())


def test_cells_of_large_rasters_are_larger(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(against, "MAX_CELLS", 4)
    old = write_surface(tmp_path / "old.tif", tilted, side=160)
    new = write_surface(tmp_path / "new.tif", dug, side=160)
    found = compared(new, old)
    # Cells of 40 pixels, in which the pit and the heap are few.
    assert (found["places"], found["scattered_pixels"]) == ([], 76)
    monkeypatch.setattr(against, "LEAST_SHARE", 1600)
    found = compared(new, old)
    assert sum(place["pixels"] for place in found["places"]) == 76


def test_places_are_ranked_by_volume_and_the_rest_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(against, "MAX_PLACES", 1)
    old = write_surface(tmp_path / "old.tif", tilted, side=160)
    new = write_surface(tmp_path / "new.tif", dug, side=160)
    found = compared(new, old)
    assert [place["pixels"] for place in found["places"]] == [60]
    assert found["number_of_places"] == 2


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    new = write_surface(tmp_path / "new.tif", tilted, crs="EPSG:25832+5783")
    datum = write_surface(tmp_path / "datum.tif", tilted, crs="EPSG:25832+3855")
    with pytest.raises(
        ConfigError, match=r"new.tif has heights of .*, .*datum.tif of .*convert"
    ):
        compared(new, datum)
    far = write_surface(tmp_path / "far.tif", tilted, west=5000)
    with pytest.raises(ConfigError, match="no pixel with heights in common"):
        compared(new, far)
    (tmp_path / "junk.tif").write_bytes(b"junk")
    with pytest.raises(InputError, match="junk.tif"):
        compared(new, tmp_path / "junk.tif")
    with pytest.raises(ConfigError, match="--difference"):
        tiler.check(new, against=far, difference=new)
    with pytest.raises(ConfigError, match="--change 0"):
        tiler.check(new, against=far, change=0)
    degrees = write_surface(tmp_path / "degrees.tif", tilted, size=1e-5, crs="EPSG:4326")
    with pytest.raises(ConfigError, match="is in degrees"):
        compared(degrees, new)
    with pytest.raises(ConfigError, match="give it with --against"):
        tiler.check(new, difference=tmp_path / "d.tif")
    with pytest.raises(ConfigError, match="--change: there is no earlier DTM"):
        tiler.check(new, change=1)


def test_one_datum_in_two_units_is_compared_and_a_missing_one_noted(tmp_path: Path) -> None:
    new = write_surface(tmp_path / "new.tif", tilted, crs="EPSG:6339+5703")
    feet = write_surface(
        tmp_path / "feet.tif",
        lambda x, y: tilted(x, y) * 3937 / 1200,
        crs="EPSG:6339+6360",
        unit="US survey foot",
    )
    found = compared(new, feet)
    assert found["all"]["max_abs"] < 1e-4
    assert found["notes"] == []
    plain = write_surface(tmp_path / "plain.tif", tilted, crs="EPSG:6339")
    (note,) = compared(new, plain)["notes"]
    assert note.startswith(f"{plain} has no vertical datum: assumed")
    bare = write_surface(tmp_path / "bare.tif", tilted, crs=None)
    (note,) = compared(new, bare)["notes"]
    assert note.startswith(f"{bare} without a CRS: assumed")


def test_heights_with_a_scale_are_read_as_heights(tmp_path: Path) -> None:
    new = write_surface(tmp_path / "new.tif", tilted)
    profile = {"driver": "GTiff", "width": 40, "height": 40, "count": 1, "dtype": "int32"}
    with rasterio.open(new) as raster:
        heights = raster.read(1)
        profile |= {"crs": raster.crs, "transform": raster.transform, "nodata": -1}
    old = tmp_path / "old.tif"
    with rasterio.open(old, "w", **profile) as raster:
        raster.write(np.rint(heights * 100 - 5000).astype(np.int32), 1)
        raster.scales, raster.offsets = (0.01,), (50.0,)
    assert compared(new, old)["all"]["max_abs"] < 0.0051


def test_lost_sheets_count_as_lost(tmp_path: Path) -> None:
    """Of a mosaic of 3,000 pixels only the first sheet was made again."""
    old = write_surface(tmp_path / "old.tif", tilted, side=3000)
    sheet = write_surface(tmp_path / "sheet.tif", tilted, side=100, south=2900)
    vrt = tmp_path / "new.vrt"
    vrt.write_text(
        '<VRTDataset rasterXSize="3000" rasterYSize="3000"><SRS>EPSG:25832</SRS>'
        "<GeoTransform>0, 1, 0, 3000, 0, -1</GeoTransform>"
        '<VRTRasterBand dataType="Float32" band="1"><NoDataValue>-9999</NoDataValue><ComplexSource>'
        f"<SourceFilename>{sheet}</SourceFilename><SourceBand>1</SourceBand>"
        '<SrcRect xOff="0" yOff="0" xSize="100" ySize="100"/>'
        '<DstRect xOff="0" yOff="0" xSize="100" ySize="100"/><NODATA>-9999</NODATA>'
        "</ComplexSource></VRTRasterBand></VRTDataset>"
    )
    found = compared(vrt, old)
    assert (found["all"]["pixels"], found["only_old"]) == (10_000, 3000 * 3000 - 10_000)


def test_the_command_and_the_report_tell_the_changes(tmp_path: Path) -> None:
    old = write_surface(tmp_path / "old.tif", tilted, side=160)
    new = write_surface(tmp_path / "new.tif", dug, side=160)
    result = tiler.check(new, against=old, change="1.5 m")
    found = result.summary["against"]
    assert found["changed_pixels"] == 60
    assert json.loads(json.dumps(found)) == found
    page = " ".join(accuracy_content({"against": found}, {})[0].itertext())
    for text in (
        "Changes since",
        "0.23 % of 25,600 pixels changed by 1.5 m or more, in 1 place.",
        "-2.00",
        "120",
    ):
        assert text in page
