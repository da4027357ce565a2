"""Writing of classified clouds: copies of the sources as LAZ, LAS or COPC, with the classes of the run."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from ptd.arrays import Bool, Indices, Int32, Int64, UInt8
from tiler.core.edits import OF_POINTS
from tiler.core.lattice import Cell
from tiler.core.points import (
    GROUND,
    LOW_NOISE,
    UNCERTIFIED_BIT,
    UNCLASSIFIED,
    WATER_BIT,
    WITHOUT_OBJECT,
    unpack_origin,
    written_classes,
)
from tiler.core.records import KnownSums
from tiler.errors import ProcessingError, write_error
from tiler.export.cloud_frame import (
    CloudStatistics,
    new_crs,
    patch_bounds,
    patch_counts_and_bounds,
    write_back,
    write_copc_back,
    write_copc_front,
    write_front,
)
from tiler.export.output_files import CloudCopy, CloudRecord, NewClasses
from tiler.io.atomic_files import (
    clear_partial,
    partial_path,
    replace_different,
    sync_folder,
)
from tiler.io.cloud_formats import open_cloud
from tiler.io.cloud_reading import BLOCK_BYTES, digest_of_file, fetched_bytes
from tiler.io.las.field_sums import layers_with_fields
from tiler.io.las.headers import LasHeader
from tiler.io.las.point_formats import (
    as_standard_times,
    class_and_flags,
    upgrade_records,
    upgraded_header,
    write_classes,
)
from tiler.io.las.reader import (
    CLASS_LAYERS,
    EVERYTHING,
    PointReader,
    Records,
    count_decodable,
    record_dtype,
    rows_at_once,
    unchanged,
    validate_unchanged,
)
from tiler.io.las.writers import (
    CLASS_RECORD,
    ClassWriter,
    CopcWriter,
    PlainWriter,
    PointWriter,
    has_class_layer,
    laszip_vlr,
)
from tiler.io.locations import as_path, is_url, staging_folder, state_of
from tiler.store import SPOOL_CHUNK, KeptRecords, TileStore

ROWS_PER_BATCH = 1 << 27
"""Maximum number of labels in memory, of one byte each."""

_STEP = SPOOL_CHUNK
"""Number of records that are read, changed and written together, so that they fit into the
processor's cache."""
_CHUNKS_A_THREAD = 2
"""Number of chunks of 65,536 records that each thread compresses per step. Threads wait for
each other at its end."""
WATER_RISE_M = 1.0
"""Height above the water level from which an object, such as a tree over a bank, is not
water."""
WATER_LOW_M = 0.5
"""Depth below the water level from which returns are noise, since waves are lower."""
_FEW_BYTES = 1 << 14
"""Size of the blocks that are read if only a part of the points is needed."""
_WAVE_FORMATS = (9, 10)
"""Point formats with wave packets in layers."""


def write_classified(store: TileStore, *, cloud: CloudCopy) -> CloudRecord:
    """Write a copy of a source with its new classes.

    Parameters
    ----------
    store : TileStore
    cloud : CloudCopy
        A point keeps the source's class if its label is 0, the store does not hold it, or it lies outside the area.
        `tiler.core.points.written_classes` gives the classes of the other points.

    Returns
    -------
    CloudRecord
        Record of the file.

    Raises
    ------
    InputError
        The source cannot be decoded, or was changed since the run read it.
    ProcessingError
        The file cannot be written, or lazrs cannot compress it without loss.
    """
    target_folder, name = os.path.split(cloud.out)
    with (
        unchanged(as_path(cloud.path), cloud.stamp, cloud.salvage) as header,
        staging_folder(target_folder) as folder,
    ):
        bytes_before = fetched_bytes()
        # A salvaged file has fewer points than its header states.
        header = replace(header, point_count=count_decodable(header))
        record = _write(store, header, cloud, folder / name)
        n_fetched = fetched_bytes() - bytes_before
    state = state_of(as_path(cloud.out)).to_json()
    return replace(record, fetched=n_fetched, state=state)


