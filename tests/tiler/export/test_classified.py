from __future__ import annotations

import math
import os
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from tests.scenes.las15 import as_las15
from tiler.core.lattice import Cell
from tiler.core.points import PointBlock, pack_origin
from tiler.errors import InputError, ProcessingError
from tiler.export import classified
from tiler.export.classified import write_classified
from tiler.export.output_files import CloudCopy, CloudRecord
from tiler.ingest.spool import SpoolPiece, spool_piece
from tiler.inputs import inspect, pieces
from tiler.io.las.field_sums import layers_with_fields
from tiler.io.las.headers import LasHeader, read_header, read_payload
from tiler.io.las.layout import checked_layers
from tiler.io.las.reader import CLASS_LAYERS, EVERYTHING, PointReader
from tiler.io.las.writers import PointWriter
from tiler.store import KeptPiece, TileStore

ALL_FORMATS = [
    (f, v)
    for f in range(11)
    for v in ("1.2", "1.3", "1.4")
    if f <= {"1.2": 3, "1.3": 5, "1.4": 10}[v]
]


def label(store: Any, labels: dict[int, int], source: int = 4) -> tuple[Cell, ...]:
    """Put labels of rows into two buckets of the store, among points of another source, marks set."""
    cells = (Cell(0, 0), Cell(1, 0))
    for k, cell in enumerate(cells):
        rows = np.array([r for r in labels if r % 2 == k][::-1], dtype=np.int64)
        origin = np.concatenate((pack_origin(source, rows), pack_origin(source + 1, rows)))
        values = np.array([labels[int(r)] for r in rows] + [9] * len(rows), dtype=np.uint8)
        values[::3] |= 0x80
        store.written[cell] = PointBlock(np.zeros((3, len(origin)), np.int32), origin=origin)
        store.labels["final", cell] = values
    return cells


def export(
    store: Any, path: Path, out: Path, cells: tuple[Cell, ...], **options: Any
) -> CloudRecord:
    cloud = CloudCopy(
        path=str(path), source=4, out=str(out), labels="final", cells=cells, **options
    )
    return write_classified(store, cloud=cloud)


def raw_records(path: Path, header: LasHeader, extended: bool) -> list[bytes]:
    data = path.read_bytes()
    records = header.evlrs if extended else header.vlrs
    return [data[r.start : r.end] for r in records if not r.is_laszip and not r.is_copc]


def decoded(path: Path) -> np.ndarray:
    header = read_header(path)
    with PointReader(header, EVERYTHING) as reader:
        return reader.read(0, header.point_count).copy()


def without_class(records: np.ndarray, point_format: int) -> bytes:
    records = records.copy()
    if point_format < 6:
        records["raw_classification"] &= 0xE0
    else:
        records["classification"] = 0
    return records.tobytes()


def assert_equal_but_classes(source: Path, out: Path) -> None:
    """Header fields, records, bytes between them and points of two files."""
    one, two = read_header(source), read_header(out)
    assert without_class(decoded(source), one.point_format) == without_class(
        decoded(out), two.point_format
    )
    assert raw_records(source, one, False) == raw_records(out, two, False)
    assert raw_records(source, one, True) == raw_records(out, two, True)
    a, b = source.read_bytes()[: one.header_size], out.read_bytes()[: two.header_size]
    moved = {*range(96, 105), *(range(227, 247) if one.version[1] >= 3 else ())}
    assert [i for i in range(one.header_size) if a[i] != b[i] and i not in moved] == []
    gap = source.read_bytes()[
        one.vlrs[-1].end if one.vlrs else one.header_size : one.points_offset
    ]
    assert out.read_bytes()[: two.points_offset].endswith(gap)


