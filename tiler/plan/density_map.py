"""Map of the point density, estimated from a few points of each file. It finds the densest place."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
import numpy.typing as npt

from tiler.inputs import Patch

CELL_M = 64.0
"""Side of a cell of the map: about a bucket."""
MOST_CELLS = 1_000_000
"""Most cells of the map. For larger surveys the cells are larger."""
PARTS = 8
"""Parts of a cell along its side. A bit for each part says whether points cover it; a cell has 64 of them."""


class DensityMap:
    """Points by cell of a coarse lattice.

    Parameters
    ----------
    patches : iterable of Patch
        Rectangles, in units of the CRS. Each holds some points, evenly spread.
    metres : float
        Metres in a unit of the CRS.

    Attributes
    ----------
    covered_m2 : float
        Approximate area of the patches. Every place counts once.
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
        cells = np.concatenate([np.empty((0, 2), np.int64), *(c for c, _, _ in parts)])
        weights = np.concatenate([np.empty(0), *(w for _, w, _ in parts)])
        self._cells, self._held = _gathered(cells, weights)
        bits = np.concatenate([np.empty(0, np.uint64), *(b for _, _, b in parts)])
        self.covered_m2 = _covered(cells, bits) * (self._cell / PARTS) ** 2
        # A plan asks for few sides, each many times. A run asks for the same squares whenever it writes run.json.
        self.fullest = cache(self._fullest)
        self.squares = cache(self._squares)

    def _squares(self, side_m: float, low: tuple[float, float], high: tuple[float, float]) -> float:
        """Approximate number of squares, on a lattice anchored at 0, that hold points between two corners (metres)."""
        inside = np.all((self._cells + 1) * self._cell > low, axis=1) & np.all(
            self._cells * self._cell < high, axis=1
        )
        cells, held = self._cells[inside], self._held[inside]
        if side_m <= self._cell:
            return float(np.minimum(held, (self._cell / side_m) ** 2).sum())
        # Each corner of a cell lies in a square. Few points in many squares: each point has a square of its own.
        corners = [
            (cells + corner) * self._cell // side_m for corner in ((0, 0), (0, 0.99), (0.99, 0), (0.99, 0.99))
        ]
        _, found = _gathered(np.concatenate(corners).astype(np.int64), np.tile(held, 4))
        return float(np.minimum(found, 1.0).sum())

    def _fullest(self, side_m: float) -> float:
        """Approximate number of points in the fullest square of that side."""
        if side_m <= self._cell:
            return float(self._held.max(initial=0.0)) * (side_m / self._cell) ** 2
        # Squares are whole cells, on four lattices that are half a square apart. The rest goes by area.
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
    """Distinct cells, int64 (n, 2), and the sum of the weights of each."""
    if len(cells) == 0:
        return cells, weights
    low = cells.min(axis=0)
    height = int(cells[:, 1].max() - low[1]) + 1
    # A cell becomes a single number, as sorting pairs takes ten times as long.
    numbers, place = np.unique((cells[:, 0] - low[0]) * height + cells[:, 1] - low[1], return_inverse=True)
    once = np.stack(np.divmod(numbers, height), axis=1) + low
    return once, np.bincount(place, weights).astype(np.float64)


def _covered(cells: npt.NDArray[np.int64], bits: npt.NDArray[np.uint64]) -> int:
    """Number of covered parts of cells. A cell may occur several times."""
    if len(cells) == 0:
        return 0
    order = np.lexsort(cells.T)
    first = np.append(True, np.any(np.diff(cells[order], axis=0), axis=1))
    union = np.bitwise_or.reduceat(bits[order], np.flatnonzero(first))
    return int(np.unpackbits(union.view(np.uint8)).sum())


def _shares(
    box: npt.NDArray[np.float64], cell: float
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.uint64]]:
    """Cells that a rectangle touches, int64 (n, 2); the points of each, by area; and the bits of the covered parts."""
    columns, across = _overlaps(box[0], box[2], cell)
    rows, along = _overlaps(box[1], box[3], cell)
    ix, iy = np.meshgrid(columns, rows)
    share = np.outer(along, across)
    bits = np.outer(_spread(_parts(rows, box[1], box[3], cell)), _parts(columns, box[0], box[2], cell))
    return np.stack([ix.ravel(), iy.ravel()], axis=1), share.ravel() * (box[4] / share.sum()), bits.ravel()


def _parts(index: npt.NDArray[np.int64], low: float, high: float, cell: float) -> npt.NDArray[np.uint64]:
    """Bits, for each cell along an axis, of the parts between ``low`` and ``high``; touched parts count."""
    first, last = (np.floor((v - index * cell) / cell * PARTS).clip(0, PARTS - 1) for v in (low, high))
    below, above = (np.uint64(1) << v.astype(np.uint64) for v in (first, last + 1))
    return np.asarray(above - below, np.uint64)


def _spread(bits: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Move each bit to the lowest place of a row of `PARTS` bits."""
    rows = np.arange(PARTS, dtype=np.uint64)
    one = (bits[:, None] >> rows) & np.uint64(1)
    return np.asarray((one << (rows * np.uint64(PARTS))).sum(axis=1), np.uint64)


def _overlaps(low: float, high: float, cell: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Indices of the cells along an axis, and the length of each between ``low`` and ``high``."""
    index = np.arange(int(np.floor(low / cell)), int(np.floor(high / cell)) + 1)
    part = np.minimum((index + 1) * cell, high) - np.maximum(index * cell, low)
    return index, np.maximum(part, 1e-9)
