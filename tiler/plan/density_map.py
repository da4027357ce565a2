"""Map of the point density, estimated from a few points per file, to find the densest place."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
import numpy.typing as npt

from tiler.inputs import DensityPatch

CELL_M = 64.0
"""Side of a cell of the map in metres, about that of a bucket."""
MAX_CELLS = 1_000_000
"""Approximate maximum number of cells of the map. Larger surveys get larger cells."""
PARTS = 8
"""Number of parts along the side of a cell. Each of the 64 parts has a bit, which is set if
points cover the part."""
_BATCH = 4096
"""Number of rectangles processed together, which limits the memory."""


class DensityMap:
    """Approximate numbers of points in the cells of a coarse lattice.

    Parameters
    ----------
    patches : iterable of DensityPatch
        Rectangles in units of the CRS. The points of a rectangle are assumed to be evenly distributed.
    metres : float
        Metres per unit of the CRS.

    Attributes
    ----------
    covered_m2 : float
        Approximate area of the patches in m2. Overlaps count once.
    """

    def __init__(self, patches: Iterable[DensityPatch], metres: float) -> None:
        rectangles = [
            (p.x0 * metres, p.y0 * metres, p.x1 * metres, p.y1 * metres, p.points)
            for p in patches
        ]
        boxes = np.array(rectangles, np.float64).reshape(-1, 5)
        width = boxes[:, 2] - boxes[:, 0]
        height = boxes[:, 3] - boxes[:, 1]
        area = float(np.sum(width * height))
        length = float(np.sum(width + height))
        self._cell = CELL_M
        while area / self._cell**2 + length / self._cell > MAX_CELLS:
            self._cell *= 2
        self._points = float(boxes[:, 4].sum())
        batches = np.split(boxes, range(_BATCH, len(boxes), _BATCH))
        shares = [_shares(batch, self._cell) for batch in batches]
        cells, points, bits = (np.concatenate(columns) for columns in zip(*shares, strict=True))
        self._cells, self._points_of_cell = _summed(cells, points)
        self.covered_m2 = _covered(cells, bits) * (self._cell / PARTS) ** 2
        # The results are cached, because a plan and each write of run.json ask for the same few
        # sides again.
        self.max_points = cache(self._max_points)
        self.squares = cache(self._squares)

    def _squares(
        self, side_m: float, low: tuple[float, float], high: tuple[float, float]
    ) -> float:
        """Estimate the number of squares of side ``side_m`` with points, between two corners in metres.

        The lattice of the squares starts at 0.
        """
        inside = np.all((self._cells + 1) * self._cell > low, axis=1)
        inside &= np.all(self._cells * self._cell < high, axis=1)
        cells, points = self._cells[inside], self._points_of_cell[inside]
        if side_m <= self._cell:
            # A point occupies one square, and a cell with many points has at most all its
            # squares occupied.
            return float(np.minimum(points, (self._cell / side_m) ** 2).sum())
        # A cell occupies the squares in which its four corners lie, up to four.
        corners = ((0, 0), (0, 0.99), (0.99, 0), (0.99, 0.99))
        squares = [(cells + corner) * self._cell // side_m for corner in corners]
        _, square_points = _summed(np.concatenate(squares).astype(np.int64), np.tile(points, 4))
        return float(np.minimum(square_points, 1.0).sum())

    def _max_points(self, side_m: float) -> float:
        """Estimate the number of points in the densest square of a side in metres."""
        if side_m <= self._cell:
            return float(self._points_of_cell.max(initial=0.0)) * (side_m / self._cell) ** 2
        # Points are counted in squares of whole cells, on four lattices shifted by half a
        # square, and scaled by area.
        count = int(side_m // self._cell)
        most = 0.0
        for east in {0, count // 2}:
            for north in {0, count // 2}:
                _, points = _summed(
                    (self._cells + (east, north)) // count, self._points_of_cell
                )
                most = max(most, float(points.max(initial=0.0)))
        return min(most * (side_m / (count * self._cell)) ** 2, self._points)


def _summed(
    cells: npt.NDArray[np.int64], weights: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Return the distinct cells, int64 (n, 2), and the sum of the weights of each."""
    if len(cells) == 0:
        return cells, weights
    low = cells.min(axis=0)
    height = int(cells[:, 1].max() - low[1]) + 1
    # A cell becomes a single number, because sorting pairs takes ten times as long.
    numbers, cell_index = np.unique(
        (cells[:, 0] - low[0]) * height + cells[:, 1] - low[1], return_inverse=True
    )
    distinct = np.stack(np.divmod(numbers, height), axis=1) + low
    return distinct, np.bincount(cell_index, weights).astype(np.float64)


