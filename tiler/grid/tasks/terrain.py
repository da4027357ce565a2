"""Rasters of heights on the TIN of the ground, and tasks that make one TIN for several blocks.

A TIN also includes the points around its blocks, so a few large TINs triangulate fewer points
than many small TINs. Pixels and digests of a block do not depend on its group, so finished
blocks remain valid.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ptd.arrays import Int64
from tiler.core.lattice import Cell, Lattice
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block
from tiler.core.records import BucketRecord
from tiler.grid.block import full_halo, grid_block, grid_blocks
from tiler.grid.ground import max_points_in_bucket
from tiler.grid.records import GridBlock
from tiler.grid.tasks.gridding import CANOPY_CELLS, CANOPY_TERRAIN, Grid, GridContext, Place
from tiler.grid.tasks.steps import near_places
from tiler.plan import Plan
from tiler.plan.memory import GROUND_BYTES, TIN_BYTES
from tiler.schedule import Task, calling

MAX_PIXELS = 16 * BLOCK_PIXELS**2
"""A task has at most this many pixels. They take 13 bytes each, little compared to the memory
of a worker."""
TASKS_PER_WORKER = 4
"""Tasks are divided until there are this many per worker, if that makes all workers finish
earlier."""
WORTH_DIVIDING = 0.95
"""A division into more groups is used only if it takes at most this share of the shortest time
so far."""

Records = Mapping[Cell, BucketRecord]


@dataclass(frozen=True)
class OnTin:
    """Raster of heights on the TIN of the ground.

    Attributes
    ----------
    name : str
        Name of the raster in the store. The stage that makes it is ``grid-<name>``.
    grid : Grid
    inputs : tuple of str
        Names of the rasters that are made before it.
    over : callable
        Function ``over(context)`` that returns the places of the blocks, or None for all that a facet can reach.
    fill : float
        Value of pixels without a height.
    """

    name: str
    grid: Grid
    inputs: tuple[str, ...] = ()
    over: Callable[[GridContext], Collection[Place] | None] = lambda _: None
    fill: float = NODATA

    @property
    def stage(self) -> str:
        """Stage that makes the raster."""
        return f"grid-{self.name}"

    def tasks(self, context: GridContext) -> Iterator[Task]:
        """Yield a task for each block within the reach of a facet."""
        plan, corrections, spec = context.plan, context.corrections, context.spec_of(self.grid)
        widest, places = full_halo(context.facets.max_edge), self.over(context)
        shared = self._shared(context)
        for block, near in context.near(spec, widest).items() if places != set() else ():
            if places is not None and (block.row, block.col) not in places:
                continue
            extent = spec.block_bounds(block)
            yield Task.of(
                self.stage,
                block.name,
                calling(grid_block, work=GridBlock(block=block, max_halo=widest, **shared)),
                context.label_digests(near),
                corrections.line_digests_near(extent, plan),
                points=context.n_points(near),
                makes=block.height * block.width,
                bounds=extent,
            )

    def _shared(self, context: GridContext) -> dict[str, Any]:
        """Return the values that all blocks have in common."""
        plan, facets = context.plan, context.facets
        of_canopies = self.grid is Grid.CANOPY
        return {
            "name": self.name,
            "spec": context.spec_of(self.grid),
            "rule": context.rule,
            "data": facets.data,
            "max_edge": facets.max_edge,
            "halo": facets.halo,
            "interpolation": "linear" if of_canopies else plan.config.interpolation,
            "thin": context.canopy_cells.lattice if of_canopies else _thinning(plan),
            "percent": plan.config.surface_percent,
            "breaklines": context.corrections.lines_key,
            "max_points": plan.block_points,
        }


def _thinning(plan: Plan) -> Lattice | None:
    """Return the cells in which one ground point makes the surface, or None if all do."""
    share = plan.surface_cells
    return (
        None if share is None else Lattice(plan.frame.counts(plan.grid.surface_pixel / share))
    )


def _where_water_is_sought(context: GridContext) -> Collection[Place] | None:
    return None if context.water_is_sought else set()


def _near_canopies(context: GridContext) -> set[Place]:
    places = context.places_with(CANOPY_CELLS, "filled", Grid.CANOPY)
    return set(near_places(context.canopy_cells, places))


TERRAIN = OnTin("dtm", Grid.PIXELS)
TERRAIN_OF_CANOPIES = OnTin(CANOPY_TERRAIN, Grid.CANOPY, (CANOPY_CELLS,), _near_canopies)
TERRAIN_OF_WATER = OnTin("water-terrain", Grid.COARSE, over=_where_water_is_sought)
"""Terrain in coarse cells, which the search for water needs if pixels are larger."""


@dataclass(frozen=True)
class _Group:
    """Blocks of a task.

    Attributes
    ----------
    blocks : int64 (n,)
        Indices of the blocks.
    buckets : int64 (m,)
        Indices of the buckets in the window of the task.
    points : int
        Largest possible number of points in these buckets.
    pixels : int
        Number of pixels of the rectangle around the blocks.
    """

    blocks: Int64
    buckets: Int64
    points: int
    pixels: int

    @property
    def cost(self) -> int:
        """Number of points plus a quarter of the pixels, as a pixel takes less time than a vertex."""
        return self.points + self.pixels // 4


def join_blocks(
    plan: Plan, records: Records, tasks: Sequence[Task], workers: int
) -> list[Task]:
    """Join tasks of single blocks of the terrain into few tasks with one TIN each, the largest first.

    There are only as many tasks as the memory of a worker and a balanced load of all workers
    require. Only blocks with linear interpolation are joined. Natural neighbours at the hull
    depend on the window, and IDW takes much memory per pixel.

    Parameters
    ----------
    plan : Plan
    records : mapping of Cell to BucketRecord
        Record of the assembly of each bucket.
    tasks : sequence of Task
        Tasks of single blocks.
    workers : int
    """
    if len(tasks) < 2 or plan.config.interpolation != "linear":
        return list(tasks)
    layout = _Layout(plan, records, [task.arguments["work"] for task in tasks])
    groups = _fitting(layout, min(plan.block_points, TIN_BYTES // GROUND_BYTES))
    groups = _balanced(layout, groups, workers)
    groups.sort(key=lambda group: -group.cost)
    return [_joined([tasks[i] for i in group.blocks]) for group in groups]


def _joined(parts: Sequence[Task]) -> Task:
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    call = calling(grid_blocks, works=tuple(part.arguments["work"] for part in parts))
    points = sum(part.points for part in parts)
    name = f"{first.key}+{len(parts) - 1}"
    return Task.of(first.stage, name, call.without("works"), points=points, parts=tuple(parts))


def _fitting(layout: _Layout, max_points: int) -> list[_Group]:
    """Divide the blocks into groups of at most ``max_points`` points and `MAX_PIXELS` pixels, or of one block.

    A group is also divided if its two halves together cost less than the group.
    """
    groups = []
    todo = [layout.whole()]
    while todo:
        group = todo.pop()
        halves = layout.halves(group)
        too_large = group.points > max_points or group.pixels > MAX_PIXELS
        if halves and (too_large or _total_cost(halves) < group.cost):
            todo += halves
        else:
            groups.append(group)
    return groups


def _balanced(layout: _Layout, groups: list[_Group], workers: int) -> list[_Group]:
    """Divide groups further if all workers then finish earlier, although more points are triangulated twice."""
    best, earliest = groups, _makespan(groups, workers)
    while len(groups) < TASKS_PER_WORKER * workers:
        # Groups of one block cannot be divided, so they come first.
        *rest, largest = sorted(groups, key=lambda group: (len(group.blocks) > 1, group.cost))
        halves = layout.halves(largest)
        if not halves:
            break
        groups = [*rest, *halves]
        if _makespan(groups, workers) < WORTH_DIVIDING * earliest:
            best, earliest = groups, _makespan(groups, workers)
    return best


def _total_cost(groups: Iterable[_Group]) -> int:
    return sum(group.cost for group in groups)


def _makespan(groups: Sequence[_Group], workers: int) -> int:
    """Return the total cost of the worker that finishes last, if each free worker takes the largest remaining group."""
    ends = [0] * workers
    for cost in sorted((group.cost for group in groups), reverse=True):
        heapq.heapreplace(ends, ends[0] + cost)
    return max(ends)


class _Layout:
    """Positions of all blocks and buckets, and numbers of points of the buckets."""

    def __init__(self, plan: Plan, records: Records, works: Sequence[GridBlock]) -> None:
        self._spec = works[0].spec
        self._halo = works[0].halo
        self._buckets = plan.buckets
        blocks = [work.block for work in works]
        self._start = np.array([(b.row, b.col) for b in blocks])
        self._stop = np.array([(b.row + b.height, b.col + b.width) for b in blocks])
        self._cells = np.array([(cell.ix, cell.iy) for cell in records])
        self._points = np.array(
            [max_points_in_bucket(r.n, self._buckets, works[0].thin) for r in records.values()]
        )

    def whole(self) -> _Group:
        """Return the group of all blocks."""
        return self._group(np.arange(len(self._start)), np.arange(len(self._cells)))

    def halves(self, group: _Group) -> list[_Group]:
        """Divide a group in two, so that the more expensive half costs as little as possible.

        Return an empty list for a single block.
        """
        divisions: list[tuple[int, int, int, list[_Group]]] = []
        for axis in (0, 1):
            starts = self._start[group.blocks, axis]
            for line in np.unique(starts)[1:]:
                sides = (group.blocks[starts < line], group.blocks[starts >= line])
                pair = [self._group(side, group.buckets) for side in sides]
                divisions.append(
                    (max(half.cost for half in pair), _total_cost(pair), len(divisions), pair)
                )
        return min(divisions)[-1] if divisions else []

    def _group(self, blocks: Int64, buckets: Int64) -> _Group:
        """Return the group of some blocks. All buckets of its window must be among ``buckets``."""
        row, col = self._start[blocks].min(axis=0).tolist()
        height, width = (self._stop[blocks].max(axis=0) - (row, col)).tolist()
        window = self._spec.block_bounds(Block(row, col, height, width)).pad(self._halo)
        index = self._buckets.index_of
        first = (index(window.x0), index(window.y0))
        last = (index(window.x1 - 1), index(window.y1 - 1))
        cells = self._cells[buckets]
        near = buckets[((cells >= first) & (cells <= last)).all(axis=1)]
        return _Group(blocks, near, int(self._points[near].sum()), height * width)
