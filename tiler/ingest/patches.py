"""Estimates where a file's points lie and how dense they are, from a few runs of successive points.

The mean over a file's bounds says little where flight strips run diagonally, or cross. A run of successive points shows
the density where it lies (or, where the order of the file is random, the whole of it).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

_PER_CELL = 4.0
_ROUNDS = 6
_FAR, _VOID = 10_000.0, 1000.0
"""A run whose rectangle is longer, in units of the CRS, and so many times larger than what it fills, is divided."""
_BINS = 16


@dataclass(frozen=True)
class Patch:
    """The rectangle ``x0 <= x <= x1, y0 <= y <= y1`` in units of the CRS, and about how many points it holds."""

    x0: float
    y0: float
    x1: float
    y1: float
    points: float


def find_patches(
    runs: Sequence[npt.NDArray[np.float64]], points: int, bounds: Sequence[float]
) -> tuple[Patch, ...]:
    """One patch for each run, all points of the file together.

    A run's rectangle is widened until, at the run's own density, it holds the points from this run to the next.

    Parameters
    ----------
    runs : sequence of float64, shape (2, n)
        x and y of successive points, at even distances in the file.
    points : int
        Of the file.
    bounds : sequence of 4 float
        Lowest x, y, highest x, y: nothing reaches beyond.
    """
    low, high = np.array(bounds[:2]), np.array(bounds[2:])
    inside = [run[:, np.all((run >= low[:, None]) & (run <= high[:, None]), axis=0)] for run in runs]
    inside = [run for run in inside if run.shape[1]]
    if not inside:
        return (Patch(bounds[0], bounds[1], bounds[2], bounds[3], points),) if points else ()
    parts = [_apart(run) for run in inside]
    if any(len(found) > 1 for found in parts):  # of a small file the runs overlap: each part once
        step = max(round(sum(run.shape[1] for run in inside) / points), 1)
        inside, parts = inside[::step], parts[::step]
    share = points / len(inside)
    return tuple(
        _patch(part, share * part.shape[1] / run.shape[1], low, high)
        for run, found in zip(inside, parts, strict=True)
        for part in found
    )


def _apart(run: npt.NDArray[np.float64]) -> list[npt.NDArray[np.float64]]:
    """A run in parts where it jumps between places far from one another: its rectangle would hold all between them."""
    sides = np.ptp(run, axis=1)
    if sides.max() < _FAR or sides.prod() < _VOID * run.shape[1] / local_density(run):
        return [run]
    axis = int(np.argmax(sides))
    place = np.floor((run[axis] - run[axis].min()) / sides[axis] * _BINS).astype(np.int64)
    return [part for number in np.unique(place) for part in _apart(run[:, place == number])]


def _patch(
    run: npt.NDArray[np.float64], points: float, low: npt.NDArray[np.float64], high: npt.NDArray[np.float64]
) -> Patch:
    first, last = run.min(axis=1), run.max(axis=1)
    wide, tall = (last - first).tolist()
    area = points / local_density(run)
    # (wide + 2 m) (tall + 2 m) = area
    margin = (math.sqrt((wide - tall) ** 2 + 4 * area) - wide - tall) / 4
    first, last = first - max(margin, 0.0), last + max(margin, 0.0)
    # What lies beyond the bounds is moved inside, not cut off: the points are somewhere.
    shift = np.maximum(low - first, 0) - np.maximum(last - high, 0)
    first, last = np.maximum(first + shift, low), np.minimum(last + shift, high)
    last = np.maximum(last, first)
    return Patch(float(first[0]), float(first[1]), float(last[0]), float(last[1]), points)


def local_density(run: npt.NDArray[np.float64]) -> float:
    """Points per square unit where the points are: of the cells that hold some, a few each.

    Right within a factor of two for points in a plane, half or a quarter too low where they are one scan line.
    """
    n = run.shape[1]
    first, sides = run.min(axis=1), np.ptp(run, axis=1)
    cell = math.sqrt(_PER_CELL * max(float(sides[0] * sides[1]), float(sides.max()) ** 2 / n**2, 1e-12) / n)
    density = 0.0
    for _ in range(_ROUNDS):
        column, row = np.floor((run - first[:, None]) / cell).astype(np.int64)
        occupied = len(np.unique(column * (int(row.max()) + 1) + row))
        held, density = n / occupied, n / (occupied * cell**2)
        if _PER_CELL / 1.5 <= held <= _PER_CELL * 1.5:
            break
        cell *= min(max(math.sqrt(_PER_CELL / held), 0.1), 10.0)
    return density
