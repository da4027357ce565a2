from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import lazrs
import numpy as np
import pytest

from tests.scenes.laz_chunks import variable_chunks
from tiler.core.points import KEY_POINT_FLAG, OVERLAP_FLAG, SYNTHETIC_FLAG, WITHHELD_FLAG
from tiler.errors import InputError
from tiler.io.las.headers import read_header
from tiler.io.las.point_formats import class_and_flags, colours, returns, write_classes
from tiler.io.las.reader import EVERYTHING, NEEDED, PointReader, count_decodable, decoding

FORMATS = [
    (f, v)
    for f in range(11)
    for v in ("1.2", "1.3", "1.4")
    if f <= {"1.2": 3, "1.3": 5, "1.4": 10}[v]
]


def records_of(path: Path, selection: int = EVERYTHING) -> np.ndarray:
    header = read_header(path)
    with PointReader(header, selection) as reader:
        return reader.read(0, header.point_count)


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize(("point_format", "version"), FORMATS)
def test_every_format_decodes_to_what_laspy_decodes(
    make_cloud: Any, point_format: int, version: str, suffix: str
) -> None:
    path = make_cloud(f"f.{suffix}", point_format=point_format, version=version, extra=True)
    assert records_of(path).tobytes() == laspy.read(path).points.array.tobytes()


@pytest.mark.parametrize("minor", [0, 1])
def test_las_1_0_and_1_1(make_cloud: Any, minor: int) -> None:
    path = make_cloud("old.las", point_format=1)
    expected = laspy.read(path).points.array.tobytes()
    data = bytearray(path.read_bytes())
    data[25] = minor
    path.write_bytes(data)
    assert read_header(path).version == (1, minor)
    assert records_of(path).tobytes() == expected


@pytest.mark.parametrize(("point_format", "version"), FORMATS)
def test_columns_are_those_of_laspy(make_cloud: Any, point_format: int, version: str) -> None:
    path = make_cloud("c.laz", point_format=point_format, version=version)
    cloud = laspy.read(path)
    records = records_of(path, NEEDED)
    classification, flags = class_and_flags(records, point_format)
    np.testing.assert_array_equal(classification, cloud.classification)
    np.testing.assert_array_equal(flags & WITHHELD_FLAG != 0, cloud.withheld)
    np.testing.assert_array_equal(flags & SYNTHETIC_FLAG != 0, cloud.synthetic)
    np.testing.assert_array_equal(flags & KEY_POINT_FLAG != 0, cloud.key_point)
    overlap = cloud.overlap if point_format > 5 else np.asarray(cloud.classification) == 12
    np.testing.assert_array_equal(flags & OVERLAP_FLAG != 0, overlap)
    np.testing.assert_array_equal(
        returns(records, point_format), [cloud.return_number, cloud.number_of_returns]
    )
    rgb = colours(records, point_format)
    if point_format in (2, 3, 5, 7, 8, 10):
        np.testing.assert_array_equal(rgb, [cloud.red, cloud.green, cloud.blue])
    else:
        assert rgb is None


@pytest.mark.parametrize("point_format", [1, 6])
def test_new_classes_leave_the_flags(make_cloud: Any, point_format: int) -> None:
    path = make_cloud("w.las", point_format=point_format, version="1.4")
    records = records_of(path).copy()
    _, flags = class_and_flags(records, point_format)
    was_overlap = class_and_flags(records, point_format)[0] == 12
    write_classes(
        records, point_format, np.full(len(records), 2, np.uint8), np.ones(len(records), bool)
    )
    classes, after = class_and_flags(records, point_format)
    assert (classes == 2).all()
    np.testing.assert_array_equal(after[~was_overlap], flags[~was_overlap])


@pytest.mark.parametrize("point_format", [3, 7])
def test_any_range_is_the_same_as_in_the_whole(make_cloud: Any, point_format: int) -> None:
    path = make_cloud("r.laz", n=120_000, point_format=point_format, version="1.4")
    header = read_header(path)
    whole = records_of(path)
    with PointReader(header, EVERYTHING) as reader:
        for start, count in (
            (100_000, 20_000),
            (0, 10),
            (49_999, 2),
            (50_000, 50_000),
            (119_999, 1),
            (5, 0),
        ):
            assert reader.read(start, count).tobytes() == whole[start : start + count].tobytes()


