"""Density, distribution, voids and swaths, from the number of first returns in cells.

The side of a cell is two times the nominal pulse spacing, so that a cell has four pulses on average.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import find_objects, label, uniform_filter

from ptd.arrays import AnyArray, Bool, Float32, Float64, Indices, Int32, Int64
from tiler.apps.acceptance.counts import SIDE_BITS, Cells, Keys, decoded

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
MIN_INNER_CELLS, GAPS_RATIO = 500, 0.9
"""Number of cells inside the wide outline from which gaps that are open to its edge count, and the ratio of the
densities with and without them below which they do. In fewer cells the corners of the outline have the same effect."""
MIN_WHOLE_CELLS = 25
"""Least number of whole cells with points of a swath, below which its density is chance."""
NEAR_CELLS = 7
"""Side, in cells, of the square around a cell at the edge in which the density of a swath is taken."""
MIN_SWATH_CELLS = 100
"""Number of cells of a swath below which its distribution and density are not reported: a few cells at the edge of a
delivery say nothing about a swath."""
DENSITY_CELLS = 5
"""Side, in cells, of the squares in which the density is compared with the asked one. They have 100 pulses on
average."""
GAP_STEPS = 4
GAP_FACTORS = (1, 2, 4, 8, 16)
"""Widths of gaps between swaths: gaps of 3 to 8 cells are found in cells that are so many times as large."""

MANY_SOURCES = 100
"""Number of point source ids above which they may be random. Each takes the time of a swath."""
CHANCES = 2
"""Ratio of the share of cells of swaths with a neighbour of the same swath to the share by chance, below which ids are
random."""

_NO_SWATH = 2**32 - 1
"""Number of no swath, above those of all swaths."""

BYTES_PER_CELL, BYTES_PER_KEY = 48, 48
"""Memory that `examine_cells` needs per cell of the survey's extent, and per cell of a swath with points."""

Labels = Int32


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
        First returns per square metre of the outline without its edge and without wide voids.
    swaths : list of Swath
        Swaths of at least `MIN_SWATH_CELLS` and `MIN_WHOLE_CELLS`, by point source id.
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
    n_random : int
        Number of point source ids if they look random, so that there are no swaths, else 0.
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
    n_random: int


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
    keys: Keys, counts: Int64, cells: Cells, metres: float, asked_per_m2: float | None
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
    near, outline = outlined(per_cell > 0)
    void_areas = areas(near & (per_cell == 0), VOID_CELLS)[2]
    parts = len(areas(outline, MIN_SWATH_CELLS)[2])
    wide = wide_voids(outline, per_cell > 0)
    void_share = int(wide.sum()) / int(outline.sum())
    if void_share <= MOST_LEFT_OUT:
        outline &= ~wide
    whole = whole_cells(near, outline)
    coverage = Coverage(shape)
    swaths: list[Swath] = []
    n_small = 0
    n_random = _number_of_random(keys)
    for swath in () if n_random else _swaths(source, columns, rows, counts):
        near_of_swath, footprint = outlined(swath.points > 0)
        coverage.add(swath.box, footprint, whole_cells(near_of_swath, footprint), swath.points)
        usable = footprint & outline[swath.box]
        n_usable, whole_of_swath = int(usable.sum()), whole_cells(near_of_swath, usable)
        n_whole = np.count_nonzero(whole_of_swath & (swath.points > 0))
        if n_usable < MIN_SWATH_CELLS or n_whole < MIN_WHOLE_CELLS:
            n_small += 1
            continue
        share = int(np.count_nonzero(swath.points)) / n_usable
        per_m2 = _mean_points(swath.points, whole_of_swath, usable) / raster.area_m2
        swaths.append(Swath(swath.source, n_usable, share, per_m2))
    return CellFindings(
        cells.side * metres,
        _mean_points(per_cell, whole if whole.any() else outline, outline) / raster.area_m2,
        swaths,
        n_small,
        _dense_share(per_cell, whole, raster, asked_per_m2),
        [raster.place(area) for area in void_areas],
        [raster.place(area) for area in coverage.gaps()],
        None if n_random else coverage.overlap_share,
        parts,
        void_share,
        n_random,
    )


