"""First step of ingest: decode pieces of sources, select and convert their points, and spool them by bucket."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import Any

import numpy as np

from ptd.arrays import Bool, Float32, Indices, Int32, Int64, UInt8, UInt16
from tiler.core.area import Runs, in_runs
from tiler.core.lattice import Bounds, CoordFrame, Lattice
from tiler.core.points import UNSELECTED_FLAG, WITHHELD_FLAG, PointBlock, pack_origin
from tiler.core.records import NOT_IN_DIGEST, KnownSums, SpoolRecord
from tiler.core.selection import (
    EVERY_POINT,
    FIRST,
    LAST,
    MAX_RETURNS,
    MAX_SOURCE_ID,
    WITHHELD,
    Selection,
    parse_numbers,
)
from tiler.inputs.requantise import fits_int32, to_counts
from tiler.io.cloud_reading import fetched_bytes
from tiler.io.las.field_sums import FieldSums
from tiler.io.las.headers import LasHeader
from tiler.io.las.point_formats import class_and_flags, colours, returns, scan_angles
from tiler.io.las.reader import (
    COLOURS,
    EVERYTHING,
    NEEDED,
    TO_SELECT,
    PointReader,
    Records,
    unchanged,
)
from tiler.io.las.writers import CLASS_RECORD, has_class_layer
from tiler.io.locations import as_path
from tiler.store import (
    MAX_RECORD_BYTES,
    SPOOL_CHUNK,
    RecordKeeper,
    StoreMeta,
    TileStore,
)


def unselected(
    selection: Selection,
    returns: UInt8,
    angles_deg: Float32,
    source_ids: UInt16,
    classes: UInt8,
) -> dict[str, Bool]:
    """Return masks of the points that each option of a selection leaves out.

    Parameters
    ----------
    selection : Selection
    returns : uint8 (2, n)
        Return number, and number of returns of the pulse. A number of 0 counts as 1.
    angles_deg : float32 (n,)
        Scan angles in degrees.
    source_ids : uint16 (n,)
    classes : uint8 (n,)

    Returns
    -------
    dict of str to bool (n,)
        Mask by the key of `Selection.options`.
    """
    masks: dict[str, Bool] = {}
    if selection.returns is not None:
        masks["returns"] = ~_of_returns(selection.returns, np.maximum(returns, 1))
    if selection.scan_angle_deg is not None:
        masks["scan_angle"] = np.abs(angles_deg) > selection.scan_angle_deg
    if selection.source_ids is not None:
        selected_ids = parse_numbers(selection.source_ids, "point source ids", 0, MAX_SOURCE_ID)
        masks["source_id"] = ~np.isin(source_ids, selected_ids)
    if selection.drop_classes:
        masks["drop_classes"] = np.isin(classes, selection.drop_classes)
    return masks


def _of_returns(wanted: str, returns: UInt8) -> Bool:
    number, of = returns
    if wanted == LAST:
        return np.asarray(number >= of)
    if wanted == FIRST:
        return np.asarray(number == 1)
    return np.isin(number, parse_numbers(wanted, "returns", 1, MAX_RETURNS))


NOT_FINITE = "not finite"
BEYOND_FRAME = "beyond the frame"
OUTSIDE_AREA = "outside the area"

STEP = SPOOL_CHUNK
"""Number of records that are decoded, converted and kept at a time."""

_RADIX_KEYS = 1 << 16
"""Number of 16-bit keys, which numpy sorts by radix, several times faster than larger keys."""


@dataclass(frozen=True)
class SpoolPiece:
    """Piece of a source to decode.

    Attributes
    ----------
    path : str
        Path or URL of the source.
    source : int
        Number of the source in the store.
    piece : str
        Name of the piece in the spool.
    start, count : int
        First record of the piece, and number of records.
    wanted : Runs or None
        Buckets whose points are stored, see `Area.cells`; None for all.
    salvage : bool
        Read the readable part of a damaged file.
    extent : Bounds or None
        Bounds in the header of the source, widened by one unit, in absolute counts. None if the header is wrong.
    identity : str or None
        Identity of the piece's content, which does not depend on ``wanted``.
    stamp : list or None
        `LasHeader.stamp` of the source as the plan found it, which detects changes.
    ranges : tuple of (int, int)
        First record and number of records of each part, if only some chunks of the source are read. ``count`` is then
        their sum.
    keep : bool
        Keep the records for the classified cloud if they are compressed, so that they are not decoded twice.
    classes_only : bool
        Of records whose other fields can be copied, keep only what new classes depend on, and the sums of all fields.
    selection : Selection
        Points that the filter and the rasters use. The others are stored with a flag.
    """

    path: str
    source: int
    piece: str
    start: int
    count: int
    wanted: Runs | None = None
    salvage: bool = False
    extent: Bounds | None = None
    identity: str | None = None
    stamp: list[Any] | None = field(default=None, metadata=NOT_IN_DIGEST)
    ranges: tuple[tuple[int, int], ...] = ()
    keep: bool = field(default=False, metadata=NOT_IN_DIGEST)
    classes_only: bool = field(default=False, metadata=NOT_IN_DIGEST)
    selection: Selection = EVERY_POINT


def spool_piece(store: TileStore, *, work: SpoolPiece) -> SpoolRecord:
    """Decode a piece into the spool.

    Returns
    -------
    SpoolRecord
        Record of the piece.

    Raises
    ------
    InputError
        The points cannot be decoded, or the file has changed since the plan read it.
    """
    frame = store.meta.frame
    bytes_before = fetched_bytes()
    with unchanged(as_path(work.path), work.stamp, work.salvage) as header:
        keeper = _keeper(store, work, header)
        layers = TO_SELECT if work.selection.options else NEEDED
        if not store.meta.has_rgb:
            layers &= ~COLOURS
        if keeper is not None:
            layers |= keeper.layers
        ranges = work.ranges or ((work.start, work.count),)
        with PointReader(header, layers, ranges=work.ranges or None) as reader:
            read = []
            for start, count in ranges:
                end = start + count
                for first in range(start, end, STEP):
                    read.append(
                        _read_step(
                            store.meta, reader, keeper, work, first, min(STEP, end - first)
                        )
                    )
        if keeper is not None:
            keeper.close()
    dropped = sum((Counter(step.dropped) for step in read), Counter[str]())
    unselected = sum((Counter(step.unselected) for step in read), Counter[str]())
    block = PointBlock.concatenate([step.block for step in read])
    order, index = sort_by_bucket(block.xyz, frame, store.meta.bucket)
    order, index, left = _of_buckets(order, index, work.wanted)
    if left:
        dropped[OUTSIDE_AREA] = sum(number for _, _, number in left)
    block = block.take(order)
    if len(block):
        store.write_piece(work.piece, block)
    bounds, z = extent(block, frame)
    return SpoolRecord(
        read=sum(count for _, count in ranges),
        stored=len(block),
        outside=sum(step.outside for step in read),
        dropped=dict(dropped),
        unselected=dict(unselected),
        largest_rounding=max(step.rounding for step in read),
        buckets=[list(entry) for entry in index],
        left=[list(entry) for entry in left],
        identity=work.identity,
        fetched=fetched_bytes() - bytes_before,
        bounds=bounds,
        z=z,
        sums=keeper.sums if keeper is not None else None,
    )


@dataclass(frozen=True)
class _Step:
    """Usable points of some records of a piece, and numbers that `spool_piece` returns."""

    block: PointBlock
    outside: int
    dropped: dict[str, int]
    unselected: dict[str, int]
    rounding: float


class _Keeper:
    """Keeper of records for the classified cloud, and their layers.

    If `classes_only`, it keeps only the fields of `CLASS_RECORD`, and adds up all others.
    """

    def __init__(
        self, store: TileStore, work: SpoolPiece, header: LasHeader, classes_only: bool
    ) -> None:
        self._sums = FieldSums(header) if classes_only else None
        # Damage in layers that are only copied would reach the classified cloud.
        self.layers = EVERYTHING
        size = CLASS_RECORD.itemsize if classes_only else header.record_length
        self._keeper: RecordKeeper = store.keep_records(work.piece, work.identity, size)

    def add(self, records: Records) -> None:
        if self._sums is None:
            self._keeper.add(records)
            return
        self._sums.add(records)
        kept = np.empty(len(records), CLASS_RECORD)
        for name in CLASS_RECORD.names or ():
            kept[name] = records[name]
        self._keeper.add(kept)

    def close(self) -> None:
        self._keeper.close()

    @property
    def sums(self) -> KnownSums | None:
        return None if self._sums is None else self._sums.without_classes()


def _keeper(store: TileStore, work: SpoolPiece, header: LasHeader) -> _Keeper | None:
    """Return a keeper for the records of a piece, or None if they are not kept.

    The records of ranges, of uncompressed sources, and records longer than `MAX_RECORD_BYTES`
    are not kept.
    """
    if not work.keep or work.ranges or header.laz is None:
        return None
    classes_only = work.classes_only and has_class_layer(header)
    if not classes_only and header.record_length > MAX_RECORD_BYTES:
        return None
    return _Keeper(store, work, header, classes_only)


def _read_step(
    meta: StoreMeta,
    reader: PointReader,
    keeper: _Keeper | None,
    work: SpoolPiece,
    start: int,
    count: int,
) -> _Step:
    """Decode ``count`` records from ``start`` on, whose arrays fit into the processor's cache."""
    records = reader.read(start, count)
    if keeper is not None:
        keeper.add(records)
    local, usable, dropped, rounding = to_local_counts(records, reader.header, meta.frame)
    rows = np.arange(start, start + count, dtype=np.int64)
    block = columns(records, reader.header, local, work.source, rows, meta.has_rgb)
    block, left_out = _flag_unselected(block, records, reader.header, work.selection)
    unselected = {key: int(np.count_nonzero(mask & usable)) for key, mask in left_out.items()}
    block = block.take(usable)
    outside = 0
    if work.extent is not None:
        inside = block.inside(work.extent, meta.frame.origin)
        outside = len(block) - int(np.count_nonzero(inside))
    return _Step(block, outside, dropped, unselected, rounding)


