"""Rows of the table of rasters that are made by steps (`tiler.grid.steps`): their blocks and their tasks.

The digest of a task includes the values of the step and what each of its reads holds there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise, product
from typing import Any, NamedTuple

from tiler.core.edits import ACTIONS
from tiler.core.lattice import Bounds, Cell
from tiler.core.products import Read
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec, north_west
from tiler.grid.coarse import Piece, Side, blocks_of, components, padded, touching
from tiler.grid.steps import Counts, MakeBlock, Position, canopy_window, run_block
from tiler.grid.tasks.gridding import Grid, GridContext, Place
from tiler.runs.job import Job
from tiler.schedule import Task, calling


class _MissingRun(NamedTuple):
    """Run of missing blocks in a row of blocks, between two existing blocks.

    Attributes
    ----------
    kind : str
        ``gap``, or ``outside`` for the area around all blocks.
    row : int
        Row of the missing blocks (see `Place`).
    first, last : int
        Columns of the first and of the last missing block.
    """

    kind: str
    row: int
    first: int
    last: int


BEYOND_ALL = _MissingRun("outside", 0, 0, 0)
"""Area around all blocks."""
SIDES = {"north": (-1, 0), "south": (1, 0), "west": (0, -1), "east": (0, 1)}
"""Offset of the neighbour at each side of a block: blocks down, and blocks to the right."""


def near_places(coarse: RasterSpec, places: Iterable[Place], n_blocks: int = 1) -> list[Place]:
    """Return the places of blocks, and of other blocks up to ``n_blocks`` away, from the north-west.

    Places outside the raster are left out.
    """
    offsets = [step * BLOCK_PIXELS for step in range(-n_blocks, n_blocks + 1)]
    near = {
        (row + down, col + right)
        for row, col in places
        for down, right in product(offsets, offsets)
    }
    return sorted(
        (row, col) for row, col in near if 0 <= row < coarse.height and 0 <= col < coarse.width
    )


def block_names(places: Iterable[Place]) -> list[str]:
    """Return the names of the blocks at some places."""
    return [Block(*place, 0, 0).name for place in places]


def near_blocks(coarse: RasterSpec, places: Iterable[Place], n_blocks: int = 1) -> list[Block]:
    """Return the blocks at `near_places`."""
    near = near_places(coarse, places, n_blocks)
    return [coarse.block_at(*place, BLOCK_PIXELS) for place in near]


def enclosed_by_survey(step: Step, context: GridContext, _: Near) -> Mapping[Block, Values]:
    """Return the blocks of open areas, and the missing blocks that the survey encloses, with the values of `survey`."""
    coarse = context.coarse
    opened = context.counts_at(step.inputs[0])
    sides = {place: counts["sides"] for place, counts in opened.items()}
    outside, empty = outside_of(sides)
    values = {}
    for place in {*sides, *empty}:
        near = near_places(coarse, [place])
        values[coarse.block_at(*place, BLOCK_PIXELS)] = {
            "outside": list(chain.from_iterable(outside.get(other, ()) for other in near)),
            "empty": [other for other in near if other in empty],
        }
    return values


def outside_of(
    blocks: Mapping[Place, Mapping[str, Side]],
) -> tuple[dict[Place, list[Piece]], set[Place]]:
    """Find the open areas that are connected with the outside of a survey, and the missing blocks that it encloses.

    Parameters
    ----------
    blocks : mapping
        For the place of each existing block, the labels of the open areas along its sides. A missing block is
        completely open.

    Returns
    -------
    outside : dict
        For the place of a block, its open areas that are connected with the outside.
    enclosed : set
        Places of the missing blocks that the survey encloses.
    """
    columns: dict[int, list[int]] = defaultdict(list)
    for row, col in sorted(blocks):
        columns[row].append(col)
    gaps = {row: _missing_runs(row, cols) for row, cols in columns.items()}
    pairs: list[tuple[Any, Any]] = [*touching(blocks, corners=False)]
    for (row, col), sides in blocks.items():
        for side, (down, right) in SIDES.items():
            neighbour = (row + down * BLOCK_PIXELS, col + right * BLOCK_PIXELS)
            if neighbour not in blocks:
                gap = _missing_run_at(gaps, *neighbour)
                pairs += [
                    (Piece(row, col, label), gap)
                    for label in sorted({label for label, _ in sides[side] if label})
                ]
    all_gaps = list(chain.from_iterable(gaps.values()))
    for gap in all_gaps:
        for row in (gap.row - BLOCK_PIXELS, gap.row + BLOCK_PIXELS):
            pairs += [(gap, other) for other in _facing(gap, row, gaps, columns)]
    nodes = dict.fromkeys((*chain.from_iterable(pairs), BEYOND_ALL))
    beyond = next(set(group) for group in components(nodes, pairs) if BEYOND_ALL in group)
    outside: dict[Place, list[Piece]] = defaultdict(list)
    for piece in sorted(node for node in beyond if isinstance(node, Piece)):
        outside[piece.row, piece.col].append(piece)
    enclosed = {
        (gap.row, col)
        for gap in all_gaps
        for col in range(gap.first, gap.last + 1, BLOCK_PIXELS)
        if gap not in beyond
    }
    return outside, enclosed


def _missing_runs(row: int, cols: list[int]) -> list[_MissingRun]:
    """Return the gaps between the blocks of a row."""
    return [
        _MissingRun("gap", row, col + BLOCK_PIXELS, next_col - BLOCK_PIXELS)
        for col, next_col in pairwise(cols)
        if next_col - col > BLOCK_PIXELS
    ]


def _missing_run_at(gaps: Mapping[int, list[_MissingRun]], row: int, col: int) -> _MissingRun:
    """Return the gap at a place without a block, or `BEYOND_ALL`."""
    return next((gap for gap in gaps.get(row, ()) if gap.first <= col <= gap.last), BEYOND_ALL)


def _facing(
    gap: _MissingRun,
    row: int,
    gaps: Mapping[int, list[_MissingRun]],
    columns: Mapping[int, list[int]],
) -> list[_MissingRun]:
    """Return the gaps of an adjacent row of blocks that touch a gap.

    `BEYOND_ALL` is one of them if the gap extends beyond the first or last block of that row, or if the row is missing.
    """
    touching_gaps = [
        other
        for other in gaps.get(row, ())
        if other.first <= gap.last and gap.first <= other.last
    ]
    cols = columns.get(row)
    if cols is None or gap.first < cols[0] or gap.last > cols[-1]:
        touching_gaps.append(BEYOND_ALL)
    return touching_gaps


def _surveyed_blocks(context: GridContext, survey: str) -> list[Block]:
    """Return the blocks of the products that overlap the inside of the survey, from the north-west."""
    found = context.counts(survey).values()
    runs = list(chain.from_iterable(counts["blocks"] for counts in found))
    return sorted(set(blocks_of(runs, context.spec, BLOCK_PIXELS)), key=north_west)


Near = Mapping[Block, list[Cell]]
"""Blocks near points, each with the buckets that it reads."""
Values = Mapping[str, Any]
NONE: Values = {}
"""Values of a block that gets only those that all blocks get."""
OF_POINTS = "points", "canopy"
"""Kinds of reads whose margin is in counts around buckets."""
Over = Callable[["Step", "GridContext", Near], Mapping[Block, Values]]
"""Function ``over(step, context, near)`` that returns the blocks over which a step works, each with the values that
depend on the block."""


def all_of(*names: str) -> Over:
    """Return the rule for the blocks in which all reads of these names hold something."""
    return lambda step, context, near: dict.fromkeys(
        set.intersection(*(set(_blocks(step, name, context, near)) for name in names)), NONE
    )


def any_of(*names: str) -> Over:
    """Return the rule for the blocks in which a read of these names holds something."""
    return lambda step, context, near: dict.fromkeys(
        set.union(*(set(_blocks(step, name, context, near)) for name in names)), NONE
    )


def blocks_with(raster: str, count: str, grid: Grid = Grid.COARSE) -> Over:
    """Return the rule for the blocks of another raster in which a count is not 0."""
    return lambda _, context, __: {
        block: NONE for block, counts in context.counts(raster, grid).items() if counts[count]
    }


@dataclass(frozen=True)
class Step:
    """Raster that is a function of what it reads.

    Attributes
    ----------
    name : str
        Name of the raster in the store. The stage that makes it is ``grid-<name>``.
    work : callable
        See `MakeBlock.work`.
    reads : mapping of str to Read
        Arguments of ``work`` that are read for each block.
    over : Over
    values : mapping
        Other arguments of ``work`` that are the same for all blocks.
    finish : callable, optional
        Function ``finish(job, context, counts)`` that enters the counts of all blocks into run.json.
    fill : float
        Value of pixels without one.
    grid : Grid
    after : tuple of str
        Rasters that the step does not read, but whose counts ``over`` uses.
    side : int
        Side of its blocks in pixels. A step without a raster may have blocks of several `BLOCK_PIXELS`, if it reads
        wide surroundings. ``over`` returns blocks of `BLOCK_PIXELS`.
    """

    name: str
    work: Callable[..., tuple[Any, Counts]]
    reads: Mapping[str, Read]
    over: Over
    values: Mapping[str, Any] = field(default_factory=dict)
    finish: Callable[[Job, GridContext, Mapping[Block, Counts]], None] | None = None
    fill: float = NODATA
    grid: Grid = Grid.PIXELS
    after: tuple[str, ...] = ()
    side: int = BLOCK_PIXELS

    @property
    def stage(self) -> str:
        """Stage that makes the raster."""
        return f"grid-{self.name}"

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the rasters that are made before the step."""
        return (*self.after, *(read.raster for read in self.reads.values() if read.raster))

    def tasks(self, context: GridContext) -> Iterator[Task]:
        """Yield a task for each block, from north to south."""
        spec, sources, side = context.spec_of(self.grid), context.sources, self.side
        widest = [read.margin for read in self.reads.values() if read.kind in OF_POINTS]
        near = context.near(spec, max(widest), side) if widest else {}
        chosen = {
            spec.block_at(part.row - part.row % side, part.col - part.col % side, side): values
            for part, values in self.over(self, context, near).items()
        }
        empty = frozenset(raster for raster in self.inputs if not context.made.get(raster))
        reads_failed = any(read.kind == "failed" for read in self.reads.values())
        failed = _failed(context, spec) if reads_failed else {}
        for block in sorted(chosen, key=north_west):
            values = {**self.values, **chosen[block]}
            work = MakeBlock(
                name=self.name,
                spec=spec,
                block=block,
                work=self.work,
                reads=self.reads,
                values=values,
                sources=replace(sources, failed=tuple(failed.get(block, ()))),
                fill=self.fill,
                empty=empty,
            )
            held = [_digest(read, context, near, work) for read in self.reads.values()]
            n_pixels = block.height * block.width
            yield Task.of(
                self.stage,
                block.name,
                calling(run_block, task=work).without("task"),
                [self.name, spec, block, values],
                held,
                points=context.n_points(near.get(block, ())),
                pixels=0 if widest else n_pixels,
                makes=n_pixels,
                bounds=spec.block_bounds(block),
            )


