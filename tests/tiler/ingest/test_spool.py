from __future__ import annotations

import struct
from fractions import Fraction
from types import SimpleNamespace
from typing import Any, ClassVar

import laspy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.points import PointBlock, unpack_origin
from tiler.core.records import SpoolRecord
from tiler.ingest.spool import (
    BEYOND_FRAME,
    OUTSIDE_AREA,
    SpoolPiece,
    sort_by_bucket,
    spool_piece,
)
from tiler.inputs.sources import inspect, pieces
from tiler.io.las.reader import COLOURS, PointReader

ORIGIN = (500_000_000, 5_400_000_000)


def spool(
    store: Any, path: Any, source: int = 0, size: int = 10**6, **options: Any
) -> list[SpoolRecord]:
    works = [
        SpoolPiece(
            str(path), source, f"s{source}p{k}", start, count, identity="of k", **options
        )
        for k, (start, count) in enumerate(pieces(inspect(path), size))
    ]
    return [spool_piece(store, work=work) for work in works]


def gathered(store: Any) -> PointBlock:
    """All points of the spool by origin."""
    block = PointBlock.concatenate(list(store.pieces.values()))
    return block.take(np.argsort(block.origin))


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize(
    ("point_format", "version"), [(3, "1.2"), (7, "1.4"), (0, "1.2"), (6, "1.4")]
)
def test_the_spool_holds_what_the_file_holds(
    make_cloud: Any, memory_store: Any, suffix: str, point_format: int, version: str
) -> None:
    memory_store.meta.frame = CoordFrame(origin=ORIGIN)
    memory_store.meta.has_rgb = True
    path = make_cloud(f"a.{suffix}", n=120_000, point_format=point_format, version=version)
    records = spool(memory_store, path, source=3, size=50_000)
    assert sum(r.read for r in records) == sum(r.stored for r in records) == 120_000
    cloud, block = laspy.read(path), gathered(memory_store)
    sources, rows = unpack_origin(block.origin)
    assert (sources == 3).all()
    np.testing.assert_array_equal(rows, np.arange(120_000))
    np.testing.assert_array_equal(block.xyz, [cloud.X * 10, cloud.Y * 10, cloud.Z * 10])
    np.testing.assert_array_equal(block.classification, cloud.classification)
    np.testing.assert_array_equal(block.returns, [cloud.return_number, cloud.number_of_returns])
    if point_format in (3, 7):
        np.testing.assert_array_equal(block.rgb, [cloud.red, cloud.green, cloud.blue])
    else:
        assert not block.rgb.any()
    assert all(r.largest_rounding == 0.0 for r in records)


def test_pieces_are_sorted_by_bucket_and_keep_their_order_within(
    make_cloud: Any, memory_store: Any
) -> None:
    memory_store.meta.frame = CoordFrame(origin=ORIGIN)
    (record,) = spool(memory_store, make_cloud("a.las", n=5000))
    block, lattice = memory_store.pieces["s0p0"], memory_store.meta.bucket
    start = 0
    cells = []
    for ix, iy, count in record.buckets:
        part = block.take(slice(start, start + count))
        assert (lattice.index(part.xyz[0].astype(np.int64) + ORIGIN[0]) == ix).all()
        assert (lattice.index(part.xyz[1].astype(np.int64) + ORIGIN[1]) == iy).all()
        assert (np.diff(part.origin) > 0).all()
        cells.append((iy, ix))
        start += count
    assert start == len(block)
    assert cells == sorted(set(cells))
    low, high = block.xyz.min(axis=1).tolist(), block.xyz.max(axis=1).tolist()
    west, south = ORIGIN
    assert record.bounds == [
        low[0] + west,
        low[1] + south,
        high[0] + west + 1,
        high[1] + south + 1,
    ]
    assert record.z == [low[2], high[2]]


def test_the_origin_of_the_frame_changes_nothing(make_cloud: Any, memory_store: Any) -> None:
    path = make_cloud("a.las", n=2000, scales=(0.00025, 0.0033, 1 / 3))
    found = []
    for shift in (0, 777, -123_456_789):
        memory_store.pieces.clear()
        memory_store.meta.frame = CoordFrame(origin=(ORIGIN[0] + shift, ORIGIN[1] - shift))
        (record,) = spool(memory_store, path)
        block = gathered(memory_store)
        absolute = block.xyz.astype(np.int64) + np.array(
            [[ORIGIN[0] + shift], [ORIGIN[1] - shift], [0]]
        )
        found.append(
            (absolute.tolist(), record.buckets, record.bounds, record.largest_rounding)
        )
    assert found[0] == found[1] == found[2]
    assert 0 < found[0][3] <= 0.0005


