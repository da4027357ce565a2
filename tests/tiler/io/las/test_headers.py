from __future__ import annotations

import bz2
import gzip
import lzma
import math
import random
import struct
import zipfile
from pathlib import Path
from typing import Any

import pytest

from tests.scenes.las15 import as_las15
from tiler.errors import InputError
from tiler.io.las.headers import read_header


def patch(path: Path, position: int, form: str, *values: Any) -> Path:
    data = bytearray(path.read_bytes())
    struct.pack_into(form, data, position, *values)
    path.write_bytes(data)
    return path


def test_the_header_is_read_as_laspy_wrote_it(make_cloud: Any) -> None:
    path = make_cloud("a.las", n=321, point_format=6, version="1.4", evlr=b"xyz" * 100)
    header = read_header(path)
    assert (header.version, header.point_format, header.point_count) == ((1, 4), 6, 321)
    assert header.scales == (0.01, 0.01, 0.01)
    assert header.offsets == (500_000.0, 5_400_000.0, 0.0)
    assert [v.record_id for v in header.vlrs] == [7, 2112]
    assert [(v.user_id, v.record_id, v.length) for v in header.evlrs] == [("mine", 9, 300)]
    assert header.notes == ()


LIES = {
    "signature": (0, "<4s", (b"LASX",), "not with LASF"),
    "version": (25, "<B", (9,), "LAS 1.9"),
    "header size": (94, "<H", (20,), "header of 20 bytes"),
    "points offset": (96, "<I", (10**9,), "points from byte 1000000000"),
    "point format": (104, "<B", (11,), "point format 11"),
    "both compression bits": (104, "<B", (0xC3,), "point format 195"),
    "compressed": (104, "<B", (0x83,), "no laszip record"),
    "record length": (105, "<H", (12,), "records of 12 bytes"),
    "point count": (107, "<I", (2**32 - 1,), "says 4294967295 points"),
    "scale 0": (131, "<d", (0.0,), "scale factors"),
    "scale NaN": (139, "<d", (math.nan,), "scale factors"),
    "scale below 0": (139, "<d", (-0.01,), "scale factors"),
    "scale too fine": (
        131,
        "<d",
        (9e-10,),
        "scale factors (9e-10, 0.01, 0.01), not all from 1e-09 to 1000; write it",
    ),
    "scale too coarse": (
        147,
        "<d",
        (1001.0,),
        "not all from 1e-09 to 1000; write it again with scales like 0.001",
    ),
    "offset inf": (155, "<d", (math.inf,), "offsets"),
}


@pytest.mark.parametrize("lie", LIES)
def test_false_headers_are_refused_in_one_line(make_cloud: Any, lie: str) -> None:
    position, form, values, said = LIES[lie]
    path = patch(make_cloud("lie.las"), position, form, *values)
    with pytest.raises(InputError) as caught:
        read_header(path)
    text = str(caught.value)
    assert str(path) in text
    assert said in text
    assert "\n" not in text
    assert ";" in text


@pytest.mark.parametrize(
    ("size", "said"),
    [
        (0, "is empty"),
        (3, "begins with b'LAS'"),
        (100, "has 100 bytes"),
        (226, "has 226 bytes"),
    ],
)
def test_stubs_are_refused(make_cloud: Any, size: int, said: str) -> None:
    path = make_cloud("stub.las")
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(InputError, match=f"stub.las: {said}"):
        read_header(path)


@pytest.mark.parametrize(
    ("packing", "module"), [("gzip", gzip), ("bzip2", bz2), ("xz", lzma), ("zip", None)]
)
def test_packed_clouds_are_refused_with_the_name_of_the_packing(
    make_cloud: Any, packing: str, module: Any
) -> None:
    path = make_cloud("packed.laz")
    content = path.read_bytes()
    if module is None:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("cloud.laz", content)
    else:
        path.write_bytes(module.compress(content))
    with pytest.raises(InputError) as caught:
        read_header(path)
    assert str(caught.value) == (
        f"{path}: is a file that is packed with {packing}, not a LAS or LAZ file; unpack it and give "
        "the LAS or LAZ files in it"
    )


def test_an_absent_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_header(tmp_path / "nowhere.las")


def test_a_wrong_number_of_vlrs_is_noted(make_cloud: Any) -> None:
    header = read_header(patch(make_cloud("vlrs.las"), 100, "<I", 2**32 - 1))
    assert len(header.vlrs) == 2
    assert header.notes == ("says 4294967295 variable length records, 2 are there",)