def _number_of_random(keys: Keys) -> int:
    """Return the number of point source ids if they are many and neighbours have the same only by chance, else 0."""
    bits = np.uint64(2 * SIDE_BITS)
    n_cells = np.unique(keys >> bits, return_counts=True)[1]
    if n_cells.size <= MANY_SOURCES:
        return 0
    n_occupied = np.unique(keys & np.uint64((1 << 2 * SIDE_BITS) - 1)).size
    by_chance = float((n_cells**2).sum()) / (n_occupied * keys.size)
    above = keys + np.uint64(1 << SIDE_BITS)
    near = np.minimum(np.searchsorted(keys, above), keys.size - 1)
    found = max(np.mean(np.diff(keys) == 1), np.mean(keys[near] == above))
    return n_cells.size if found < CHANCES * by_chance else 0


def outlined(occupied: Bool) -> tuple[Bool, Bool]:
    """Return two outlines of cells with points: one that follows them, and one for wider gaps.

    The second encloses gaps of up to 32 cells, and reaches a few cells too far in places.
    """
    near = closed(occupied, OUTLINE_STEPS)
    inner = _inner(
        closed(_coarse(occupied, COARSE, np.logical_or), OUTLINE_STEPS), occupied.shape
    )
    return filled(near), filled(near | inner)


def _mean_points(points: Int32, whole: Bool, outline: Bool) -> float:
    """Return the mean number of points in the whole cells, or also in wide gaps that are open to the edge."""
    mean = float(points[whole].mean())
    inner = _without_edge(outline)
    if np.count_nonzero(inner) < MIN_INNER_CELLS:
        return mean
    with_gaps = float(points[inner].mean())
    return with_gaps if with_gaps < GAPS_RATIO * mean else mean


def _means_near(points: Int32, full: Bool) -> Float32:
    """Return the mean number of points in the full cells around each cell, or in the cell itself without any."""
    n, sums = (
        uniform_filter(values.astype(np.float32), NEAR_CELLS, mode="constant")
        for values in (full, points * full)
    )
    found = n > 0.5 / NEAR_CELLS**2
    return np.where(found, sums / np.where(found, n, 1), np.maximum(points, 1))


def _without_edge(mask: Bool) -> Bool:
    """Return the cells of a mask with no neighbour outside it. Cells beyond the raster are outside."""
    return ~grown_once(~np.pad(mask, 1))[1:-1, 1:-1]


def whole_cells(near: Bool, outline: Bool) -> Bool:
    """Return the cells that are wholly inside both outlines (`outlined`).

    The edge of the survey lies anywhere in the cells at the edge of the outline that follows the points.
    """
    whole = _without_edge(near & outline)
    # Cells beyond the raster are outside.
    padded = np.pad(outline, COARSE)
    wide = _inner(_coarse(padded, COARSE, np.logical_and), padded.shape)
    whole |= wide[COARSE:-COARSE, COARSE:-COARSE]
    return whole


def _inner(larger: Bool, shape: tuple[int, ...]) -> Bool:
    """Return the cells, in a raster of a shape, in those larger cells of a mask that lie inside it."""
    return _fine(~grown_once(~larger), COARSE, shape)


def _fine(raster: Bool, factor: int, shape: tuple[int, ...]) -> Bool:
    """Return a mask of cells smaller by a factor, in a raster of a shape."""
    return np.repeat(np.repeat(raster, factor, 0), factor, 1)[: shape[0], : shape[1]]


def wide_voids(outline: Bool, occupied: Bool) -> Bool:
    """Return the cells without points of voids that hold a square of two larger cells.

    Narrower ones are gaps between scan lines, or chance.
    """
    empty = _coarse(outline & ~occupied, COARSE, np.logical_and)
    squares = empty[:-1, :-1] & empty[1:, :-1] & empty[:-1, 1:] & empty[1:, 1:]
    core = np.zeros_like(empty)
    for row, column in ((0, 0), (1, 0), (0, 1), (1, 1)):
        core[row : row + squares.shape[0], column : column + squares.shape[1]] |= squares
    inner = _fine(core, COARSE, occupied.shape)
    # Cells around the void that are empty by chance would leave only dense ones.
    return grown(inner, 2 * COARSE) & opened(outline & ~occupied)


@dataclass(frozen=True)
class _SwathCells:
    """Number of first returns of a swath in the cells of their box of the raster."""

    source: int
    box: tuple[slice, slice]
    points: Int32


