"""Classified clouds: a source file again as LAZ or LAS, equal but for the classes that the run found.

laspy rewrites what it does not keep (text behind a NUL, reserved bytes, counts, dates, bytes between
records); here the header and its records are copied as bytes, the positions in them moved, and only the
points pass through lazrs.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from tiler.core.edits import OF_POINTS
from tiler.core.lattice import Cell
from tiler.core.points import unpack_origin
from tiler.errors import ProcessingError, refused_write
from tiler.export.cloud_statistics import CloudStatistics
from tiler.export.work import WriteClassified
from tiler.io.cloud_reading import digest_of_file, fetched_bytes, open_cloud
from tiler.io.las.columns import LEGACY_CLASS_MASK, class_and_flags, is_legacy, write_classes
from tiler.io.las.headers import LasHeader
from tiler.io.las.reader import EVERYTHING, PointReader, Records, count_decodable, rows_at_once
from tiler.io.las.records import VariableRecord
from tiler.io.las.unchanged import refuse_changed, unchanged
from tiler.io.las.writer import PlainWriter, PointWriter, laszip_vlr
from tiler.io.locations import cloud_path, folder_for, state_of
from tiler.io.partial_files import partial_path, sync_folder
from tiler.store import TileStore, open_store

ROWS_AT_ONCE = 1 << 27
"""Labels held in memory at once, one byte each."""

_CHUNK = 50_000
_STEP = 10 * _CHUNK
_COPY = 1 << 20
_MARK = 0x80
_WAVE_FORMATS = (9, 10)
_COMPRESSED = 0x80
"""Bit of the point format in the header of a LAZ file."""


def write_classified(store_url: str, work: WriteClassified) -> dict[str, Any]:
    """Write one source with its new classes.

    Parameters
    ----------
    store_url : str
    work : WriteClassified
        A label of 0, a point that the store does not hold and one outside of the area keep the source's class.

    Returns
    -------
    dict
        ``points``, ``changed`` (points of another class), ``classes`` (class to points, afterwards),
        ``statistics`` (see `CloudStatistics.to_json`),
        ``bytes``, ``digest`` (of all bytes), ``state`` (see `tiler.io.locations.State`), ``notes`` (list of str).

    Raises
    ------
    InputError
        The source cannot be decoded, or is no longer the one whose points have these classes.
    ProcessingError
        The file cannot be written, or lazrs cannot compress it without loss.
    """
    store = open_store(store_url)
    place, name = os.path.split(work.out)
    with unchanged(cloud_path(work.path), work.stamp, work.salvage) as header, folder_for(place) as folder:
        before = fetched_bytes()
        header = replace(header, point_count=count_decodable(header))  # as it was read, if salvaged
        record = _write(store, header, work, folder / name)
        record["fetched"] = fetched_bytes() - before
    return {**record, "state": state_of(cloud_path(work.out)).to_json()}


def _write(store: TileStore, header: LasHeader, work: WriteClassified, out: Path) -> dict[str, Any]:
    """Write a cloud on this machine; the record of `write_classified`."""
    partial, compressed = partial_path(out), out.suffix.lower() == ".laz"
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        block_bytes = (
            _COPY >> 4 if work.ranges else _COPY << 2
        )  # of a part, little but the header is asked for
        with open_cloud(header.path, block_bytes) as source, open(partial, "w+b") as target:
            notes = _write_front(header, source, target, compressed)
            record = _write_points(header, target, store, work, compressed)
            _write_back(header, source, target)
            target.flush()
            os.fsync(target.fileno())
        refuse_changed(header.path, header.state)
        digest = digest_of_file(partial)
        os.replace(partial, out)
        sync_folder(out.parent)
    except OSError as error:
        raise refused_write(str(out), error, out.parent) from error
    finally:
        partial.unlink(missing_ok=True)
    if record["refused"]:
        notes.append(
            f"{record['refused']} points keep their class: format {header.point_format} has classes 0 to 31"
        )
    return {
        "points": record["points"],
        "changed": record["changed"],
        "classes": record["classes"],
        "statistics": record["statistics"],
        "bytes": out.stat().st_size,
        "digest": digest,
        "notes": notes,
    }


def _kept(records: Sequence[VariableRecord]) -> list[VariableRecord]:
    return [r for r in records if not r.is_copc]


def _write_front(header: LasHeader, source: BinaryIO, target: BinaryIO, compressed: bool) -> list[str]:
    """Header, VLRs and whatever lies between them and the points; returns notes."""
    form = "LAZ" if compressed else "LAS"
    notes = (
        [f"COPC written as plain {form}, without its octree"] if any(v.is_copc for v in header.vlrs) else []
    )
    _copy(source, target, 0, header.header_size)
    written = 0
    laszip_done = not compressed
    for vlr in _kept(header.vlrs):
        if vlr.is_laszip:
            if laszip_done:
                continue
            target.write(laszip_vlr(header))
            laszip_done = True
        else:
            _copy(source, target, vlr.start, vlr.end)
        written += 1
    if not laszip_done:
        target.write(laszip_vlr(header))
        written += 1
    _copy(source, target, header.vlrs[-1].end if header.vlrs else header.header_size, header.points_offset)
    points = target.tell()
    _patch(target, 94, "<HII", header.header_size, points, written)
    _patch(target, 104, "<B", header.point_format | (_COMPRESSED if compressed else 0))
    _patch_counts(header, target)
    target.seek(points)
    return notes


def _patch(target: BinaryIO, position: int, form: str, *values: float) -> None:
    target.seek(position)
    target.write(struct.pack(form, *values))


def _patch_counts(header: LasHeader, target: BinaryIO) -> None:
    """The number of points, where the header's was not what could be read (salvaged files)."""
    target.seek(107)
    (legacy,) = struct.unpack("<I", target.read(4))
    if header.version[1] < 4:
        if legacy != header.point_count:
            _patch(target, 107, "<I", header.point_count)
        return
    target.seek(247)
    (count,) = struct.unpack("<Q", target.read(8))
    if count not in (header.point_count, 0) or (count == 0 and legacy != header.point_count):
        _patch(target, 247, "<Q", header.point_count)
        _patch(target, 107, "<I", header.point_count if legacy else 0)


