"""Estimates of the distribution and density of a file's points, from runs of successive points.

The mean density over a file's bounds is wrong if flight strips run diagonally, or cross. A run
of successive points gives the density at its position or, if the order of the file is random,
the density of the whole file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

_PER_CELL = 4.0
"""Mean number of points per occupied cell for which `local_density` chooses the size of its
cells."""
_ROUNDS = 6

# A long run is divided if its rectangle is mostly empty.
_FAR = 10_000.0
"""Minimum length of a long run in units of the CRS."""
_FAR_VOID = 1000.0
"""Ratio of the area of its rectangle to the area that its points fill, above which it is
divided."""

# A run of many points is divided if its rectangle is partly empty.
_MANY = 512
_VOID = 2.0
"""Ratio of the area of its rectangle to the area of all points that the run represents, above
which it is divided."""

# If the order of the file is random, patches are cells of the bounds.
_SPANS = 0.7
"""Share of both sides of the bounds that each run must span for the order to count as
random."""
_CELLS = 16
"""Maximum number of cells along a side."""
IN_CELL = 8
"""Mean number of points of the sample per cell."""


@dataclass(frozen=True)
class DensityPatch:
    """Rectangle from x0, y0 to x1, y1 in units of the CRS, with its estimated number of points."""

    x0: float
    y0: float
    x1: float
    y1: float
    points: float


def find_patches(
    runs: Sequence[npt.NDArray[np.float64]], points: int, bounds: Sequence[float]
) -> tuple[DensityPatch, ...]:
    """Estimate the patches of a file: one or more per run, or one per cell if its order is random.

    Together they contain all points. The rectangle of a run is widened until, at the density of
    the run, it contains all points up to the next run.

    Parameters
    ----------
    runs : sequence of float64, shape (2, n)
        x and y of successive points, at even distances in the file.
    points : int
        Number of points in the file.
    bounds : sequence of 4 float
        Lowest x, y and highest x, y, within which all patches lie.
    """
    low = np.array(bounds[:2])
    high = np.array(bounds[2:])
    inside = [
        run[:, np.all((run >= low[:, None]) & (run <= high[:, None]), axis=0)] for run in runs
    ]
    inside = [run for run in inside if run.shape[1]]
    if not inside:
        return (
            (DensityPatch(bounds[0], bounds[1], bounds[2], bounds[3], points),)
            if points
            else ()
        )
    if all(np.all(np.ptp(run, axis=1) >= _SPANS * (high - low)) for run in inside):
        return _cells(np.concatenate(inside, axis=1), points, low, high)
    share = points / len(inside)
    divided = [_divide(run, share) for run in inside]
    if any(len(parts) > 1 for parts in divided):
        # The runs of a small file overlap. So some are left out, until they have about as many
        # points as the file.
        step = max(round(sum(run.shape[1] for run in inside) / points), 1)
        divided = divided[::step]
        share = points / len(divided)
    patches = []
    for parts in divided:
        total = sum(part.shape[1] for part in parts)
        patches += [_patch(part, share * part.shape[1] / total, low, high) for part in parts]
    return tuple(patches)


def _cells(
    sample: npt.NDArray[np.float64],
    points: int,
    low: npt.NDArray[np.float64],
    high: npt.NDArray[np.float64],
) -> tuple[DensityPatch, ...]:
    """Return a patch per cell of the bounds with points of a sample of the whole file."""
    total = sample.shape[1]
    across = min(max(math.isqrt(total // IN_CELL), 1), _CELLS)
    side = (high - low) / across
    indices = np.floor((sample - low[:, None]) / np.where(side > 0, side, 1.0)[:, None]).astype(
        np.int64
    )
    cells, held = np.unique(np.minimum(indices, across - 1), axis=1, return_counts=True)
    corners = (low + cells.T * side).tolist()
    return tuple(
        DensityPatch(x, y, x + float(side[0]), y + float(side[1]), points * number / total)
        for (x, y), number in zip(corners, held.tolist(), strict=True)
    )


def _divide(run: npt.NDArray[np.float64], points: float) -> list[npt.NDArray[np.float64]]:
    """Divide a run that represents ``points`` points, until no part is diagonal or has a large gap."""
    sides = np.ptp(run, axis=1)
    density = local_density(run)
    total = run.shape[1]
    jumps = sides.max() >= _FAR and sides.prod() > _FAR_VOID * total / density
    diagonal = total > _MANY and sides.prod() > _VOID * points / density
    if not jumps and not diagonal:
        return [run]
    axis = int(np.argmax(sides))
    first = run[axis] <= run[axis].min() + sides[axis] / 2
    parts = []
    for half in (run[:, first], run[:, ~first]):
        parts += _divide(half, points * half.shape[1] / total)
    return parts


def _patch(
    run: npt.NDArray[np.float64],
    points: float,
    low: npt.NDArray[np.float64],
    high: npt.NDArray[np.float64],
) -> DensityPatch:
    first, last = run.min(axis=1), run.max(axis=1)
    wide, tall = (last - first).tolist()
    area = points / local_density(run)
    # The margin m solves (wide + 2 m) (tall + 2 m) = area.
    margin = (math.sqrt((wide - tall) ** 2 + 4 * area) - wide - tall) / 4
    first, last = first - max(margin, 0.0), last + max(margin, 0.0)
    # A patch that extends beyond the bounds is moved inside instead of clipped, so that it
    # keeps its area.
    shift = np.maximum(low - first, 0) - np.maximum(last - high, 0)
    first, last = np.maximum(first + shift, low), np.minimum(last + shift, high)
    last = np.maximum(last, first)
    return DensityPatch(
        float(first[0]), float(first[1]), float(last[0]), float(last[1]), points
    )


def local_density(run: npt.NDArray[np.float64]) -> float:
    """Return the points per square unit of the occupied cells, with about `_PER_CELL` points per cell.

    The error is at most a factor of two for points distributed over a plane. For a single scan
    line the density is too low by a factor of two to four.
    """
    n = run.shape[1]
    first, sides = run.min(axis=1), np.ptp(run, axis=1)
    cell = math.sqrt(
        _PER_CELL * max(float(sides[0] * sides[1]), float(sides.max()) ** 2 / n**2, 1e-12) / n
    )
    density = 0.0
    for _ in range(_ROUNDS):
        column, row = np.floor((run - first[:, None]) / cell).astype(np.int64)
        occupied = len(np.unique(column * (int(row.max()) + 1) + row))
        held = n / occupied
        density = n / (occupied * cell**2)
        if _PER_CELL / 1.5 <= held <= _PER_CELL * 1.5:
            break
        cell *= min(max(math.sqrt(_PER_CELL / held), 0.1), 10.0)
    return density
