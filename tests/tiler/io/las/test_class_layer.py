"""The bytes of class layers, and of clouds whose other layers are copied, against those that lazrs writes."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import laspy
import lazrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiler.errors import InputError
from tiler.io.las.class_layer import ClassEncoder
from tiler.io.las.headers import LasHeader, read_header
from tiler.io.las.layout import checked_layers, parse_laszip, with_chunk_size
from tiler.io.las.reader import EVERYTHING, PointReader
from tiler.io.las.writers import ClassWriter, has_class_layer

LAYERED = (6, 7, 8, 9, 10)
FIELDS = ("classification", "bit_fields", "classification_flags")


def records_of(point_format: int, n: int, seed: int = 0) -> np.ndarray:
    """Random bytes, of one scanner channel."""
    dtype = laspy.PointFormat(point_format).dtype()
    raw = np.random.default_rng(seed).integers(0, 256, n * dtype.itemsize, dtype=np.uint8)
    records = raw.view(dtype).copy()
    records["classification_flags"] &= 0xCF
    return records


def compressed(records: np.ndarray, settings: bytes) -> bytes:
    """What lazrs writes: the position of the table, the chunks and the table."""
    target = io.BytesIO()
    compressor = lazrs.LasZipCompressor(target, lazrs.LazVlr(settings))
    compressor.compress_many(records.view(np.uint8))
    compressor.done()
    return target.getvalue()


def layers_of(points: bytes, settings: bytes, count: int) -> list[bytes]:
    """Layers of the first chunk."""
    layout = parse_laszip(settings)
    head = struct.unpack_from(f"<{1 + layout.layers}I", points, 8 + layout.item_size)
    assert head[0] == count
    stream, layers = io.BytesIO(points), []
    stream.seek(8 + layout.min_chunk)
    for size in head[1:]:
        layers.append(stream.read(size))
    return layers


def assert_as_lazrs(records: np.ndarray, point_format: int) -> bytes:
    settings = bytes(lazrs.LazVlr.new_for_compression(point_format, 0).record_data())
    expected = layers_of(compressed(records, settings), settings, len(records))[2]
    layer = ClassEncoder().encode(*(np.ascontiguousarray(records[name]) for name in FIELDS))
    assert layer == expected
    return layer


def _of_one_class() -> bytes:
    settings = bytes(lazrs.LazVlr.new_for_compression(6, 0).record_data())
    return layers_of(compressed(records_of(6, 1), settings), settings, 1)[2]


leaves_out_layers = pytest.mark.skipif(
    _of_one_class() != b"",
    reason="this lazrs writes layers of one class, which LASzip and newer ones leave out",
)


@leaves_out_layers
@pytest.mark.parametrize("point_format", LAYERED)
@pytest.mark.parametrize("n", [1, 2, 3, 50_000])
def test_any_classes_and_returns(point_format: int, n: int) -> None:
    assert_as_lazrs(records_of(point_format, n), point_format)


@leaves_out_layers
@pytest.mark.parametrize("code", [0, 2, 255])
def test_one_class_has_no_bytes(code: int) -> None:
    records = records_of(6, 1000)
    records["classification"] = code
    assert assert_as_lazrs(records, 6) == b""
    records["classification"][-1] = code ^ 1
    assert len(assert_as_lazrs(records, 6)) >= 4


def test_few_classes_which_halve_the_counts_of_their_models() -> None:
    records = records_of(7, 50_000)
    rng = np.random.default_rng(1)
    records["classification"] = rng.choice([1, 2, 6, 255], 50_000, p=[0.6, 0.3, 0.099, 0.001])
    records["bit_fields"] = rng.choice([0x01, 0x11, 0x21, 0x22], 50_000)
    assert_as_lazrs(records, 7)


def test_every_class_after_every_other() -> None:
    before, after = np.divmod(np.arange(1 << 15), 256)
    records = records_of(6, 1 << 16)[:50_000]
    records["classification"] = np.stack((before, after), 1).ravel()[:50_000]
    assert_as_lazrs(records, 6)


@pytest.mark.parametrize("run", [1, 7, 5000])
def test_scanner_channels_have_their_own_models(run: int) -> None:
    """Format 6, as lazrs may damage other fields of other formats, but not the classes."""
    n = 20_000
    records = records_of(6, n)
    records["classification"] &= 3
    records["bit_fields"] = 0x11
    records["classification_flags"] |= ((np.arange(n) // run) % 4 << 4).astype(np.uint8)
    separate = assert_as_lazrs(records, 6)
    records["classification_flags"] &= 0xCF
    assert assert_as_lazrs(records, 6) != separate


@leaves_out_layers
@given(
    points=st.lists(
        st.tuples(st.integers(0, 255), st.integers(0, 255), st.integers(0, 255)), min_size=1
    ),
    repeated=st.integers(1, 40),
)
def test_any_points(points: list[tuple[int, int, int]], repeated: int) -> None:
    records = records_of(6, len(points) * repeated)
    for name, values in zip(FIELDS, zip(*points, strict=True), strict=True):
        records[name] = np.repeat(np.array(values, np.uint8), repeated)
    assert_as_lazrs(records, 6)


def test_an_encoder_forgets_the_chunk_before() -> None:
    encoder = ClassEncoder()
    chunks = [
        [np.ascontiguousarray(records_of(6, n, seed=n)[name]) for name in FIELDS]
        for n in (3000, 50, 7000)
    ]
    assert [encoder.encode(*chunk) for chunk in chunks] == [
        ClassEncoder().encode(*chunk) for chunk in chunks
    ]


def chunked(path: Path, chunk_points: int) -> LasHeader:
    """Compress a cloud again in chunks of another size."""
    header = read_header(path)
    assert header.laz is not None
    with PointReader(header, EVERYTHING) as reader:
        records = reader.read(0, header.point_count)
    front = path.read_bytes()[: header.points_offset]
    settings = with_chunk_size(header.laz.record_data, chunk_points)
    front = front.replace(header.laz.record_data, settings)
    points = bytearray(compressed(records, settings))
    struct.pack_into("<q", points, 0, struct.unpack_from("<q", points)[0] + len(front))
    path.write_bytes(front + points)
    return read_header(path)


def rewritten(header: LasHeader, classes: np.ndarray, step: int) -> tuple[bytes, bytes]:
    """Points with new classes by `ClassWriter`, ``step`` at a time, and by lazrs."""
    assert header.laz is not None
    with PointReader(header, EVERYTHING) as reader:
        records = reader.read(0, header.point_count)
    records["classification"] = classes
    target = io.BytesIO()
    with open(header.path, "rb") as source:
        writer = ClassWriter(target, source, header)
        for start in range(0, len(records), step):
            writer.write(records[start : start + step])
        writer.close()
    return target.getvalue(), compressed(records, header.laz.record_data)


@leaves_out_layers
@pytest.mark.parametrize("point_format", LAYERED)
@pytest.mark.parametrize(
    ("n", "chunk_points"), [(1, 50_000), (1000, 100), (1001, 100), (999, 100), (77, 1)]
)
def test_the_bytes_of_a_cloud_are_those_of_lazrs(
    make_cloud: Any, point_format: int, n: int, chunk_points: int
) -> None:
    path = make_cloud("a.laz", n=n, point_format=point_format, version="1.4", extra=True)
    header = chunked(path, chunk_points)
    assert has_class_layer(header)
    rng = np.random.default_rng(2)
    for classes in (
        rng.integers(0, 256, n),
        rng.choice([1, 2], n),
        np.full(n, 2),
        np.arange(n) // chunk_points % 256,
    ):
        for step in (n, 64):
            written, expected = rewritten(header, classes, step)
            assert written == expected


def test_several_chunks_of_the_usual_size(make_cloud: Any) -> None:
    for n in (100_000, 120_001):
        header = read_header(make_cloud("a.laz", n=n, point_format=7, version="1.4"))
        written, expected = rewritten(header, np.arange(n) // 333 % 7, 1 << 16)
        assert written == expected


@leaves_out_layers
def test_layers_of_one_class_get_classes(make_cloud: Any) -> None:
    def one_class(cloud: laspy.LasData) -> None:
        cloud.points.array["classification"] = 1

    path = make_cloud("a.laz", point_format=6, version="1.4", edit=one_class)
    header = read_header(path)
    with open(path, "rb") as source:
        assert header.laz is not None
        assert checked_layers(source, header.laz, 0, header.points_offset + 8)[2] == 0
    written, expected = rewritten(header, np.arange(1000) % 3, 100)
    assert written == expected


def test_what_is_not_layered_in_equal_chunks_has_no_class_layer(make_cloud: Any) -> None:
    def header(name: str, **options: Any) -> LasHeader:
        return read_header(make_cloud(name, **options))

    assert has_class_layer(header("a.laz", point_format=7, version="1.4"))
    assert not has_class_layer(header("b.las", point_format=7, version="1.4"))
    assert not has_class_layer(header("c.laz", point_format=3))
    assert not has_class_layer(header("d.laz", point_format=7, version="1.4", n=0))
    # chunks of different sizes, as in COPC
    path = make_cloud("e.laz", point_format=7, version="1.4")
    assert not has_class_layer(chunked(path, 2**32 - 1))
    # one huge chunk
    path = make_cloud("f.laz", point_format=7, version="1.4")
    assert has_class_layer(chunked(path, 2**31))


def test_a_salvaged_cloud_has_no_class_layer(make_cloud: Any) -> None:
    path = make_cloud("a.laz", point_format=7, version="1.4")
    chunked(path, 100)
    path.write_bytes(path.read_bytes()[:-20])
    header = read_header(path, salvage=True)
    assert 0 < header.point_count <= 1000
    assert not has_class_layer(header)


def test_a_damaged_chunk_is_refused(make_cloud: Any) -> None:
    path = make_cloud("a.laz", point_format=7, version="1.4")
    header = read_header(path)
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, header.points_offset + 8 + header.record_length, 999)
    with PointReader(header, EVERYTHING) as reader:
        records = reader.read(0, 1000)
    path.write_bytes(data)
    with open(path, "rb") as source, pytest.raises(InputError, match="has 999 points"):
        ClassWriter(io.BytesIO(), source, header).write(records)
