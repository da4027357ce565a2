"""Map of the point density, estimated from a few points of each file; finds the densest place."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
import numpy.typing as npt

from tiler.ingest import Patch

CELL_M = 64.0
"""Side of a cell of the map: about a bucket."""
MOST_CELLS = 1_000_000
"""Cells of the map at most; where files cover more, the cells are larger."""


class DensityMap:
    """Points by cell of a coarse lattice.

    Parameters
    ----------
    patches : iterable of Patch
        Rectangles that hold some points, evenly, in units of the CRS.
    metres : float
        Of a unit of the CRS.
    """

    def __init__(self, patches: Iterable[Patch], metres: float) -> None:
        found = [(p.x0 * metres, p.y0 * metres, p.x1 * metres, p.y1 * metres, p.points) for p in patches]
        boxes = np.array(found, np.float64).reshape(-1, 5)
        wide, tall = boxes[:, 2] - boxes[:, 0], boxes[:, 3] - boxes[:, 1]
        area, length = float(np.sum(wide * tall)), float(np.sum(wide + tall))
        self._cell = CELL_M
        while area / self._cell**2 + length / self._cell > MOST_CELLS:
            self._cell *= 2
        self._points = float(boxes[:, 4].sum())
        parts = [_shares(box, self._cell) for box in boxes]
        cells = np.concatenate([np.empty((0, 2), np.int64), *(c for c, _ in parts)])
        weights = np.concatenate([np.empty(0), *(w for _, w in parts)])
        self._cells, self._held = _gathered(cells, weights)
        # A plan asks for few sides, and for each of them often; a run for the same squares whenever it writes run.json.
        self.fullest = cache(self._fullest)
        self.squares = cache(self._squares)

    def _squares(self, side_m: float, low: tuple[float, float], high: tuple[float, float]) -> float:
        """About how many squares of that side, on a lattice anchored at 0, hold points between two corners, metres."""
        inside = np.all((self._cells + 1) * self._cell > low, axis=1) & np.all(
            self._cells * self._cell < high, axis=1
        )
        cells, held = self._cells[inside], self._held[inside]
        if side_m <= self._cell:
            return float(np.minimum(held, (self._cell / side_m) ** 2).sum())
        # A square at each corner of a cell; of a few points over many squares each lies in one.
        corners = [
            (cells + corner) * self._cell // side_m for corner in ((0, 0), (0, 0.99), (0.99, 0), (0.99, 0.99))
        ]
        _, found = _gathered(np.concatenate(corners).astype(np.int64), np.tile(held, 4))
        return float(np.minimum(found, 1.0).sum())

    def _fullest(self, side_m: float) -> float:
        """About how many points the fullest square of that side holds."""
        if side_m <= self._cell:
            return float(self._held.max(initial=0.0)) * (side_m / self._cell) ** 2
        # Squares of whole cells, on four lattices that are half a square apart; the rest by area.
        count = int(side_m // self._cell)
        best = 0.0
        for east in {0, count // 2}:
            for north in {0, count // 2}:
                _, held = _gathered((self._cells + (east, north)) // count, self._held)
                best = max(best, float(held.max(initial=0.0)))
        return min(best * (side_m / (count * self._cell)) ** 2, self._points)


def _gathered(
    cells: npt.NDArray[np.int64], weights: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Each cell once, int64 (n, 2), and the sum of its weights."""
    if len(cells) == 0:
        return cells, weights
    low = cells.min(axis=0)
    height = int(cells[:, 1].max() - low[1]) + 1
    # One number a cell: sorting pairs takes ten times as long.
    numbers, place = np.unique((cells[:, 0] - low[0]) * height + cells[:, 1] - low[1], return_inverse=True)
    once = np.stack(np.divmod(numbers, height), axis=1) + low
    return once, np.bincount(place, weights).astype(np.float64)


def _shares(
    box: npt.NDArray[np.float64], cell: float
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """The cells that a rectangle touches, int64 (n, 2), and the points that fall to each, by area."""
    columns, across = _overlaps(box[0], box[2], cell)
    rows, along = _overlaps(box[1], box[3], cell)
    ix, iy = np.meshgrid(columns, rows)
    share = np.outer(along, across)
    return np.stack([ix.ravel(), iy.ravel()], axis=1), share.ravel() * (box[4] / share.sum())


def _overlaps(low: float, high: float, cell: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Indices of the cells along an axis, and how much of each lies between ``low`` and ``high``."""
    index = np.arange(int(np.floor(low / cell)), int(np.floor(high / cell)) + 1)
    part = np.minimum((index + 1) * cell, high) - np.maximum(index * cell, low)
    return index, np.maximum(part, 1e-9)
