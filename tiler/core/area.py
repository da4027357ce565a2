"""Area of interest of a run: polygons in absolute counts, exact to the count, and an index of many areas."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, pairwise, product

import numpy as np

from ptd.arrays import Bool, Indices, Int64
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.records import new_digest

Counts = Int64

MAX_BOXES = 1 << 14
"""Number of rectangles of cells after which `Area.cells` divides no more, which takes some
seconds."""

FEW_SIDES = 1 << 14
"""Maximum number of pairs of a position and an edge that are compared in one array."""

Runs = list[list[int]]
"""Runs of neighbouring cells in rows of a lattice: [iy, first ix, end ix], row by row from the
south-west."""

CROSSINGS_AT_ONCE = 1 << 18
"""Number of crossings of a row and an edge that are computed at a time, which limits the memory."""

MAX_EDGE = 1 << 30
"""Longest edge of a polygon, in counts along each axis, for which the exact test of a point
fits int64."""


@dataclass(frozen=True, eq=False)
class Area:
    """Area of polygons. A position is inside the area if it is inside one of them.

    Attributes
    ----------
    polygons : tuple of tuple of int64 (n, 2)
        Rings of each polygon, closed or not, in absolute counts. A position is inside a polygon if a ray from it
        crosses the rings an odd number of times: holes are rings like others, and the direction of rings does not
        matter.

    Notes
    -----
    Areas are half-open: a position on an edge that two areas share is inside exactly one of them. A rectangle contains
    its lower and left edge, like `Bounds`. Only edges along an axis may be longer than `MAX_EDGE` (see
    `segmentized`).
    """

    polygons: tuple[tuple[Counts, ...], ...]

    @classmethod
    def rectangle(cls, bounds: Bounds) -> Area:
        """Return the area that equals ``bounds``."""
        x0, y0, x1, y1 = bounds.to_json()
        return cls(((np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], np.int64),),))

    @cached_property
    def bounds(self) -> Bounds:
        """Bounds of all polygons."""
        rings = list(chain(*self.polygons))
        vertices = np.concatenate(rings) if len(rings) > 1 else rings[0]
        return Bounds(*vertices.min(axis=0).tolist(), *vertices.max(axis=0).tolist())

    @cached_property
    def key(self) -> str:
        """Digest of the polygons."""
        digest = new_digest()
        for rings in self.polygons:
            digest.update(b"polygon %d" % len(rings))
            for ring in rings:
                digest.update(b"ring %d" % len(ring))
                digest.update(ring.astype("<i8").tobytes())
        return digest.hexdigest()

    @cached_property
    def edges(self) -> tuple[Counts, ...]:
        """Edges of each polygon except level ones: x, y of the lower end, x, y of the upper end, int64 (4, n)."""
        return tuple(_rising(rings) for rings in self.polygons)

    @cached_property
    def _outline(self) -> Counts:
        """All edges, including level ones: x0, y0, x1, y1, int64 (4, n)."""
        return np.concatenate([_edges(ring) for ring in chain(*self.polygons)], axis=1)

    def inside(self, x: Counts, y: Counts) -> Bool:
        """Return the mask of the positions inside the area, given by x and y in absolute counts, int64 (n,)."""
        is_inside = np.zeros(x.shape, np.bool_)
        if not x.size:
            return is_inside
        if x.size * max(edges.shape[1] for edges in self.edges) <= FEW_SIDES and self._is_small:
            for edges in self.edges:
                is_inside |= _few_crossed_oddly(edges, x, y)
            return is_inside
        order = np.argsort(y, kind="stable")
        xs, ys = x[order], y[order]
        for edges in self.edges:
            is_inside[order] |= _odd_crossings(edges, xs, ys)
        return is_inside

    def inside_grid(self, x: Counts, y: Counts) -> Bool:
        """Return the mask of the positions of a grid inside the area, bool (n rows, n columns).

        Parameters
        ----------
        x, y : int64 (n columns,), int64 (n rows,)
            Positions of the columns, ascending, and of the rows, in absolute counts.
        """
        is_inside = np.zeros((len(y), len(x)), np.bool_)
        for edges in self.edges if is_inside.size else ():
            is_inside |= _odd_crossings_of_rows(edges, x, y)
        return is_inside

    def covers(self, bounds: Bounds) -> bool:
        """Return whether every count of the bounds is inside. The result is False if an edge is near the bounds."""
        return not _near(self._outline, bounds).size and self._holds_corner(bounds)

    def touches(self, bounds: Bounds) -> bool:
        """Return whether some count of the bounds is inside, or so near to an edge that rounding could decide."""
        extent = self.bounds
        if (
            extent.x0 > bounds.x1
            or extent.x1 < bounds.x0
            or extent.y0 > bounds.y1
            or extent.y1 < bounds.y0
        ):
            return False
        if (
            extent.x0 >= bounds.x0
            and extent.x1 <= bounds.x1
            and extent.y0 >= bounds.y0
            and extent.y1 <= bounds.y1
        ):
            return True
        return bool(_near(self._outline, bounds).size) or self._holds_corner(bounds)

    def cells(self, lattice: Lattice, window: Bounds, margin: int) -> Runs | None:
        """Return the cells that overlap ``window`` and come within ``margin`` counts of the area.

        The result is None if the area covers the window. If the outline is longer than about
        `MAX_BOXES` cells, cells beyond the margin may be included.
        """
        if self.covers(window):
            return None
        whole = Bounds(
            lattice.index_of(window.x0),
            lattice.index_of(window.y0),
            lattice.index_of(window.x1 - 1) + 1,
            lattice.index_of(window.y1 - 1) + 1,
        )
        rows: dict[int, list[tuple[int, int]]] = {}
        # Each box is a rectangle of cells with the edges near it.
        boxes = deque([(whole, self._outline)])
        looked_at = 0
        while boxes:
            box, outline = boxes.popleft()
            looked_at += 1
            bounds = Bounds(*(lattice.first(i) for i in box.to_json()))
            outline = _near(outline, bounds.pad(margin))
            inside = not _near(outline, bounds).size and self._holds_corner(bounds)
            smallest = box.area() == 1 or looked_at > MAX_BOXES
            if inside or (outline.size and smallest):
                for iy in range(box.y0, box.y1):
                    rows.setdefault(iy, []).append((box.x0, box.x1))
            elif outline.size:
                boxes += [(quarter, outline) for quarter in _quarters(box)]
        runs = []
        for iy in sorted(rows):
            for first, end in _joined(sorted(rows[iy])):
                runs.append([iy, first, end])
        return runs

    @cached_property
    def _is_small(self) -> bool:
        bounds = self.bounds
        return max(bounds.x1 - bounds.x0, bounds.y1 - bounds.y0) <= MAX_EDGE

    def _holds_corner(self, bounds: Bounds) -> bool:
        return bool(
            self.inside(np.array([bounds.x0], np.int64), np.array([bounds.y0], np.int64))[0]
        )

    def to_json(self) -> list[list[list[int]]]:
        """Return the rings of each polygon as x, y, x, y, ..., which `from_json` reads."""
        return [[ring.ravel().tolist() for ring in rings] for rings in self.polygons]

    @classmethod
    def from_json(cls, data: Sequence[Sequence[Sequence[int]]]) -> Area:
        """Return the area that `to_json` wrote."""
        polygons = []
        for rings in data:
            polygons.append(tuple(np.array(ring, np.int64).reshape(-1, 2) for ring in rings))
        return cls(tuple(polygons))


class Places:
    """Positions sorted by y, so that each of many areas is compared only with the positions in its range of y."""

    def __init__(self, x: Counts, y: Counts) -> None:
        self._order = np.argsort(y, kind="stable")
        self._x = x[self._order]
        self._y = y[self._order]

    def inside(self, area: Area) -> Indices:
        """Return the indices of the positions inside an area, ascending."""
        bounds = area.bounds
        strip = slice(*np.searchsorted(self._y, (bounds.y0, bounds.y1)).tolist())
        x = self._x[strip]
        near = np.flatnonzero((x >= bounds.x0) & (x < bounds.x1)) + strip.start
        return np.sort(self._order[near[area.inside(self._x[near], self._y[near])]])


def segmentized(ring: Counts) -> Counts:
    """Return a ring with additional points on the edges that are longer than `MAX_EDGE` along an axis.

    The points are rounded to counts.
    """
    if np.ptp(ring, axis=0).max() < MAX_EDGE:
        return ring
    parts = []
    for (x0, y0), (x1, y1) in zip(
        ring.tolist(), np.roll(ring, -1, axis=0).tolist(), strict=True
    ):
        number = max(abs(x1 - x0), abs(y1 - y0)) // MAX_EDGE + 1
        for i in range(number):
            parts.append([x0 + (x1 - x0) * i // number, y0 + (y1 - y0) * i // number])
    return np.array(parts, np.int64)


def in_runs(runs: Runs, ix: Counts, iy: Counts) -> Bool:
    """Return the mask of the cells (ix, iy) that are in ``runs``."""
    if not runs:
        return np.zeros(ix.shape, np.bool_)
    row, first, end = np.array(runs, np.int64).T
    west = min(int(first.min()), int(ix.min(initial=0)))
    wide = max(int(end.max()), int(ix.max(initial=0))) - west + 1
    starts = row * wide + (first - west)
    run = np.searchsorted(starts, iy * wide + (ix - west), side="right") - 1
    is_in_runs: Bool = (run >= 0) & (row[run] == iy) & (ix < end[run])
    return is_in_runs


def _edges(ring: Counts) -> Counts:
    """Return x0, y0, x1, y1 of the edges of a ring, int64 (4, n). The last edge of a closed ring has length 0."""
    following = np.concatenate((ring[1:], ring[:1]))
    return np.concatenate((ring, following), axis=1).T


def _rising(rings: Sequence[Counts]) -> Counts:
    """Return the edges of rings except level ones, from the lower end to the upper end."""
    edges = (
        _edges(rings[0])
        if len(rings) == 1
        else np.concatenate([_edges(ring) for ring in rings], axis=1)
    )
    edges = edges[:, edges[1] != edges[3]]
    return np.where(edges[1] < edges[3], edges, edges[[2, 3, 0, 1]])


def _near(edges: Counts, bounds: Bounds) -> Counts:
    """Return the edges that touch the bounds or their border, or miss them by less than a rounding error."""
    x0, y0, x1, y1 = edges
    hit = (np.minimum(x0, x1) <= bounds.x1) & (np.maximum(x0, x1) >= bounds.x0)
    hit &= (np.minimum(y0, y1) <= bounds.y1) & (np.maximum(y0, y1) >= bounds.y0)
    edges = edges[:, hit]
    x0, y0, x1, y1 = edges.astype(np.float64)
    corners = product((bounds.x0, bounds.x1), (bounds.y0, bounds.y1))
    sides = [(x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) for x, y in corners]
    slack = np.abs(x1 - x0) + np.abs(y1 - y0)
    return edges[:, (np.min(sides, axis=0) <= slack) & (np.max(sides, axis=0) >= -slack)]


def _odd_crossings(edges: Counts, x: Counts, y: Counts) -> Bool:
    """Return the mask of the positions from which a ray to the east crosses an odd number of edges.

    ``y`` must be ascending. An edge includes its lower end but not its upper end. A position on an edge is not west
    of it.
    """
    x0, y0, x1, y1 = edges
    facing = (y0 <= y[-1]) & (y1 > y[0]) & (np.maximum(x0, x1) > x.min())
    beyond = facing & (np.minimum(x0, x1) > x.max())
    # Edges east of all positions are crossed by every ray in their range of y.
    lower = np.sort(y0[beyond])
    upper = np.sort(y1[beyond])
    crossings = np.searchsorted(lower, y, side="right") - np.searchsorted(
        upper, y, side="right"
    )
    odd: Bool = crossings % 2 == 1
    for ax, ay, bx, by in edges[:, facing & ~beyond].T.tolist():
        rows = slice(*np.searchsorted(y, (ay, by)).tolist())
        if ax == bx:
            odd[rows] ^= x[rows] < ax
        else:
            odd[rows] ^= (bx - ax) * (y[rows] - ay) > (x[rows] - ax) * (by - ay)
    return odd


def _odd_crossings_of_rows(edges: Counts, x: Counts, y: Counts) -> Bool:
    """Return `_odd_crossings` for a grid: columns at ascending ``x`` and rows at ``y``, bool (rows, columns)."""
    x0, y0, x1, y1 = edges
    edges = edges[:, (y0 <= y.max()) & (y1 > y.min()) & (np.maximum(x0, x1) > x[0])]
    if not edges.shape[1]:
        return np.zeros((len(y), len(x)), np.bool_)
    order = np.argsort(y, kind="stable")
    first, last = (np.searchsorted(y[order], ends) for ends in (edges[1], edges[3]))
    n_rows = last - first
    ends = np.cumsum(n_rows)
    cuts = np.searchsorted(ends, np.arange(CROSSINGS_AT_ONCE, ends[-1], CROSSINGS_AT_ONCE))
    # By row and by number of columns west of an edge: whether an odd number of edges is there.
    wide = len(x) + 1
    crossed = np.zeros(len(y) * wide, np.uint8)
    for some in np.split(np.arange(edges.shape[1]), cuts):
        n = n_rows[some]
        edge = np.repeat(some, n)
        row = order[np.arange(edge.size) - np.repeat(np.cumsum(n) - n, n) + first[edge]]
        ax, ay, bx, by = edges[:, edge]
        # A column is west of the edge if (bx - ax) * (y - ay) > (x - ax) * (by - ay).
        columns = np.searchsorted(x, ax - (ax - bx) * (y[row] - ay) // (by - ay))
        crossed ^= (np.bincount(row * wide + columns, minlength=crossed.size) & 1).astype(
            np.uint8
        )
    odd = np.bitwise_xor.accumulate(crossed.reshape(-1, wide)[:, :0:-1], axis=1)[:, ::-1]
    return odd.astype(np.bool_)


def _few_crossed_oddly(edges: Counts, x: Counts, y: Counts) -> Bool:
    """Return `_odd_crossings` for a few positions in any order, by comparing every position with every edge."""
    x0, y0, x1, y1 = edges[:, :, np.newaxis]
    crossed = (x1 - x0) * (y - y0) > (x - x0) * (y1 - y0)
    crossed &= (y0 <= y) & (y < y1)
    odd: Bool = np.logical_xor.reduce(crossed, axis=0)
    return odd


def _quarters(box: Bounds) -> list[Bounds]:
    """Return four parts of a rectangle of cells, or fewer if it is one cell wide or high."""
    xs = (box.x0, (box.x0 + box.x1 + 1) // 2, box.x1)
    ys = (box.y0, (box.y0 + box.y1 + 1) // 2, box.y1)
    parts = [
        Bounds(x0, y0, x1, y1) for (y0, y1), (x0, x1) in product(pairwise(ys), pairwise(xs))
    ]
    return [part for part in parts if not part.empty]


def _joined(runs: list[tuple[int, int]]) -> list[list[int]]:
    """Join adjacent runs of a row. The runs are ascending."""
    joined: list[list[int]] = []
    for first, end in runs:
        if joined and joined[-1][1] == first:
            joined[-1][1] = end
        else:
            joined.append([first, end])
    return joined


class AreaIndex:
    """Index of areas by position. Its methods return ascending indices into ``areas``."""

    def __init__(self, areas: Sequence[Area]) -> None:
        import shapely

        self._areas = areas
        edges = np.array([area.bounds.to_json() for area in areas], np.float64).reshape(-1, 4)
        self._tree = shapely.STRtree(shapely.box(*edges.T))

    def overlapping(self, bounds: Bounds) -> list[int]:
        """Return the areas whose bounds overlap ``bounds``."""
        import shapely

        near = np.sort(self._tree.query(shapely.box(*bounds.to_json()))).tolist()
        return [i for i in near if self._areas[i].bounds.overlaps(bounds)]

    def touching(self, bounds: Bounds) -> list[int]:
        """Return the areas that touch ``bounds`` (see `Area.touches`)."""
        return [i for i in self.overlapping(bounds) if self._areas[i].touches(bounds)]

    def by_cell(self, lattice: Lattice, cells: Iterable[Cell]) -> dict[Cell, list[int]]:
        """Return the areas that touch each cell, without the cells that have no areas."""
        import shapely

        cell_bounds = [(cell, lattice.bounds(cell)) for cell in cells]
        edges = np.array([bounds.to_json() for _, bounds in cell_bounds], np.float64).reshape(
            -1, 4
        )
        pairs = self._tree.query(shapely.box(*edges.T))
        areas_by_cell: dict[Cell, list[int]] = defaultdict(list)
        for cell_number, i in pairs[:, np.lexsort(pairs[::-1])].T.tolist():
            cell, bounds = cell_bounds[cell_number]
            area = self._areas[i]
            if area.bounds.overlaps(bounds) and area.touches(bounds):
                areas_by_cell[cell].append(i)
        return dict(areas_by_cell)