def _covered(cells: npt.NDArray[np.int64], bits: npt.NDArray[np.uint64]) -> int:
    """Count the covered parts of cells. A cell may occur several times."""
    if len(cells) == 0:
        return 0
    order = np.lexsort(cells.T)
    first = np.append(True, np.any(np.diff(cells[order], axis=0), axis=1))
    union = np.bitwise_or.reduceat(bits[order], np.flatnonzero(first))
    return int(np.unpackbits(union.view(np.uint8)).sum())


def _shares(
    boxes: npt.NDArray[np.float64], cell: float
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.uint64]]:
    """Distribute the points of rectangles to cells, in proportion to area.

    Returns
    -------
    cells : int64 (n, 2)
        Column and row of a cell, for each rectangle that intersects it.
    points : float64 (n,)
        Points of the rectangle in the cell.
    bits : uint64 (n,)
        Bits of the parts of the cell that the rectangle covers.
    """
    first = np.floor(boxes[:, :2] / cell).astype(np.int64)
    counts = np.floor(boxes[:, 2:4] / cell).astype(np.int64) - first + 1
    # Each pair of a rectangle and a cell that it intersects is a row.
    box, cell_number = _enumerated(counts.prod(axis=1))
    columns = counts[box, 0]
    cells = first[box] + np.stack([cell_number % columns, cell_number // columns], axis=1)
    low, high = boxes[box, :2], boxes[box, 2:4]
    west_south = cells * cell
    sides = np.minimum(west_south + cell, high) - np.maximum(west_south, low)
    area = np.maximum(sides, 1e-9).prod(axis=1)
    box_area = np.bincount(box, area, minlength=len(boxes))
    points = area / box_area[box] * boxes[box, 4]
    columns_covered, rows_covered = _parts(low - west_south, high - west_south, cell).T
    # A product with the lowest bits of the covered rows copies the bits of the covered columns
    # into each of these rows.
    return cells, points, columns_covered * _row_starts(rows_covered)


def _enumerated(
    counts: npt.NDArray[np.int64],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the owner of each item, and its position among the items of the owner.

    ``counts`` are the numbers of items per owner. (2, 3) gives 0 0 1 1 1 and 0 1 0 1 2.
    """
    ends = np.cumsum(counts)
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - (ends - counts)[owner]


def _parts(
    low: npt.NDArray[np.float64], high: npt.NDArray[np.float64], cell: float
) -> npt.NDArray[np.uint64]:
    """Return the bits of the parts of a cell between two distances from its edge along an axis.

    Partly covered parts count.
    """
    first, last = (
        np.floor(v / cell * PARTS).clip(0, PARTS - 1).astype(np.uint64) for v in (low, high)
    )
    one = np.uint64(1)
    return np.asarray((one << (last + one)) - (one << first), np.uint64)


def _row_starts(bits: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Move each bit i to position ``i * PARTS``, the lowest of a row of `PARTS` bits."""
    rows = np.arange(PARTS, dtype=np.uint64)
    one = (bits[:, None] >> rows) & np.uint64(1)
    return np.asarray((one << (rows * np.uint64(PARTS))).sum(axis=1), np.uint64)
