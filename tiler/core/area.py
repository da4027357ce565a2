"""The area of interest of a run: polygons in absolute counts, exact to the count."""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from tiler.core.lattice import Bounds, Lattice

Counts = npt.NDArray[np.int64]
MOST_BOXES = 1 << 14
"""Rectangles of cells that are looked at to find those near an area: some seconds."""

Runs = list[list[int]]
"""Cells of a lattice: [iy, first ix, end ix] of neighbours in a row, row by row from the south-west."""

LONGEST_EDGE = 1 << 30
"""Longest edge of a polygon, in counts along each axis, with which the exact test of a point stays within int64."""


@dataclass(frozen=True, eq=False)
class Area:
    """Polygons of an area; a place is inside if it is inside of one of them.

    Attributes
    ----------
    polygons : tuple of tuple of int64 (n, 2)
        Rings of each polygon, closed or not, in absolute counts. A place is inside of a polygon if a ray from it
        crosses the rings an odd number of times: holes are rings like others, in whatever direction they run.

    Notes
    -----
    Half-open: of areas that share an edge, a place on it is inside of exactly one. A rectangle holds its lower and left
    edge, as `Bounds` do. No edge but those along an axis may be longer than `LONGEST_EDGE`, see `shortened`.
    """

    polygons: tuple[tuple[Counts, ...], ...]

    @classmethod
    def rectangle(cls, bounds: Bounds) -> Area:
        """The area of these bounds."""
        x0, y0, x1, y1 = bounds.to_json()
        return cls(((np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], np.int64),),))

    @cached_property
    def bounds(self) -> Bounds:
        """Bounds of all polygons."""
        x, y = np.concatenate([ring for rings in self.polygons for ring in rings]).T
        return Bounds(int(x.min()), int(y.min()), int(x.max()), int(y.max()))

    @cached_property
    def key(self) -> str:
        """A digest of the polygons."""
        return hashlib.blake2b(json.dumps(self.to_json()).encode(), digest_size=16).hexdigest()

    @cached_property
    def edges(self) -> tuple[Counts, ...]:
        """The edges of each polygon but level ones: x, y of the lower end, x, y of the upper one, int64 (4, n)."""
        return tuple(np.concatenate([_rising(ring) for ring in rings], axis=1) for rings in self.polygons)

    @cached_property
    def _outline(self) -> Counts:
        """All edges, level ones too: x0, y0, x1, y1, int64 (4, n)."""
        return np.concatenate([_edges(ring) for rings in self.polygons for ring in rings], axis=1)

    def inside(self, x: Counts, y: Counts) -> npt.NDArray[np.bool_]:
        """Mask of the places inside, absolute counts int64 (n,)."""
        found = np.zeros(x.shape, np.bool_)
        if not x.size:
            return found
        order = np.argsort(y, kind="stable")
        xs, ys = x[order], y[order]
        for edges in self.edges:
            found[order] |= _crossed_oddly(edges, xs, ys)
        return found

    def covers(self, bounds: Bounds) -> bool:
        """Whether every count of the bounds is inside; False where an outline runs through them."""
        return not _near(self._outline, bounds).size and self._holds_corner(bounds)

    def touches(self, bounds: Bounds) -> bool:
        """Whether some count of the bounds is inside, or so near to the edge that rounding decides."""
        return bool(_near(self._outline, bounds).size) or self._holds_corner(bounds)

    def cells(self, lattice: Lattice, window: Bounds, margin: int) -> Runs | None:
        """Cells that overlap ``window`` and come within ``margin`` counts of the area; None where it covers all of it.

        A cell is taken or left as a whole. Where the outline is longer than some `MOST_BOXES` cells, cells farther off
        than ``margin`` may be among those found.
        """
        if self.covers(window):
            return None
        x0, y0 = lattice.index_of(window.x0), lattice.index_of(window.y0)
        x1, y1 = lattice.index_of(window.x1 - 1) + 1, lattice.index_of(window.y1 - 1) + 1
        rows: dict[int, list[tuple[int, int]]] = {}
        boxes, looked_at = deque([(x0, y0, x1, y1, self._outline)]), 0
        while boxes:
            x0, y0, x1, y1, outline = boxes.popleft()
            looked_at += 1
            bounds = Bounds(*(lattice.first(i) for i in (x0, y0, x1, y1)))
            outline = _near(outline, bounds.pad(margin))
            whole = not _near(outline, bounds).size and self._holds_corner(bounds)
            smallest = (x1 - x0, y1 - y0) == (1, 1) or looked_at > MOST_BOXES
            if whole or (outline.size and smallest):
                for iy in range(y0, y1):
                    rows.setdefault(iy, []).append((x0, x1))
            elif outline.size:
                across, up = (x0, (x0 + x1 + 1) // 2, x1), (y0, (y0 + y1 + 1) // 2, y1)
                boxes += [
                    (west, south, east, north, outline)
                    for south, north in pairwise(up)
                    for west, east in pairwise(across)
                    if south < north and west < east
                ]
        return [[iy, first, end] for iy in sorted(rows) for first, end in _joined(sorted(rows[iy]))]

    def _holds_corner(self, bounds: Bounds) -> bool:
        return bool(self.inside(np.array([bounds.x0], np.int64), np.array([bounds.y0], np.int64))[0])

    def to_json(self) -> list[list[list[int]]]:
        """Rings of each polygon as x, y, x, y, ...; `from_json` reads them back."""
        return [[ring.ravel().tolist() for ring in rings] for rings in self.polygons]

    @classmethod
    def from_json(cls, data: Sequence[Sequence[Sequence[int]]]) -> Area:
        """The area that `to_json` wrote."""
        return cls(tuple(tuple(np.array(r, np.int64).reshape(-1, 2) for r in rings) for rings in data))


def shortened(ring: Counts) -> Counts:
    """A ring with further points on edges that are longer than `LONGEST_EDGE` along an axis, to the next count."""
    parts = []
    for start, end in zip(ring.tolist(), np.roll(ring, -1, axis=0).tolist(), strict=True):
        number = max(abs(e - s) for s, e in zip(start, end, strict=True)) // LONGEST_EDGE + 1
        parts += [[s + (e - s) * i // number for s, e in zip(start, end, strict=True)] for i in range(number)]
    return np.array(parts, np.int64)


def in_runs(runs: Runs, ix: Counts, iy: Counts) -> npt.NDArray[np.bool_]:
    """Mask of the cells that are in runs of `Area.cells`."""
    if not runs:
        return np.zeros(ix.shape, np.bool_)
    row, first, end = np.array(runs, np.int64).T
    west = min(int(first.min()), int(ix.min(initial=0)))
    wide = max(int(end.max()), int(ix.max(initial=0))) - west + 1
    run: npt.NDArray[np.intp] = (
        np.searchsorted(row * wide + (first - west), iy * wide + (ix - west), side="right") - 1
    )
    found: npt.NDArray[np.bool_] = (run >= 0) & (row[run] == iy) & (ix < end[run])
    return found


def _edges(ring: Counts) -> Counts:
    """x0, y0, x1, y1 of the edges of a ring, int64 (4, n); one more closes it, if of no length where it is closed."""
    return np.concatenate([ring, np.roll(ring, -1, axis=0)], axis=1).T


def _rising(ring: Counts) -> Counts:
    """The edges of a ring but level ones, from the lower end to the upper one."""
    edges = _edges(ring)
    edges = edges[:, edges[1] != edges[3]]
    return np.where(edges[1] < edges[3], edges, edges[[2, 3, 0, 1]])


def _near(edges: Counts, bounds: Bounds) -> Counts:
    """The edges that touch closed bounds, or pass them by less than a rounding."""
    x0, y0, x1, y1 = edges
    hit = (np.minimum(x0, x1) <= bounds.x1) & (np.maximum(x0, x1) >= bounds.x0)
    hit &= (np.minimum(y0, y1) <= bounds.y1) & (np.maximum(y0, y1) >= bounds.y0)
    edges = edges[:, hit]
    x0, y0, x1, y1 = edges.astype(np.float64)
    sides = [
        (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
        for x in (bounds.x0, bounds.x1)
        for y in (bounds.y0, bounds.y1)
    ]
    slack = np.abs(x1 - x0) + np.abs(y1 - y0)
    return edges[:, (np.min(sides, axis=0) <= slack) & (np.max(sides, axis=0) >= -slack)]


def _crossed_oddly(edges: Counts, x: Counts, y: Counts) -> npt.NDArray[np.bool_]:
    """Places from which a ray to the east crosses an odd number of edges; y ascending.

    An edge holds its lower end and not its upper one; a place on an edge is west of it only if x is lower.
    """
    x0, y0, x1, y1 = edges
    facing = (y0 <= y[-1]) & (y1 > y[0]) & (np.maximum(x0, x1) > x.min())
    beyond = facing & (np.minimum(x0, x1) > x.max())
    # All of those that lie east of the places count wherever they reach in y.
    lower, upper = np.sort(y0[beyond]), np.sort(y1[beyond])
    crossings = np.searchsorted(lower, y, side="right") - np.searchsorted(upper, y, side="right")
    odd: npt.NDArray[np.bool_] = crossings % 2 == 1
    for ax, ay, bx, by in edges[:, facing & ~beyond].T.tolist():
        rows = slice(*np.searchsorted(y, (ay, by)).tolist())
        if ax == bx:
            odd[rows] ^= x[rows] < ax
        else:
            odd[rows] ^= (bx - ax) * (y[rows] - ay) > (x[rows] - ax) * (by - ay)
    return odd


def _joined(runs: list[tuple[int, int]]) -> list[list[int]]:
    """Runs of a row, ascending, those that follow one another as one."""
    found: list[list[int]] = []
    for first, end in runs:
        if found and found[-1][1] == first:
            found[-1][1] = end
        else:
            found.append([first, end])
    return found