@pytest.mark.parametrize(
    ("suffix", "to"), [("las", "laz"), ("laz", "laz"), ("laz", "las"), ("las", "las")]
)
@pytest.mark.parametrize(("point_format", "version"), ALL_FORMATS)
def test_all_but_the_classes_is_equal(
    make_cloud: Any,
    memory_store: Any,
    tmp_path: Path,
    point_format: int,
    version: str,
    suffix: str,
    to: str,
) -> None:
    evlr = b"waves" * 100 if version == "1.4" else None
    path = make_cloud(
        f"a.{suffix}", point_format=point_format, version=version, extra=True, evlr=evlr
    )
    labels = {row: 1 + row % 2 for row in range(100, 900)}
    labels[500] = 0
    out = tmp_path / "out" / "deep" / f"a.{to}"
    record = export(memory_store, path, out, label(memory_store, labels))
    assert (read_header(out).laz is not None) == (to == "laz")
    assert_equal_but_classes(path, out)
    before, after = (
        np.asarray(laspy.read(path).classification),
        np.asarray(laspy.read(out).classification),
    )
    expected = before.copy()
    for row, value in labels.items():
        expected[row] = 2 if value == 2 else before[row] if value == 0 or before[row] > 2 else 1
    np.testing.assert_array_equal(after, expected)
    kept = before[[row for row, value in labels.items() if value == 1 and before[row] > 2]]
    assert record.kept == {str(code): int(n) for code, n in enumerate(np.bincount(kept)) if n}
    assert record.points == 1000
    assert record.changed == np.count_nonzero(before != expected)
    assert record.bytes == out.stat().st_size
    assert sum(record.classes.values()) == 1000
    # Points of class 2 without a label, or with the label 0, are not ground of the run.
    assert record.ground == sum(value == 2 for value in labels.values())
    assert record.classes.get("2", 0) == np.count_nonzero(expected == 2)
    assert [p.name for p in out.parent.iterdir()] == [f"a.{to}"]


@pytest.mark.parametrize("version", ["1.2", "1.4"])
def test_missing_bounds_are_written_from_the_points(
    make_cloud: Any, memory_store: Any, tmp_path: Path, version: str
) -> None:
    path = make_cloud("a.las", version=version)
    data = bytearray(path.read_bytes())
    struct.pack_into("<6d", data, 179, *[math.nan] * 6)
    path.write_bytes(data)
    assert inspect(path).notes == ()
    out = tmp_path / "out" / "a.laz"
    export(memory_store, path, out, label(memory_store, {1: 2}))
    header, xyz = read_header(out), laspy.read(path).xyz
    assert header.mins == pytest.approx(tuple(xyz.min(axis=0)))
    assert header.maxs == pytest.approx(tuple(xyz.max(axis=0)))
    assert without_class(decoded(path), 3) == without_class(decoded(out), 3)


@pytest.mark.parametrize("to", ["las", "laz"])
@pytest.mark.parametrize("offset", [None, 1500])
def test_las_1_5_comes_back_as_las_1_5(
    make_cloud: Any, memory_store: Any, tmp_path: Path, to: str, offset: int | None
) -> None:
    path = make_cloud("a.las", point_format=7, version="1.4", extra=True, evlr=b"more")
    as_las15(path, 12.5, 99.0, offset)
    out = tmp_path / f"b.{to}"
    export(
        memory_store, path, out, label(memory_store, {row: 1 + row % 2 for row in range(1000)})
    )
    header = read_header(out)
    assert (header.version, header.gps_times, header.time_offset) == (
        (1, 5),
        (12.5, 99.0),
        offset,
    )
    assert_equal_but_classes(path, out)


def test_las_1_5_is_read_alike_by_an_independent_reader(
    make_cloud: Any, memory_store: Any, tmp_path: Path
) -> None:
    path = make_cloud("a.las", point_format=6, version="1.4")
    as_las15(path, 12.5, 99.0)
    out = tmp_path / "b.laz"
    export(memory_store, path, out, label(memory_store, dict.fromkeys(range(1000), 2)))
    if not hasattr(laspy.LasHeader(), "min_gps_time"):
        pytest.skip("this laspy does not know the header of LAS 1.5")
    found = laspy.read(out)
    assert (found.header.min_gps_time, found.header.max_gps_time) == (12.5, 99.0)
    assert (np.asarray(found.classification) == 2).all()


