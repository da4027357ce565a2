"""Density, distribution, voids and swaths, from the number of first returns in cells.

The side of a cell is two times the nominal pulse spacing, so that a cell has four pulses on average.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiler.apps.acceptance.counts import Cells, Int64s, Keys, decoded
from tiler.apps.acceptance.rasters import (
    Area,
    Mask,
    areas,
    closed,
    convex_hull,
    filled,
    grown,
    grown_once,
    opened,
    widened_boxes,
)

SPACINGS_PER_CELL = 2
"""Side of a cell in nominal pulse spacings (USGS Lidar Base Specification, spatial distribution and regularity)."""
VOID_CELLS = (4 // SPACINGS_PER_CELL) ** 2
"""Least number of cells of a data void, whose area is the square of four nominal pulse spacings (the same, data
voids)."""
OUTLINE_STEPS = 2
"""Steps by which the cells with points are closed to the outline of a swath or of the survey. With more, the corners of
bays would count as voids."""
COARSE = 8
"""Side of the larger cells, which are closed by the same steps, so that wide gaps between scan lines are inside."""
MOST_LEFT_OUT = 0.25
"""Share of the outline up to which wide voids are left out of density and distribution. More are not only water."""
MIN_SWATH_CELLS = 100
"""Number of cells of a swath below which its distribution and density are not reported: a few cells at the edge of a
delivery say nothing about a swath."""
DENSITY_CELLS = 5
"""Side, in cells, of the squares in which the density is compared with the asked one. They have 100 pulses on
average."""
GAP_STEPS = 4
GAP_FACTORS = (1, 2, 4, 8, 16)
"""Widths of gaps between swaths: gaps of 3 to 8 cells are found in cells that are so many times as large."""

_NO_SWATH = 2**32 - 1
"""Number of no swath, above those of all swaths."""

BYTES_PER_CELL, BYTES_PER_KEY = 40, 48
"""Memory that `examine_cells` needs per cell of the survey's extent, and per cell of a swath with points."""


@dataclass(frozen=True)
class Place:
    """Area in square metres, and a position in units of the CRS near its middle."""

    area_m2: float
    x: float
    y: float


@dataclass(frozen=True)
class Swath:
    """Swath with its point source id, its number of cells, the share of them with a first return, and its density."""

    source: int
    cells: int
    share: float
    per_m2: float


@dataclass(frozen=True)
class CellFindings:
    """Figures that follow from the cells.

    Attributes
    ----------
    side_m : float
    per_m2 : float or None
        First returns per square metre of the area inside the outline that is not a wide void.
    swaths : list of Swath
        Swaths of at least `MIN_SWATH_CELLS`, by point source id.
    n_small : int
        Number of smaller swaths.
    dense_share : float or None
        Share of the squares inside the outline that reach the asked density.
    voids, gaps : list of Place
        Areas without a first return inside the outline, and between swaths, the largest first.
    overlap_share : float or None
        Share of the area of all swaths that two of them cover.
    parts : int
        Number of separate parts of the outline, of at least `MIN_SWATH_CELLS` each.
    void_share : float
        Share of the outline in wide voids, which are left out if it is not above `MOST_LEFT_OUT`.
    """

    side_m: float
    per_m2: float | None
    swaths: list[Swath]
    n_small: int
    dense_share: float | None
    voids: list[Place]
    gaps: list[Place]
    overlap_share: float | None
    parts: int
    void_share: float


@dataclass(frozen=True)
class _Raster:
    """Raster of the cells with points: its first column and row, counted from those of ``cells``."""

    cells: Cells
    column: int
    row: int
    metres: float

    @property
    def area_m2(self) -> float:
        return (self.cells.side * self.metres) ** 2

    def place(self, area: Area) -> Place:
        x = (self.cells.column + self.column + area.column + 0.5) * self.cells.side
        y = (self.cells.row + self.row + area.row + 0.5) * self.cells.side
        return Place(area.cells * self.area_m2, x, y)


def needed_bytes(keys: Keys) -> int:
    """Return the memory that `examine_cells` needs."""
    _, columns, rows = decoded(keys)
    extent = int(np.ptp(columns) + 1) * int(np.ptp(rows) + 1)
    return extent * BYTES_PER_CELL + keys.size * BYTES_PER_KEY


