"""Heights of trees by place, from the depths of land below the crowns around it, for woods in which no land is near."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from ptd.frame import CellLattice, Scale
from ptd.places import PLACE_M, Figures, Table, field, on_cells, place_of

WEIGHTS = (1, 8, 64, 8, 1)
"""Weights of the land of a place and of the places around, along a row or column. Nearer land counts almost alone."""
MM = 1000

Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
Partial = list[list[int]]
"""Column and row of each place with land, number of its cells of land, and sum of their depths in millimetres."""


def measure_trees(depths_m: Float64, xyz: Int32, scale: Scale) -> Partial:
    """Return the sums of the depths of some cells of land, by place. ``xyz`` has the middles of the cells."""
    indices = np.stack(CellLattice.of(PLACE_M, scale).cell_indices(xyz[0], xyz[1]))
    found, of_found, n = np.unique(indices, axis=1, return_inverse=True, return_counts=True)
    sums = np.zeros(n.size, np.int64)
    np.add.at(sums, of_found.ravel(), np.rint(depths_m * MM).astype(np.int64))
    partial: Partial = np.column_stack([found.T, n, sums]).tolist()
    return partial


def tree_heights(
    partials: Iterable[Partial], places: Mapping[str, Figures]
) -> dict[str, list[float]]:
    """Return the height of the trees around each place in metres, and 1, or zeros without land within two places."""
    counts: Counter[tuple[int, int]] = Counter()
    sums: Counter[tuple[int, int]] = Counter()
    around = [(step - len(WEIGHTS) // 2, weight) for step, weight in enumerate(WEIGHTS)]
    for partial in partials:
        for column, row, n, sum_mm in partial:
            for right, across in around:
                for up, along in around:
                    counts[column + right, row + up] += across * along * n
                    sums[column + right, row + up] += across * along * sum_mm
    heights = {}
    for name in places:
        place = place_of(name)
        n = counts[place]
        heights[name] = [round(sums[place] / n / MM, 2), 1.0] if n else [0.0, 0.0]
    return heights


def tree_heights_on_cells(
    table: Table,
    cells: CellLattice,
    row: int,
    column: int,
    shape: tuple[int, ...],
    scale: Scale,
) -> Float64:
    """Return the height of trees at the middles of cells in metres, 0 where it is not known.

    It is interpolated between the places where it is known. For the other arguments see `ptd.places.on_cells`.
    """
    total, known = (
        on_cells(field(table, figure, scale, 0.0), cells, row, column, shape)
        for figure in (0, 1)
    )
    return np.where(known > 0, total / np.where(known > 0, known, 1.0), 0.0)