def _blocks(step: Step, name: str, context: GridContext, near: Near) -> Iterable[Block]:
    """Return the blocks in which a read of a step holds something."""
    spec, read = context.spec_of(step.grid), step.reads[name]
    if read.kind in ("raster", "numbers"):
        return [spec.block_named(key, BLOCK_PIXELS) for key in context.made[read.raster]]
    if read.kind == "cells":
        return _surveyed_blocks(context, read.raster)
    if read.kind == "failed":
        return _failed(context, spec)
    if read.kind == "canopy" and context.canopy is None:
        return ()
    return near


def _failed(context: GridContext, spec: RasterSpec) -> Mapping[Block, list[Bounds]]:
    """Return the blocks that overlap tiles that failed, each with the bounds of these tiles."""
    failed: dict[Block, list[Bounds]] = defaultdict(list)
    for hole in context.holes:
        for block in spec.blocks_within(hole, BLOCK_PIXELS):
            failed[block].append(hole)
    return failed


def _digest(read: Read, context: GridContext, near: Near, work: MakeBlock) -> Any:
    """Return what a read holds at a block, as far as it can change the result."""
    spec, sources = work.spec, work.sources
    bounds, buckets = spec.block_bounds(work.block), near.get(work.block, ())
    wider = spec.block_bounds(padded(work.block, read.margin))
    if read.kind in ("raster", "numbers"):
        return _checksums(context, read.raster, spec, wider)
    if read.kind in ("pixels", "same-cells"):
        pixels = sources.pixels if read.kind == "pixels" else spec
        return [pixels, _checksums(context, read.raster, pixels, bounds)]
    if read.kind == "cells":
        return [sources.coarse, _checksums(context, read.raster, sources.coarse, wider)]
    if read.kind == "canopy-grid":
        place = Position(context.plan.frame, spec, work.block, sources)
        cells = sources.canopy_grid
        window = cells.block_bounds(canopy_window(place, read.margin))
        return [cells, _checksums(context, read.raster, cells, window)]
    if read.kind == "canopy":
        digests = {} if context.canopy is None else context.canopy.digests
        return [digests[cell] for cell in buckets]
    if read.kind == "waters":
        return context.waters.digest(bounds)
    if read.kind == "edits":
        return context.corrections.edit_digests(bounds, ACTIONS)
    if read.kind == "failed":
        return [failed.to_json() for failed in sources.failed]
    if read.kind == "points":
        terrain = _checksums(context, read.raster, spec, bounds.pad(read.margin))
        return [sources.rule, context.label_digests(buckets), terrain]
    alike = {
        "area": sources.area, "facets": sources.facets, "kind": sources.kind, "products": sources.pixels,
        "place": None,  # The digest of a task includes the block.
        "coarse": sources.coarse,  # The values of the block have the digests of what is read.
    }  # fmt: skip
    return alike[read.kind]


def _checksums(
    context: GridContext, raster: str, spec: RasterSpec, bounds: Bounds
) -> list[list[str]]:
    """Return the checksums of the blocks of a raster that overlap bounds. Without a raster there are none."""
    if not raster:
        return []
    return context.checksums(raster, [b.name for b in spec.blocks_within(bounds, BLOCK_PIXELS)])
