"""Breaklines: lines of known height, divided into pieces short enough to become edges of the TIN.

A piece of a line is an edge of the Delaunay triangulation if no other vertex lies in the circle
that has the piece as its diameter. No ground point lies in this circle, since no piece is
longer than a pixel and ground points within half a pixel of a line are left out. No other line
lies in it, since pieces are shorter where lines come near each other. The pieces depend only on
the lines and the pixel, so blocks, tiles and the order of the lines do not change the result. A
triangulation with constrained edges would not be Delaunay: it would not be unique, and a block
could not certify it.

Also lines and rings of drawn and detected features in run.json, for the map of the report.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import chain, product
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.arrays import AnyArray, Bool, Float64, Int32, Int64
from tiler.core.area import Area
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds, Cell, Lattice
from tiler.core.records import digest_of_arrays, digest_of_bytes
from tiler.core.results import Rings

Counts = Int64

MIN_LENGTH_M = Fraction(1, 50)
"""Length in metres below which a piece is not divided, even where lines meet at sharp angles or
overlap."""

MAX_SEGMENT = 1 << 32
"""Longest segment between two vertices, in counts along an axis, that can be divided within
int64."""

ALIKE = 10
"""Largest difference of height at which two lines that meet count as equally high, in
counts."""


_NO_PIECES = np.empty((0, 6), np.int64)


@dataclass(frozen=True, eq=False)
class Breaklines:
    """Breaklines, divided into pieces.

    Attributes
    ----------
    pieces : int64 (n, 6)
        x, y, z of both ends in absolute counts, sorted, each piece once.
    pixel : Fraction
        Side of a pixel in counts, which is the maximum length of a piece.
    """

    pieces: Counts
    pixel: Fraction

    @classmethod
    def of(
        cls, lines: Iterable[Counts], pixel: Fraction, shortest: Fraction, data: Bounds
    ) -> Breaklines:
        """Divide lines into pieces.

        Parameters
        ----------
        lines : iterable of int64 (n, 3)
            Vertices x, y, z in absolute counts.
        pixel, shortest : Fraction
            Maximum length of a piece, and the length below which a piece is not divided, in counts.
        data : Bounds
            Bounds of all points of the run. Pieces more than three pixels outside are left out.
        """
        segments = np.unique(np.concatenate([_NO_PIECES, *map(_segments, lines)]), axis=0)
        return cls(
            _divided(segments, float(pixel), float(shortest), data.pad(int(3 * pixel))), pixel
        )

    @cached_property
    def vertices(self) -> Counts:
        """Ends of the pieces, int64 (n, 3), sorted, each once."""
        return np.unique(self.pieces.reshape(-1, 3), axis=0)

    @cached_property
    def key(self) -> str:
        """Digest of the pieces and the pixel."""
        return digest_of_bytes(self.pieces.tobytes(), str(self.pixel).encode())

    def digests(self, lattice: Lattice) -> dict[Cell, str]:
        """Return the digest of the pieces that begin in each cell of a lattice."""
        ix = lattice.index(self.pieces[:, 0])
        iy = lattice.index(self.pieces[:, 1])
        order = np.lexsort((ix, iy))
        ends = np.flatnonzero(np.diff(ix[order]) | np.diff(iy[order])) + 1
        digest_by_cell = {}
        for rows in np.split(order, ends):
            if len(rows):
                cell = Cell(int(ix[rows[0]]), int(iy[rows[0]]))
                digest_by_cell[cell] = digest_of_arrays(self.pieces[rows])
        return digest_by_cell

    def applied(
        self, xyz: Int32, window: Bounds, data: Bounds, origin: tuple[int, int]
    ) -> Int32:
        """Return the points for the TIN of a window: vertices of lines, and ground points not too near to a line.

        Parameters
        ----------
        xyz : int32 (3, n)
            Ground points, local counts.
        window : Bounds
            Bounds of the window. Vertices outside are left out.
        data : Bounds
            Bounds of all points of the run. Vertices outside are left out.
        origin : tuple of int
            Absolute counts of the local count 0.
        """
        near = self._within(window.pad(int(2 * self.pixel) + 1))
        if not len(near):
            return xyz
        offset = np.array([*origin, 0], np.int64)
        kept = xyz[:, ~self._beside(xyz[:2].T + offset[:2], near)]
        vertices = np.unique(near.reshape(-1, 3), axis=0)
        inside = window.intersection(data)
        x, y = vertices[:, 0], vertices[:, 1]
        chosen = (x >= inside.x0) & (x < inside.x1) & (y >= inside.y0) & (y < inside.y1)
        local = (vertices[chosen] - offset).astype(np.int32)
        return np.concatenate((kept, local.T), axis=1)

    def _within(self, bounds: Bounds) -> Counts:
        """Return the pieces that begin in ``bounds``."""
        first, last = np.searchsorted(self.pieces[:, 0], (bounds.x0, bounds.x1))
        pieces = self.pieces[first:last]
        return pieces[(pieces[:, 1] >= bounds.y0) & (pieces[:, 1] < bounds.y1)]

    def _beside(self, xy: Counts, pieces: Counts) -> Bool:
        """Return the mask of the positions, int64 (n, 2), that are within half a pixel of a piece."""
        import shapely

        is_beside = np.zeros(len(xy), np.bool_)
        # Only positions in pixels next to the end of a piece can be this near.
        lattice = Lattice(self.pixel)
        ends = lattice.index(pieces.reshape(-1, 3)[:, :2])
        west, south = ends.min(axis=0) - 1
        wide = int(ends[:, 0].max()) - int(west) + 2
        keys = np.unique((ends[:, 1] - south) * wide + ends[:, 0] - west)
        steps = [down * wide + right for down, right in product((-1, 0, 1), repeat=2)]
        around = np.unique(np.concatenate([keys + step for step in steps]))
        cells = lattice.index(xy) - (west, south)
        possible = (cells[:, 0] >= 0) & (cells[:, 0] < wide)
        rows = np.flatnonzero(possible & np.isin(cells[:, 1] * wide + cells[:, 0], around))
        # The distance depends only on one position and one piece, and their counts are exact in
        # float64.
        tree = shapely.STRtree(_as_lines(pieces))
        hits = tree.query(
            shapely.points(xy[rows]), predicate="dwithin", distance=float(self.pixel / 2)
        )
        is_beside[rows[hits[0]]] = True
        return is_beside

    def to_json(self) -> dict[str, str]:
        """Return a JSON-able description, which `from_json` reads."""
        packed = zlib.compress(np.diff(self.pieces, axis=0, prepend=0).astype("<i8").tobytes())
        return {"pixel": str(self.pixel), "pieces": base64.b85encode(packed).decode("ascii")}

    @classmethod
    def from_json(cls, data: dict[str, str]) -> Breaklines:
        """Return the lines that `to_json` described."""
        steps = np.frombuffer(zlib.decompress(base64.b85decode(data["pieces"])), "<i8").reshape(
            -1, 6
        )
        return cls(np.cumsum(steps, axis=0).astype(np.int64), Fraction(data["pixel"]))


def two_heights(lines: Iterable[Counts]) -> Counts:
    """Return the positions where lines meet or cross at heights that differ by more than `ALIKE`.

    Returns
    -------
    int64 (n, 4)
        x, y and both z, in absolute counts.
    """
    import shapely

    segments = np.unique(np.concatenate([_NO_PIECES, *map(_segments, lines)]), axis=0)
    shapes = _as_lines(segments)
    one, other = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    one, other = one[one < other], other[one < other]
    common = shapely.intersection(shapes[one], shapes[other])
    positions = shapely.get_coordinates(shapely.point_on_surface(common))
    z_one = _heights_at(segments[one], positions)
    z_other = _heights_at(segments[other], positions)
    crossings = np.rint(np.column_stack((positions, z_one, z_other))).astype(np.int64)
    return np.unique(crossings[np.abs(z_one - z_other) > ALIKE], axis=0)


def _heights_at(segments: Counts, places: Float64) -> Float64:
    """Return the height of each segment at a position on it."""
    way = segments[:, 3:] - segments[:, :3]
    along = ((places - segments[:, :2]) * way[:, :2]).sum(axis=1) / (way[:, :2] ** 2).sum(
        axis=1
    )
    heights: Float64 = segments[:, 2] + along * way[:, 2]
    return heights


def _segments(line: Counts) -> Counts:
    """Return the straight parts of a line, int64 (n, 6), without vertical ones. The smaller end by (x, y) is first."""
    segments = np.concatenate((line[:-1], line[1:]), axis=1)
    x0, y0, _, x1, y1, _ = segments.T
    backwards = (x0 > x1) | ((x0 == x1) & (y0 > y1))
    segments = np.where(backwards[:, None], segments[:, [3, 4, 5, 0, 1, 2]], segments)
    kept: Counts = segments[(x0 != x1) | (y0 != y1)]
    return kept


def _divided(segments: Counts, longest: float, shortest: float, wanted: Bounds) -> Counts:
    """Halve segments until no other segment enters the circle around a piece.

    Only pieces that touch ``wanted`` are kept. They are returned sorted.
    """
    import shapely

    done = [_NO_PIECES]
    tree = shapely.STRtree(_as_lines(segments))
    parents = np.arange(len(segments))
    number = np.zeros(len(segments), np.int64)
    parts = 1
    while len(parents):
        pieces = _part(segments[parents], number, parts)
        inside = _touching(pieces, wanted)
        pieces, parents, number = pieces[inside], parents[inside], number[inside]
        length = np.hypot(pieces[:, 3] - pieces[:, 0], pieces[:, 4] - pieces[:, 1])
        long = length > longest
        rows = np.flatnonzero(~long & (length > shortest))
        middles = shapely.points((pieces[rows, 0:2] + pieces[rows, 3:5]) / 2)
        near, other = tree.query(
            middles, predicate="dwithin", distance=np.maximum(length[rows] / 2 - 1, 0)
        )
        long[rows[near[other != parents[rows[near]]]]] = True
        done.append(pieces[~long])
        parents, number = np.repeat(parents[long], 2), np.repeat(2 * number[long], 2)
        number[1::2] += 1
        parts *= 2
    pieces = np.unique(np.concatenate(done), axis=0)
    kept: Counts = pieces[(pieces[:, 0] != pieces[:, 3]) | (pieces[:, 1] != pieces[:, 4])]
    return kept


def _touching(pieces: Counts, bounds: Bounds) -> Bool:
    """Return the mask of the pieces whose bounds touch ``bounds``."""
    x = pieces[:, [0, 3]]
    y = pieces[:, [1, 4]]
    is_touching: Bool = (x.max(axis=1) >= bounds.x0) & (x.min(axis=1) < bounds.x1)
    is_touching &= (y.max(axis=1) >= bounds.y0) & (y.min(axis=1) < bounds.y1)
    return is_touching


def _part(segments: Counts, number: Counts, parts: int) -> Counts:
    """Return part ``number`` of the ``parts`` equal parts of each segment, with ends rounded to counts."""
    start = segments[:, :3]
    way = segments[:, 3:] - start
    ends = [
        start + (2 * way * (number + more)[:, None] + parts) // (2 * parts) for more in (0, 1)
    ]
    return np.concatenate(ends, axis=1)


def _as_lines(pieces: Counts) -> npt.NDArray[np.object_]:
    import shapely

    ends = pieces.reshape(-1, 2, 3)[:, :, :2].astype(np.float64)
    lines: npt.NDArray[np.object_] = shapely.linestrings(ends)
    return lines


MAX_PLACES = 20_000
"""Maximum number of vertices of all edits, all breaklines or all water on a page."""

MAX_VERTICES = 8_000
"""Maximum number of vertices of the outline on the map of the report."""


def drawn(lines: Sequence[Counts]) -> Rings:
    """Return lines as x, y, x, y, ... in units of the CRS, or no lines if they have too many vertices for a page."""
    if sum(map(len, lines)) > MAX_PLACES:
        return []
    return [(line[:, :2] / COUNTS_PER_UNIT).ravel().tolist() for line in lines]


def rings_of_areas(areas: Sequence[Area]) -> list[Rings | None]:
    """Return the closed rings of each area, or None for all areas if the rings have too many vertices for a page."""
    rings_by_area = [list(chain.from_iterable(area.polygons)) for area in areas]
    if sum(map(len, chain.from_iterable(rings_by_area))) > MAX_PLACES:
        return [None] * len(areas)
    return [drawn([np.vstack((ring, ring[:1])) for ring in rings]) for rings in rings_by_area]


def area_within(rings: Sequence[Sequence[float]]) -> Any:
    """Return the shapely area within closed rings, each x, y, x, y, ... A ring inside another one is a hole."""
    import shapely

    lines = [np.reshape(ring, (-1, 2)) for ring in rings]
    return shapely.build_area(shapely.MultiLineString(lines))


def rings_of(parts: AnyArray, size: float) -> Rings:
    """Return rings of polygons, simplified with the tolerance ``size``, which doubles until the vertices are few."""
    import shapely

    while True:
        simple = shapely.simplify(parts, size)
        simple = simple[~shapely.is_empty(simple)]
        if (
            shapely.get_num_coordinates(simple).sum() <= MAX_VERTICES
            or len(simple) > MAX_VERTICES / 4
        ):
            break
        size *= 2
    rings = shapely.get_rings(simple)[: MAX_VERTICES // 4]
    return [np.round(shapely.get_coordinates(ring), 3).ravel().tolist() for ring in rings]
