"""Overview of the classified clouds: a thin cloud in one COPC file, which QGIS draws until it shows the clouds."""

from __future__ import annotations

import os
import struct
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ptd.arrays import Indices, UInt8
from ptd.cells import sample_per_cell
from ptd.frame import CellLattice
from tiler.core.lattice import COUNTS_PER_UNIT, Cell, CoordFrame
from tiler.core.points import (
    KEY_POINT_FLAG,
    OVERLAP_FLAG,
    SYNTHETIC_FLAG,
    WITHHELD_FLAG,
    PointBlock,
    written_classes,
)
from tiler.errors import write_error
from tiler.export.classified import final_labels
from tiler.export.cloud_frame import (
    CloudStatistics,
    crs_of_run,
    write_copc_back,
    write_copc_front,
)
from tiler.export.output_files import FileRecord, NewClasses, OutFile, new_file
from tiler.io.atomic_files import SCRATCH_PREFIX, atomic_path
from tiler.io.las.headers import LasHeader, read_header
from tiler.io.las.reader import Records, record_dtype
from tiler.io.las.writers import HEADER_BYTES, CopcWriter
from tiler.store import TileStore

CELL_M = 1
"""Side of the smallest cells. Larger ones have twice the side, and again twice."""
MAX_POINTS = 500_000
"""Largest number of points of an overview. Half as many again are thinned together, in about 100 MB."""
MIN_POINTS = 20_000
"""Number of points up to which an overview is not made thinner."""
THINNING = 100
"""Least ratio of the points of the clouds to those of a larger overview, so that it costs little beside the clouds."""
_POINT_FORMAT, _RECORD_BYTES = 6, 30
_BITS = (
    (SYNTHETIC_FLAG, 1),
    (KEY_POINT_FLAG, 2),
    (WITHHELD_FLAG, 4),
    (OVERLAP_FLAG, 8),
)
"""Flags of `tiler.core.points`, and their bits in formats 6 to 10."""


def write_overview(store: TileStore, *, overview: NewClasses, to: OutFile) -> FileRecord:
    """Write one point per cell of the classified clouds, with its class there, as COPC.

    The cells are the smallest ones with which the overview has at most 1/`THINNING` of all points, and at most
    `MAX_POINTS`. Position, class, flags and returns of the points are those of the clouds. Other fields are 0.
    Points outside the area are left out.

    Parameters
    ----------
    store : TileStore
    overview : NewClasses
    to : OutFile

    Returns
    -------
    FileRecord

    Raises
    ------
    ProcessingError
        The file cannot be written.
    """
    with new_file(to) as file:
        try:
            with (
                TemporaryDirectory(prefix=SCRATCH_PREFIX) as scratch,
                atomic_path(file.path) as partial,
            ):
                header = _header(Path(scratch, "empty.las"), store)
                _write(partial, header, store.meta.frame, _thinned(store, overview, header))
        except OSError as error:
            raise write_error(str(file.path), error, file.path.parent) from error
    return file.record


def _header(path: Path, store: TileStore) -> LasHeader:
    """Write a LAS 1.4 file without points, and return its header. Its integers are the counts of the store."""
    origin = (*store.meta.frame.origin, 0)
    data = bytearray(HEADER_BYTES)
    struct.pack_into("<4s", data, 0, b"LASF")
    struct.pack_into("<BB", data, 24, 1, 4)
    struct.pack_into("<32s", data, 58, b"tiler")
    # The date before is 0, since equal clouds have equal overviews.
    struct.pack_into("<HII", data, 94, HEADER_BYTES, HEADER_BYTES, 0)
    struct.pack_into("<BH", data, 104, _POINT_FORMAT, _RECORD_BYTES)
    scales, offsets = 3 * [1 / COUNTS_PER_UNIT], [count / COUNTS_PER_UNIT for count in origin]
    struct.pack_into("<6d", data, 131, *scales, *offsets)
    path.write_bytes(data)
    return read_header(path)