def _write_points(
    header: LasHeader, target: BinaryIO, store: TileStore, work: WriteClassified, compressed: bool
) -> dict[str, Any]:
    """All records in their order with their new classes."""
    classes = np.zeros(256, dtype=np.int64)
    changed = refused = 0
    channels: set[int] = set()
    statistics = CloudStatistics(header)
    highest = LEGACY_CLASS_MASK if is_legacy(header.point_format) else 255
    step = rows_at_once(header.record_length, _STEP)
    writer = PointWriter(target, header) if compressed else PlainWriter(target)
    spans = work.ranges or [
        (first, min(ROWS_AT_ONCE, header.point_count - first))
        for first in range(0, header.point_count, ROWS_AT_ONCE)
    ]
    with PointReader(header, EVERYTHING, ranges=work.ranges) as reader:
        for first, number in spans:
            last = first + number
            found = collect_labels(store, work, first, last)
            wanted = _inside_area(store, work, first, last) if work.ranges else None
            for start in range(first, last, step):
                stop = min(start + step, last)
                records = reader.read(start, stop - start)
                channels |= _channels(header, records)
                if compressed and len(channels) > 1:
                    raise ProcessingError(
                        f"{header.path}: wave packets of scanner channels {sorted(channels)} in one LAZ file "
                        "would be damaged by the compressor; split the file by channel"
                    )
                before = class_and_flags(records, header.point_format)[0]
                new = found[start - first : stop - first]
                if wanted is not None:
                    inside = wanted[start - first : stop - first]
                    records, before, new = records[inside], before[inside], new[inside]
                refused += int(np.count_nonzero(new > highest))
                chosen = (new != 0) & (new <= highest) & (new != before)
                write_classes(records, header.point_format, new, chosen)
                changed += int(np.count_nonzero(chosen))
                classes += np.bincount(np.where(chosen, new, before), minlength=256)
                statistics.add(records)
                writer.write(records)
    writer.close()
    if work.ranges:
        _patch_window(header, target, statistics)
    histogram = {str(c): int(n) for c, n in enumerate(classes.tolist()) if n}
    return {
        "points": statistics.points,
        "changed": changed,
        "refused": refused,
        "classes": histogram,
        "statistics": statistics.to_json(),
    }


