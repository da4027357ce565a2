"""The tasks of each stage, with the digest of everything that their results depend on.

A task is done if the store holds a commit with its digest. So a change of a parameter, an input or a neighbour makes
exactly those tasks new that it can reach, and everything else is found done.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, reduce
from typing import Any

from ptd.methods import METHODS
from ptd.passes import Pass, later_passes, read_at_candidates
from tiler.core.classes import GROUND, OVERLAP_FLAG, STRAY_FLAG, SYNTHETIC_FLAG, WITHHELD_FLAG
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.export import WriteClassified, write_classified
from tiler.filter import LABELS, FilterTile, filter_tile, sight_m
from tiler.grid import GridBlock, GroundRule, full_halo, grid_block
from tiler.ingest import (
    AssembleBuckets,
    BucketParts,
    SourceInfo,
    SpoolPiece,
    Strays,
    assemble_buckets,
    claimed_bounds,
    find_strays,
    pieces,
    spool_piece,
)
from tiler.io.locations import joined, location
from tiler.io.result_folder import CLASSIFIED
from tiler.plan import KEEP, PIECE_POINTS, Plan
from tiler.plan.filter_tiles import tiles_of
from tiler.plan.memory import held_bytes, nested
from tiler.schedule import Task, digest_of
from tiler.store import Commits
from tiler.version import __version__

ERODE_RISE_M = 1
"""How much higher than a ground point an object beside it has to be for `--erode`."""

GROUP = 4
"""Buckets a side that one assembly task writes."""


@dataclass(frozen=True)
class Source:
    """A readable file and its number in the store."""

    info: SourceInfo
    number: int
    content: str

    @property
    def name(self) -> str:
        """What the keys of its pieces begin with: ``s000012``."""
        return f"s{self.number:06d}"

    @property
    def identity(self) -> list[Any]:
        """What a piece of it depends on."""
        return [self.info.size, self.info.digest, self.content, self.info.salvaged]


def skip_flags(plan: Plan) -> int:
    """Bits of flags that keep a point out of filtering."""
    config = plan.config
    return (
        WITHHELD_FLAG
        | STRAY_FLAG
        | (SYNTHETIC_FLAG if config.skip_synthetic else 0)
        | (OVERLAP_FLAG if config.skip_overlap else 0)
    )


def spool_tasks(plan: Plan, sources: Iterable[Source]) -> Iterator[Task]:
    """One for each piece of a source."""
    for source in sources:
        wanted = plan.buckets_of(source.info)
        claimed = claimed_bounds(source.info)
        for start, count in pieces(source.info, PIECE_POINTS):
            key = f"{source.name}-{start:012d}"
            identity = digest_of(source.identity, source.number, start, count, claimed, plan.meta.to_json())
            work = SpoolPiece(
                location(source.info.path),
                source.number,
                key,
                start,
                count,
                wanted,
                salvage=plan.config.salvage,
                extent=claimed,
                identity=identity,
                stamp=source.info.stamp,
            )
            yield Task("spool", key, digest_of(identity, wanted), spool_piece, work, count)


def by_source(spooled: Commits) -> dict[str, list[dict[str, Any]]]:
    """Name of a source -> the records of its pieces."""
    found: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for key, (_, record) in spooled.items():
        found[source_of(key)].append(record)
    return found


def source_of(piece: str) -> str:
    """Name of the source that a piece is of."""
    return piece.partition("-")[0]


Fragments = dict[Cell, list[tuple[str, int, int]]]
"""Piece, first and end row of each run of points that belongs to a bucket."""


def fragments_of(spooled: Commits) -> Fragments:
    """Where the points of each bucket lie in the spool, from the commits of the pieces."""
    found: Fragments = defaultdict(list)
    for piece in sorted(spooled):
        start = 0
        for ix, iy, count in spooled[piece][1]["buckets"]:
            found[Cell(ix, iy)].append((piece, start, start + count))
            start += count
    return dict(found)


def strays_of(plan: Plan, sources: Iterable[Source], spooled: Commits) -> dict[int, Strays]:
    """Number of a source -> its strays, for those that have some."""
    held: dict[str, dict[Cell, int]] = defaultdict(lambda: defaultdict(int))
    outside: dict[str, int] = defaultdict(int)
    for key, (_, record) in spooled.items():
        outside[source_of(key)] += record["outside"]
        for ix, iy, count in record["buckets"] + record["left"]:  # a file is judged whole
            held[source_of(key)][Cell(ix, iy)] += count
    found = {}
    for source in sources:
        strays = find_strays(
            held[source.name], plan.meta.bucket, claimed_bounds(source.info), outside[source.name]
        )
        if strays != Strays():
            found[source.number] = strays
    return found


def assemble_tasks(
    plan: Plan,
    spooled: Commits,
    fragments: Fragments,
    strays: Mapping[int, Strays],
) -> Iterator[Task]:
    """One for each group of neighbouring buckets."""

    def bucket(cell: Cell) -> BucketParts:
        sources = {int(source_of(piece)[1:]) for piece, _, _ in fragments[cell]} & strays.keys()
        rules = ((n, strays[n].rule(plan.meta.bucket, cell)) for n in sorted(sources))
        return BucketParts(
            cell, tuple(fragments[cell]), tuple((n, rule) for n, rule in rules if rule is not None)
        )

    groups: dict[Cell, list[Cell]] = defaultdict(list)
    for cell in fragments:
        groups[Cell(cell.ix // GROUP, cell.iy // GROUP)].append(cell)
    flags, keep = skip_flags(plan), plan.config.keep_classes
    for group in sorted(groups):
        buckets = tuple(bucket(c) for c in sorted(groups[group]))
        parents = [
            spooled[piece][1]["identity"]
            for piece in sorted({f[0] for c in groups[group] for f in fragments[c]})
        ]
        points = sum(stop - start for c in groups[group] for _, start, stop in fragments[c])
        # In which rows of a piece the points lie depends on what else is wanted of it; which points they are does not.
        content = [
            [b.cell, [[piece, stop - start] for piece, start, stop in b.fragments], b.rules] for b in buckets
        ]
        digest = digest_of(content, keep, flags, parents)
        work = AssembleBuckets(buckets, keep, flags)
        yield Task("assemble", group.name, digest, assemble_buckets, work, points)


@dataclass(frozen=True)
class Assembled:
    """What the finished ingest holds: bucket -> record, and bucket -> digest of what its contents depend on."""

    records: dict[Cell, dict[str, Any]]
    digests: dict[Cell, str]

    @classmethod
    def of(cls, commits: Commits) -> Assembled:
        """From the commits of the assembly tasks."""
        records: dict[Cell, dict[str, Any]] = {}
        digests: dict[Cell, str] = {}
        for digest, record in commits.values():
            for bucket in record["buckets"]:
                cell = Cell(*bucket["cell"])
                records[cell], digests[cell] = bucket, digest
        return cls(dict(sorted(records.items())), digests)

    @cached_property
    def bounds(self) -> Bounds:
        """Bounds of all stored points, absolute counts."""
        found = [Bounds.from_json(r["bounds"]) for r in self.records.values() if r["bounds"]]
        return reduce(Bounds.union, found)


@dataclass(frozen=True)
class Before:
    """What the passes before left for the next one: names in the store, and by bucket digests of what they name.

    Attributes
    ----------
    labels, elected, elected_labels : str or None
        Of the last labels of points, of the points that were elected, and of these points' last labels.
    of_candidates : bool
        The last labels of points are those of candidates.
    digests, elected_digests : mapping of Cell to str
        Of the contents of a bucket with the labels of its points, and with what was elected there, labels and all.
    n_elected : mapping of Cell to int
        Elected points of a bucket; none where the tile failed.
    """

    digests: Mapping[Cell, str]
    labels: str | None = None
    of_candidates: bool = False
    elected: str | None = None
    elected_labels: str | None = None
    elected_digests: Mapping[Cell, str] = field(default_factory=dict)
    n_elected: Mapping[Cell, int] = field(default_factory=dict)

    def after(
        self, number: int, step: Pass, last: bool, few: bool, assembled: Assembled, done: Commits
    ) -> Before:
        """What there is after a pass that was done, and that elects or gives labels.

        ``last``: of all points; ``few``: of candidates alone.
        """
        if step.elects:
            counts = dict.fromkeys(assembled.records, 0)
            for _, record in done.values():
                cells = (Cell(*cell) for cell in record["cells"])
                counts |= dict(zip(cells, record["elected_points"], strict=True))
            digests = label_digests(assembled, done, "elected")
            if step.gives_labels:
                of_labels = label_digests(assembled, done)
                digests = {cell: digest_of(digest, of_labels[cell]) for cell, digest in digests.items()}
            return replace(
                self,
                elected=elected_name(number),
                elected_labels=labels_name(number) if step.gives_labels else None,
                elected_digests=digests,
                n_elected=counts,
            )
        digests = label_digests(assembled, done)
        if step.elected and not last:
            both = {cell: digest_of(digest, self.elected_digests[cell]) for cell, digest in digests.items()}
            return replace(self, elected_labels=labels_name(number), elected_digests=both)
        return replace(self, labels=labels_name(number), of_candidates=few, digests=digests)


def labels_name(number: int) -> str:
    """Name in the store of the labels of a pass that is not the last one."""
    return f"{LABELS}-{number}"


def elected_name(number: int) -> str:
    """Name in the store of the points that a pass elects."""
    return f"elected-{number}"


def labels_given(plan: Plan, number: int, state: Mapping[str, Any]) -> tuple[bool, bool]:
    """Whether the labels that a pass gives are the last ones, and whether they are those of candidates alone."""
    params = METHODS[plan.config.method].params(**plan.parameters)
    step = params.passes[number]
    if not step.gives_labels:
        return False, False
    later = later_passes(params.passes, number, state)
    few = not (step.elected or step.elects or step.label_margin_m) and nested(plan.candidate_cell_m)
    return not later, few and read_at_candidates(later)


def filter_tasks(
    plan: Plan, assembled: Assembled, number: int, state: Mapping[str, Any], before: Before
) -> Iterator[Task]:
    """One for each tile of a pass."""
    frame = plan.meta.frame
    params = METHODS[plan.config.method].params(**plan.parameters)
    step = params.passes[number]
    last, few = labels_given(plan, number, state)
    if step.elected and before.elected is None:
        raise ValueError(f"pass {step.name} works on elected points, and no pass before it elected any")
    beyond = math.ceil(frame.counts(Fraction(sight_m(step, params))))
    margin = math.ceil(frame.counts(Fraction(repr(float(step.label_margin_m)))))
    reads = "labels" in step.columns
    records: Mapping[Cell, Mapping[str, Any]] = assembled.records
    if step.elected:
        records = {cell: {**record, "n_elected": before.n_elected[cell]} for cell, record in records.items()}
    for tile in tiles_of(plan, records, plan.passes[number]):
        work = FilterTile(
            plan.config.method,
            plan.parameters,
            number,
            dict(state),
            tile.cells,
            tile.halo,
            tile.max_halo,
            plan.config.keep_classes,
            skip_flags(plan),
            labels_in=before.labels if reads else None,
            labels_out=LABELS if last else labels_name(number),
            elected_in=before.elected if step.elected else None,
            elected_labels_in=before.elected_labels if step.elected and reads else None,
            elected_out=elected_name(number) if step.elects else None,
            of_elected=step.elected and not last,
            of_candidates=few,
            in_of_candidates=reads and before.of_candidates,
            held_bytes=held_bytes(plan.memory),
        )
        sight = plan.meta.bucket.hull(tile.cells).pad(max(tile.max_halo + beyond, margin))
        digests = before.digests if reads else assembled.digests
        near = plan.meta.bucket.among(sight, digests)
        seen = [[c.ix, c.iy, digests[c]] for c in near]
        made = [before.elected_digests[c] for c in near] if step.elected else []
        points = sum(assembled.records[c]["n"] for c in tile.cells)
        digest = digest_of(__version__, work, seen, made)
        yield Task(f"filter{number}", f"t{tile.name}", digest, filter_tile, work, points)


def label_digests(assembled: Assembled, filtered: Commits, what: str = "labels") -> dict[Cell, str]:
    """Bucket -> digest of its contents and of the labels that a pass gave it; of a tile that failed it gave none.

    ``what``: the entry of the record, ``labels`` or ``elected``.
    """
    labels = dict.fromkeys(assembled.records, "none")
    for _, record in filtered.values():
        labels |= {Cell(*cell): record[what] for cell in record["cells"]}
    return {cell: digest_of(given, assembled.digests[cell]) for cell, given in labels.items()}


def area_key(plan: Plan) -> str | None:
    """Name of the plan's area in the store; None where all is wanted."""
    return None if plan.area is None else plan.area.key