def _write(path: Path, header: LasHeader, frame: CoordFrame, records: Records) -> None:
    crs = crs_of_run(frame.crs_wkt)
    statistics = CloudStatistics(header)
    with open(header.path, "rb") as source, open(path, "x+b") as target:
        write_copc_front(header, source, target, crs)
        with CopcWriter(target, header, str(path.parent)) as copc:
            if records.size:
                statistics.add(records)
            copc.write(records)
            copc.close()
        write_copc_back(header, source, target, crs, copc, statistics)
        target.flush()
        os.fsync(target.fileno())


def _thinned(store: TileStore, overview: NewClasses, header: LasHeader) -> Records:
    """Return the records of the points of an overview, in the order of their cells."""
    frame, dtype = store.meta.frame, record_dtype(header.point_format, header.record_length)
    buckets = store.buckets()
    infos = [buckets[cell] for cell in overview.cells]
    most = min(max(sum(info.n for info in infos) // THINNING, MIN_POINTS), MAX_POINTS)
    side = round(frame.counts(Fraction(CELL_M)))
    if overview.area is None:
        # Each fine cell of the store with a candidate has a point, and a cell here touches so many of them at most.
        occupied, fine = sum(info.n_candidates for info in infos), store.meta.fine.size
        while occupied / (side / fine + 2) ** 2 > most:
            side *= 2
    held, n_held = [np.empty(0, dtype)], 0
    for cell in overview.cells:
        held.append(_of_bucket(store, overview, cell, side, dtype))
        n_held += held[-1].size
        if n_held > 3 * most // 2:
            fewer, side = _thinner(np.concatenate(held), frame, side, most)
            held, n_held = [fewer], fewer.size
    return _thinner(np.concatenate(held), frame, side, most)[0]


def _of_bucket(
    store: TileStore, overview: NewClasses, cell: Cell, side: int, dtype: np.dtype[np.void]
) -> Records:
    """Return records of the points of a bucket, one per cell."""
    block = store.read_bucket(cell, ("xyz", "classification", "flags", "returns"))
    (x, y, z), frame = block.xyz, store.meta.frame
    inside: Indices | None = None
    area = store.area(overview.area)
    if area is not None and not area.covers(store.meta.bucket.bounds(cell)):
        east, north = frame.origin
        is_inside = area.inside(x.astype(np.int64) + east, y.astype(np.int64) + north)
        inside = np.flatnonzero(is_inside)
        x, y, z = x[inside], y[inside], z[inside]
    # A repeated point is not chosen, since the store has the point that represents it before it.
    rows = sample_per_cell(x, y, z, _cells(frame, side)).astype(np.intp)
    if inside is not None:
        rows = inside[rows]
    block = block.take(rows)
    labels = final_labels(store, overview, cell, rows, block.xyz)
    return _records(block, labels, written_classes(overview.reclass), dtype)


def _records(
    block: PointBlock,
    labels: UInt8,
    classes: UInt8,
    dtype: np.dtype[np.void],
) -> Records:
    if block.flags is None or block.classification is None or block.returns is None:
        raise ValueError("points of the store must have classes, flags and returns")
    records = np.zeros(len(block), dtype)
    records["X"], records["Y"], records["Z"] = block.xyz
    records["classification"] = classes[labels, block.classification]
    records["bit_fields"] = block.returns[0] | block.returns[1] << 4
    for flag, bit in _BITS:
        records["classification_flags"] |= (block.flags & flag != 0) * np.uint8(bit)
    return records


def _thinner(records: Records, frame: CoordFrame, side: int, most: int) -> tuple[Records, int]:
    """Return at most ``most`` records, one per cell, and the side of the cells, which is doubled if needed.

    A cell has the point of one of its quarters, so the points do not depend on the side at which the thinning begins.
    """
    x, y, z = (np.ascontiguousarray(records[axis]) for axis in "XYZ")
    while True:
        chosen = sample_per_cell(x, y, z, _cells(frame, side))
        if chosen.size <= most:
            return records[chosen], side
        side *= 2


def _cells(frame: CoordFrame, side: int) -> CellLattice:
    return CellLattice(side, 1, *frame.origin)