@pytest.mark.parametrize(("point_format", "step"), [(1, 100_000), (6, 50_000), (7, 7_000)])
def test_neighbouring_ranges_are_read_one_after_the_other(
    make_cloud: Any, point_format: int, step: int
) -> None:
    path = make_cloud("n.laz", n=260_000, point_format=point_format, version="1.4")
    header = read_header(path)
    with PointReader(header, EVERYTHING) as reader:
        parts = [
            reader.read(s, min(step, 260_000 - s)).tobytes() for s in range(0, 260_000, step)
        ]
    assert b"".join(parts) == laspy.read(path).points.array.tobytes()


@pytest.mark.parametrize("point_format", [1, 7])
def test_any_range_of_variable_chunks(make_cloud: Any, point_format: int) -> None:
    path = make_cloud("v.laz", n=1000, point_format=point_format, version="1.4")
    whole = records_of(path).copy()
    variable_chunks(path, [10, 300, 1, 489, 200], whole, point_format)
    header = read_header(path)
    assert header.laz is not None
    assert header.laz.chunk_size is None
    assert header.laz.counts.tolist()[:5] == [10, 300, 1, 489, 200]
    for start, count in (
        (0, 1000),
        (10, 300),
        (310, 1),
        (311, 489),
        (800, 200),
        (5, 900),
        (999, 1),
    ):
        with PointReader(header, EVERYTHING) as reader:
            assert reader.read(start, count).tobytes() == whole[start : start + count].tobytes()


@pytest.mark.parametrize("point_format", [1, 7])
def test_whole_chunks_of_a_cut_laz_are_salvaged(make_cloud: Any, point_format: int) -> None:
    path = make_cloud("s.laz", n=120_000, point_format=point_format, version="1.4")
    whole = records_of(path)
    layout = read_header(path).laz
    assert layout is not None
    cut = read_header(path).points_offset + 8 + int(layout.sizes[:2].sum()) + 1000
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(InputError, match="cut short"):
        read_header(path)
    header = read_header(path, salvage=True)
    assert count_decodable(header) == 100_000
    with PointReader(header, EVERYTHING) as reader:
        assert reader.read(60_000, 40_000).tobytes() == whole[60_000:100_000].tobytes()
        assert reader.read(0, 10).tobytes() == whole[:10].tobytes()


def test_layers_that_claim_gigabytes_are_refused_before_they_are_allocated(
    make_cloud: Any,
) -> None:
    path = make_cloud("l.laz", point_format=6, version="1.4")
    header = read_header(path)
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, header.points_offset + 8 + header.record_length + 4, 2**32 - 1)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"chunk 0 says 429\d+ bytes"):
        records_of(path)


def test_points_of_a_chunk_are_compared_with_the_header(make_cloud: Any) -> None:
    path = make_cloud("n.laz", n=1000, point_format=6, version="1.4")
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, 247, 900)
    path.write_bytes(data)
    with pytest.raises(InputError, match="chunk 0 has 1000 points, by the header 900"):
        records_of(path)


def test_damaged_points_are_an_input_error(make_cloud: Any) -> None:
    path = make_cloud("d.laz", n=5000)
    header = read_header(path)
    with (
        PointReader(replace(header, point_count=60_000)) as reader,
        pytest.raises(InputError, match=r"d\.laz"),
    ):
        reader.read(0, 60_000)


def test_a_file_that_shrank_is_an_input_error(make_cloud: Any) -> None:
    path = make_cloud("d.las", n=100)
    header = read_header(path)
    with PointReader(header) as reader:
        path.write_bytes(path.read_bytes()[:-10])
        with pytest.raises(InputError, match="cannot be decoded"):
            reader.read(0, 100)


class PanicException(BaseException):
    """A BaseException that is no Exception, with the name of pyo3's."""


class Panics:
    def decompress_many(self, target: bytearray) -> None:
        raise PanicException("index out of bounds:\nthe len is 0")

    def seek(self, point: int) -> None:
        pass


def test_a_panic_of_the_decoder_is_an_input_error(
    make_cloud: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make_cloud("p.laz")
    monkeypatch.setattr(lazrs, "LasZipDecompressor", lambda *a: Panics())
    with pytest.raises(InputError, match="make the decoder fail") as caught:
        records_of(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit, GeneratorExit])
def test_interrupts_go_through(kind: type[BaseException]) -> None:
    with pytest.raises(kind), decoding(Path("x.laz")):
        raise kind