def _write(store: TileStore, header: LasHeader, cloud: CloudCopy, out: Path) -> CloudRecord:
    """Write a cloud on this machine and return its record without ``fetched`` and ``state``."""
    partial = partial_path(out)
    form = upgraded_header(header) if cloud.copc else header
    crs = new_crs(header, cloud, store.meta.frame.crs_wkt)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        clear_partial(partial)
        block_bytes = BLOCK_BYTES
        if cloud.ranges:  # Only a part of the file is read.
            block_bytes = _FEW_BYTES
        with open_cloud(header.path, block_bytes) as source, open(partial, "x+b") as target:
            if cloud.copc:
                notes = write_copc_front(header, source, target, crs)
                with CopcWriter(target, form, str(out.parent)) as copc:
                    counts, statistics = _write_points(header, form, copc, store, cloud)
                    copc.close()
                write_copc_back(header, source, target, crs, copc, statistics)
            else:
                laszip = _laszip_record(header, cloud)
                notes = write_front(header, source, target, laszip, crs)
                writer = _writer(header, cloud, source, target)
                counts, statistics = _write_points(header, form, writer, store, cloud)
                writer.close()
                if cloud.ranges:
                    patch_counts_and_bounds(target, statistics)
                elif not header.has_bounds:
                    patch_bounds(target, statistics)
                write_back(header, source, target, crs)
            target.flush()
            os.fsync(target.fileno())
        validate_unchanged(header.path, header.state)
        digest = digest_of_file(partial)
        replace_different(partial, out)
        sync_folder(out.parent)
    except OSError as error:
        raise write_error(str(out), error, out.parent) from error
    finally:
        partial.unlink(missing_ok=True)
    return CloudRecord(
        points=statistics.points,
        changed=counts.n_changed,
        classes=counts.written,
        kept=counts.kept,
        ground=counts.n_ground,
        statistics=statistics.to_json(),
        bytes=out.stat().st_size,
        digest=digest,
        notes=notes,
    )


def _is_compressed(cloud: CloudCopy) -> bool:
    """Return whether a cloud is written as LAZ, by its suffix."""
    return os.path.splitext(cloud.out)[1].lower() == ".laz"


def _copies_layers(header: LasHeader, cloud: CloudCopy) -> bool:
    """Return whether only the classes of a cloud are encoded, and the other layers copied as bytes.

    From a URL, all bytes would be fetched a second time.
    """
    return (
        _is_compressed(cloud)
        and not cloud.copc
        and not cloud.ranges
        and not is_url(as_path(cloud.path))
        and has_class_layer(header)
    )


def _laszip_record(header: LasHeader, cloud: CloudCopy) -> bytes | None:
    """Return the laszip record of a cloud, or None if it is written as LAS."""
    if not _is_compressed(cloud):
        return None
    if header.laz is not None and _copies_layers(header, cloud):
        return laszip_vlr(header, chunk_points=header.laz.chunk_size)
    return laszip_vlr(header)


def _writer(
    header: LasHeader, cloud: CloudCopy, source: BinaryIO, target: BinaryIO
) -> PointWriter | PlainWriter | ClassWriter:
    """Return the writer of the points of a LAZ or LAS file."""
    if not _is_compressed(cloud):
        return PlainWriter(target)
    if _copies_layers(header, cloud):
        return ClassWriter(target, source, header)
    return PointWriter(target, header, cloud.threads)


def _write_points(
    header: LasHeader,
    form: LasHeader,
    writer: PointWriter | PlainWriter | CopcWriter | ClassWriter,
    store: TileStore,
    cloud: CloudCopy,
) -> tuple[_WrittenClasses, CloudStatistics]:
    """Write all records in their order, with new classes and in the format of the header ``form``."""
    table = written_classes(cloud.reclass)
    # number of points for each label and class of the source
    pairs = np.zeros(table.size, dtype=np.int64)
    channels: set[int] = set()
    statistics = CloudStatistics(form)
    at_once = _STEP
    if cloud.threads > 1 and not isinstance(writer, ClassWriter):
        at_once *= _CHUNKS_A_THREAD * cloud.threads
    step = rows_at_once(max(header.record_length, form.record_length), at_once)
    layers = EVERYTHING
    known: list[KnownSums] = []
    if isinstance(writer, ClassWriter):
        known = _known_sums(header, cloud)
        layers = CLASS_LAYERS if known else layers_with_fields(header)
    for sums in known:
        statistics.join(sums)
    add = statistics.add_classes if known else statistics.add
    with _reader(store, header, cloud, layers) as reader:
        for ranges in _spans(cloud.ranges or [(0, header.point_count)]):
            first, last = ranges[0][0], ranges[-1][1]
            span_labels = collect_labels(store, cloud, first, last)
            in_area = _inside_area(store, cloud, first, last) if cloud.ranges else None
            for start, stop in _steps(ranges, step):
                records = reader.read(start, stop - start)
                if isinstance(writer, PointWriter):
                    channels |= _channels(header, records)
                if len(channels) > 1:
                    raise ProcessingError(
                        f"{header.path}: wave packets of scanner channels {sorted(channels)} in one LAZ file "
                        "would be damaged by the compressor; split the file by channel"
                    )
                if cloud.copc:
                    records = upgrade_records(
                        as_standard_times(records, header), header.point_format
                    )
                labels = span_labels[start - first : stop - first]
                if in_area is not None:
                    inside = in_area[start - first : stop - first]
                    records, labels = records[inside], labels[inside]
                old_classes = class_and_flags(records, form.point_format)[0]
                pair = labels.astype(np.intp) * len(table) + old_classes
                pairs += np.bincount(pair, minlength=table.size)
                new = table.ravel()[pair]
                write_classes(records, form.point_format, new, new != old_classes)
                add(records)
                writer.write(records)
    return _counts(pairs.reshape(table.shape), table), statistics


