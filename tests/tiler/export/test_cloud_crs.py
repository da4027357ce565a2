"""The CRS of the run in classified clouds whose source has none, read back by laspy, PROJ and our own reader."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import laspy
import pytest
from pyproj import CRS

from tests.tiler.export.test_classified import export
from tiler.export.cloud_frame import crs_to_write, geotiff_keys
from tiler.inputs import inspect
from tiler.inputs.georeference import georeference
from tiler.io.las.headers import read_header

LOCAL = "+proj=tmerc +lat_0=47 +lon_0=9.5 +k=1 +x_0=0 +y_0=0 +ellps=GRS80 +units=m"


@pytest.mark.parametrize("suffix", ["laz", "las"])
@pytest.mark.parametrize(
    ("point_format", "version"), [(1, "1.0"), (3, "1.2"), (5, "1.3"), (3, "1.4"), (7, "1.4")]
)
@pytest.mark.parametrize("crs", ["EPSG:25832", "EPSG:2154+5720", "EPSG:2991+6360", LOCAL])
def test_it_is_written_as_the_version_has_it(
    make_cloud: Any,
    memory_store: Any,
    tmp_path: Path,
    crs: str,
    point_format: int,
    version: str,
    suffix: str,
) -> None:
    evlr = b"more" if version == "1.4" else None
    made = "1.2" if version == "1.0" else version
    path = make_cloud("a.laz", point_format=point_format, version=made, crs=None, evlr=evlr)
    if version == "1.0":
        data = bytearray(path.read_bytes())
        data[25] = 0
        path.write_bytes(data)
    known, out = CRS.from_user_input(crs), tmp_path / "out" / f"a.{suffix}"
    record = export(memory_store, path, out, (), wkt=known.to_wkt())
    header, found = read_header(out), laspy.read(out)
    own = georeference(header)
    horizontal = known.sub_crs_list[0] if known.is_compound else known
    parsed = found.header.parse_crs()
    assert own.wkt is not None
    for other in (parsed, CRS.from_wkt(own.wkt)):
        other = other.sub_crs_list[0] if other.is_compound else other
        assert (
            other.equals(horizontal, ignore_axis_order=True)
            or other.to_epsg() == horizontal.to_epsg() is not None
        )
    assert own.notes == ()
    if known.is_compound:
        assert own.vertical is not None
        assert float(own.vertical) == pytest.approx(known.axis_info[-1].unit_conversion_factor)
        heights = CRS.from_wkt(own.wkt).sub_crs_list[1]
        assert heights.to_epsg() == known.sub_crs_list[1].to_epsg()
    is_wkt = version == "1.4" or crs == LOCAL
    records = [v.record_id for v in found.header.vlrs if v.user_id == "LASF_Projection"]
    assert records == [2112 if is_wkt else 34735]
    assert header.prefers_wkt == (version == "1.4")
    assert (record.notes != []) == (crs == LOCAL and version != "1.4")
    source = laspy.read(path)
    assert found.points.array.tobytes() == source.points.array.tobytes()
    assert found.header.vlrs[0].record_data == source.header.vlrs[0].record_data
    assert [e.record_data for e in found.evlrs or ()] == [
        e.record_data for e in source.evlrs or ()
    ]


def test_records_that_cannot_be_read_are_replaced(
    make_cloud: Any, memory_store: Any, tmp_path: Path
) -> None:
    def broken(cloud: laspy.LasData) -> None:
        keys = struct.pack("<8H", 1, 1, 0, 1, 3072, 0, 1, 32767)
        cloud.header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", keys))
        cloud.header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", b"PROJCS[\0"))

    wkt = CRS("EPSG:25832").to_wkt()
    path = make_cloud("a.las", point_format=6, version="1.4", crs=None, edit=broken)
    record = export(memory_store, path, tmp_path / "a.laz", (), wkt=wkt)
    assert record.notes == [
        "CRS of the run written in place of CRS records that cannot be read or have no vertical CRS"
    ]
    assert georeference(read_header(tmp_path / "a.laz")).name == "ETRS89 / UTM zone 32N"
    memory_store.meta.frame = type(memory_store.meta.frame)(crs_wkt=wkt)
    export(memory_store, path, tmp_path / "a.copc.laz", (), wkt=wkt, copc=True)
    assert laspy.read(tmp_path / "a.copc.laz").header.parse_crs().to_epsg() == 25832


@pytest.mark.parametrize(
    ("given", "is_written"),
    [(None, False), ("none", False), ("EPSG:25832", False), ("EPSG:25832+5783", True)],
)
def test_only_a_given_crs_with_heights_adds_them(
    given: str | None, is_written: bool, make_cloud: Any
) -> None:
    """The run may have heights from another file."""
    info, run = inspect(make_cloud("a.laz", crs="EPSG:25832")), CRS("EPSG:25832+5783").to_wkt()
    assert crs_to_write(info, run, given) == (run if is_written else None)


def test_keys_name_what_epsg_has_numbers_for() -> None:
    for text in (LOCAL, "EPSG:4326", "EPSG:4979", "EPSG:5720"):
        assert geotiff_keys(CRS.from_user_input(text)) is None
    keys = geotiff_keys(CRS("EPSG:2992"))
    assert keys is not None
    assert struct.unpack("<16H", keys) == (
        1,
        1,
        0,
        3,
        1024,
        0,
        1,
        1,
        3072,
        0,
        1,
        2992,
        3076,
        0,
        1,
        9002,
    )
