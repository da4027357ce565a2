"""Ingest, first step: a piece of a source decoded, put in the frame, sorted by bucket, spooled."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.area import Runs, in_runs
from tiler.core.frame import CoordFrame
from tiler.core.lattice import Bounds, Lattice
from tiler.core.points import PointBlock, pack_origin
from tiler.ingest.requantise import fits_int32, to_counts
from tiler.io.cloud_reading import fetched_bytes
from tiler.io.las.columns import class_and_flags, colours, returns
from tiler.io.las.headers import LasHeader
from tiler.io.las.reader import EVERYTHING, NEEDED, PointReader, Records
from tiler.io.las.unchanged import unchanged
from tiler.io.locations import cloud_path
from tiler.schedule.task import NOT_IN_DIGEST
from tiler.store import LONGEST_BYTES, SPOOL_CHUNK, RecordKeeper, StoreMeta, TileStore, open_store

NOT_FINITE = "not finite"
BEYOND_FRAME = "beyond the frame"
OUTSIDE_AREA = "outside the area"

STEP = SPOOL_CHUNK
"""Records that are decoded, converted and kept at a time."""

_RADIX_KEYS = 1 << 16


@dataclass(frozen=True)
class SpoolPiece:
    """A piece to be decoded: the arguments of `spool_piece`.

    Attributes
    ----------
    path : str
        Of the source, or its URL.
    source : int
        Its number in the store.
    piece : str
        Name in the spool.
    start, count : int
        Records of the source.
    wanted : Runs or None
        The buckets whose points are stored, see `Area.cells`; None: all.
    salvage : bool
    extent : Bounds or None
        What the header of the source says, absolute counts.
    identity : str or None
        Of the piece, whatever is wanted of it.
    stamp : list or None
        Of the source, as the plan found it.
    ranges : tuple of (int, int)
        First record and number of each part of the piece, where it is not all one; then ``count`` is their sum.
    keep : bool
        Keep the records for the classified cloud, where decoding them is work.
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


def spool_piece(store_url: str, work: SpoolPiece) -> dict[str, Any]:
    """Decode one piece into the spool.

    Parameters
    ----------
    store_url : str
    work : SpoolPiece

    Returns
    -------
    dict
        ``read``, ``stored``, ``outside`` (usable points outside of ``extent``), ``dropped`` (reason to number),
        ``largest_rounding`` (CRS units), ``buckets`` ([[ix, iy, number], ...] in the order of the piece), ``left`` (the
        same of buckets that are not wanted), ``bounds`` (half-open absolute counts, or None), ``z`` ([lowest, highest]
        in counts, or None), ``identity``, ``fetched`` (bytes of a source at a URL).

    Raises
    ------
    InputError
        The points cannot be decoded, or the file is no longer the one that the plan read.
    """
    store, before = open_store(store_url), fetched_bytes()
    frame, lattice = store.meta.frame, store.meta.bucket
    with unchanged(cloud_path(work.path), work.stamp, work.salvage) as header:
        keeper = _keeper(store, work, header)
        selection = NEEDED if keeper is None else EVERYTHING
        ranges = work.ranges or ((work.start, work.count),)
        with PointReader(header, selection, ranges=work.ranges or None) as reader:
            read = [
                _read_step(store.meta, reader, keeper, work, first, min(STEP, start + count - first))
                for start, count in ranges
                for first in range(start, start + count, STEP)
            ]
        if keeper is not None:
            keeper.close()
    dropped = sum((Counter(step.dropped) for step in read), Counter[str]())
    block = PointBlock.concatenate([step.block for step in read])
    order, index = sort_by_bucket(block.xyz, frame, lattice)
    order, index, left = _of_buckets(order, index, work.wanted)
    if left:
        dropped[OUTSIDE_AREA] = sum(number for _, _, number in left)
    block = block.take(order)
    if len(block):
        store.write_piece(work.piece, block)
    return {
        "read": sum(count for _, count in ranges),
        "stored": len(block),
        "outside": sum(step.outside for step in read),
        "dropped": dict(dropped),
        "largest_rounding": max(step.rounding for step in read),
        "buckets": [list(entry) for entry in index],
        "left": [list(entry) for entry in left],
        "identity": work.identity,
        "fetched": fetched_bytes() - before,
        **extent(block, frame),
    }


@dataclass(frozen=True)
class _Step:
    """Some records of a piece: the points that can be kept, and what `spool_piece` tells of all."""

    block: PointBlock
    outside: int
    dropped: dict[str, int]
    rounding: float


def _keeper(store: TileStore, work: SpoolPiece, header: LasHeader) -> RecordKeeper | None:
    """What keeps the records of a piece, if that is wanted, saves a decoder's work, and can be done."""
    if not work.keep or work.ranges or header.laz is None or header.record_length > LONGEST_BYTES:
        return None
    return store.keep_records(work.piece, work.identity, header.record_length)


