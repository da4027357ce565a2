"""Seeds: the lowest point per cell, and a ring of virtual points that holds the TIN beyond the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, lowest_per_cell
from ptd.certify import Doubt
from ptd.frame import Cells, Window

RING = 2
"""Cells of virtual seeds around occupied ones. Any circle of a radius above sqrt(2) cells through a point of the data would
hold a whole cell within two cells of it, and with it a seed: so the circles that matter are bounded."""


@dataclass(frozen=True)
class Seeds:
    """Vertices of the first TIN: the chosen points and the virtual ones.

    Attributes
    ----------
    chosen : int32 [m]
        Indices of the points that are seeds.
    virtual : int32 [k, 3]
        x, y, z in local counts; never output.
    """

    chosen: Int32
    virtual: Int32


def choose_seeds(
    x: Int32,
    y: Int32,
    z: Int32,
    eligible: npt.NDArray[np.bool_],
    doubtful: npt.NDArray[np.bool_],
    cells: Cells,
    window: Window,
    reach: int,
    doubt: Doubt,
) -> Seeds:
    """Lowest eligible point per cell of a lattice anchored at CRS coordinate 0, and the ring around them.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts; at least one point is eligible.
    eligible, doubtful : bool [n]
        No outlier; eligibility not certain.
    cells : Cells
        Side: the largest building.
    window : Window
    reach : int
        Counts within which points outside the window can change a point's eligibility.
    doubt : Doubt
        Cells whose seed is not certain are added.
    """
    index = np.flatnonzero(eligible).astype(np.int32)
    chosen = index[lowest_per_cell(x[index], y[index], z[index], cells)]
    cx, cy = x[chosen].astype(np.int64), y[chosen].astype(np.int64)
    columns = ((cx + cells.origin_x) * cells.q) // cells.p
    rows = ((cy + cells.origin_y) * cells.q) // cells.p
    heights = {(int(c), int(r)): int(h) for c, r, h in zip(columns, rows, z[chosen], strict=True)}
    virtual = _ring(heights)
    if doubt.active:
        _doubt_cells(set(heights), set(virtual), cells, window.shrink(reach), doubt)
        doubt.add_points(x, y, doubtful)
    half = cells.p // (2 * cells.q)
    points = [(cells.west(c) + half, cells.south(r) + half, h) for (c, r), h in sorted(virtual.items())]
    return Seeds(chosen, np.array(points, np.int32).reshape(-1, 3))


def _neighbours(cell: tuple[int, int], reach: int = 1) -> list[tuple[int, int]]:
    c, r = cell
    span = range(-reach, reach + 1)
    return [(c + i, r + j) for j in span for i in span if i or j]


def _ring(heights: dict[tuple[int, int], int]) -> dict[tuple[int, int], int]:
    """Heights of the empty cells around the filled ones: mean of the filled 8-neighbours, growing outward (Chen 2023, 2.2)."""
    filled = dict(heights)
    added: dict[tuple[int, int], int] = {}
    rim = set(heights)
    for _ in range(RING):
        empty = {n for cell in rim for n in _neighbours(cell) if n not in filled}
        layer = {}
        for cell in empty:
            around = [filled[n] for n in _neighbours(cell) if n in filled]
            layer[cell] = sum(around) // len(around)
        filled.update(layer)
        added.update(layer)
        rim = empty
    return added


def _doubt_cells(
    filled: set[tuple[int, int]], virtual: set[tuple[int, int]], cells: Cells, known: Window, doubt: Doubt
) -> None:
    """Cells that are not wholly known, and virtual ones whose height came from such a cell."""

    def box(cell: tuple[int, int]) -> tuple[int, int, int, int]:
        c, r = cell
        return cells.west(c), cells.south(r), cells.west(c + 1), cells.south(r + 1)

    def unknown(cell: tuple[int, int]) -> bool:
        west, south, east, north = box(cell)
        return west < known.west or south < known.south or east > known.east or north > known.north

    for cell in filled | virtual:
        if unknown(cell) or (cell in virtual and any(unknown(n) for n in _neighbours(cell, RING))):
            doubt.add_box(*box(cell))


def box_with_ring(x: Int32, y: Int32, cells: Cells) -> tuple[int, int, int, int]:
    """West, south, east, north (local counts) of the data and of the virtual cells around them."""
    c0, c1 = cells.column(int(x.min())), cells.column(int(x.max()))
    r0, r1 = cells.row(int(y.min())), cells.row(int(y.max()))
    return (
        cells.west(c0 - RING),
        cells.south(r0 - RING),
        cells.west(c1 + RING + 1),
        cells.south(r1 + RING + 1),
    )