def raster_spec(plan: Plan, assembled: Assembled) -> RasterSpec:
    """The one pixel grid of the run: all stored points within the area, pixels on multiples of the resolution."""
    extent = assembled.bounds
    if plan.area is not None:
        extent = extent.intersection(plan.area.bounds)
    return RasterSpec.covering(Lattice(plan.meta.frame.counts(plan.resolution)), extent)


def ground_rule(plan: Plan) -> GroundRule:
    """Which points are ground."""
    keep = plan.config.method == KEEP
    return GroundRule(
        None if keep else LABELS,
        plan.config.ground_classes if keep else (GROUND,),
        skip_flags(plan),
        plan.meta.frame.counts(plan.config.erosion),
        math.ceil(ERODE_RISE_M / plan.meta.frame.metres_z),
    )


def grid_tasks(plan: Plan, assembled: Assembled, labels: Mapping[Cell, str], name: str) -> Iterator[Task]:
    """One for each block of the raster that a facet could reach."""
    spec, frame = raster_spec(plan, assembled), plan.meta.frame
    max_edge, share = frame.counts(plan.config.max_edge), plan.surface_share
    thin = None if share is None else Lattice(frame.counts(plan.resolution / share))
    rule, data, halo = ground_rule(plan), assembled.bounds, math.ceil(frame.counts(plan.grid_halo))
    reach = full_halo(max_edge) + math.ceil(frame.counts(plan.config.erosion))
    for block, near in spec.blocks_near(plan.meta.bucket, labels, BLOCK_PIXELS, reach).items():
        work = GridBlock(
            name=name,
            spec=spec,
            block=block,
            rule=rule,
            data=data,
            max_edge=max_edge,
            halo=halo,
            max_halo=full_halo(max_edge),
            interpolation=plan.config.interpolation,
            percent=plan.config.surface_percent,
            thin=thin,
            max_points=plan.block_points,
        )
        digest = digest_of(__version__, work, [[cell.ix, cell.iy, labels[cell]] for cell in near])
        points = sum(assembled.records[cell]["n"] for cell in near)
        yield Task(f"grid-{name}", block.name, digest, grid_block, work, points)


def classified_tasks(
    plan: Plan,
    sources: Iterable[Source],
    spooled: Commits,
    labels: Mapping[Cell, str],
    out: str,
) -> Iterator[Task]:
    """One for each source."""
    records = by_source(spooled)
    for source in sources:
        touched = {Cell(ix, iy) for r in records[source.name] for ix, iy, _ in r["buckets"]}
        cells = sorted(touched & labels.keys())  # a bucket whose task failed is not there
        extent = claimed_bounds(source.info)
        whole = plan.area is None or (extent is not None and plan.area.covers(extent))
        work = WriteClassified(
            path=location(source.info.path),
            source=source.number,
            out=joined(out, CLASSIFIED, str(plan.names[source.info.path])),
            labels=LABELS,
            cells=tuple(cells),
            salvage=plan.config.salvage,
            area=None if whole else area_key(plan),
            stamp=source.info.stamp,
        )
        digest = digest_of(__version__, source.identity, work, [labels[c] for c in cells], "statistics")
        yield Task("export", f"c{source.number:06d}", digest, write_classified, work, source.info.points)