def examine_cells(
    keys: Keys, counts: Int64s, cells: Cells, metres: float, asked_per_m2: float | None
) -> CellFindings:
    """Measure density, distribution, voids, overlaps and gaps.

    Parameters
    ----------
    keys : uint64, shape (n,)
        Keys of `Cells`, sorted; at least one.
    counts : int64, shape (n,)
        Number of first returns in each.
    cells : Cells
    metres : float
        Metres per unit of the CRS.
    asked_per_m2 : float or None
        Density that the specification asks for.
    """
    source, columns, rows = decoded(keys)
    raster = _Raster(cells, int(columns.min()), int(rows.min()), metres)
    columns, rows = columns - raster.column, rows - raster.row
    shape = (int(rows.max()) + 1, int(columns.max()) + 1)
    sums = np.bincount(rows * shape[1] + columns, counts, shape[0] * shape[1])
    per_cell = sums.astype(np.int32).reshape(shape)
    del sums
    # At the corners of bays, the wide outline has cells that are no voids.
    near = filled(closed(per_cell > 0, OUTLINE_STEPS))
    void_areas = areas(near & (per_cell == 0), VOID_CELLS)[2]
    outline = outlined(per_cell > 0)
    parts = len(areas(outline, MIN_SWATH_CELLS)[2])
    wide = wide_voids(outline, per_cell > 0)
    void_share = int(wide.sum()) / int(outline.sum())
    if void_share <= MOST_LEFT_OUT:
        outline &= ~wide
    coverage = Coverage(shape)
    swaths: list[Swath] = []
    n_small = 0
    for swath in _swaths(source, columns, rows, counts):
        footprint = outlined(swath.occupied)
        coverage.add(swath.box, footprint)
        usable = int((footprint & outline[swath.box]).sum())
        if usable < MIN_SWATH_CELLS:
            n_small += 1
            continue
        share = int(swath.occupied.sum()) / usable
        per_m2 = swath.points / (usable * raster.area_m2)
        swaths.append(Swath(swath.source, usable, share, per_m2))
    return CellFindings(
        cells.side * metres,
        int(counts.sum()) / (int(outline.sum()) * raster.area_m2),
        swaths,
        n_small,
        _dense_share(per_cell, outline, raster, asked_per_m2),
        [raster.place(area) for area in void_areas],
        [raster.place(area) for area in coverage.gaps()],
        coverage.overlap_share,
        parts,
        void_share,
    )


def outlined(occupied: Mask) -> Mask:
    """Return the outline of cells with points, which encloses gaps of up to 32 cells between them."""
    larger = ~grown_once(~closed(_larger(occupied, np.logical_or), OUTLINE_STEPS))
    rows, columns = occupied.shape
    inner = np.repeat(np.repeat(larger, COARSE, 0), COARSE, 1)[:rows, :columns]
    return filled(closed(occupied, OUTLINE_STEPS) | inner)


def wide_voids(outline: Mask, occupied: Mask) -> Mask:
    """Return the cells without points of voids that hold a square of two larger cells.

    Narrower ones are gaps between scan lines, or chance.
    """
    empty = _larger(outline & ~occupied, np.logical_and)
    squares = empty[:-1, :-1] & empty[1:, :-1] & empty[:-1, 1:] & empty[1:, 1:]
    core = np.zeros_like(empty)
    for row, column in ((0, 0), (1, 0), (0, 1), (1, 1)):
        core[row : row + squares.shape[0], column : column + squares.shape[1]] |= squares
    rows, columns = occupied.shape
    inner = np.repeat(np.repeat(core, COARSE, 0), COARSE, 1)[:rows, :columns]
    return grown(inner, 2 * COARSE) & outline & ~occupied