def _steps(ranges: Iterable[tuple[int, int]], step: int) -> Iterator[tuple[int, int]]:
    """Cut ranges (first, end) of rows into pieces of at most ``step`` rows."""
    for first, end in ranges:
        for start in range(first, end, step):
            yield start, min(start + step, end)


class _WrittenClasses(NamedTuple):
    """Numbers of points with a new class, of all points and of those that keep their class, and of ground points."""

    n_changed: int
    written: dict[str, int]
    kept: dict[str, int]
    n_ground: int


def _counts(pairs: Int64, table: UInt8) -> _WrittenClasses:
    """Count the points of a classified cloud by class.

    ``pairs`` has the number of points, and ``table`` the new class, by label (row) and class of the source (column).
    """
    source_classes = np.arange(len(table))
    kept = pairs[[UNCLASSIFIED, UNCLASSIFIED | WATER_BIT]].sum(axis=0) * (
        table[UNCLASSIFIED] == source_classes
    )
    kept[list(WITHOUT_OBJECT)] = 0
    classes = np.zeros(len(table), np.int64)
    np.add.at(classes, table.ravel(), pairs.ravel())
    n_changed = int(pairs[table != source_classes].sum())
    # Points without a label keep class 2 of their source, but the run did not find them.
    of_ground = [GROUND, GROUND | WATER_BIT]
    n_ground = int(pairs[of_ground][table[of_ground] == GROUND].sum())
    return _WrittenClasses(n_changed, _histogram(classes), _histogram(kept), n_ground)


def _histogram(counts: Int64) -> dict[str, int]:
    """Return the number of points by class, without empty classes."""
    return {str(c): n for c, n in enumerate(counts.tolist()) if n}


def _known_sums(header: LasHeader, cloud: CloudCopy) -> list[KnownSums]:
    """Return the sums of the fields of all pieces of a source, or [] if they are not known."""
    sums = [piece.sums for piece in cloud.pieces if piece.sums is not None]
    n_points = sum(piece.count for piece in cloud.pieces)
    return sums if len(sums) == len(cloud.pieces) and n_points == header.point_count else []


def _reader(
    store: TileStore, header: LasHeader, cloud: CloudCopy, layers: int
) -> AbstractContextManager[KeptRecords | PointReader]:
    """Return the decoded records that the store kept, or a reader of ``layers`` of the source if it kept none.

    Of `CLASS_LAYERS`, only the fields of `CLASS_RECORD` are kept.
    """
    if cloud.pieces and not cloud.ranges:
        dtype = record_dtype(header.point_format, header.record_length)
        if layers == CLASS_LAYERS:
            dtype = CLASS_RECORD
        kept = store.records(cloud.pieces, header.point_count, dtype)
        if kept is not None:
            return nullcontext(kept)
    return PointReader(header, layers, ranges=cloud.ranges or None)


def _spans(ranges: Iterable[tuple[int, int]]) -> Iterator[list[tuple[int, int]]]:
    """Group ranges of rows, (start, count), into lists of (first, end) that span at most `ROWS_PER_BATCH` rows.

    An octree has many small nodes, so the buckets are read once per group and not once per
    node.
    """
    together: list[tuple[int, int]] = []
    for start, count in ranges:
        for first in range(start, start + count, ROWS_PER_BATCH):
            end = min(first + ROWS_PER_BATCH, start + count)
            if together and end - together[0][0] > ROWS_PER_BATCH:
                yield together
                together = []
            together.append((first, end))
    if together:
        yield together


def _channels(header: LasHeader, records: Records) -> set[int]:
    """Return the scanner channels of records with layered wave packets, or an empty set for other formats.

    lazrs 0.8 silently damages wave packets if the channel changes within a chunk, both when it
    writes and when it reads. All other fields are right.
    """
    if header.point_format not in _WAVE_FORMATS:
        return set()
    return set(np.unique((records["classification_flags"] >> 4) & 3).tolist())