def test_offset_times_of_las_1_5_become_standard_times_in_copc(
    make_cloud: Any, memory_store: Any, tmp_path: Path
) -> None:
    path = make_cloud("a.las", point_format=6, version="1.4")
    times = laspy.read(path).gps_time
    as_las15(path, 0.0, 1e6, 1250)
    out = tmp_path / "b.copc.laz"
    record = export(memory_store, path, out, (), copc=True)
    found = laspy.read(out)
    assert str(found.header.version) == "1.4"
    np.testing.assert_allclose(
        np.sort(found.gps_time), np.sort(times) + 250e6, rtol=0, atol=1e-3
    )
    assert record.notes[:2] == [
        "range of GPS times in the header left out: COPC is LAS 1.4",
        "GPS times written with an offset of 1000 million seconds, as COPC has them, instead of 1250",
    ]


ODD = (
    "1.0_0.las", "4_6_crop.las", "bad_vlr_count.las", "epsg_4326.las", "extra.laz", "fullwave.laz",
    "file_with_both_wkt_and_geotiff_vlrs.las", "gps-time-nan.las", "no-points.las", "simple1_3.las",
    "vegetation_1_3.las", "warsaw_small.las",
)  # fmt: skip


@pytest.mark.parametrize("name", ODD)
def test_odd_files_come_back_whole(
    shared_data: Path, memory_store: Any, tmp_path: Path, name: str
) -> None:
    path = shared_data / "odd" / name
    for out in (tmp_path / "o.laz", tmp_path / "o.las"):
        export(memory_store, path, out, label(memory_store, {0: 2}))
        assert_equal_but_classes(path, out)
        if name != "no-points.las":
            assert laspy.read(out).classification[0] == 2


def test_waveform_packets_of_las_1_3_move_with_their_position(
    shared_data: Path, memory_store: Any, tmp_path: Path
) -> None:
    path = shared_data / "odd" / "simple1_3.las"
    out = tmp_path / "w.laz"
    export(memory_store, path, out, ())
    old, new = read_header(path), read_header(out)
    packets = path.read_bytes()[old.waveform_start :]
    assert len(packets) == 160
    assert out.read_bytes()[new.waveform_start :] == packets


def test_waveform_packets_of_las_1_4_are_an_evlr(
    make_cloud: Any, memory_store: Any, tmp_path: Path
) -> None:
    path = make_cloud("w.las", point_format=9, version="1.4", evlr=b"packets")
    header = read_header(path)
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, 227, header.evlrs[0].start)
    path.write_bytes(data)
    out = tmp_path / "w.laz"
    export(memory_store, path, out, ())
    new = read_header(out)
    assert new.waveform_start == new.evlrs[0].start
    assert read_payload(out, new.evlrs[0]) == b"packets"


def test_copc_becomes_plain_laz(shared_data: Path, memory_store: Any, tmp_path: Path) -> None:
    path = shared_data / "odd" / "simple.copc.laz"
    out = tmp_path / "c.laz"
    record = export(memory_store, path, out, label(memory_store, {0: 2, 1064: 2}))
    assert "COPC" in record.notes[0]
    header = read_header(out)
    assert not any(r.is_copc for r in (*header.vlrs, *header.evlrs))
    assert header.evlrs == ()
    assert_equal_but_classes(path, out)
    assert np.asarray(laspy.read(out).classification)[[0, 1064]].tolist() == [2, 2]