def _flag_unselected(
    block: PointBlock, records: Records, header: LasHeader, selection: Selection
) -> tuple[PointBlock, dict[str, Bool]]:
    """Return all points, with a flag if the selection excludes them, and masks of the excluded points by option."""
    if block.flags is None or block.returns is None or block.classification is None:
        raise ValueError("points were read without their flags, returns and classes")
    withheld = (block.flags & WITHHELD_FLAG) > 0
    flags = block.flags
    if selection.withheld:
        flags = flags & ~np.uint8(WITHHELD_FLAG)
        withheld[:] = False
    if not selection.options:
        return replace(block, flags=flags), {WITHHELD: withheld}
    angles = scan_angles(records, header.point_format)
    masks = unselected(
        selection, block.returns, angles, records["point_source_id"], block.classification
    )
    for left_out in masks.values():
        flags = flags | (left_out * np.uint8(UNSELECTED_FLAG))
    return replace(block, flags=flags), {**masks, WITHHELD: withheld}


def to_local_counts(
    records: Records, header: LasHeader, frame: CoordFrame
) -> tuple[Int32, Bool, dict[str, int], float]:
    """Convert the coordinates of records to local counts.

    Returns
    -------
    local : int32 (3, n)
        Local counts; 0 for coordinates that do not fit.
    usable : bool (n,)
        Mask of the usable points.
    dropped : dict of str to int
        Number of the other points by reason.
    rounding : float
        Largest rounding of a coordinate, in units of the CRS.
    """
    local = np.zeros((3, len(records)), dtype=np.int32)
    finite = np.ones(len(records), dtype=np.bool_)
    framed = np.ones(len(records), dtype=np.bool_)
    rounding = 0.0
    origins = (*frame.origin, 0)
    for axis, name in enumerate("XYZ"):
        converted = to_counts(records[name], header.scales[axis], header.offsets[axis])
        rounding = max(rounding, converted.largest_rounding)
        finite &= converted.usable
        shifted = converted.counts - origins[axis]
        fits = fits_int32(shifted)
        framed &= fits
        local[axis] = shifted if fits.all() else np.where(fits, shifted, 0)
    dropped = {
        NOT_FINITE: int(np.count_nonzero(~finite)),
        BEYOND_FRAME: int(np.count_nonzero(finite & ~framed)),
    }
    dropped = {reason: number for reason, number in dropped.items() if number}
    return local, finite & framed, dropped, rounding