def collect_labels(store: TileStore, cloud: CloudCopy, first: int, last: int) -> UInt8:
    """Return the final labels of the rows ``first`` to ``last`` of a source, uint8.

    Points in water have `WATER_BIT`. A label is 0 if the point is not in the store or lies
    outside the area.
    """
    labels = np.zeros(last - first, dtype=np.uint8)
    for cell, rows, row_mask in _rows_inside(store, cloud, first, last):
        labels[rows[row_mask] - first] = final_labels(store, cloud, cell)[row_mask]
    return labels


def final_labels(
    store: TileStore,
    cloud: NewClasses,
    cell: Cell,
    rows: Indices | slice = slice(None),
    xyz: Int32 | None = None,
) -> UInt8:
    """Return the labels of the ``rows`` of a bucket after edits, uint8, with `WATER_BIT` for points in water.

    ``rows`` need their positions ``xyz`` in local counts, int32 (3, n), so that the bucket is not read again.
    """
    labels = store.read_labels(cloud.labels, cell)
    if cloud.edits is not None:
        labels = _corrected(store, cloud.edits, cell, labels)
    labels = labels[rows] & ~np.uint8(UNCERTIFIED_BIT)
    if cloud.waters is not None:
        labels = _with_water(store, cloud, cell, labels, xyz)
    return labels


def _inside_area(store: TileStore, cloud: CloudCopy, first: int, last: int) -> Bool:
    """Return a mask of the rows ``first`` to ``last`` of a source: True for points of the store inside the area."""
    in_area = np.zeros(last - first, dtype=np.bool_)
    for _, rows, row_mask in _rows_inside(store, cloud, first, last):
        in_area[rows[row_mask] - first] = True
    return in_area


def _rows_inside(
    store: TileStore, cloud: CloudCopy, first: int, last: int
) -> Iterator[tuple[Cell, Int64, Bool]]:
    """Yield the buckets that contain any of the rows ``first`` to ``last`` of a source inside the area.

    Yield the cell of each bucket, the rows of all of its points, and a mask of the requested
    ones.
    """
    area = store.area(cloud.area)
    for cell in cloud.cells:
        sources, rows = unpack_origin(store.read_origin(cell))
        row_mask = (sources == cloud.source) & (rows >= first) & (rows < last)
        if area is not None and not area.covers(store.meta.bucket.bounds(cell)):
            east, north = store.meta.frame.origin[:2]
            xyz = store.read_bucket(cell).xyz
            row_mask &= area.inside(
                xyz[0].astype(np.int64) + east, xyz[1].astype(np.int64) + north
            )
        if row_mask.any():
            yield cell, rows, row_mask


def _corrected(store: TileStore, edits: str, cell: Cell, labels: UInt8) -> UInt8:
    """Return the labels of a bucket after the edits. Points at the position of another point get its label."""
    bucket_edits = store.edits(edits, store.meta.bucket.bounds(cell), OF_POINTS)
    if bucket_edits is None:
        return labels
    points = store.read_bucket(cell, ("xyz", "classification", "flags"))
    edited = bucket_edits.labels(points, labels, store.meta.frame.origin)
    repeated, chosen = store.representatives(cell, points)
    taking = labels[repeated] > 0
    edited[repeated[taking]] = edited[chosen[taking]]
    return edited


def _with_water(
    store: TileStore,
    cloud: NewClasses,
    cell: Cell,
    labels: UInt8,
    xyz: Int32 | None,
) -> UInt8:
    """Return the labels of the points at ``xyz``, or of all points of a bucket, with `WATER_BIT` for points in water.

    Objects above the water, such as trees and boats, do not get it. If ``cloud.low_is_noise``, returns from more than
    `WATER_LOW_M` below the level become low noise.
    """
    waters = store.waters(cloud.waters, store.meta.bucket.bounds(cell))
    if waters is None:
        return labels
    frame = store.meta.frame
    x, y, z = (store.read_bucket(cell).xyz if xyz is None else xyz).astype(np.int64)
    levels = waters.levels(x + frame.origin[0], y + frame.origin[1])
    reached = z <= levels + WATER_RISE_M / float(frame.metres_z)
    wet = np.where(labels == UNCLASSIFIED, reached, levels > -np.inf)
    if cloud.low_is_noise:
        low = z <= levels - WATER_LOW_M / float(frame.metres_z)
        labels = np.where(low & (labels != 0), np.uint8(LOW_NOISE), labels)
    return labels | wet * np.uint8(WATER_BIT)
