"""What a pass of `auto` leaves for the next one: a code for each cell, given to all points in it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.cells import CellIndex, Int32, lowest_per_cell
from ptd.frame import Cells, Window
from ptd.ground.labelling import UNCLASSIFIED
from ptd.passes import Model, Points, UInt8

Bool = npt.NDArray[np.bool_]


class CellCodes(Model):
    """What a pass says of each cell; cells without a point are unclassified.

    Parameters
    ----------
    x, y : int32 [m]
        A point of each cell, local counts, by rows of cells.
    codes : uint8 [m]
    cells : Cells
    certain : Window
        All cells outside of it are doubtful.
    stats : dict
    doubtful : bool [m], optional
        Points outside the window could change the code; none within `certain` if left out.
    """

    def __init__(
        self,
        x: Int32,
        y: Int32,
        codes: UInt8,
        cells: Cells,
        certain: Window,
        stats: dict[str, Any],
        doubtful: Bool | None = None,
    ) -> None:
        self.stats, self._certain = {"cells": int(x.size), **stats}, certain
        self._codes = np.append(codes, np.uint8(UNCLASSIFIED))
        self._doubtful = np.zeros(x.size + 1, np.bool_) if doubtful is None else np.append(doubtful, False)
        self._index = CellIndex(x, y, cells) if x.size else None

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Codes (uint8 [n]) and marks (bool [n]) of the cells of points."""
        x, y, _ = points.columns()
        slots = np.full(x.size, -1, np.int32)
        if self._index is not None:
            slots = self._index.find(x, y)
        marked = self._doubtful[slots]
        if self._certain.closed:
            w = self._certain
            marked |= (x < w.west) | (y < w.south) | (x >= w.east) | (y >= w.north)
        return self._codes[slots], marked


def lowest_points(points: Points, cells: Cells) -> tuple[Int32, Int32, Int32, UInt8]:
    """x, y, z and label of the lowest point of each cell, by rows of cells; labels are 0 if there are none yet."""
    x, y, z = points.columns()
    index = lowest_per_cell(x, y, z, cells)
    labels = np.zeros(index.size, np.uint8) if points.labels is None else points.labels[index]
    return x[index], y[index], z[index], labels
