"""Second step of ingest: assemble buckets from their points, with the candidates first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ptd.arrays import Bool, Indices, Int64
from ptd.cells import sort_in_cells
from ptd.frame import CellLattice
from tiler.core.lattice import Bounds, Cell, CoordFrame, Lattice
from tiler.core.points import (
    NOISE,
    REPEATED_FLAG,
    SOURCE_SHIFT,
    STRAY_FLAG,
    WITHHELD_FLAG,
    PointBlock,
    participates,
    preference,
)
from tiler.core.records import AssembledRecord, BucketRecord
from tiler.ingest.coverage import Outranked, flag_outranked
from tiler.ingest.spool import extent
from tiler.ingest.strays import places, stray_mask
from tiler.store import TileStore


@dataclass(frozen=True)
class BucketOrder:
    """Stored order of a bucket's points, and the number of duplicates among them.

    Attributes
    ----------
    order : intp, shape (n,)
        Indices of the points: candidates in the order of their fine cells, then the others by fine cell, z, x, y.
    n_candidates : int
    repeated : bool, shape (n,)
        Mask of the points at the position of another point, which represents them (`tiler.core.points`).
    duplicates_within, duplicates_between : int
        Number of points that repeat the position of a point of the same source, and of another source.
    """

    order: Indices
    n_candidates: int
    repeated: Bool
    duplicates_within: int
    duplicates_between: int


@dataclass(frozen=True)
class BucketParts:
    """Locations of a bucket's points in the spool.

    Attributes
    ----------
    cell : Cell
    fragments : tuple of (str, int, int)
        Piece, first row and end row of each run of points.
    rules : tuple of (int, Bounds)
        Number of each source with strays, and the bounds outside which its points are strays (see
        `tiler.ingest.strays`).
    outranked : tuple of Outranked
        Surveys with points in the bucket near which a survey counts more.
    """

    cell: Cell
    fragments: tuple[tuple[str, int, int], ...]
    rules: tuple[tuple[int, Bounds], ...] = ()
    outranked: tuple[Outranked, ...] = ()


def assemble_buckets(
    store: TileStore,
    *,
    buckets: tuple[BucketParts, ...],
    keep_classes: tuple[int, ...] | None = None,
    skip_flags: int = WITHHELD_FLAG,
) -> AssembledRecord:
    """Assemble buckets from their fragments in the spool, and write them.

    Parameters
    ----------
    store : TileStore
    buckets : tuple of BucketParts
    keep_classes : tuple of int or None
        Classes that are excluded from filtering; None for the default of `tiler.core.points.participates`.
    skip_flags : int
        Bits of flags that exclude a point from filtering.

    Returns
    -------
    AssembledRecord
        Records of the buckets.
    """
    meta = store.meta
    records = []
    for bucket in buckets:
        cell = bucket.cell
        block, strays = read_bucket(store, bucket)
        block, outranked = flag_outranked(block, bucket.outranked, meta.frame)
        participating = _participating(block, keep_classes, skip_flags)
        measured = _measured(block, participating, skip_flags)
        ordering = bucket_order(block, participating, meta.frame, meta.fine)
        records.append(
            replace(
                _record(cell, block, participating, measured, strays, ordering, meta.frame),
                outranked=outranked,
            )
        )
        if ordering.repeated.any() and block.flags is not None:
            flags = block.flags | (ordering.repeated * np.uint8(REPEATED_FLAG))
            block = replace(block, flags=flags)
        store.write_bucket(cell, block.take(ordering.order), ordering.n_candidates)
    return AssembledRecord(records)


def read_bucket(store: TileStore, bucket: BucketParts) -> tuple[PointBlock, Bool]:
    """Return the points of a bucket from the spool, with the flag of strays, and the mask of the strays."""
    parts = [store.read_fragment(*fragment) for fragment in bucket.fragments]
    block = PointBlock.concatenate(parts)
    strays = stray_mask(block, dict(bucket.rules), store.meta.frame.origin)
    if strays.any() and block.flags is not None:
        block = replace(block, flags=block.flags | (strays * np.uint8(STRAY_FLAG)))
    return block, strays


def _participating(block: PointBlock, keep: Sequence[int] | None, skip_flags: int) -> Bool:
    if block.classification is None or block.flags is None:
        raise ValueError("fragments of the spool must have classes and flags")
    if keep is None:
        return participates(block.classification, block.flags, skip_flags=skip_flags)
    return participates(block.classification, block.flags, keep, skip_flags)


def _measured(block: PointBlock, participating: Bool, skip_flags: int) -> Bool:
    """Return the mask of the points on a surface: those that take part, and others without a flag that are not noise.

    Water and bridges are not filtered by default, but their points belong to the density of the cloud.
    """
    if block.classification is None or block.flags is None:
        raise ValueError("fragments of the spool must have classes and flags")
    used = (block.flags & (skip_flags | WITHHELD_FLAG)) == 0
    measured: Bool = participating | (used & ~np.isin(block.classification, NOISE))
    return measured


def bucket_order(
    block: PointBlock,
    participating: Bool,
    frame: CoordFrame,
    fine: Lattice,
) -> BucketOrder:
    """Find the order in which a bucket stores its points.

    The candidate of a fine cell is the lowest participating point, or the one with the smallest
    x, then y, of equally low points. Of points at the same position, the one that represents
    them is first. The result depends only on the points and not on their order.
    """
    origin = block.origin if block.origin is not None else np.arange(len(block), dtype=np.int64)
    # Cells keep their order when the origin moves by whole cells, and small numbers cannot overflow.
    cells = CellLattice(fine.p, fine.q, *(count % fine.p for count in frame.origin))
    x, y, z = block.xyz
    order, cell_of, is_repeat = sort_in_cells(x, y, z, cells)
    within, between = _duplicates(order, is_repeat, origin)
    order = _ties_sorted(order, is_repeat, replace(block, origin=origin), participating)
    repeated = np.zeros(len(order), dtype=np.bool_)
    repeated[order[is_repeat]] = True
    ranked = order[participating[order]]
    cell_of_ranked = cell_of[ranked]
    first = np.ones(len(ranked), dtype=np.bool_)
    first[1:] = cell_of_ranked[1:] != cell_of_ranked[:-1]
    chosen = ranked[first]
    rest = np.ones(len(order), dtype=np.bool_)
    rest[chosen] = False
    return BucketOrder(
        np.concatenate((chosen, order[rest[order]])), len(chosen), repeated, within, between
    )


def _ties_sorted(
    order: Indices,
    is_repeat: Bool,
    block: PointBlock,
    participating: Bool,
) -> Indices:
    """Return the order with points at the same position sorted by `preference`.

    ``is_repeat`` is a mask, in the order, of the points that equal the point before them.
    """
    if not is_repeat.any():
        return order
    tied, runs = _ties(is_repeat)
    points = order[tied]
    ties = block.take(points)
    keys = (runs, *preference(ties, participating[points]))
    result = order.copy()
    result[tied] = points[np.lexsort(keys[::-1])]
    return result


def _duplicates(
    order: Indices,
    is_repeat: Bool,
    origin: Int64,
) -> tuple[int, int]:
    """Count the points that repeat a point of the same source, and of another source."""
    if not is_repeat.any():
        return 0, 0
    tied, runs = _ties(is_repeat)
    sources_of_ties = origin[order[tied]] >> SOURCE_SHIFT
    by_source = np.lexsort((sources_of_ties, runs))
    same_run = np.diff(runs) == 0  # Runs ascend, so the sort does not change them.
    between = int(np.count_nonzero(same_run & (np.diff(sources_of_ties[by_source]) != 0)))
    return int(np.count_nonzero(is_repeat)) - between, between


def _ties(
    is_repeat: Bool,
) -> tuple[Indices, Indices]:
    """Return the positions in an order of the points with an equal one next to them, and a number per run of these."""
    tied = is_repeat.copy()
    tied[:-1] |= is_repeat[1:]
    positions = np.flatnonzero(tied)
    return positions, np.cumsum(~is_repeat[positions])


def _record(
    cell: Cell,
    block: PointBlock,
    participating: Bool,
    measured: Bool,
    strays: Bool,
    found: BucketOrder,
    frame: CoordFrame,
) -> BucketRecord:
    z = block.xyz[2][participating]
    classes = {}
    if block.classification is not None:
        counts = np.bincount(block.classification).tolist()
        classes = {str(number): count for number, count in enumerate(counts) if count}
    bounds, z_range = extent(block.take(~strays) if strays.any() else block, frame)
    return BucketRecord(
        cell=[cell.ix, cell.iy],
        n=len(block),
        n_candidates=found.n_candidates,
        n_participating=int(np.count_nonzero(participating)),
        n_measured=int(np.count_nonzero(measured & ~found.repeated)),
        duplicates={"within": found.duplicates_within, "between": found.duplicates_between},
        z_participating=[int(z.min()), int(z.max())] if z.size else None,
        classes=classes,
        strays=places(block, strays, frame.origin),
        bounds=bounds,
        z=z_range,
    )