def test_rows_in_several_ranges_and_steps(
    make_cloud: Any, memory_store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(classified, "ROWS_PER_BATCH", 300)
    monkeypatch.setattr(classified, "_STEP", 70)
    path = make_cloud("a.laz")
    labels = {row: 1 + row % 2 for row in range(1000)}
    out = tmp_path / "r.laz"
    export(memory_store, path, out, label(memory_store, labels), reclass="all")
    assert np.asarray(laspy.read(out).classification).tolist() == [
        labels[r] for r in range(1000)
    ]
    assert_equal_but_classes(path, out)


def test_a_salvaged_file_says_how_many_points_it_has(
    make_cloud: Any, memory_store: Any, tmp_path: Path
) -> None:
    for point_format, version in ((3, "1.2"), (6, "1.4")):
        path = make_cloud("cut.las", point_format=point_format, version=version)
        path.write_bytes(path.read_bytes()[:-100])
        with pytest.raises(InputError):
            export(memory_store, path, tmp_path / "no.laz", ())
        out = tmp_path / "cut.laz"
        kept = export(memory_store, path, out, (), salvage=True).points
        assert 990 < kept < 1000
        assert laspy.read(out).header.point_count == kept == len(laspy.read(out))


@pytest.mark.parametrize("point_format", [1, 7])
def test_a_cut_laz_is_written_up_to_its_last_whole_chunk(
    make_cloud: Any, memory_store: Any, tmp_path: Path, point_format: int
) -> None:
    path = make_cloud("cut.laz", n=60_000, point_format=point_format, version="1.4")
    path.write_bytes(path.read_bytes()[:-20_000])
    out = tmp_path / "out.laz"
    assert export(memory_store, path, out, (), salvage=True).points == 50_000
    assert len(laspy.read(out)) == 50_000


def test_the_same_bytes_each_time(make_cloud: Any, memory_store: Any, tmp_path: Path) -> None:
    path = make_cloud("a.laz", point_format=7, version="1.4")
    cells = label(memory_store, dict.fromkeys(range(500), 2))
    export(memory_store, path, tmp_path / "1.laz", cells)
    export(memory_store, path, tmp_path / "2.laz", cells)
    assert (tmp_path / "1.laz").read_bytes() == (tmp_path / "2.laz").read_bytes()


def test_two_threads_write_the_same_bytes(
    make_cloud: Any, memory_store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RAYON_NUM_THREADS", "2")
    monkeypatch.setattr(classified, "_STEP", 30_000)
    path = make_cloud("a.laz", point_format=7, version="1.4", n=120_001)
    cells = label(memory_store, dict.fromkeys(range(500), 2))
    export(memory_store, path, tmp_path / "1.laz", cells)
    export(memory_store, path, tmp_path / "2.laz", cells, threads=2)
    assert (tmp_path / "1.laz").read_bytes() == (tmp_path / "2.laz").read_bytes()


@pytest.mark.parametrize("point_format", [6, 7, 8, 9, 10])
def test_copied_layers_give_the_bytes_of_compressing_all(
    make_cloud: Any,
    memory_store: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    point_format: int,
) -> None:
    def standard_times(cloud: laspy.LasData) -> None:
        cloud.header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD

    path = make_cloud(
        "a.laz",
        point_format=point_format,
        version="1.4",
        n=60_000,
        extra=True,
        evlr=b"more",
        edit=standard_times,
    )
    cells = label(memory_store, {row: row // 7 % 4 for row in range(0, 60_000, 2)})

    def refuse(*_: Any) -> None:
        pytest.fail("all layers are compressed")

    with monkeypatch.context() as context:
        context.setattr(PointWriter, "write", refuse)
        copied = export(memory_store, path, tmp_path / "1.laz", cells)
    monkeypatch.setattr(classified, "has_class_layer", lambda header: False)
    compressed = export(memory_store, path, tmp_path / "2.laz", cells)
    assert (tmp_path / "1.laz").read_bytes() == (tmp_path / "2.laz").read_bytes()
    assert replace(copied, state=None) == replace(compressed, state=None)
    assert copied.statistics["gps"] is not None


@pytest.mark.parametrize("time_type", ["STANDARD", "WEEK_TIME"])
@pytest.mark.parametrize("point_format", [6, 7, 8, 9, 10])
def test_kept_classes_give_what_another_decode_gives(
    make_cloud: Any,
    small_store: TileStore,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    point_format: int,
    time_type: str,
) -> None:
    def times(cloud: laspy.LasData) -> None:
        # laspy 2.5 toggles the bit of a type that is given again.
        encoding, kind = cloud.header.global_encoding, laspy.header.GpsTimeType[time_type]
        encoding.value = encoding.value & ~encoding.GPS_TIME_TYPE_MASK | int(kind)

    n = 120_000
    path = make_cloud("a.laz", point_format=point_format, version="1.4", n=n, edit=times)
    kept = []
    for number, (start, count) in enumerate(pieces(inspect(path), 50_000)):
        work = SpoolPiece(
            str(path), 4, f"p{number}", start, count, keep=True, classes_only=True, identity="x"
        )
        record = spool_piece(small_store, work=work)
        kept.append(KeptPiece(f"p{number}", start, count, "x", record.sums))
    assert len(kept) > 1
    labels = (np.arange(n) // 7 % 4).astype(np.uint8)
    monkeypatch.setattr(
        classified, "collect_labels", lambda store, cloud, first, last: labels[first:last]
    )
    selections = []

    def reader(header: LasHeader, selection: int, **options: Any) -> PointReader:
        selections.append(selection)
        return PointReader(header, selection, **options)

    monkeypatch.setattr(classified, "PointReader", reader)
    out = tmp_path / "b.laz"
    written = []
    for given in (tuple(kept), tuple(kept), ()):
        record = export(small_store, path, out, (), pieces=given)
        written.append((out.read_bytes(), replace(record, state=None)))
        small_store.drop_records()
        out.unlink()
    assert written[0] == written[1] == written[2]
    assert selections == [CLASS_LAYERS, layers_with_fields(read_header(path))]
    assert (written[0][1].statistics["gps"] is not None) == (time_type == "STANDARD")


def test_a_failure_leaves_no_file(
    make_cloud: Any, memory_store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ProcessingError, match="No space left"):
        export(memory_store, make_cloud("a.las"), tmp_path / "out" / "a.laz", ())
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("point_format", [9, 10])
def test_wave_packets_of_several_channels_are_refused_not_damaged(
    make_cloud: Any, memory_store: Any, tmp_path: Path, point_format: int
) -> None:
    def two_channels(cloud: laspy.LasData) -> None:
        cloud.points.array["classification_flags"][::2] |= 0x10

    path = make_cloud("w.las", point_format=point_format, version="1.4", edit=two_channels)
    with pytest.raises(ProcessingError, match=r"scanner channels \[0, 1\]"):
        export(memory_store, path, tmp_path / "out" / "w.laz", ())
    assert list((tmp_path / "out").iterdir()) == []


def test_nodes_that_lie_together_share_what_is_read_of_the_store(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(classified, "ROWS_PER_BATCH", 10)
    ranges = [(0, 3), (4, 2), (9, 4), (30, 25)]
    spans = list(classified._spans(ranges))
    assert spans == [[(0, 3), (4, 6)], [(9, 13)], [(30, 40)], [(40, 50)], [(50, 55)]]


@pytest.mark.parametrize("point_format", [9, 10])
def test_wave_packets_of_several_channels_are_copied(
    make_cloud: Any, memory_store: Any, tmp_path: Path, point_format: int
) -> None:
    def two_channels(cloud: laspy.LasData) -> None:
        cloud.points.array["classification_flags"][::2] |= 0x10

    path = make_cloud("w.laz", point_format=point_format, version="1.4", edit=two_channels)
    out = tmp_path / "out" / "w.laz"
    export(memory_store, path, out, label(memory_store, dict.fromkeys(range(500), 2)))
    (before, old), (after, new) = map(layers, (path, out))
    assert before[:16] + before[17:] == after[:16] + after[17:]
    assert [number for number, layer in enumerate(old) if layer != new[number]] == [2]
    assert laspy.read(out).classification[:500].tolist() == [2] * 500


def layers(path: Path) -> tuple[bytes, list[bytes]]:
    """The first record and the layers of a cloud of one chunk."""
    header = read_header(path)
    assert header.laz is not None
    start = header.points_offset + 8
    with open(path, "rb") as file:
        sizes = checked_layers(file, header.laz, 0, start)
        file.seek(start)
        record = file.read(header.record_length)
        file.seek(start + header.laz.min_chunk)
        return record, [file.read(size) for size in sizes]
