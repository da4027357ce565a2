"""Joining of blocks of the terrain to tasks with one TIN each.

A TIN also includes the points around its blocks, so a few large TINs triangulate fewer points than many small ones.
Pixels, digests and commits of a block do not depend on the joining, so finished blocks remain valid.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiler.core.lattice import Cell
from tiler.core.raster import BLOCK_PIXELS, Block
from tiler.core.records import BucketRecord
from tiler.grid import GridBlock, GridBlocks, grid_blocks, max_points_in_bucket
from tiler.plan import Plan
from tiler.plan.memory import GROUND_BYTES, TIN_BYTES
from tiler.schedule import Task

MAX_PIXELS = 16 * BLOCK_PIXELS**2
"""Largest number of pixels of a task. They take 13 bytes each, which is little compared to the memory of a worker."""
TASKS_PER_WORKER = 4
"""Tasks per worker up to which tasks are divided, so that workers do not wait for others."""
WORTH_DIVIDING = 0.95
"""Share to which dividing must shorten the time of the worker that finishes last."""

Records = Mapping[Cell, BucketRecord]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class _Group:
    """Indices of the blocks of a task and of the buckets of its window, and the numbers of points and pixels."""

    blocks: Ints
    buckets: Ints
    points: int
    pixels: int

    @property
    def cost(self) -> int:
        """Number of points and a quarter of the pixels, as a pixel takes less time than a vertex."""
        return self.points + self.pixels // 4


def joined_blocks(plan: Plan, records: Records, tasks: Sequence[Task], workers: int) -> list[Task]:
    """Join tasks of single blocks of the terrain into few tasks with one TIN each, the largest first.

    The number of tasks is as small as the memory of a worker and a balanced load of all workers allow. Blocks with
    other interpolations are not joined: natural neighbours at the hull depend on the window, and IDW takes much memory
    per pixel.

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
    survey = _Survey(plan, records, [task.arguments for task in tasks])
    groups = _balanced(survey, _fitting(survey, min(plan.block_points, TIN_BYTES // GROUND_BYTES)), workers)
    groups.sort(key=lambda group: -group.cost)
    return [_joined([tasks[i] for i in group.blocks]) for group in groups]


def _joined(parts: Sequence[Task]) -> Task:
    if len(parts) == 1:
        return parts[0]
    first, blocks = parts[0], GridBlocks(tuple(part.arguments for part in parts))
    points = sum(part.points for part in parts)
    name = f"{first.key}+{len(parts) - 1}"
    return Task(first.stage, name, "", grid_blocks, blocks, points, tuple(parts))


def _fitting(survey: _Survey, most: int) -> list[_Group]:
    """Divide the blocks into groups of at most ``most`` points, or of one block.

    A group is also divided if its halves together cost less than the group.
    """
    groups, todo = [], [survey.whole()]
    while todo:
        group = todo.pop()
        halves = survey.halves(group)
        if halves and (_too_large(group, most) or _total(halves) < group.cost):
            todo += halves
        else:
            groups.append(group)
    return groups


def _too_large(group: _Group, most: int) -> bool:
    return group.points > most or group.pixels > MAX_PIXELS


def _balanced(survey: _Survey, groups: list[_Group], workers: int) -> list[_Group]:
    """Divide groups further if all workers then finish earlier, although more points are triangulated twice."""
    best, earliest = groups, _makespan(groups, workers)
    while len(groups) < TASKS_PER_WORKER * workers:
        *rest, largest = sorted(groups, key=lambda group: (len(group.blocks) > 1, group.cost))
        halves = survey.halves(largest)
        if not halves:
            break
        groups = [*rest, *halves]
        if _makespan(groups, workers) < WORTH_DIVIDING * earliest:
            best, earliest = groups, _makespan(groups, workers)
    return best


def _total(groups: Iterable[_Group]) -> int:
    return sum(group.cost for group in groups)


def _makespan(groups: Sequence[_Group], workers: int) -> int:
    """Return the cost for the worker that finishes last, if workers take the largest remaining group in turn."""
    ends = [0] * workers
    for cost in sorted((group.cost for group in groups), reverse=True):
        heapq.heapreplace(ends, ends[0] + cost)
    return max(ends)


class _Survey:
    """Blocks to make, and points of all buckets."""

    def __init__(self, plan: Plan, records: Records, works: Sequence[GridBlock]) -> None:
        self._spec, self._halo, self._buckets = works[0].spec, works[0].halo, plan.meta.bucket
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
        """Divide a group by the line with the cheapest larger part. Return an empty list for a single block."""
        divisions: list[tuple[int, int, int, list[_Group]]] = []
        for axis in (0, 1):
            starts = self._start[group.blocks, axis]
            for line in np.unique(starts)[1:]:
                sides = (group.blocks[starts < line], group.blocks[starts >= line])
                pair = [self._group(side, group.buckets) for side in sides]
                divisions.append((max(half.cost for half in pair), _total(pair), len(divisions), pair))
        return min(divisions)[-1] if divisions else []

    def _group(self, blocks: Ints, buckets: Ints) -> _Group:
        """Return the group of some blocks. Only the given buckets can be in its window."""
        row, col = self._start[blocks].min(axis=0).tolist()
        height, width = (self._stop[blocks].max(axis=0) - (row, col)).tolist()
        window = self._spec.block_bounds(Block(row, col, height, width)).pad(self._halo)
        index, cells = self._buckets.index_of, self._cells[buckets]
        low, high = (index(window.x0), index(window.y0)), (index(window.x1 - 1), index(window.y1 - 1))
        near = buckets[((cells >= low) & (cells <= high)).all(axis=1)]
        return _Group(blocks, near, int(self._points[near].sum()), height * width)
