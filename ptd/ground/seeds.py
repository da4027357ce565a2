"""Seeds: the lowest point per cell, and a ring of virtual points that continues the TIN beyond the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, lowest_per_cell
from ptd.frame import CellLattice
from ptd.ground.certificates import UncertifiedRegion

RING = 2
"""Width in cells of the ring of virtual seeds around occupied cells. A circle through or around
a data point with a radius above sqrt(2) cells would contain a whole cell within two cells of
the point, and so a seed. So an empty circle (one without vertices) has a radius of at most
sqrt(2) cells and extends less than three cells from the data."""


@dataclass(frozen=True)
class Seeds:
    """Vertices of the first TIN: the chosen points and the virtual ones.

    Attributes
    ----------
    chosen : int32 [m]
        Indices of the points that are seeds.
    virtual : int32 [k, 3]
        x, y, z of the virtual seeds in local counts; they are never output.
    """

    chosen: Int32
    virtual: Int32


def choose_seeds(
    x: Int32,
    y: Int32,
    z: Int32,
    eligible: npt.NDArray[np.bool_],
    cells: CellLattice,
    region: UncertifiedRegion,
    uncertified: npt.NDArray[np.bool_] | None = None,
) -> Seeds:
    """Choose the lowest eligible point per cell of a lattice anchored at CRS coordinate 0, and the ring around them.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts. At least one point is eligible.
    eligible : bool [n]
        Mask of the points that may be seeds.
    cells : CellLattice
        Lattice of the seed cells.
    region : UncertifiedRegion
        Uncertified region, to which cells with an uncertified seed are added.
    uncertified : bool [n], optional
        Mask of the points for which ``eligible`` is uncertified; none by default.
    """
    index = np.flatnonzero(eligible).astype(np.int32)
    chosen = index[lowest_per_cell(x[index], y[index], z[index], cells)]
    filled = cells_of(x[chosen], y[chosen], cells)
    heights = {cell: int(h) for cell, h in zip(filled, z[chosen], strict=True)}
    virtual = _ring(heights)
    if region.active and uncertified is None:
        _add_uncertified_cells(set(filled), set(), cells, region)
    elif region.active and uncertified is not None:
        certain = eligible & ~uncertified
        certified_cells, uncertified_cells = (
            set(cells_of(x[w], y[w], cells)) for w in (certain, uncertified)
        )
        _add_uncertified_cells(certified_cells, uncertified_cells, cells, region)
    half = cells.p // (2 * cells.q)
    points = [
        (cells.west(c) + half, cells.south(r) + half, h)
        for (c, r), h in sorted(virtual.items())
    ]
    return Seeds(chosen, np.array(points, np.int32).reshape(-1, 3))


def cells_of(x: Int32, y: Int32, cells: CellLattice) -> list[tuple[int, int]]:
    """Return column and row of each point."""
    columns, rows = cells.cell_indices(x, y)
    return list(zip(columns.tolist(), rows.tolist(), strict=True))


def _neighbours(cell: tuple[int, int], reach: int = 1) -> list[tuple[int, int]]:
    c, r = cell
    span = range(-reach, reach + 1)
    return [(c + i, r + j) for j in span for i in span if i or j]


def _ring(heights: dict[tuple[int, int], int]) -> dict[tuple[int, int], int]:
    """Return heights of the empty cells around filled ones, layer by layer outward (Chen 2023, 2.2).

    The height of a cell is the mean of its filled 8-neighbours.
    """
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


def _add_uncertified_cells(
    filled: set[tuple[int, int]],
    uncertified: set[tuple[int, int]],
    cells: CellLattice,
    region: UncertifiedRegion,
) -> None:
    """Make the cells uncertified that may have another seed in the untiled run.

    These are cells that are not wholly known, and empty cells within the ring around them. A
    point beyond the border could add or remove the virtual seed of an empty cell near it, or
    change its height. The same applies to cells near cells with points of uncertified
    eligibility (`uncertified`). Cells of `filled` contain a point that is certainly eligible.
    """
    known, deep = region.known.inside(cells), region.known.inside(cells, RING)
    reached = uncertified.union(*(_neighbours(cell, RING) for cell in uncertified))
    west, south, east, north = region.box
    for row in range(cells.row(south), cells.row(north - 1) + 1):
        for column in range(cells.column(west), cells.column(east - 1) + 1):
            box = (
                cells.west(column),
                cells.south(row),
                cells.west(column + 1),
                cells.south(row + 1),
            )
            if known.contains_box(*box) and (column, row) in filled:
                continue
            if not deep.contains_box(*box) or (column, row) in reached:
                region.add_box(*box)


def box_with_ring(x: Int32, y: Int32, cells: CellLattice) -> tuple[int, int, int, int]:
    """Return west, south, east and north of a box that contains all empty circles through or around data (`RING`).

    They are local counts.
    """
    c0, c1 = cells.column(int(x.min())), cells.column(int(x.max()))
    r0, r1 = cells.row(int(y.min())), cells.row(int(y.max()))
    margin = RING + 1
    return (
        cells.west(c0 - margin),
        cells.south(r0 - margin),
        cells.west(c1 + margin + 1),
        cells.south(r1 + margin + 1),
    )
