"""Repeatability of swaths: the spread of heights in cells of even surfaces around the plane of the cell.

This is the precision within a swath. Each cell has its own plane, so a slope does not count. The figure of a swath is
robust: that of its median cell, so that low plants and gravel in some cells do not decide it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiler.apps.acceptance.counts import (
    STEPS_PER_METRE,
    Cells,
    Int64s,
    Keys,
    decoded,
)

MIN_CELL_POINTS = 8
"""Least number of points of a swath in a cell. A plane takes three degrees of freedom."""
MAX_LIMIT_M = 0.08
"""Largest limit in metres: cells with a larger spread are not even, so the figures of rougher swaths do not grow."""
MIN_CELLS = 30
"""Least number of cells of a swath, and of an area where it is worst."""
AREA_CELLS = 16
"""Side in cells of the areas of which the worst is named."""
_MAX_CORRELATION = 0.99
"""Largest squared correlation of x and y. Points on one scan line define no plane."""
_PLANE_PARAMETERS = 3

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Precision:
    """Repeatability of a swath.

    Attributes
    ----------
    source : int
        Point source id.
    sigma_m : float
        Standard deviation of heights in metres.
    cells : int
        Number of cells.
    worst_m : float
        Standard deviation in the worst area of `AREA_CELLS`.
    x, y : float
        Middle of this area in units of the CRS.
    """

    source: int
    sigma_m: float
    cells: int
    worst_m: float
    x: float
    y: float


def repeatability(
    keys: Keys, sums: Int64s, fault: npt.NDArray[np.uint8], lattice: Cells
) -> tuple[list[Precision], list[int]]:
    """Return the repeatability of the swaths with at least `MIN_CELLS` even cells, the worst first, and the others.

    The others are the point source ids of the swaths with at least `MIN_CELLS` cells of which too few are even, or have
    enough points.

    Parameters
    ----------
    keys : uint64, shape (n,)
        Keys of ``lattice``, sorted.
    sums : int64, shape (n, `N_SUMS`)
        Their `Cells.height_sums`.
    fault : uint8, shape (n,)
        0 for even cells.
    lattice : Cells
        Cells of heights.
    """
    sources, n_cells = np.unique(decoded(keys)[0], return_counts=True)
    usable = np.flatnonzero((fault == 0) & (sums[:, 0] >= MIN_CELL_POINTS))
    variance = _variances(sums[usable])
    is_plane = ~np.isnan(variance)
    variance = variance[is_plane]
    if not variance.size:
        return [], sources[n_cells >= MIN_CELLS].tolist()
    source, column, row = decoded(keys[usable[is_plane]])
    x, y = (column + lattice.column) // AREA_CELLS, (row + lattice.row) // AREA_CELLS
    order = np.lexsort((variance, x, y, source))
    source, x, y, variance = source[order], x[order], y[order], variance[order]
    new_swath = np.r_[True, source[1:] != source[:-1]]
    new_area = new_swath | np.r_[True, (x[1:] != x[:-1]) | (y[1:] != y[:-1])]
    areas = np.flatnonzero(new_area)
    n_of_area = np.diff(areas, append=source.size)
    # The middle of the sorted variances of each area.
    middle = (variance[areas + (n_of_area - 1) // 2] + variance[areas + n_of_area // 2]) / 2
    found = []
    starts = np.flatnonzero(new_swath)
    for start, end in zip(starts, [*starts[1:], source.size], strict=True):
        if end - start < MIN_CELLS:
            continue
        first, last = np.searchsorted(areas, (start, end))
        of_swath = slice(first, last)
        # A small swath may have no area with so many cells.
        least = min(MIN_CELLS, int(n_of_area[of_swath].max()))
        worst = first + int(
            np.argmax(np.where(n_of_area[of_swath] < least, -1, middle[of_swath]))
        )
        at = areas[worst]
        found.append(
            Precision(
                int(source[start]),
                float(np.sqrt(np.median(variance[start:end]))),
                int(end - start),
                float(np.sqrt(middle[worst])),
                float((x[at] + 0.5) * AREA_CELLS * lattice.side),
                float((y[at] + 0.5) * AREA_CELLS * lattice.side),
            )
        )
    measured = [swath.source for swath in found]
    others = sources[(n_cells >= MIN_CELLS) & ~np.isin(sources, measured)]
    return sorted(found, key=lambda swath: (-swath.sigma_m, swath.source)), others.tolist()


def _variances(sums: Int64s) -> Floats:
    """Return the variance of heights around the plane of each cell in square metres, NaN without a plane.

    The median of these variances is that of the heights: the median of a variance of few points is below its mean by
    the cube of 1 - 2 / 9 per degree of freedom (Wilson and Hilferty 1931, PNAS).
    """
    n, z, zz, x, y, xx, yy, xy, xz, yz = sums.T
    # Products that wrap around wrap back in the differences.
    xx, yy, zz = n * xx - x * x, n * yy - y * y, n * zz - z * z
    xy, xz, yz = n * xy - x * y, n * xz - x * z, n * yz - y * z
    xx, yy, zz, xy, xz, yz = (moment.astype(np.float64) for moment in (xx, yy, zz, xy, xz, yz))
    determinant = xx * yy - xy**2
    is_plane = determinant > (1 - _MAX_CORRELATION) * xx * yy
    with np.errstate(divide="ignore", invalid="ignore"):
        explained = (xz**2 * yy - 2 * xz * yz * xy + yz**2 * xx) / determinant
    squares = np.maximum(zz - explained, 0.0) / n
    freedom = n - _PLANE_PARAMETERS
    variance = squares / freedom / (1 - 2 / (9 * freedom)) ** 3 / STEPS_PER_METRE**2
    return np.where(is_plane, variance, np.nan)