@pytest.mark.parametrize("start", [2**60, 900])
def test_evlrs_beyond_the_file_or_inside_the_points(make_cloud: Any, start: int) -> None:
    path = patch(
        make_cloud("e.las", point_format=6, version="1.4", evlr=b"1"), 235, "<Q", start
    )
    with pytest.raises(InputError, match="extended records"):
        read_header(path)
    assert read_header(path, salvage=True).evlrs == ()


def test_cut_las_is_salvaged_to_whole_records(make_cloud: Any) -> None:
    path = make_cloud("cut.las", n=100)
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(InputError, match="--salvage"):
        read_header(path)
    assert read_header(path, salvage=True).point_count == 98


CHUNK_LIES = {
    "table beyond the end": lambda size: 10 * size,
    "table before the points": lambda size: 12,
    "table at the last byte": lambda size: size - 2,
    "never written": lambda size: -1,
}


@pytest.mark.parametrize("lie", CHUNK_LIES)
@pytest.mark.parametrize("point_format", [3, 6])
def test_a_false_chunk_table_is_refused(make_cloud: Any, lie: str, point_format: int) -> None:
    version = "1.4" if point_format > 5 else "1.2"
    path = make_cloud("t.laz", point_format=point_format, version=version)
    patch(path, read_header(path).points_offset, "<q", CHUNK_LIES[lie](path.stat().st_size))
    with pytest.raises(InputError, match="--salvage"):
        read_header(path)


def test_the_number_of_chunks_is_compared_with_the_bytes(make_cloud: Any) -> None:
    path = make_cloud("t.laz")
    (table,) = struct.unpack_from("<q", path.read_bytes(), read_header(path).points_offset)
    patch(path, table + 4, "<I", 2**32 - 1)
    with pytest.raises(InputError, match="4294967295 chunks"):
        read_header(path)


@pytest.mark.parametrize(("point_format", "version"), [(3, "1.2"), (6, "1.4")])
def test_chunks_of_0_points_need_a_table_with_the_points_of_each(
    make_cloud: Any, point_format: int, version: str
) -> None:
    path = make_cloud("t.laz", n=70_000, point_format=point_format, version=version)
    record = path.read_bytes().index(b"laszip encoded") + 52
    with pytest.raises(InputError, match="chunk"):
        read_header(patch(path, record + 12, "<I", 0))


def test_the_number_of_points_is_compared_with_the_chunks(make_cloud: Any) -> None:
    path = patch(make_cloud("t.laz", n=70_000), 107, "<I", 700_000)
    with pytest.raises(InputError, match="chunk table has 2 chunks, 700000 points need 14"):
        read_header(path)


def test_the_digest_covers_the_bytes_before_the_points(make_cloud: Any) -> None:
    first = make_cloud("a.las")
    digest = read_header(first).digest
    assert digest == read_header(first).digest
    assert digest != read_header(patch(first, 131, "<d", 0.02)).digest


def test_the_digest_covers_the_table_of_chunks(make_cloud: Any) -> None:
    first, second = (make_cloud(f"{seed}.laz", n=200, seed=seed) for seed in (1, 2))
    offset = read_header(first).points_offset
    second.write_bytes(first.read_bytes()[:offset] + second.read_bytes()[offset:])
    assert read_header(first).digest != read_header(second).digest


@pytest.mark.parametrize("n", [1, 49_999, 50_000, 50_001, 100_000])
@pytest.mark.parametrize("point_format", [0, 6])
def test_chunks_that_are_exactly_full_are_read(
    make_cloud: Any, n: int, point_format: int
) -> None:
    header = read_header(make_cloud("full.laz", n=n, point_format=point_format, version="1.4"))
    assert header.laz is not None
    assert int(header.laz.counts.sum()) == n


def test_items_of_a_newer_laszip_are_refused_by_version(make_cloud: Any) -> None:
    path = make_cloud("v4.laz", point_format=6, version="1.4")
    laszip = next(v for v in read_header(path).vlrs if v.is_laszip)
    patch(path, laszip.payload + 34 + 4, "<H", 4)
    with pytest.raises(InputError, match="items of version 4, 3 can be read; write it as LAS"):
        read_header(path)


@pytest.mark.parametrize(("suffix", "point_format"), [("las", 3), ("laz", 3), ("laz", 6)])
def test_points_are_salvaged_if_the_header_says_there_are_none(
    suffix: str, point_format: int, make_cloud: Any
) -> None:
    version = "1.4" if point_format > 5 else "1.2"
    path = make_cloud(f"c.{suffix}", n=500, point_format=point_format, version=version)
    patch(path, *((247, "<Q", 0) if version == "1.4" else (107, "<I", 0)))
    with pytest.raises(
        InputError, match=r"says 0 points, has .* it was never finished; .*--salvage"
    ):
        read_header(path)
    header = read_header(path, salvage=True)
    assert "never finished" in header.notes[0]
    assert header.laz is not None or header.point_count == 500
    assert point_format != 6 or header.point_count == 500


