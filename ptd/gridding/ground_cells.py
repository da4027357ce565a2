"""Sums of points by cells, and variance of the points in a window of cells about their plane.

Sums are whole numbers, so they do not depend on the order of points. The sums of a cell do not
depend on other cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Float64, Int32, Int64
from ptd.cells import quotient
from ptd.kernel import as_int64, inlined, kernel

PLANE_POINTS = 6
"""A plane with residuals needs at least this many points in a window: three more than a plane
alone."""
FLATTEST = 0.01
"""Points lie on a line if the determinant of their spread is at most this share of the
determinant of a disk."""
SUMS = 10
"""Number of sums: number, x, y, z, xx, xy, xz, yy, yz, zz."""


class CellWindow(NamedTuple):
    """A raster of cells of the lattice anchored at absolute count 0, with the northern row first.

    Attributes
    ----------
    p, q : int
        The size of a cell is p / q counts.
    west, north : int
        Global indices of the western column and of the northern row. Indices of rows grow to the north.
    rows, columns : int
    origin_x, origin_y : int
        Absolute counts of the points' local 0.
    """

    p: int
    q: int
    west: int
    north: int
    rows: int
    columns: int
    origin_x: int = 0
    origin_y: int = 0


@inlined
def cell_number(x: int, y: int, window: tuple[int, ...], inverse: float) -> int:
    """Return ``row * columns + column`` of a position in a `CellWindow`, -1 outside. ``inverse`` is 1 / p."""
    p, q, west, north, rows, columns, ox, oy = window
    column = quotient((x + ox) * q, p, inverse) - west
    row = north - quotient((y + oy) * q, p, inverse)
    return row * columns + column if 0 <= column < columns and 0 <= row < rows else -1


@kernel
def _sums(
    x: Int32, y: Int32, z: Int32, window: tuple[int, ...], start: tuple[int, int, int]
) -> Int64:
    """Return sums [10, rows, columns] of coordinates relative to ``start`` (absolute x and y, height)."""
    p, q, west, north, rows, columns, ox, oy = window
    sums = np.zeros((SUMS, rows, columns), np.int64)
    for i in range(x.size):
        column = ((as_int64(x[i]) + ox) * q) // p - west
        row = north - ((as_int64(y[i]) + oy) * q) // p
        if not (0 <= column < columns and 0 <= row < rows):
            continue
        dx, dy, dz = (
            as_int64(x[i]) + ox - start[0],
            as_int64(y[i]) + oy - start[1],
            as_int64(z[i]) - start[2],
        )
        sums[0, row, column] += 1
        sums[1, row, column] += dx
        sums[2, row, column] += dy
        sums[3, row, column] += dz
        sums[4, row, column] += dx * dx
        sums[5, row, column] += dx * dy
        sums[6, row, column] += dx * dz
        sums[7, row, column] += dy * dy
        sums[8, row, column] += dy * dz
        sums[9, row, column] += dz * dz
    return sums


@kernel
def _plane_variance(
    sums: Int64, row: int, column: int, half: int, middle: tuple[int, int]
) -> float:
    """Return the variance of heights about their plane in a window of cells, or -1 if the points define no plane.

    ``middle`` is the middle of the window relative to the start of the sums. Intermediate int64 sums may wrap, but
    their differences are small and exact.
    """
    top, bottom, left, right = row - half, row + half + 1, column - half, column + half + 1
    s = np.empty(SUMS, np.int64)
    for k in range(SUMS):
        s[k] = (
            sums[k, bottom, right]
            - sums[k, top, right]
            - sums[k, bottom, left]
            + sums[k, top, left]
        )
    n = s[0]
    if n < PLANE_POINTS:
        return -1.0
    cx, cy, cz = middle[0], middle[1], s[3] // n
    m = float(n)
    x, y, z = float(s[1] - n * cx) / m, float(s[2] - n * cy) / m, float(s[3] - n * cz) / m
    xx = float(s[4] - 2 * cx * s[1] + n * cx * cx) / m - x * x
    xy = float(s[5] - cx * s[2] - cy * s[1] + n * cx * cy) / m - x * y
    xz = float(s[6] - cx * s[3] - cz * s[1] + n * cx * cz) / m - x * z
    yy = float(s[7] - 2 * cy * s[2] + n * cy * cy) / m - y * y
    yz = float(s[8] - cy * s[3] - cz * s[2] + n * cy * cz) / m - y * z
    zz = float(s[9] - 2 * cz * s[3] + n * cz * cz) / m - z * z
    spread = xx * yy - xy * xy
    if spread <= FLATTEST * (0.5 * (xx + yy)) ** 2:
        return -1.0
    east, north = (xz * yy - yz * xy) / spread, (yz * xx - xz * xy) / spread
    return max(zz - east * xz - north * yz, 0.0) * m / (m - 3.0)


@kernel
def _plane_variances(
    sums: Int64, window: tuple[int, ...], start: tuple[int, int], margin: int, halves: Int64
) -> Float64:
    """Variances of `plane_variance`, cell by cell."""
    p, q, west, north, rows, columns, _ox, _oy = window
    out = np.full((rows - 2 * margin, columns - 2 * margin), np.nan)
    for row in range(margin, rows - margin):
        cy = ((2 * (north - row) + 1) * p) // (2 * q) - start[1]
        for column in range(margin, columns - margin):
            cx = ((2 * (west + column) + 1) * p) // (2 * q) - start[0]
            for half in halves:
                variance = _plane_variance(sums, row, column, as_int64(half), (cx, cy))
                if variance >= 0.0:
                    out[row - margin, column - margin] = variance
                    break
    return out


def plane_variance(xyz: Int32, window: CellWindow, half_widths: Sequence[int]) -> Float64:
    """Return the variance of heights about their plane, in the smallest window around each cell with enough points.

    Parameters
    ----------
    xyz : int32 [3, n]
        Local counts; points outside of the window are ignored.
    window : CellWindow
        Raster of the requested cells with a margin on each side as wide as the largest of the ``half_widths``.
    half_widths : sequence of int
        Cells on each side of the middle one, ascending.

    Returns
    -------
    float64 [rows - 2 * margin, columns - 2 * margin]
        Squared vertical counts, with n - 3 degrees of freedom; NaN if no window around a cell has a plane through
        `PLANE_POINTS` points. The margin is the widest of the half widths.
    """
    x, y, z = (np.ascontiguousarray(axis) for axis in xyz)
    low = int(z.min()) if z.size else 0
    start = (
        window.west * window.p // window.q,
        (window.north - window.rows) * window.p // window.q,
    )
    sums = _integral(_sums(x, y, z, tuple(window), (*start, low)))
    halves = np.asarray(half_widths, np.int64)
    return _plane_variances(sums, tuple(window), start, max(half_widths), halves)


def cell_numbers(xyz: Int32, window: CellWindow) -> Int64:
    """Return ``row * columns + column`` of the cell of each point (int32 [3, n]), -1 outside: int64 [n]."""
    x, y = (np.ascontiguousarray(axis) for axis in xyz[:2])
    return _numbers(x, y, tuple(window))


@kernel
def _numbers(x: Int32, y: Int32, window: tuple[int, ...]) -> Int64:
    numbers, inverse = np.empty(x.size, np.int64), 1.0 / window[0]
    for i in range(x.size):
        numbers[i] = cell_number(as_int64(x[i]), as_int64(y[i]), window, inverse)
    return numbers


def cell_counts(xyz: Int32, window: CellWindow) -> Int64:
    """Count the points (int32 [3, n]) in each cell: int64 [rows, columns]. Points outside are ignored."""
    counts = np.zeros((window.rows, window.columns), np.int64)
    add_counts(counts, xyz, window, np.ones(xyz.shape[1], np.bool_))
    return counts


def add_counts(counts: Int64, xyz: Int32, window: CellWindow, wanted: Bool) -> None:
    """Add the number of wanted points in each cell to counts. Points outside are ignored.

    Parameters
    ----------
    counts : int64 [rows, columns]
        Contiguous.
    xyz : int32 [3, n]
        Local counts.
    window : CellWindow
    wanted : bool [n]
    """
    x, y = (np.ascontiguousarray(axis) for axis in xyz[:2])
    _count(counts.reshape(-1), x, y, wanted, tuple(window))


@kernel
def _count(counts: Int64, x: Int32, y: Int32, wanted: Bool, window: tuple[int, ...]) -> None:
    inverse = 1.0 / window[0]
    for i in range(x.size):
        if wanted[i]:
            cell = cell_number(as_int64(x[i]), as_int64(y[i]), window, inverse)
            if cell >= 0:
                counts[cell] += 1


def _integral(cells: Int64) -> Int64:
    """Sums over all cells to the north and west, int64 [..., rows + 1, columns + 1], of int64 [..., rows, columns]."""
    sums = np.zeros((*cells.shape[:-2], cells.shape[-2] + 1, cells.shape[-1] + 1), np.int64)
    inner = sums[..., 1:, 1:]
    np.cumsum(np.cumsum(cells, axis=-2), axis=-1, out=inner)
    return sums


def box_sums(cells: Int64, half: int, margin: int) -> Int64:
    """Sums over windows of ``half`` cells on each side of each cell, without the ``margin`` of the raster of cells.

    Parameters
    ----------
    cells : int64 [rows, columns]
    half : int
    margin : int
        At least ``half``.

    Returns
    -------
    int64 [rows - 2 * margin, columns - 2 * margin]
    """
    sums = _integral(cells)
    rows, columns = (n - 2 * margin for n in cells.shape)
    first, last = margin - half, margin + half + 1

    def corner(top: int, left: int) -> Int64:
        return sums[top : top + rows, left : left + columns]

    return corner(last, last) - corner(first, last) - corner(last, first) + corner(first, first)