def _read_step(
    meta: StoreMeta,
    reader: PointReader,
    keeper: RecordKeeper | None,
    work: SpoolPiece,
    start: int,
    count: int,
) -> _Step:
    """Decode ``count`` records from ``start`` on: few enough that the processor's cache holds what is made of them."""
    records = reader.read(start, count)
    if keeper is not None:
        keeper.add(records)
    local, keep, dropped, rounding = place(records, reader.header, meta.frame)
    rows = np.arange(start, start + count, dtype=np.int64)
    block = columns(records, reader.header, local, work.source, rows, meta.has_rgb)
    block = block.take(keep)
    inside = None if work.extent is None else block.inside(work.extent, meta.frame.origin)
    outside = 0 if inside is None else len(block) - int(np.count_nonzero(inside))
    return _Step(block, outside, dropped, rounding)


def place(
    records: Records, header: LasHeader, frame: CoordFrame
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.bool_], dict[str, int], float]:
    """Local counts (int32, shape (3, n)), mask of those to keep, dropped by reason, largest rounding."""
    local = np.zeros((3, len(records)), dtype=np.int32)
    finite = np.ones(len(records), dtype=np.bool_)
    framed = np.ones(len(records), dtype=np.bool_)
    rounding = 0.0
    origins = (*frame.origin, 0)
    for axis, name in enumerate("XYZ"):
        found = to_counts(records[name], header.scales[axis], header.offsets[axis])
        rounding = max(rounding, found.largest_rounding)
        finite &= found.usable
        shifted = found.counts - origins[axis]
        fits = fits_int32(shifted)
        framed &= fits
        local[axis] = np.where(fits, shifted, 0)
    reasons = {
        NOT_FINITE: int(np.count_nonzero(~finite)),
        BEYOND_FRAME: int(np.count_nonzero(finite & ~framed)),
    }
    return local, finite & framed, {k: v for k, v in reasons.items() if v}, rounding


def columns(
    records: Records,
    header: LasHeader,
    local: npt.NDArray[np.int32],
    source: int,
    rows: npt.NDArray[np.int64],
    has_rgb: bool,
) -> PointBlock:
    """All columns of the records; colours are 0 where the store has them and the source has none."""
    classification, flags = class_and_flags(records, header.point_format)
    rgb = colours(records, header.point_format) if has_rgb else None
    if has_rgb and rgb is None:
        rgb = np.zeros((3, len(records)), dtype=np.uint16)
    return PointBlock(
        local, classification, flags, returns(records, header.point_format), rgb, pack_origin(source, rows)
    )


def sort_by_bucket(
    local: npt.NDArray[np.int32], frame: CoordFrame, lattice: Lattice
) -> tuple[npt.NDArray[np.intp], list[tuple[int, int, int]]]:
    """A stable order by bucket, row by row from the south-west, and (ix, iy, points) of each bucket there."""
    if local.shape[1] == 0:
        return np.empty(0, dtype=np.intp), []
    ix = lattice.index(local[0].astype(np.int64) + frame.origin[0])
    iy = lattice.index(local[1].astype(np.int64) + frame.origin[1])
    west, south = int(ix.min()), int(iy.min())
    width = int(ix.max()) - west + 1
    keys = (iy - south) * width + (ix - west)
    # numpy sorts 16-bit keys by radix, which is several times faster; wider ranges are numbered first.
    distinct: npt.NDArray[np.int64] | None = None
    if int(keys.max()) >= _RADIX_KEYS:
        distinct, keys = np.unique(keys, return_inverse=True)
    if int(keys.max()) < _RADIX_KEYS:
        keys = keys.astype(np.uint16)
    order = np.argsort(keys, kind="stable")
    numbers = np.bincount(keys)
    used = np.flatnonzero(numbers)
    names = used if distinct is None else distinct[used]
    rows, cols = np.divmod(names.astype(np.int64), width)
    return order, list(
        zip((cols + west).tolist(), (rows + south).tolist(), numbers[used].tolist(), strict=True)
    )


Index = list[tuple[int, int, int]]


def _of_buckets(
    order: npt.NDArray[np.intp], index: Index, wanted: Runs | None
) -> tuple[npt.NDArray[np.intp], Index, Index]:
    """What `sort_by_bucket` gave, of the wanted buckets alone, and the index of the others."""
    if wanted is None or not index:
        return order, index, []
    ix, iy, numbers = np.array(index, np.int64).T
    mine = in_runs(wanted, ix, iy)
    kept = [entry for entry, keep in zip(index, mine.tolist(), strict=True) if keep]
    left = [entry for entry, keep in zip(index, mine.tolist(), strict=True) if not keep]
    return order[np.repeat(mine, numbers)], kept, left


def extent(block: PointBlock, frame: CoordFrame) -> dict[str, Any]:
    """``bounds`` (half-open, absolute counts) and ``z`` (lowest, highest); None without points."""
    if len(block) == 0:
        return {"bounds": None, "z": None}
    low, high = block.xyz.min(axis=1).tolist(), block.xyz.max(axis=1).tolist()
    x, y = frame.origin
    return {
        "bounds": [low[0] + x, low[1] + y, high[0] + x + 1, high[1] + y + 1],
        "z": [low[2], high[2]],
    }