@pytest.mark.parametrize("name", ["none.las", "none.laz"])
def test_a_cloud_without_points_is_no_damage(name: str, make_cloud: Any) -> None:
    header = read_header(
        make_cloud(name, n=0, point_format=6, version="1.4", evlr=b"xyz" * 100)
    )
    assert (header.point_count, header.notes) == (0, ())


@pytest.mark.parametrize("point_format", [3, 6])
def test_chunks_behind_the_last_point_are_refused(point_format: int, make_cloud: Any) -> None:
    path = make_cloud("c.laz", n=110_000, point_format=point_format, version="1.4")
    with pytest.raises(InputError, match="chunk table has 3 chunks, 70000 points need 2"):
        read_header(patch(path, 247, "<Q", 70_000))


def test_records_behind_the_last_point_are_noted(make_cloud: Any) -> None:
    path = patch(make_cloud("c.las", n=100), 107, "<I", 90)
    header = read_header(path)
    assert header.notes == ("says 90 points, has room for 100, and the rest looks like points",)
    assert (header.point_count, header.unread_points) == (90, 10)
    header = read_header(path, salvage=True)
    assert (header.point_count, header.stated_points, header.unread_points) == (100, 90, 0)


@pytest.mark.parametrize("behind", [bytes(4096), random.Random(1).randbytes(4096)])
def test_bytes_of_no_meaning_behind_the_last_point_are_no_points(
    behind: bytes, make_cloud: Any
) -> None:
    path = make_cloud("c.las", n=100)
    with path.open("ab") as stream:
        stream.write(behind)
    for salvage in (False, True):
        header = read_header(path, salvage)
        assert header.notes[0].endswith("the rest is not read")
        assert (header.point_count, header.unread_points) == (100, 0)


@pytest.mark.parametrize(
    ("times", "offset", "found"),
    [
        ((0.0, 0.0), None, None),
        ((10.0, 2e6), None, (10.0, 2e6)),
        ((-3.5, -3.5), 1500, (-3.5, -3.5)),
    ],
)
def test_the_times_of_las_1_5_are_read(
    make_cloud: Any,
    times: tuple[float, float],
    offset: int | None,
    found: tuple[float, float] | None,
) -> None:
    path = make_cloud("a.las", point_format=7, version="1.4", evlr=b"more")
    before = read_header(path)
    as_las15(path, *times, offset)
    header = read_header(path)
    assert header.version == (1, 5)
    assert header.header_size == 393
    assert (header.gps_times, header.time_offset) == (found, offset)
    assert (header.point_count, header.scales, header.notes) == (
        before.point_count,
        before.scales,
        (),
    )
    assert [v.length for v in header.vlrs + header.evlrs] == [
        v.length for v in before.vlrs + before.evlrs
    ]


def test_an_unfinished_header_of_las_1_5_needs_its_own_length(make_cloud: Any) -> None:
    path = make_cloud("a.las", point_format=6, version="1.4")
    as_las15(path)
    raw = bytearray(path.read_bytes()[:380])
    struct.pack_into("<HI", raw, 94, 0, 0)
    path.write_bytes(raw)
    with pytest.raises(InputError, match="has 380 bytes, its header alone needs 393"):
        read_header(path, salvage=True)


def test_week_times_have_no_offset(make_cloud: Any) -> None:
    path = make_cloud("a.las", point_format=6, version="1.4")
    as_las15(path, offset=1500)
    raw = bytearray(path.read_bytes())
    raw[6] &= 0xFE
    path.write_bytes(raw)
    assert read_header(path).time_offset is None


def test_what_las_1_5_forbids_is_noted(make_cloud: Any) -> None:
    path = make_cloud("a.las", point_format=3, version="1.4")
    as_las15(path, 5.0, 4.0)
    assert read_header(path).notes == (
        "has points of format 3; LAS 1.5 has formats 6 to 10",
        "says GPS times from 5.0 to 4.0",
    )


def test_a_header_shorter_than_its_version_is_refused(make_cloud: Any) -> None:
    path = make_cloud("a.las", point_format=6, version="1.4")
    as_las15(path)
    raw = bytearray(path.read_bytes())
    struct.pack_into("<H", raw, 94, 375)
    path.write_bytes(raw)
    with pytest.raises(InputError, match="says header of 375 bytes"):
        read_header(path)
