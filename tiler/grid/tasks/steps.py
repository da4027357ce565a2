"""Rows of the table of rasters that are made by steps (`tiler.grid.steps`), and the tasks of a row.

The digest of a task includes the values of the step and what each of its reads holds there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from tiler.core.digests import digest_of
from tiler.core.edits import FLAT
from tiler.core.lattice import Bounds, Cell
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec, north_west
from tiler.grid.coarse import padded
from tiler.grid.steps import Counts, MakeBlock, Read, run_block
from tiler.grid.tasks.gridding import Grid, GridContext
from tiler.grid.tasks.survey import surveyed_blocks
from tiler.runs.job import Job
from tiler.schedule import Task
from tiler.version import RULES

Near = Mapping[Block, list[Cell]]
"""Blocks near points, each with the buckets that it reads."""


@dataclass(frozen=True)
class Over:
    """Blocks over which a step works: those where all, or any, of some of its reads hold something."""

    names: tuple[str, ...]
    combine: Callable[..., set[Block]]


def all_of(*names: str) -> Over:
    """Return the blocks in which all reads of these names hold something."""
    return Over(names, set.intersection)


def any_of(*names: str) -> Over:
    """Return the blocks in which a read of these names holds something."""
    return Over(names, set.union)


@dataclass(frozen=True)
class Step:
    """Raster of pixels that is a function of what it reads.

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
        Other arguments of ``work``.
    finish : callable, optional
        Function ``finish(job, context, counts)`` that enters the counts of all blocks into run.json.
    fill : float
        Value of pixels without one.
    """

    name: str
    work: Callable[..., tuple[Any, Counts]]
    reads: Mapping[str, Read]
    over: Over
    values: Mapping[str, Any] = field(default_factory=dict)
    finish: Callable[[Job, GridContext, Mapping[Block, Counts]], None] | None = None
    fill: float = NODATA
    grid: Grid = Grid.PIXELS

    @property
    def stage(self) -> str:
        """Stage that makes the raster."""
        return f"grid-{self.name}"

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the rasters that the step reads."""
        return tuple(read.raster for read in self.reads.values() if read.raster)

    def tasks(self, context: GridContext) -> Iterator[Task]:
        """Yield a task for each block, from north to south."""
        spec, sources = context.spec, context.sources
        widest = [read.margin for read in self.reads.values() if read.kind == "points"]
        near = context.near(spec, max(widest)) if widest else {}
        holding = [_blocks(self.reads[name], context, near) for name in self.over.names]
        for block in sorted(self.over.combine(*map(set, holding)), key=north_west):
            work = MakeBlock(
                name=self.name,
                spec=spec,
                block=block,
                work=self.work,
                reads=self.reads,
                values=self.values,
                sources=sources,
                fill=self.fill,
            )
            held = [_digest(read, context, near, work) for read in self.reads.values()]
            yield Task(
                self.stage,
                block.name,
                digest_of(RULES, self.name, spec, block, self.values, held),
                run_block,
                work,
                points=context.n_points(near.get(block, ())),
                pixels=0 if widest else block.height * block.width,
            )


def _blocks(read: Read, context: GridContext, near: Near) -> Iterable[Block]:
    """Return the blocks in which a read holds something."""
    spec = context.spec
    if read.kind == "raster":
        return [spec.block_named(key, BLOCK_PIXELS) for key in context.made[read.raster]]
    if read.kind == "cells":
        return surveyed_blocks(context, read.raster)
    if read.kind == "failed":
        return [
            block for hole in context.holes for block in spec.blocks_within(hole, BLOCK_PIXELS)
        ]
    return near


def _digest(read: Read, context: GridContext, near: Near, work: MakeBlock) -> Any:
    """Return what a read holds at a block, as far as it can change the result."""
    spec, sources = work.spec, work.sources
    bounds = spec.block_bounds(work.block)
    wider = padded(work.block, read.margin)
    if read.kind == "raster":
        return _checksums(context, read.raster, spec, spec.block_bounds(wider))
    if read.kind == "cells":
        return [sources.coarse, context.coarse_checksums(read.raster, wider)]
    if read.kind == "facets":
        return sources.facets
    if read.kind == "kind":
        return sources.kind
    if read.kind == "water":
        return context.waters.digest(bounds)
    if read.kind == "flat":
        return context.corrections.edit_digests(bounds, (FLAT,))
    if read.kind == "area":
        return sources.area
    if read.kind == "failed":
        return [hole.to_json() for hole in sources.failed if hole.overlaps(bounds)]
    terrain = _checksums(context, read.raster, spec, bounds.pad(read.margin))
    return [sources.rule, context.label_digests(near.get(work.block, ())), terrain]


def _checksums(
    context: GridContext, raster: str, spec: RasterSpec, bounds: Bounds
) -> list[list[str]]:
    """Return the checksums of the blocks of a raster that overlap bounds. Without a raster there are none."""
    if not raster:
        return []
    return context.checksums(raster, [b.name for b in spec.blocks_within(bounds, BLOCK_PIXELS)])
