"""Breaklines: lines of known height that the surface follows, as vertices so close that they become edges of its TIN.

A piece of a line is an edge of the Delaunay triangulation if no other vertex lies within the circle around it. Ground
points nearer to a line than half a pixel are left out, and no piece is longer than a pixel: so no ground point lies
there. Where other lines come near, pieces are as much shorter. All of that follows from the lines and the pixel alone,
so blocks, tiles and the order of the lines do not show. The alternative, a triangulation with constrained edges, would
be no longer Delaunay, and so neither unique nor of a reach that a block can certify.
"""

from __future__ import annotations

import base64
import hashlib
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import numpy.typing as npt

from tiler.core.lattice import Bounds, Cell, Lattice

Counts = npt.NDArray[np.int64]

SHORTEST_M = Fraction(1, 50)
"""Length below which a piece is not divided any more: where lines meet at sharp angles, or lie on one another."""


LONGEST_SEGMENT = 1 << 32
"""Counts along an axis between two vertices with which a segment is divided within int64."""
ALIKE = 10
"""Counts by which heights of lines that meet may differ."""


@dataclass(frozen=True, eq=False)
class Breaklines:
    """Pieces of lines.

    Attributes
    ----------
    pieces : int64 (n, 6)
        x, y, z of both ends in absolute counts, sorted, each once.
    pixel : Fraction
        Counts of a pixel's side, at most the length of a piece.
    """

    pieces: Counts
    pixel: Fraction

    @classmethod
    def of(cls, lines: Iterable[Counts], pixel: Fraction, shortest: Fraction, data: Bounds) -> Breaklines:
        """Divide lines.

        Parameters
        ----------
        lines : iterable of int64 (n, 3)
            Vertices x, y, z in absolute counts.
        pixel, shortest : Fraction
            Counts: the longest piece, and the length below which none is divided any more.
        data : Bounds
            Of all points of the run; what is farther from them than pieces are long is left out.
        """
        found = [_segments(line) for line in lines]
        segments = np.unique(np.concatenate([np.empty((0, 6), np.int64), *found]), axis=0)
        return cls(_divided(segments, float(pixel), float(shortest), data.pad(int(3 * pixel))), pixel)

    @cached_property
    def vertices(self) -> Counts:
        """Ends of the pieces, int64 (n, 3), sorted, each once."""
        return np.unique(self.pieces.reshape(-1, 3), axis=0)

    @cached_property
    def key(self) -> str:
        """A digest of the pieces and the pixel."""
        return hashlib.blake2b(self.pieces.tobytes() + str(self.pixel).encode(), digest_size=16).hexdigest()

    def digests(self, lattice: Lattice) -> dict[Cell, str]:
        """Digest of the pieces that begin in each cell of a lattice."""
        ix, iy = lattice.index(self.pieces[:, 0]), lattice.index(self.pieces[:, 1])
        order = np.lexsort((ix, iy))
        ends = np.flatnonzero(np.diff(ix[order]) | np.diff(iy[order])) + 1
        return {
            Cell(int(ix[rows[0]]), int(iy[rows[0]])): hashlib.blake2b(
                np.ascontiguousarray(self.pieces[rows]).tobytes(), digest_size=16
            ).hexdigest()
            for rows in np.split(order, ends)
            if len(rows)
        }

    def applied(
        self, xyz: npt.NDArray[np.int32], window: Bounds, data: Bounds, origin: tuple[int, int]
    ) -> npt.NDArray[np.int32]:
        """The points of a window that make its TIN: ground that is not too near to a line, and the lines.

        Parameters
        ----------
        xyz : int32 (3, n)
            Ground points, local counts.
        window : Bounds
        data : Bounds
            Of all points of the run, beyond which lines have no influence.
        origin : tuple of int
            Absolute counts of the local 0.
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
        """Pieces that begin in some bounds."""
        first, last = np.searchsorted(self.pieces[:, 0], (bounds.x0, bounds.x1))
        found = self.pieces[first:last]
        return found[(found[:, 1] >= bounds.y0) & (found[:, 1] < bounds.y1)]

    def _beside(self, xy: Counts, pieces: Counts) -> npt.NDArray[np.bool_]:
        """Which places, int64 (n, 2), are within half a pixel of some pieces."""
        found = np.zeros(len(xy), np.bool_)
        lattice = Lattice(self.pixel)
        ends = lattice.index(pieces.reshape(-1, 3)[:, :2])
        west, south = ends.min(axis=0) - 1
        wide = int(ends[:, 0].max()) - int(west) + 2
        keys = np.unique((ends[:, 1] - south) * wide + ends[:, 0] - west)
        around = np.unique(
            np.concatenate([keys + down * wide + right for down in (-1, 0, 1) for right in (-1, 0, 1)])
        )
        cells = lattice.index(xy) - (west, south)
        possible = (cells[:, 0] >= 0) & (cells[:, 0] < wide)
        rows = np.flatnonzero(possible & np.isin(cells[:, 1] * wide + cells[:, 0], around))
        import shapely

        # Counts are whole numbers that float64 holds, and a distance follows from one place and one piece alone.
        tree = shapely.STRtree(_as_lines(pieces))
        hits = tree.query(shapely.points(xy[rows]), predicate="dwithin", distance=float(self.pixel / 2))
        found[rows[hits[0]]] = True
        return found

    def to_json(self) -> dict[str, str]:
        """A JSON-able description; `from_json` reads it back."""
        packed = zlib.compress(np.diff(self.pieces, axis=0, prepend=0).astype("<i8").tobytes())
        return {"pixel": str(self.pixel), "pieces": base64.b85encode(packed).decode("ascii")}

    @classmethod
    def from_json(cls, data: dict[str, str]) -> Breaklines:
        """The lines that `to_json` described."""
        steps = np.frombuffer(zlib.decompress(base64.b85decode(data["pieces"])), "<i8").reshape(-1, 6)
        return cls(np.cumsum(steps, axis=0).astype(np.int64), Fraction(data["pixel"]))


def two_heights(lines: Iterable[Counts]) -> Counts:
    """Places where lines meet or cross at heights that differ by more than `ALIKE`: int64 (n, 4), x, y and both z."""
    import shapely

    segments = np.unique(
        np.concatenate([np.empty((0, 6), np.int64), *(_segments(line) for line in lines)]), axis=0
    )
    shapes = _as_lines(segments)
    one, other = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    one, other = one[one < other], other[one < other]
    places = shapely.get_coordinates(
        shapely.point_on_surface(shapely.intersection(shapes[one], shapes[other]))
    )
    z = [_heights_at(segments[rows], places) for rows in (one, other)]
    found = np.rint(np.column_stack((places, *z))).astype(np.int64)
    return np.unique(found[np.abs(z[0] - z[1]) > ALIKE], axis=0)


def _heights_at(segments: Counts, places: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Heights of segments at places on them."""
    way = segments[:, 3:] - segments[:, :3]
    along = ((places - segments[:, :2]) * way[:, :2]).sum(axis=1) / (way[:, :2] ** 2).sum(axis=1)
    heights: npt.NDArray[np.float64] = segments[:, 2] + along * way[:, 2]
    return heights