def _patch_window(header: LasHeader, target: BinaryIO, statistics: CloudStatistics) -> None:
    """Counts and bounds of a cloud that holds a part of its source: LAS 1.4, as COPC is."""
    fields = statistics.to_json()["fields"]
    ends = [fields[axis][end] if fields else 0.0 for axis in "XYZ" for end in ("maximum", "minimum")]
    _patch(target, 107, "<6I", *[0] * 6)
    _patch(target, 179, "<6d", *ends)
    _patch(target, 247, "<16Q", statistics.points, *statistics.by_return)
    target.seek(0, os.SEEK_END)


def _channels(header: LasHeader, records: Records) -> set[int]:
    """Scanner channels of records with layered wave packets; empty for other formats.

    lazrs 0.8 loses wave packets where the channel changes within a chunk (what it writes it reads back
    otherwise), in both directions and without a word; all other fields are right.
    """
    if header.point_format not in _WAVE_FORMATS:
        return set()
    return set(np.unique((records["classification_flags"] >> 4) & 3).tolist())


def collect_labels(store: TileStore, work: WriteClassified, first: int, last: int) -> npt.NDArray[np.uint8]:
    """Final classes of the rows ``first`` to ``last`` of a source, uint8; 0 where the store or the area has none."""
    found = np.zeros(last - first, dtype=np.uint8)
    for cell, rows, mine in _rows_inside(store, work, first, last):
        final = store.read_labels(work.labels, cell)
        if work.edits is not None:
            final = _corrected(store, work.edits, cell, final)
        found[rows[mine] - first] = final[mine] & ~np.uint8(_MARK)
    return found


def _inside_area(store: TileStore, work: WriteClassified, first: int, last: int) -> npt.NDArray[np.bool_]:
    """Which of the rows ``first`` to ``last`` of a source the store holds, inside of the area."""
    found = np.zeros(last - first, dtype=np.bool_)
    for _, rows, mine in _rows_inside(store, work, first, last):
        found[rows[mine] - first] = True
    return found


def _rows_inside(
    store: TileStore, work: WriteClassified, first: int, last: int
) -> Iterator[tuple[Cell, npt.NDArray[np.int64], npt.NDArray[np.bool_]]]:
    """Buckets with rows ``first`` to ``last`` of a source inside of the area: cell, all rows, which are these."""
    area = store.area(work.area)
    for cell in work.cells:
        whole = area is None or area.covers(store.meta.bucket.bounds(cell))
        block = store.read_bucket(cell, columns=("origin",) if whole else ("origin", "xyz"))
        if block.origin is None:
            continue
        sources, rows = unpack_origin(block.origin)
        mine = (sources == work.source) & (rows >= first) & (rows < last)
        if area is not None and not whole:
            x, y = (block.xyz[axis].astype(np.int64) + store.meta.frame.origin[axis] for axis in (0, 1))
            mine &= area.inside(x, y)
        if mine.any():
            yield cell, rows, mine


def _corrected(
    store: TileStore, edits: str, cell: Cell, labels: npt.NDArray[np.uint8]
) -> npt.NDArray[np.uint8]:
    """Labels of a bucket as the corrections want them."""
    found = store.edits(edits, store.meta.bucket.bounds(cell), OF_POINTS)
    if found is None:
        return labels
    points = store.read_bucket(cell, ("xyz", "classification", "flags"))
    return found.labels(points, labels, store.meta.frame.origin)


def _write_back(header: LasHeader, source: BinaryIO, target: BinaryIO) -> None:
    """EVLRs, or the waveform packets of LAS 1.3, and the positions of both."""
    target.seek(0, os.SEEK_END)
    if header.version[1] >= 4:
        kept = _kept(header.evlrs)
        begin = target.tell()
        waveform = 0
        for record in kept:
            if record.start == header.waveform_start:
                waveform = target.tell()
            _copy(source, target, record.start, record.end)
        _patch(target, 235, "<QI", begin if kept else 0, len(kept))
        if header.waveform_start:
            _patch(target, 227, "<Q", waveform)
    elif header.version[1] == 3 and header.points_offset < header.waveform_start < header.size:
        begin = target.tell()
        _copy(source, target, header.waveform_start, header.size)
        _patch(target, 227, "<Q", begin)
    target.seek(0, os.SEEK_END)


def _copy(source: BinaryIO, target: BinaryIO, start: int, stop: int) -> None:
    """Bytes ``start`` to ``stop`` of the source, in bounded pieces."""
    source.seek(start)
    left = stop - start
    while left > 0:
        part = source.read(min(left, _COPY))
        if not part:
            raise OSError(f"the source ends at byte {stop - left}")
        target.write(part)
        left -= len(part)
