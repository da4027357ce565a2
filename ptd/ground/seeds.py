"""Seeds: the lowest point per cell, and a ring of virtual points that holds the TIN beyond the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, lowest_per_cell
from ptd.frame import CellLattice
from ptd.ground.certificates import UncertifiedRegion

RING = 2
"""Cells of virtual seeds around occupied ones. Any circle of a radius above sqrt(2) cells around or through a point
of the data would hold a whole cell within two cells of it, and with it a seed: so the circles that matter are
bounded, and reach less than three cells from the data."""


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
    cells: CellLattice,
    doubt: UncertifiedRegion,
    unsure: npt.NDArray[np.bool_] | None = None,
) -> Seeds:
    """Lowest eligible point per cell of a lattice anchored at CRS coordinate 0, and the ring around them.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts; at least one point is eligible.
    eligible : bool [n]
        No outlier.
    cells : CellLattice
        Side: the largest building.
    doubt : UncertifiedRegion
        Cells whose seed is not certain are added.
    unsure : bool [n], optional
        Whether it is not certain that a point is (or is not) eligible; else all are certain.
    """
    index = np.flatnonzero(eligible).astype(np.int32)
    chosen = index[lowest_per_cell(x[index], y[index], z[index], cells)]
    filled = cells_of(x[chosen], y[chosen], cells)
    heights = {cell: int(h) for cell, h in zip(filled, z[chosen], strict=True)}
    virtual = _ring(heights)
    if doubt.active and unsure is None:
        _doubt_cells(set(filled), set(), cells, doubt)
    elif doubt.active and unsure is not None:
        certain = eligible & ~unsure
        sure, not_sure = (set(cells_of(x[w], y[w], cells)) for w in (certain, unsure))
        _doubt_cells(sure, not_sure, cells, doubt)
    half = cells.p // (2 * cells.q)
    points = [(cells.west(c) + half, cells.south(r) + half, h) for (c, r), h in sorted(virtual.items())]
    return Seeds(chosen, np.array(points, np.int32).reshape(-1, 3))


def cells_of(x: Int32, y: Int32, cells: CellLattice) -> list[tuple[int, int]]:
    """Column and row of each point."""
    columns, rows = cells.places(x, y)
    return list(zip(columns.tolist(), rows.tolist(), strict=True))


def _neighbours(cell: tuple[int, int], reach: int = 1) -> list[tuple[int, int]]:
    c, r = cell
    span = range(-reach, reach + 1)
    return [(c + i, r + j) for j in span for i in span if i or j]


def _ring(heights: dict[tuple[int, int], int]) -> dict[tuple[int, int], int]:
    """Heights of empty cells around filled ones: mean of the filled 8-neighbours, growing outward (Chen 2023, 2.2)."""
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
    filled: set[tuple[int, int]], unsure: set[tuple[int, int]], cells: CellLattice, doubt: UncertifiedRegion
) -> None:
    """Put in doubt what may have another seed: cells not wholly known, and empty ones within the ring of such.

    An empty cell near the border has a virtual seed, or none, or one of another height if there is a point beyond; and
    so has one near a cell of whose points it is not certain that they are eligible (`unsure`). Cells of `filled` hold
    one that certainly is.
    """
    known, deep = doubt.known.inside(cells), doubt.known.inside(cells, RING)
    reached = unsure.union(*(_neighbours(cell, RING) for cell in unsure))
    west, south, east, north = doubt.box
    for row in range(cells.row(south), cells.row(north - 1) + 1):
        for column in range(cells.column(west), cells.column(east - 1) + 1):
            box = cells.west(column), cells.south(row), cells.west(column + 1), cells.south(row + 1)
            if known.holds(*box) and (column, row) in filled:
                continue
            if not deep.holds(*box) or (column, row) in reached:
                doubt.add_box(*box)


def box_with_ring(x: Int32, y: Int32, cells: CellLattice) -> tuple[int, int, int, int]:
    """West, south, east, north (local counts) of all circles that hold data: see `RING`."""
    c0, c1 = cells.column(int(x.min())), cells.column(int(x.max()))
    r0, r1 = cells.row(int(y.min())), cells.row(int(y.max()))
    reach = RING + 1
    return (
        cells.west(c0 - reach),
        cells.south(r0 - reach),
        cells.west(c1 + reach + 1),
        cells.south(r1 + reach + 1),
    )