def _larger(mask: Mask, join: np.ufunc) -> Mask:
    """Return a mask of larger cells. Those that reach beyond the raster are joined with empty cells."""
    pads = [(0, -size % COARSE) for size in mask.shape]
    padded = np.pad(mask, pads)
    rows, columns = (size // COARSE for size in padded.shape)
    joined: Mask = join.reduce(padded.reshape(rows, COARSE, columns, COARSE), axis=(1, 3))
    return joined


@dataclass(frozen=True)
class _SwathCells:
    """Number of first returns of a swath, and its cells with first returns in their box of the raster."""

    source: int
    points: int
    box: tuple[slice, slice]
    occupied: Mask


def _swaths(
    source: Int64s, columns: Int64s, rows: Int64s, counts: Int64s
) -> Iterator[_SwathCells]:
    """Yield the swaths by point source id. The cells are sorted by it."""
    starts = np.flatnonzero(np.r_[True, source[1:] != source[:-1]])
    for start, end in zip(starts, [*starts[1:], len(source)], strict=True):
        of_column, of_row = columns[start:end], rows[start:end]
        column, row = int(of_column.min()), int(of_row.min())
        box = (slice(row, int(of_row.max()) + 1), slice(column, int(of_column.max()) + 1))
        occupied = np.zeros((box[0].stop - row, box[1].stop - column), np.bool_)
        occupied[of_row - row, of_column - column] = True
        yield _SwathCells(int(source[start]), int(counts[start:end].sum()), box, occupied)


def _dense_share(
    per_cell: npt.NDArray[np.int32], outline: Mask, raster: _Raster, asked: float | None
) -> float | None:
    """Return the share of the squares inside the outline that reach a density, None without one."""
    if asked is None:
        return None
    # The squares do not depend on the extent of the clouds.
    before = [
        (start + first) % DENSITY_CELLS
        for start, first in (
            (raster.cells.row, raster.row),
            (raster.cells.column, raster.column),
        )
    ]
    pads = [
        (first, -(first + size) % DENSITY_CELLS)
        for first, size in zip(before, per_cell.shape, strict=True)
    ]
    rows, columns = (
        (first + size + last) // DENSITY_CELLS
        for (first, last), size in zip(pads, per_cell.shape, strict=True)
    )
    squares = (rows, DENSITY_CELLS, columns, DENSITY_CELLS)
    whole = np.pad(outline, pads).reshape(squares).all(axis=(1, 3))
    points = np.pad(per_cell, pads).reshape(squares).sum(axis=(1, 3))[whole]
    if not points.size:
        return None
    least = asked * DENSITY_CELLS**2 * raster.area_m2
    return float((points >= least * (1 - 1e-9)).mean())


class Coverage:
    """Cells that swaths cover, and their convex hulls, between which gaps are looked for.

    A lake at the edges of two swaths lies in their hulls, so that it is not a gap between them.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._n = np.zeros(shape, np.uint8)
        self._lowest = np.full(shape, _NO_SWATH, np.uint32)
        self._highest = np.zeros(shape, np.uint32)
        self._added = 0

    def add(self, box: tuple[slice, slice], footprint: Mask) -> None:
        """Add the footprint of a swath in a box of the raster."""
        self._added += 1
        of_box = self._n[box]
        of_box += footprint & (of_box < 255)
        hull = convex_hull(opened(footprint))
        lowest, highest = self._lowest[box], self._highest[box]
        lowest[hull] = np.minimum(lowest[hull], self._added)
        highest[hull] = self._added

    @property
    def overlap_share(self) -> float:
        """Share of the covered cells that two swaths or more cover."""
        return int((self._n > 1).sum()) / int((self._n > 0).sum())

    def gaps(self) -> list[Area]:
        """Return the areas between two swaths, the largest first."""
        found = np.zeros(self._n.shape, np.bool_)
        if self._added > 1:
            for factor in GAP_FACTORS:
                fine = np.repeat(np.repeat(self._gaps_in(factor), factor, 0), factor, 1)
                found |= fine[: found.shape[0], : found.shape[1]]
        found &= (self._highest == 0) & (self._n == 0)
        return areas(found, VOID_CELLS)[2]

    def _gaps_in(self, factor: int) -> Mask:
        """Return the gaps in cells that are larger by a factor."""
        lowest = _coarse(self._lowest, factor, np.minimum, _NO_SWATH)
        highest = _coarse(self._highest, factor, np.maximum, 0)
        covered = highest > 0
        labels, numbers, _ = areas(opened(closed(covered, GAP_STEPS) & ~covered), 1)
        for number, box in zip(numbers, widened_boxes(labels, numbers, 2), strict=True):
            gap = labels[box] == number
            near = grown_once(grown_once(gap))
            if lowest[box][near].min() >= highest[box][near].max():
                labels[labels == number] = 0
        gaps: Mask = labels > 0
        return gaps


def _coarse(
    raster: npt.NDArray[np.uint32], factor: int, join: np.ufunc, empty: int
) -> npt.NDArray[np.uint32]:
    """Return a raster of cells larger by a factor, whose values are joined."""
    pads = [(0, -size % factor) for size in raster.shape]
    padded = np.pad(raster, pads, constant_values=empty)
    rows, columns = (size // factor for size in padded.shape)
    joined: npt.NDArray[np.uint32] = join.reduce(
        padded.reshape(rows, factor, columns, factor), axis=(1, 3)
    )
    return joined
