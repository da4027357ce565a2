"""Classified clouds: a source file again as LAZ, LAS or COPC, equal but for the classes that the run found."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.edits import OF_POINTS
from tiler.core.lattice import Cell
from tiler.core.points import unpack_origin
from tiler.errors import ProcessingError, refused_write
from tiler.export.cloud_frame import patch_window, write_back, write_copc_back, write_copc_front, write_front
from tiler.export.cloud_statistics import CloudStatistics
from tiler.export.work import WriteClassified
from tiler.io.cloud_reading import BLOCK_BYTES, digest_of_file, fetched_bytes, open_cloud
from tiler.io.las.columns import LEGACY_CLASS_MASK, class_and_flags, is_legacy, write_classes
from tiler.io.las.copc_writer import CopcWriter
from tiler.io.las.headers import LasHeader
from tiler.io.las.newer_formats import as_newer, newer_header
from tiler.io.las.reader import EVERYTHING, PointReader, Records, count_decodable, record_dtype, rows_at_once
from tiler.io.las.unchanged import refuse_changed, unchanged
from tiler.io.las.writer import PlainWriter, PointWriter
from tiler.io.locations import cloud_path, folder_for, state_of
from tiler.io.partial_files import partial_path, sync_folder
from tiler.store import SPOOL_CHUNK, KeptRecords, TileStore, open_store

ROWS_AT_ONCE = 1 << 27
"""Labels held in memory at once, one byte each."""

_STEP = SPOOL_CHUNK
"""Records that are read, changed and written at a time: the processor's cache holds them."""
_CHUNKS_A_THREAD = 2
"""Chunks of 65,536 records that each of several threads compresses in a step; at its end they wait for one another."""
_FEW_BYTES = 1 << 14
_MARK = 0x80
_WAVE_FORMATS = (9, 10)


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
    form = newer_header(header) if work.copc else header
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        # Of a part, little but the header is asked for.
        block_bytes = _FEW_BYTES if work.ranges else BLOCK_BYTES
        with open_cloud(header.path, block_bytes) as source, open(partial, "w+b") as target:
            if work.copc:
                notes = write_copc_front(header, source, target, store.meta.frame.crs_wkt)
                with CopcWriter(target, form, str(out.parent)) as copc:
                    record, statistics = _write_points(header, form, copc, store, work)
                    copc.close()
                write_copc_back(header, store.meta.frame.crs_wkt, source, target, copc, statistics)
            else:
                notes = write_front(header, source, target, compressed)
                writer = PointWriter(target, header, work.threads) if compressed else PlainWriter(target)
                record, statistics = _write_points(header, form, writer, store, work)
                writer.close()
                if work.ranges:
                    patch_window(target, statistics)
                write_back(header, source, target)
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
        "points": statistics.points,
        "changed": record["changed"],
        "classes": record["classes"],
        "statistics": statistics.to_json(),
        "bytes": out.stat().st_size,
        "digest": digest,
        "notes": notes,
    }


def _write_points(
    header: LasHeader,
    form: LasHeader,
    writer: PointWriter | PlainWriter | CopcWriter,
    store: TileStore,
    work: WriteClassified,
) -> tuple[dict[str, Any], CloudStatistics]:
    """All records in their order with their new classes, in the form of another header."""
    classes = np.zeros(256, dtype=np.int64)
    changed = refused = 0
    channels: set[int] = set()
    statistics = CloudStatistics(form)
    highest = LEGACY_CLASS_MASK if is_legacy(form.point_format) else 255
    at_once = _STEP if work.threads == 1 else _STEP * _CHUNKS_A_THREAD * work.threads
    step = rows_at_once(max(header.record_length, form.record_length), at_once)
    with _reader(store, header, work) as reader:
        for ranges in _spans(work.ranges or [(0, header.point_count)]):
            first, last = ranges[0][0], ranges[-1][1]
            found = collect_labels(store, work, first, last)
            wanted = _inside_area(store, work, first, last) if work.ranges else None
            for start, stop in (
                (s, min(s + step, end)) for begin, end in ranges for s in range(begin, end, step)
            ):
                records = reader.read(start, stop - start)
                if isinstance(writer, PointWriter):
                    channels |= _channels(header, records)
                if len(channels) > 1:
                    raise ProcessingError(
                        f"{header.path}: wave packets of scanner channels {sorted(channels)} in one LAZ file "
                        "would be damaged by the compressor; split the file by channel"
                    )
                records = as_newer(records, header.point_format) if work.copc else records
                before = class_and_flags(records, form.point_format)[0]
                new = found[start - first : stop - first]
                if wanted is not None:
                    inside = wanted[start - first : stop - first]
                    records, before, new = records[inside], before[inside], new[inside]
                refused += int(np.count_nonzero(new > highest))
                chosen = (new != 0) & (new <= highest) & (new != before)
                write_classes(records, form.point_format, new, chosen)
                changed += int(np.count_nonzero(chosen))
                classes += np.bincount(np.where(chosen, new, before), minlength=256)
                statistics.add(records)
                writer.write(records)
    histogram = {str(c): int(n) for c, n in enumerate(classes.tolist()) if n}
    record = {"changed": changed, "refused": refused, "classes": histogram}
    return record, statistics


def _reader(
    store: TileStore, header: LasHeader, work: WriteClassified
) -> AbstractContextManager[KeptRecords | PointReader]:
    """The records that the store kept as they were decoded; else the source is decoded once more."""
    kept = None
    if work.pieces and not work.ranges:
        dtype = record_dtype(header.point_format, header.record_length)
        kept = store.records(work.pieces, header.point_count, dtype)
    return PointReader(header, EVERYTHING, ranges=work.ranges or None) if kept is None else nullcontext(kept)


def _spans(ranges: Iterable[tuple[int, int]]) -> Iterator[list[tuple[int, int]]]:
    """Ranges (start, count) of rows as (first, end), those together that lie within `ROWS_AT_ONCE` rows.

    The buckets are read once for what is together: the nodes of an octree are many, and may be small.
    """
    together: list[tuple[int, int]] = []
    for start, count in ranges:
        for first in range(start, start + count, ROWS_AT_ONCE):
            end = min(first + ROWS_AT_ONCE, start + count)
            if together and end - together[0][0] > ROWS_AT_ONCE:
                yield together
                together = []
            together.append((first, end))
    if together:
        yield together


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
    """Buckets with rows ``first`` to ``last`` of a source inside of the area: cell, rows of its points, which count."""
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
    """Labels of a bucket after the corrections."""
    found = store.edits(edits, store.meta.bucket.bounds(cell), OF_POINTS)
    if found is None:
        return labels
    points = store.read_bucket(cell, ("xyz", "classification", "flags"))
    return found.labels(points, labels, store.meta.frame.origin)
