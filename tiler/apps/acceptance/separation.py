"""Separation of swaths: differences of their heights in cells of open, even ground.

A cell of a swath is even if a plane through the mean heights of its 3 x 3 neighbours fits, is not steep, and explains
the heights of the cell. Plants, edges of roofs and parked cars are not even. The difference of two swaths is that of
their heights at the centre of the cell, so that it does not depend on where in the cell their points lie.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiler.apps.acceptance.counts import (
    HEIGHT_CELL_FACTOR,
    OFFSET_STEPS,
    SIDE_BITS,
    STEPS_PER_METRE,
    Cells,
    Int64s,
    Keys,
    Mask,
    decoded,
)
from tiler.apps.difference_statistics import Spread, pairs_in_cells, spread

MIN_POINTS = 3
"""Least number of points of a swath in a cell."""
MIN_NEIGHBOURS = 6
"""Least number of cells, of 3 x 3, that define the plane."""
MAX_SLOPE_DEGREES = 10
"""Steepest ground that is compared (USGS Lidar Base Specification, interswath accuracy)."""
MAX_ROUGH_M = 0.1
"""Largest standard deviation of the heights of a cell from the plane, and of the 3 x 3 cells. Plants have more, and the
noise of a scanner less."""
MIN_PAIR_CELLS = 30
"""Number of cells below which the mean difference of two swaths is not reported."""
BYTES_PER_HEIGHT_CELL = 500
"""Memory that `separate_swaths` needs per cell of a swath, if most are shared by two swaths."""

_PLANE_PARAMETERS = 3

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class SwathPair:
    """Two swaths by their point source ids, the mean and RMS of the second minus the first, and where they overlap.

    ``x`` and ``y`` are the middle of the compared cells in units of the CRS.
    """

    first: int
    second: int
    cells: int
    mean_m: float
    rms_m: float
    x: float
    y: float


@dataclass(frozen=True)
class Separation:
    """Differences of swaths.

    Attributes
    ----------
    side, side_m : float
        Side of the cells in units of the CRS, and in metres.
    pairs : list of SwathPair
        Pairs with at least `MIN_PAIR_CELLS` cells, the largest mean difference first.
    all : Spread
        Statistics of all differences in metres.
    first, second : int64, shape (n,)
        Point source ids of the swaths of each difference.
    x, y : float64, shape (n,)
        Centres of the cells in units of the CRS.
    difference_m : float64, shape (n,)
        Height of the second swath minus that of the first.
    asked_m : float or None
        Absolute difference that the specification asks for.
    """

    side: float
    side_m: float
    pairs: list[SwathPair]
    all: Spread
    first: Int64s
    second: Int64s
    x: Floats
    y: Floats
    difference_m: Floats
    asked_m: float | None

    @property
    def beyond_share(self) -> float | None:
        """Share of the differences beyond the asked one, None without one."""
        if self.asked_m is None:
            return None
        return float((np.abs(self.difference_m) > self.asked_m).mean())


def separate_swaths(
    keys: Keys, sums: Int64s, cells: Cells, metres: float, asked_m: float | None
) -> Separation | str:
    """Compare the heights of all swaths that share cells, or return why there are none.

    Parameters
    ----------
    keys : uint64, shape (n,)
        Keys of ``cells.of_heights``, sorted.
    sums : int64, shape (n, 5)
        Their `Cells.height_sums`.
    cells : Cells
        Cells of the first returns.
    metres : float
        Metres per unit of the CRS.
    asked_m : float or None
        Absolute difference that the specification asks for.
    """
    enough = sums[:, 0] >= MIN_POINTS
    keys, sums = keys[enough], sums[enough]
    source, column, row = decoded(keys)
    if np.unique(source).size < 2:
        return "the points have fewer than two swaths"
    order = np.lexsort((source, column, row))
    first, second = (order[side] for side in pairs_in_cells(np.stack((column, row))[:, order]))
    if not first.size:
        return f"no two swaths have {MIN_POINTS} single returns each in the same cell"
    side_m = cells.side * HEIGHT_CELL_FACTOR * metres
    shared = np.unique(np.concatenate((first, second)))
    height_m, even = _heights(keys, sums, shared, side_m)
    first_at, second_at = np.searchsorted(shared, first), np.searchsorted(shared, second)
    usable = even[first_at] & even[second_at]
    if not usable.any():
        return f"no open, even ground in the {first.size:,} cells of {side_m:.3g} m that swaths share"
    difference = (height_m[second_at] - height_m[first_at])[usable]
    first, second = first[usable], second[usable]
    lattice = cells.of_heights
    x = np.asarray((lattice.column + column[first] + 0.5) * lattice.side, np.float64)
    y = np.asarray((lattice.row + row[first] + 0.5) * lattice.side, np.float64)
    of_first, of_second = source[first], source[second]
    pairs = _pairs(of_first, of_second, x, y, difference)
    return Separation(
        lattice.side,
        side_m,
        pairs,
        spread(difference),
        of_first,
        of_second,
        x,
        y,
        difference,
        asked_m,
    )


def _heights(keys: Keys, sums: Int64s, at: Indices, side_m: float) -> tuple[Floats, Mask]:
    """Return the heights in metres at the centres of some cells, and the mask of the even ones."""
    n = sums[:, 0].astype(np.float64)
    mean_m = sums[:, 1] / n / STEPS_PER_METRE
    variance = sums[:, 2] / n / STEPS_PER_METRE**2 - mean_m**2
    offset_x, offset_y = (sums[:, axis] / n / OFFSET_STEPS - 0.5 for axis in (3, 4))
    slope_x, slope_y, deviation = _planes(keys, at, (offset_x, offset_y, mean_m))
    squared_slope = slope_x**2 + slope_y**2
    # A plane spreads the heights of points all over a cell of side 1 with a twelfth of its squared slope.
    rough = variance[at] - squared_slope / 12
    even = (rough <= MAX_ROUGH_M**2) & (deviation <= MAX_ROUGH_M)
    even &= squared_slope <= (math.tan(math.radians(MAX_SLOPE_DEGREES)) * side_m) ** 2
    return mean_m[at] - slope_x * offset_x[at] - slope_y * offset_y[at], even


def _planes(
    keys: Keys, at: Indices, means: tuple[Floats, Floats, Floats]
) -> tuple[Floats, Floats, Floats]:
    """Fit planes to the means of 3 x 3 cells around some cells by least squares.

    Return their slopes along x and y in metres per cell, and the standard deviation of the means from them. It is
    infinite if too few cells define the plane.
    """
    n = np.zeros(at.size)
    total = np.zeros((3, at.size))
    products = np.zeros((3, 3, at.size))
    for rows, columns in ((r, c) for r in (-1, 0, 1) for c in (-1, 0, 1)):
        near, is_there = _neighbours(keys, at, rows, columns)
        x, y, z = (mean[near] for mean in means)
        position = np.stack((x + columns, y + rows, z - means[2][at])) * is_there
        n += is_there
        total += position
        products += position[:, None] * position[None]
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = products - total[:, None] * total[None] / n
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = xx * yy - xy**2
        slope_x = (xz * yy - yz * xy) / determinant
        slope_y = (yz * xx - xz * xy) / determinant
        squares = np.maximum(zz - slope_x * xz - slope_y * yz, 0.0)
        deviation = np.sqrt(squares / (n - _PLANE_PARAMETERS))
    is_plane = (n >= MIN_NEIGHBOURS) & (determinant > 0)
    return (
        np.where(is_plane, slope_x, 0.0),
        np.where(is_plane, slope_y, 0.0),
        np.where(is_plane, deviation, np.inf),
    )


def _neighbours(keys: Keys, at: Indices, rows: int, columns: int) -> tuple[Indices, Mask]:
    """Return the positions of the neighbours of some cells in the sorted keys, and the mask of those that exist.

    Cells at the edge of the lattice have neighbours of another row or swath, but no survey reaches there.
    """
    wanted = (keys[at].astype(np.int64) + (rows << SIDE_BITS) + columns).astype(np.uint64)
    found = np.minimum(np.searchsorted(keys, wanted), keys.size - 1)
    return found, keys[found] == wanted


def _pairs(
    first: Int64s, second: Int64s, x: Floats, y: Floats, difference: Floats
) -> list[SwathPair]:
    """Return the pairs with enough cells, the one with the largest mean difference first."""
    order = np.lexsort((second, first))
    first, second = first[order], second[order]
    x, y, difference = x[order], y[order], difference[order]
    is_new = (first[1:] != first[:-1]) | (second[1:] != second[:-1])
    starts = np.flatnonzero(np.r_[True, is_new])
    found = []
    for start, end in zip(starts, [*starts[1:], first.size], strict=True):
        if end - start < MIN_PAIR_CELLS:
            continue
        of_pair = difference[start:end]
        found.append(
            SwathPair(
                int(first[start]),
                int(second[start]),
                int(end - start),
                float(of_pair.mean()),
                math.sqrt(float((of_pair**2).mean())),
                float(x[start:end].mean()),
                float(y[start:end].mean()),
            )
        )
    return sorted(found, key=lambda pair: (-abs(pair.mean_m), pair.first, pair.second))
