"""Tasks of the stage ingest, which decode pieces of files and assemble groups of buckets."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from tiler.core.lattice import Cell
from tiler.core.records import SpoolRecord, digest_of
from tiler.ingest.assemble import BucketParts, assemble_buckets
from tiler.ingest.spool import SpoolPiece, spool_piece
from tiler.ingest.strays import Strays, far_buckets
from tiler.inputs import SourceInfo, header_bounds, pieces, window_pieces
from tiler.inputs.extent import can_be_strays
from tiler.io.locations import is_url, location
from tiler.plan import PIECE_POINTS, Plan, buckets_of, chunks_of
from tiler.runs.found import Source, by_source, skip_flags, source_of
from tiler.schedule import Task, calling
from tiler.schedule.task import Call
from tiler.store import Commits
from tiler.version import INGEST_RULES

GROUP = 4
"""Number of buckets along a side of the group that an assembly task writes."""


def spool_tasks(plan: Plan, sources: Iterable[Source], keep: bool) -> Iterator[Task]:
    """Yield a task per piece of each source. With ``keep``, the tasks keep the records."""
    selection, meta = plan.config.selection, plan.grid.meta.to_json()
    for source in sources:
        buckets = buckets_of(plan, source.info)
        claimed = header_bounds(source.info)
        for start, count, ranges in _pieces(plan, source.info):
            key = f"{source.name}-{start:012d}"
            parts = [source.identity, source.number, start, count, claimed, meta, selection]
            identity = digest_of(*parts, *([ranges] if ranges else []))
            work = SpoolPiece(
                location(source.info.path),
                source.number,
                key,
                start,
                count,
                buckets,
                salvage=plan.config.salvage,
                extent=claimed,
                identity=identity,
                stamp=source.info.stamp,
                ranges=ranges,
                keep=keep,
                classes_only=plan.config.classified == "laz" and not is_url(source.info.path),
                selection=selection,
            )
            call = calling(spool_piece, work=work).without("work")
            yield Task.of(
                "spool", key, call, identity, buckets, rules=INGEST_RULES, points=count
            )


def _pieces(
    plan: Plan, info: SourceInfo
) -> Iterator[tuple[int, int, tuple[tuple[int, int], ...]]]:
    """Yield first record, number of records and ranges of each piece.

    Pieces of files that are read completely have no ranges.
    """
    chunks = chunks_of(plan, info)
    if chunks is None:
        yield from ((start, count, ()) for start, count in pieces(info, PIECE_POINTS))
        return
    for ranges in window_pieces(info, chunks, PIECE_POINTS):
        yield ranges[0][0], sum(count for _, count in ranges), ranges


Fragments = dict[Cell, list[tuple[str, int, int]]]
"""Piece, first row and end row of each run of points that belongs to a bucket."""


def fragments_of(spooled: Commits) -> Fragments:
    """Return the locations in the spool of each bucket's points, from the commits of the pieces."""
    fragments: Fragments = defaultdict(list)
    for piece in sorted(spooled):
        start = 0
        _, stored = spooled[piece]
        for ix, iy, count in SpoolRecord.of(stored).buckets:
            fragments[Cell(ix, iy)].append((piece, start, start + count))
            start += count
    return dict(fragments)


def strays_of(plan: Plan, sources: Iterable[Source], spooled: Commits) -> dict[int, Strays]:
    """Return the strays of each source that may have some, by its number.

    The buckets of all sources are judged together. The number of points in a bucket is the largest of any source, since
    a sum would count points several times that several files contain.
    """
    held: dict[Cell, int] = defaultdict(int)
    total: dict[str, int] = defaultdict(int)
    outside: dict[str, int] = defaultdict(int)
    cells: dict[str, set[Cell]] = defaultdict(set)
    for name, records in by_source(spooled).items():
        of_source: dict[Cell, int] = defaultdict(int)
        for record in records:
            outside[name] += record.outside
            for ix, iy, count in record.buckets + record.left:  # A file is judged as a whole.
                of_source[Cell(ix, iy)] += count
        total[name], cells[name] = sum(of_source.values()), set(of_source)
        for cell, count in of_source.items():
            held[cell] = max(held[cell], count)
    far = far_buckets(held, plan.buckets)
    strays_by_source = {}
    for source in sources:
        name, n_outside = source.name, outside[source.name]
        # If there are many, they are not strays, because the header is wrong.
        lies = n_outside > 0 and can_be_strays(n_outside, total[name])
        strays = Strays(far & cells[name], header_bounds(source.info) if lies else None)
        if strays != Strays():
            strays_by_source[source.number] = strays
    return strays_by_source


def parts_of_buckets(
    plan: Plan, fragments: Fragments, strays: Mapping[int, Strays]
) -> list[BucketParts]:
    """Return the locations of each bucket's points, with the rules for its strays."""

    def parts(cell: Cell) -> BucketParts:
        rules = (
            (n, strays[n].rule(plan.buckets, cell))
            for n in sorted(sources_in(fragments[cell]) & strays.keys())
        )
        return BucketParts(
            cell,
            tuple(fragments[cell]),
            tuple((n, rule) for n, rule in rules if rule is not None),
        )

    return [parts(cell) for cell in sorted(fragments)]


def sources_in(fragments: Iterable[tuple[str, int, int]]) -> set[int]:
    """Return the numbers of the sources of fragments."""
    return {int(source_of(piece)[1:]) for piece, _, _ in fragments}


def assemble_tasks(
    plan: Plan, spooled: Commits, buckets: Iterable[BucketParts]
) -> Iterator[Task]:
    """Yield a task per group of neighbouring buckets."""
    flags, keep = skip_flags(plan), plan.config.keep_classes

    def call(group: tuple[BucketParts, ...]) -> Call:
        return calling(assemble_buckets, buckets=group, keep_classes=keep, skip_flags=flags)

    return group_tasks("assemble", plan, spooled, buckets, call)


def group_tasks(
    stage: str,
    plan: Plan,
    spooled: Commits,
    buckets: Iterable[BucketParts],
    call: Callable[[tuple[BucketParts, ...]], Call],
) -> Iterator[Task]:
    """Yield a task of a stage per group of neighbouring buckets. The call has the group as the value ``buckets``."""
    groups: dict[Cell, list[BucketParts]] = defaultdict(list)
    for bucket in buckets:
        groups[Cell(bucket.cell.ix // GROUP, bucket.cell.iy // GROUP)].append(bucket)
    identities = {
        piece: SpoolRecord.of(stored).identity for piece, (_, stored) in spooled.items()
    }
    for name in sorted(groups):
        group = tuple(groups[name])
        pieces_of_group = {piece for bucket in group for piece, _, _ in bucket.fragments}
        parents = [identities[piece] for piece in sorted(pieces_of_group)]
        yield Task.of(
            stage,
            name.name,
            call(group).without("buckets"),
            [_content(bucket) for bucket in group],
            parents,
            rules=INGEST_RULES,
            points=sum(stop - start for b in group for _, start, stop in b.fragments),
            bounds=plan.buckets.hull(bucket.cell for bucket in group),
        )


def _content(bucket: BucketParts) -> list[Any]:
    """Return what the digest has of a bucket.

    It has no rows, because a bucket's rows in a piece depend on the other buckets that are stored.
    """
    counts = [[piece, stop - start] for piece, start, stop in bucket.fragments]
    return [bucket.cell, counts, bucket.rules, *bucket.outranked]
