"""Results of the passes of `auto` for the next pass: each cell has a code that applies to all its points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.cells import CellIndex, Int32, Xyz, lowest_per_cell
from ptd.frame import CellLattice, Window
from ptd.ground.labelling import LOW_NOISE, UNCLASSIFIED
from ptd.passes import Model, Points, Stats, UInt8

Bool = npt.NDArray[np.bool_]

OBJECT, OUTLIER, SEED, DENSIFIED, ROOF = UNCLASSIFIED, LOW_NOISE, 3, 4, 6
"""Codes of cells between passes. Cells that stay ground after `refine` have the code
`GROUND` (`ptd.ground.labelling`). `ROOF` is also that of crowns on slopes."""
ABOVE_NOISE = 32
"""Bit of the codes of cells in which points below the elected one are low noise. It stays the
same in all passes."""


class CellCodes(Model):
    """Model with a code per cell. Cells without a point are unclassified.

    Parameters
    ----------
    x, y : int32 [m]
        Local counts of a point of each cell, by rows of cells.
    codes : uint8 [m]
        Codes of the cells.
    cells : CellLattice
    certain : Window
        Window outside which all cells are uncertified.
    stats : dict
    uncertified : bool [m], optional
        Mask of the codes that points outside the window could change. By default all codes within `certain` are
        certified.
    """

    def __init__(
        self,
        x: Int32,
        y: Int32,
        codes: UInt8,
        cells: CellLattice,
        certain: Window,
        stats: Stats,
        uncertified: Bool | None = None,
    ) -> None:
        self.stats, self._certain = {"cells": int(x.size), **stats}, certain
        self._codes = np.append(codes, np.uint8(UNCLASSIFIED))
        self._uncertified = (
            np.zeros(x.size + 1, np.bool_)
            if uncertified is None
            else np.append(uncertified, False)
        )
        self._x, self._y, self._cells = x, y, cells
        self._index: CellIndex | None = None

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Return the codes of the cells of points (uint8 [n]), and a mask of uncertified codes (bool [n])."""
        x, y, _ = points.columns()
        if np.array_equal(x, self._x) and np.array_equal(
            y, self._y
        ):  # In an untiled run the points are those of the model.
            codes, uncertified_codes = self._codes[:-1].copy(), self._uncertified[:-1].copy()
        else:
            slots = self._slots(x, y)
            codes, uncertified_codes = self._codes[slots], self._uncertified[slots]
        if points.labels is not None:
            codes |= points.labels & ABOVE_NOISE
        if self._certain.closed:
            w = self._certain
            uncertified_codes |= (x < w.west) | (y < w.south) | (x >= w.east) | (y >= w.north)
        return codes, uncertified_codes

    def _slots(self, x: Int32, y: Int32) -> Int32:
        """Return the index of the model's cell in which each point lies, or -1 if there is none: int32 [n]."""
        if self._x.size == 0:
            return np.full(x.size, -1, np.int32)
        if self._index is None:
            self._index = CellIndex(self._x, self._y, self._cells)
        return self._index.find(x, y)


def lowest_points(points: Points, cells: CellLattice) -> tuple[Int32, Int32, Int32, UInt8]:
    """Return x, y, z and code of the lowest point of each cell, by rows of cells.

    Codes have no bit `ABOVE_NOISE`, and are 0 before the first pass that gives labels.
    """
    x, y, z = points.columns()
    index = lowest_per_cell(x, y, z, cells)
    labels = np.zeros(index.size, np.uint8) if points.labels is None else points.labels[index]
    return x[index], y[index], z[index], labels & ~np.uint8(ABOVE_NOISE)


class ElectedCells(CellCodes):
    """Model that elects a point of each cell: the lowest that is not noise, or else the highest.

    Cells whose elected point is noise have the code `OUTLIER`, and cells with noise below the elected point the bit
    `ABOVE_NOISE`.

    Parameters
    ----------
    points : Xyz
        All points of a window.
    noise : bool [n]
        Mask of the points that are noise.
    cells : CellLattice
    certain : Window
        See `CellCodes`.
    """

    def __init__(self, points: Xyz, noise: Bool, cells: CellLattice, certain: Window) -> None:
        index = lowest_per_cell(*points, cells)
        codes = np.zeros(index.size, np.uint8)
        lowest_is_noise = noise[index]
        table = None
        if lowest_is_noise.any():
            table = CellIndex(points.x[index], points.y[index], cells)
            cell_of = table.find(points.x, points.y)
            changed = lowest_is_noise[cell_of]
            for which, sign, code in ((noise, -1, OUTLIER), (~noise, 1, ABOVE_NOISE)):
                among = np.flatnonzero(changed & which)
                x, y, z = (axis[among] for axis in points)
                found = among[lowest_per_cell(x, y, sign * z, cells)]
                index[cell_of[found]], codes[cell_of[found]] = found, code
        x, y, self._z = (axis[index] for axis in points)
        stats = {"low_noise": int(noise.sum())}
        super().__init__(x, y, codes, cells, certain, stats)
        self._index = table  # The elected points lie in the same cells.

    def elect(self, bounds: Window) -> Int32:
        """Return the elected points within bounds, by rows of cells."""
        inside = bounds.contains(self._x, self._y)
        return np.stack([self._x[inside], self._y[inside], self._z[inside]])
