"""What a worker needs: bytes by stage and by window, all of them from numbers of points.

The factors were measured: peak resident memory of workers over the points of their windows (docs/decisions.md,
"The plan").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from ptd.passes import Pass

FINE_CELL_M = Fraction(1, 2)
"""Side of the store's cells, each with one candidate, where the method has none of its own (`fine_cell_m`)."""
BASE_BYTES = 260 << 20
"""A worker before the first point: the interpreter and the libraries."""
READ_BYTES = 60
"""Per candidate that a window reads: columns and sorting."""
VERTEX_BYTES = 200
"""Per candidate that may become a vertex: its columns while it is tested, and its share of the TIN. Per cell of a
raster: 35 to look for large objects, 180 to make the surface (measured)."""
BUCKET_POINT_BYTES = 200
"""Per point while its bucket is labelled."""
HELD_BYTES, HELD_SHARE = 64 << 20, 16
"""Of decoded buckets that are kept for the labels of their neighbours, and at most this part of the memory."""
ASSEMBLY_POINT_BYTES = 800
"""Per point while its bucket is assembled: fragments, keys and their order."""
SPOOL_POINT_BYTES = 160
"""Per point while its piece is decoded and sorted."""
GROUND_BYTES = 200
"""Per ground point in a block's window: coordinates and the TIN (123 measured on a city)."""
PIECE_BYTES, NEAR_PIECE_BYTES = 160, 650
"""Per piece of a breakline, of all in the run and of those in a block's window: 460 measured while they are looked up,
and a vertex of the TIN."""
JOINED_BYTES = 1 << 30
"""A worker at most, with a tile of a pass on candidates: 1.4 km of dense laser scans and 229 m around them. Larger ones
save nothing (213 M points: 413 CPU s in 18 tiles a pass, 415 in 12), and more of them share out more equally."""
TIN_BYTES = 3 << 29
"""Of the points of a TIN that blocks of the terrain share, at most."""
EXPORT_BYTES = 128 << 20
"""A worker that writes a file: GDAL's blocks, or the records of a classified cloud in hand."""
EXPORT_POINTS = 1 << 27
"""Points of the largest classified cloud: its labels are held at once, a byte each."""


@dataclass(frozen=True)
class PlannedPass:
    """A pass of the method, and the halo that its tiles begin with."""

    work: Pass
    halo_m: float

    @property
    def name(self) -> str:
        """Of the pass."""
        return self.work.name

    @property
    def title(self) -> str:
        """What it does, in a few words."""
        return self.work.title or self.work.name

    @property
    def kind(self) -> str | None:
        """What made the clouds that it is for; None: for all."""
        return self.work.kind

    @property
    def sometimes(self) -> bool:
        """It does not always apply."""
        return type(self.work).applies is not Pass.applies

    @property
    def on_candidates(self) -> bool:
        """It looks at one candidate a cell, not at all points or elected ones, and makes no raster of its window."""
        return not (self.work.every_point or self.work.elected or self.work.raster_cell_m)


def breakline_bytes(lines: Sequence[npt.NDArray[np.int64]], pixel: float, window: float) -> int:
    """Of breaklines that are divided into pieces of half a pixel or more, in the fullest window.

    Parameters
    ----------
    lines : sequence of int64 (n, 3)
        Vertices in counts.
    pixel, window : float
        Counts: side of a pixel, and of the window of a block.
    """
    if not lines:
        return 0
    ends = [(line[:-1, :2], line[1:, :2]) for line in lines]
    start, stop = (np.concatenate(part).astype(np.float64) for part in zip(*ends, strict=True))
    pieces = np.maximum(2 * np.hypot(*(stop - start).T) / pixel, 1)
    # A window touches no more than two by two squares of its side.
    squares, which = np.unique(np.floor((start + stop) / 2 / window), axis=0, return_inverse=True)
    held = dict(zip(map(tuple, squares.tolist()), np.bincount(which.ravel(), pieces), strict=True))
    most = max(
        sum(held.get((x + right, y + up), 0.0) for right in (0, 1) for up in (0, 1))
        for x0, y0 in held
        for x, y in ((x0, y0), (x0 - 1, y0), (x0, y0 - 1), (x0 - 1, y0 - 1))
    )
    return int(PIECE_BYTES * pieces.sum() + NEAR_PIECE_BYTES * most)


def fine_cell_m(cell_m: float, bucket_m: Fraction) -> Fraction:
    """Side of the cells with one candidate each: the method's own (0: it has none), if buckets are made of them."""
    own = Fraction(repr(float(cell_m)))
    return own if own > 0 and (bucket_m / own).denominator == 1 else FINE_CELL_M


def nested(cell_m: float, fine_m: Fraction) -> bool:
    """Whether a method's cells of ``cell_m`` are made of whole fine cells, so that candidates are all it reads."""
    return cell_m > 0 and (Fraction(repr(float(cell_m))) / fine_m).denominator == 1


def filter_bytes(points: float, area_m2: float, cell_m: float, step: PlannedPass, fine_m: Fraction) -> float:
    """Bytes, above `BASE_BYTES`, that a window of a pass needs.

    Elected points are reckoned as one in each thinning cell at most: how many there are is known later. A raster has
    all cells of the window, whatever it holds.

    Parameters
    ----------
    points : float
        Of the window, candidates or not.
    area_m2 : float
        Of the window.
    cell_m : float
        Of the method's thinning cell (`candidate_cell_m`); 0: it has none.
    step : PlannedPass
    fine_m : Fraction
        Side of the store's cells.
    """
    vertices = min(points, area_m2 / cell_m**2) if cell_m > 0 else points
    read = points
    if step.work.elected:
        read = vertices
    elif not step.work.every_point and nested(cell_m, fine_m):
        read = min(points, area_m2 / float(fine_m) ** 2)
    if step.work.raster_cell_m:
        vertices = area_m2 / step.work.raster_cell_m**2
    return read * READ_BYTES + vertices * VERTEX_BYTES


def held_bytes(memory: int) -> int:
    """Bytes of decoded buckets that a worker keeps for their neighbours, of the memory that it may use."""
    return min(HELD_BYTES, max(memory - BASE_BYTES, 0) // HELD_SHARE)


def bucket_bytes(points: float) -> int:
    """Bytes of a worker that labels a bucket, above those of its window."""
    return int(points * BUCKET_POINT_BYTES)


def ingest_bytes(piece_points: int, bucket_points: float) -> int:
    """Peak bytes of a worker that decodes pieces and assembles buckets."""
    return int(BASE_BYTES + max(piece_points * SPOOL_POINT_BYTES, bucket_points * ASSEMBLY_POINT_BYTES))