def columns(
    records: Records,
    header: LasHeader,
    local: Int32,
    source: int,
    rows: Int64,
    has_rgb: bool,
) -> PointBlock:
    """Return the columns that the store keeps. Colours are 0 if the store has them, but the records do not."""
    classification, flags = class_and_flags(records, header.point_format)
    rgb = None
    if has_rgb:
        rgb = colours(records, header.point_format)
        if rgb is None:
            rgb = np.zeros((3, len(records)), dtype=np.uint16)
    return PointBlock(
        xyz=local,
        classification=classification,
        flags=flags,
        returns=returns(records, header.point_format),
        rgb=rgb,
        origin=pack_origin(source, rows),
    )


def sort_by_bucket(
    local: Int32, frame: CoordFrame, lattice: Lattice
) -> tuple[Indices, list[tuple[int, int, int]]]:
    """Return a stable order of the points by bucket, and ix, iy and size of each bucket.

    The buckets come row by row from the south-west.
    """
    if local.shape[1] == 0:
        return np.empty(0, dtype=np.intp), []
    ix = lattice.index(local[0].astype(np.int64) + frame.origin[0])
    iy = lattice.index(local[1].astype(np.int64) + frame.origin[1])
    west, south = int(ix.min()), int(iy.min())
    width = int(ix.max()) - west + 1
    keys = (iy - south) * width + (ix - west)
    # If the keys do not fit 16 bits, their ranks may.
    distinct: Int64 | None = None
    if int(keys.max()) >= _RADIX_KEYS:
        distinct, keys = np.unique(keys, return_inverse=True)
    if int(keys.max()) < _RADIX_KEYS:
        keys = keys.astype(np.uint16)
    order = np.argsort(keys, kind="stable")
    numbers = np.bincount(keys)
    used = np.flatnonzero(numbers)
    names = used if distinct is None else distinct[used]
    rows, cols = np.divmod(names.astype(np.int64), width)
    ix, iy = cols + west, rows + south
    return order, list(zip(ix.tolist(), iy.tolist(), numbers[used].tolist(), strict=True))


Index = list[tuple[int, int, int]]


def _of_buckets(
    order: Indices, index: Index, wanted: Runs | None
) -> tuple[Indices, Index, Index]:
    """Return order and index of the wanted buckets from the result of `sort_by_bucket`, and the index of the others."""
    if wanted is None or not index:
        return order, index, []
    ix, iy, numbers = np.array(index, np.int64).T
    kept = in_runs(wanted, ix, iy)
    return (
        order[np.repeat(kept, numbers)],
        list(compress(index, kept)),
        list(compress(index, ~kept)),
    )


def extent(block: PointBlock, frame: CoordFrame) -> tuple[list[int] | None, list[int] | None]:
    """Return the bounds (half-open, absolute counts) and z (lowest, highest) of points.

    Both are None without points.
    """
    if len(block) == 0:
        return None, None
    low = block.xyz.min(axis=1).tolist()
    high = block.xyz.max(axis=1).tolist()
    x, y = frame.origin
    return [low[0] + x, low[1] + y, high[0] + x + 1, high[1] + y + 1], [low[2], high[2]]
