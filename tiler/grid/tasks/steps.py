"""Rows of the table of rasters that are made by steps (`tiler.grid.steps`), and the tasks of a row.

The digest of a task includes the values of the step and what each of its reads holds there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from tiler.core.edits import ACTIONS
from tiler.core.lattice import Bounds, Cell
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec, north_west
from tiler.grid.coarse import padded
from tiler.grid.steps import Counts, MakeBlock, Position, Read, canopy_window, run_block
from tiler.grid.tasks.gridding import Grid, GridContext
from tiler.grid.tasks.survey import surveyed_blocks
from tiler.runs.job import Job
from tiler.schedule import Task, calling

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
        spec, sources = context.spec_of(self.grid), context.sources
        widest = [read.margin for read in self.reads.values() if read.kind in OF_POINTS]
        near = context.near(spec, max(widest)) if widest else {}
        chosen = self.over(self, context, near)
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
        return surveyed_blocks(context, read.raster)
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