def _swaths(source: Int64, columns: Int64, rows: Int64, counts: Int64) -> Iterator[_SwathCells]:
    """Yield the swaths by point source id. The cells are sorted by it."""
    starts = np.flatnonzero(np.r_[True, source[1:] != source[:-1]])
    for start, end in zip(starts, [*starts[1:], len(source)], strict=True):
        of_column, of_row = columns[start:end], rows[start:end]
        column, row = int(of_column.min()), int(of_row.min())
        box = (slice(row, int(of_row.max()) + 1), slice(column, int(of_column.max()) + 1))
        points = np.zeros((box[0].stop - row, box[1].stop - column), np.int32)
        points[of_row - row, of_column - column] = counts[start:end]
        yield _SwathCells(int(source[start]), box, points)


def _dense_share(
    per_cell: Int32, outline: Bool, raster: _Raster, asked: float | None
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
        self._n_whole = np.zeros(shape, np.uint8)
        self._edges = np.zeros(shape, np.float32)
        self._lowest = np.full(shape, _NO_SWATH, np.uint32)
        self._highest = np.zeros(shape, np.uint32)
        self._added = 0

    def add(
        self,
        box: tuple[slice, slice],
        footprint: Bool,
        whole: Bool,
        points: Int32,
    ) -> None:
        """Add the footprint of a swath in a box of the raster, its `whole_cells`, and the points in each cell.

        The covered share of a cell at the edge is its points divided by the mean of the whole cells around it, which is
        right on average over the cells.
        """
        self._added += 1
        for number, mask in ((self._n, footprint), (self._n_whole, whole)):
            of_box = number[box]
            of_box += mask & (of_box < 255)
        edge = footprint & ~whole
        self._edges[box][edge] += points[edge] / _means_near(points, whole & (points > 0))[edge]
        hull = convex_hull(opened(footprint))
        lowest, highest = self._lowest[box], self._highest[box]
        lowest[hull] = np.minimum(lowest[hull], self._added)
        highest[hull] = self._added

    @property
    def overlap_share(self) -> float:
        """Share of the covered area that two swaths or more cover."""
        # Swaths with an edge in the same cell mostly end together, at the edge of the survey.
        n_edges = self._n - self._n_whole
        share = self._edges / np.maximum(n_edges, 1)
        covered = np.where(self._n_whole > 0, self._n > 0, share)
        shared = np.where(self._n_whole > 1, 1, np.where(self._n > 1, share, 0))
        return min(float(shared.sum(dtype=np.float64) / covered.sum(dtype=np.float64)), 1.0)

    def gaps(self) -> list[Area]:
        """Return the areas between two swaths, the largest first."""
        found = np.zeros(self._n.shape, np.bool_)
        if self._added > 1:
            for factor in GAP_FACTORS:
                found |= _fine(self._gaps_in(factor), factor, found.shape)
        found &= (self._highest == 0) & (self._n == 0)
        return areas(found, VOID_CELLS)[2]

    def _gaps_in(self, factor: int) -> Bool:
        lowest = _coarse(self._lowest, factor, np.minimum, _NO_SWATH)
        highest = _coarse(self._highest, factor, np.maximum)
        covered = highest > 0
        labels, numbers, _ = areas(opened(closed(covered, GAP_STEPS) & ~covered), 1)
        for number, box in zip(numbers, widened_boxes(labels, numbers, 2), strict=True):
            gap = labels[box] == number
            near = grown_once(grown_once(gap))
            if lowest[box][near].min() >= highest[box][near].max():
                labels[labels == number] = 0
        gaps: Bool = labels > 0
        return gaps


def _coarse(raster: AnyArray, factor: int, join: np.ufunc, empty: int = 0) -> Any:
    """Return a raster of cells larger by a factor, whose values are joined. Cells beyond the raster are empty."""
    padded = np.pad(
        raster, [(0, -size % factor) for size in raster.shape], constant_values=empty
    )
    rows, columns = (size // factor for size in padded.shape)
    return join.reduce(padded.reshape(rows, factor, columns, factor), axis=(1, 3))


@dataclass(frozen=True)
class Area:
    """Connected cells: their number, and the mean column and row of their centres in the raster."""

    cells: int
    column: float
    row: float


def grown(mask: Bool, steps: int) -> Bool:
    """Return the cells within some steps of a mask, in a shape near a circle.

    Steps to the four and to the eight neighbours alternate, which makes an octagon.
    """
    for step in range(steps):
        mask = grown_once(mask, diagonally=step % 2 > 0)
    return mask


def grown_once(mask: Bool, diagonally: bool = True) -> Bool:
    """Return the cells of a mask and their eight neighbours, or only the four that share an edge."""
    wider = mask.copy()
    wider[1:] |= mask[:-1]
    wider[:-1] |= mask[1:]
    source = wider.copy() if diagonally else mask
    wider[:, 1:] |= source[:, :-1]
    wider[:, :-1] |= source[:, 1:]
    return wider


def shrunk(mask: Bool, steps: int) -> Bool:
    """Return the cells of a mask that are more than some steps from its other cells. Cells beyond the raster count."""
    return ~grown(~mask, steps)


def closed(mask: Bool, steps: int) -> Bool:
    """Return a mask with its gaps of at most two times ``steps`` cells closed."""
    padded = np.pad(mask, steps)
    inner = slice(steps, -steps)
    return shrunk(grown(padded, steps), steps)[inner, inner] | mask


def opened(mask: Bool) -> Bool:
    """Return a mask without its parts that are narrower than three cells."""
    return grown_once(~grown_once(~np.pad(mask, 1)))[1:-1, 1:-1]


def filled(mask: Bool) -> Bool:
    """Return a mask with its holes, which are the cells that it encloses."""
    labels, _ = label(np.pad(~mask, 1, constant_values=True))
    inside: Bool = labels[1:-1, 1:-1] != labels[0, 0]
    return inside


def areas(mask: Bool, min_cells: int) -> tuple[Labels, list[int], list[Area]]:
    """Return connected cells: labels of all, and the labels and areas of those with at least ``min_cells``.

    The largest area comes first, then the one with the lowest row and column.
    """
    labels = label(mask)[0].astype(np.int32, copy=False)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    boxes = find_objects(labels)
    found = []
    for number in np.flatnonzero(sizes >= min_cells).tolist():
        box = boxes[number - 1]
        rows, columns = np.nonzero(labels[box] == number)
        row, column = box[0].start + rows.mean(), box[1].start + columns.mean()
        found.append((number, Area(int(sizes[number]), float(column), float(row))))
    found.sort(key=lambda item: (-item[1].cells, item[1].row, item[1].column))
    return labels, [number for number, _ in found], [area for _, area in found]


def widened_boxes(labels: Labels, numbers: list[int], margin: int) -> list[tuple[slice, slice]]:
    """Return the boxes around some labels with a margin inside the raster."""
    boxes = find_objects(labels)
    found = []
    for number in numbers:
        rows, columns = (
            slice(max(side.start - margin, 0), side.stop + margin) for side in boxes[number - 1]
        )
        found.append((rows, columns))
    return found


def convex_hull(mask: Bool) -> Bool:
    """Return the cells whose centres lie in the convex hull of the centres of a mask's cells."""
    rows = np.flatnonzero(mask.any(axis=1))
    if not rows.size:
        return mask
    first = mask[rows].argmax(axis=1)
    last = mask.shape[1] - 1 - mask[rows, ::-1].argmax(axis=1)
    inside = np.arange(rows[0], rows[-1] + 1)
    left = _envelope(rows, first, inside)
    right = -_envelope(rows, -last, inside)
    columns = np.arange(mask.shape[1])
    hull = np.zeros_like(mask)
    # Rounding errors must not exclude cells on the edge.
    hull[inside] = (columns >= left[:, None] - 1e-9) & (columns <= right[:, None] + 1e-9)
    return hull


def _envelope(x: Indices, y: Indices, at: Indices) -> Float64:
    """Return the lower convex envelope of points with ascending x at some positions (Andrew's monotone chain)."""
    chain: list[tuple[int, int]] = []
    for c in zip(x.tolist(), y.tolist(), strict=True):
        while len(chain) > 1:
            a, b = chain[-2:]
            if (b[0] - a[0]) * (c[1] - a[1]) > (c[0] - a[0]) * (b[1] - a[1]):
                break
            chain.pop()
        chain.append(c)
    corners = np.array(chain, np.float64)
    return np.interp(at, corners[:, 0], corners[:, 1])