def _segments(line: Counts) -> Counts:
    """Straight parts of a line, int64 (n, 6), from the lower end in (x, y) on; upright ones are left out."""
    found = np.concatenate((line[:-1], line[1:]), axis=1)
    x0, y0, _, x1, y1, _ = found.T
    found = np.where(((x0 > x1) | ((x0 == x1) & (y0 > y1)))[:, None], found[:, [3, 4, 5, 0, 1, 2]], found)
    kept: Counts = found[(x0 != x1) | (y0 != y1)]
    return kept


def _divided(segments: Counts, longest: float, shortest: float, wanted: Bounds) -> Counts:
    """Segments halved until no other one comes into the circle around a piece, sorted; those in some bounds."""
    import shapely

    done = [np.empty((0, 6), np.int64)]
    tree = shapely.STRtree(_as_lines(segments))
    parents, number, parts = (np.arange(len(segments)), np.zeros(len(segments), np.int64), 1)
    while len(parents):
        pieces = _part(segments[parents], number, parts)
        inside = _touching(pieces, wanted)
        pieces, parents, number = pieces[inside], parents[inside], number[inside]
        length = np.hypot(pieces[:, 3] - pieces[:, 0], pieces[:, 4] - pieces[:, 1])
        long = length > longest
        rows = np.flatnonzero(~long & (length > shortest))
        middles = shapely.points((pieces[rows, 0:2] + pieces[rows, 3:5]) / 2)
        near, other = tree.query(middles, predicate="dwithin", distance=np.maximum(length[rows] / 2 - 1, 0))
        long[rows[near[other != parents[rows[near]]]]] = True
        done.append(pieces[~long])
        parents, number = np.repeat(parents[long], 2), np.repeat(2 * number[long], 2)
        number[1::2] += 1
        parts *= 2
    pieces = np.unique(np.concatenate(done), axis=0)
    kept: Counts = pieces[(pieces[:, 0] != pieces[:, 3]) | (pieces[:, 1] != pieces[:, 4])]
    return kept


def _touching(pieces: Counts, bounds: Bounds) -> npt.NDArray[np.bool_]:
    """Pieces whose own bounds touch some others."""
    x, y = pieces[:, [0, 3]], pieces[:, [1, 4]]
    found: npt.NDArray[np.bool_] = (x.max(axis=1) >= bounds.x0) & (x.min(axis=1) < bounds.x1)
    found &= (y.max(axis=1) >= bounds.y0) & (y.min(axis=1) < bounds.y1)
    return found


def _part(segments: Counts, number: Counts, parts: int) -> Counts:
    """One of ``parts`` equal parts of each segment, its ends rounded to counts."""
    start, way = segments[:, :3], segments[:, 3:] - segments[:, :3]
    ends = [start + (2 * way * (number + more)[:, None] + parts) // (2 * parts) for more in (0, 1)]
    return np.concatenate(ends, axis=1)


def _as_lines(pieces: Counts) -> npt.NDArray[np.object_]:
    import shapely

    ends = pieces.reshape(-1, 2, 3)[:, :, :2].astype(np.float64)
    lines: npt.NDArray[np.object_] = shapely.linestrings(ends)
    return lines