@given(data=st.data())
def test_read_is_stored_and_dropped_by_reason(
    make_cloud_once: Any, data: st.DataObject
) -> None:
    store, path, cloud = make_cloud_once
    x0, y0 = data.draw(st.integers(9_940, 10_040)), data.draw(st.integers(107_960, 108_020))
    width, height = data.draw(st.integers(1, 100)), data.draw(st.integers(1, 100))
    shift = data.draw(st.sampled_from([0, 2**31 - 1, -(2**31)]))
    wanted = [[iy, x0, x0 + width] for iy in range(y0, y0 + height)]
    store.pieces.clear()
    store.meta.frame = CoordFrame(origin=(ORIGIN[0] + shift, ORIGIN[1]))
    records = spool(store, path, wanted=wanted)
    side = 5000  # cells of 50 m, in the file's units
    inside = ((x0 - 10_000) * side <= cloud.X) & ((x0 + width - 10_000) * side > cloud.X)
    inside &= ((y0 - 108_000) * side <= cloud.Y) & ((y0 + height - 108_000) * side > cloud.Y)
    framed = np.abs(cloud.X.astype(np.int64) * 10 - shift) < 2**31
    for record in records:
        assert record.read == record.stored + sum(record.dropped.values())
        assert record.stored == sum(n for _, _, n in record.buckets)
        assert record.dropped.get(OUTSIDE_AREA, 0) == sum(n for _, _, n in record.left)
    assert sum(r.stored for r in records) == np.count_nonzero(inside & framed)
    assert sum(r.dropped.get(OUTSIDE_AREA, 0) for r in records) == np.count_nonzero(
        ~inside & framed
    )
    assert sum(r.dropped.get(BEYOND_FRAME, 0) for r in records) == np.count_nonzero(~framed)


@pytest.fixture(scope="module")
def make_cloud_once(tmp_path_factory: pytest.TempPathFactory) -> Any:
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales, header.offsets = np.full(3, 0.01), np.array([500_000.0, 5_400_000.0, 0.0])
    cloud = laspy.LasData(header)
    rng = np.random.default_rng(5)
    cloud.X, cloud.Y = (
        rng.integers(-200_000, 200_000, 500),
        rng.integers(-150_000, 150_000, 500),
    )
    cloud.Z = np.zeros(500, dtype=np.int32)
    path = tmp_path_factory.mktemp("once") / "a.las"
    cloud.write(path)

    class Store:
        pieces: ClassVar[dict[str, PointBlock]] = {}
        meta = SimpleNamespace(
            frame=CoordFrame(), bucket=Lattice(Fraction(50_000)), has_rgb=False
        )

        def write_piece(self, piece: str, block: PointBlock) -> None:
            self.pieces[piece] = block

    return Store(), path, cloud


@pytest.mark.parametrize("has_rgb", [False, True])
def test_colours_are_decoded_only_for_a_store_that_has_them(
    make_cloud: Any, memory_store: Any, monkeypatch: pytest.MonkeyPatch, has_rgb: bool
) -> None:
    selections = []

    def reader(header: Any, selection: int, **options: Any) -> PointReader:
        selections.append(selection)
        return PointReader(header, selection, **options)

    monkeypatch.setattr("tiler.ingest.spool.PointReader", reader)
    memory_store.meta.frame = CoordFrame(origin=ORIGIN)
    memory_store.meta.has_rgb = has_rgb
    path = make_cloud("a.laz", n=1000, point_format=7, version="1.4")
    spool(memory_store, path)
    assert [selection & COLOURS > 0 for selection in selections] == [has_rgb]
    cloud, block = laspy.read(path), gathered(memory_store)
    np.testing.assert_array_equal(block.xyz, [cloud.X * 10, cloud.Y * 10, cloud.Z * 10])
    if has_rgb:
        np.testing.assert_array_equal(block.rgb, [cloud.red, cloud.green, cloud.blue])


def test_a_piece_without_points_writes_nothing(make_cloud: Any, memory_store: Any) -> None:
    memory_store.meta.frame = CoordFrame(origin=ORIGIN)
    (record,) = spool(memory_store, make_cloud("a.las", n=10), wanted=[])
    assert sum(n for _, _, n in record.left) == record.read == 10
    assert (record.stored, record.outside, record.dropped) == (0, 0, {OUTSIDE_AREA: 10})
    assert (record.buckets, record.bounds, record.z) == ([], None, None)
    assert (record.identity, record.fetched, record.largest_rounding) == ("of k", 0, 0.0)
    assert memory_store.pieces == {}


def test_coordinates_that_are_not_finite_are_dropped(
    make_cloud: Any, memory_store: Any
) -> None:
    path = make_cloud("a.las", n=10)
    data = bytearray(path.read_bytes())
    struct.pack_into("<d", data, 155, 1e306)
    path.write_bytes(data)
    (record,) = spool(memory_store, path)
    assert record.stored == 0
    assert record.dropped["not finite"] == 10


@pytest.mark.parametrize(
    "size", [Fraction(1000), Fraction(10**7), Fraction(1000, 3), Fraction(1)]
)
def test_sorting_by_bucket_is_a_stable_permutation(size: Fraction) -> None:
    rng = np.random.default_rng(1)
    local = rng.integers(-500_000, 500_000, (3, 20_000)).astype(np.int32)
    frame, lattice = CoordFrame(origin=(7, -3)), Lattice(size)
    order, index = sort_by_bucket(local, frame, lattice)
    ix = lattice.index(local[0].astype(np.int64) + 7)
    iy = lattice.index(local[1].astype(np.int64) - 3)
    np.testing.assert_array_equal(order, np.lexsort((ix, iy)))
    expanded = np.repeat([(i, j) for i, j, _ in index], [n for _, _, n in index], axis=0)
    np.testing.assert_array_equal(expanded.T, [ix[order], iy[order]])
