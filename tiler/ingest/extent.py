"""Bounds of a file's points: those of its header, checked against the points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiler.core.units import FARTHEST
from tiler.errors import InputError
from tiler.ingest.patches import Patch, find_patches
from tiler.io.las.columns import returns
from tiler.io.las.headers import LasHeader
from tiler.io.las.octree import Octree
from tiler.io.las.reader import COORDINATES, PointReader, Records, rows_at_once

_PLACES = 16
_SAMPLE = 2048
_SCAN = 1 << 19
_BLOCK_BYTES = 1 << 19
"""Bytes of an object read at once: about what a chunk's coordinates take."""
_WIDEST = 1e6
"""Units of a credible extent: from anywhere within it, int32 counts reach all of it."""

FEW = 10
SHARE = 1000
"""Strays are at most so few, and at most one in so many of their file."""

FAR = 1000.0
"""Units of the CRS across which a point is far from another."""
_TIMES = 4
_LEVELS = 4
"""Of an octree, whose squares tell how its points are spread: 256 of them at most."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Extent:
    """Bounds of a file, checked against its points.

    Attributes
    ----------
    bounds : tuple of 6 float or None
        Lowest x, y, z, highest x, y, z in units of the CRS; None where there are no points.
    claimed : bool
        They are the header's, whole, and a sample of the points lies inside: points outside of them are strays.
    note : str or None
        What people should know.
    patches : tuple of Patch
        How the points are spread over the bounds, estimated.
    returns : int
        Largest number of returns of a pulse in the sample; 0 or 1 for clouds without pulses.
    """

    bounds: tuple[float, ...] | None
    claimed: bool
    note: str | None = None
    patches: tuple[Patch, ...] = ()
    returns: int = 0


def few(number: int, total: int) -> bool:
    """Whether so many of a file's points can be strays."""
    return number <= FEW and number * SHARE <= total


def find_extent(header: LasHeader, octree: Octree | None = None) -> Extent:
    """The bounds of a file.

    The header's where a sample of points fills them, but for a few strays, else those of all points. Where they
    reach so far beyond
    the sample that there must be strays, or emptiness, they end with the sample: a plan made with them
    would be one for an area without points. Of an octree the root is the sample: its points span the whole file.

    Raises
    ------
    InputError
        The points cannot be decoded, or none has finite coordinates.
    """
    if header.point_count == 0:
        return Extent(None, False)
    root = None if octree is None else octree.root(header, rows_at_once(header.record_length, _SCAN))
    with PointReader(header, COORDINATES, _BLOCK_BYTES, [root] if root else None) as reader:
        if root is not None:
            sample = [reader.read(*root)]
        else:
            last = header.point_count - 1
            starts = sorted({_chunk_start(header, last * i // (_PLACES - 1)) for i in range(_PLACES)})
            sample = [reader.read(s, min(_SAMPLE, header.point_count - s)) for s in starts]
        most = max(int(returns(records, header.point_format)[1].max(initial=0)) for records in sample)
        near = _Hull.of(header, sample)
        claim = _Hull(np.array(header.mins), np.array(header.maxs))
        note = None
        credible = bool(np.all(claim.high - claim.low <= _WIDEST))
        claimed = credible and claim.holds(near, header.scales)
        if credible and not claimed and _few_outside(header, sample, claim):
            claimed, near = True, _Hull(np.maximum(near.low, claim.low), np.minimum(near.high, claim.high))
        if not claimed:
            claim = _Hull.of(header, reader.pieces(_SCAN))
            note = "its points lie outside the bounds that its header gives: read from the points"
    if not np.all(np.isfinite(claim.low)):
        raise InputError(
            f"{header.path}: not one of its {header.point_count} points has a finite place; get the file again"
        )
    trimmed = claim.trimmed(near)
    if trimmed is not None:
        claim, claimed = trimmed, False
        note = "a few of its points, or the bounds of its header, lie far from all others: the plan leaves them out"
    low, high = claim.low.tolist(), claim.high.tolist()
    if octree is not None and header.laz is not None:
        patches = _patches_of(octree, header.laz.counts.tolist(), (*low[:2], *high[:2]))
    else:
        patches = find_patches(
            [_plan_view(header, block) for block in sample], header.point_count, (*low[:2], *high[:2])
        )
    return Extent((*low, *high), claimed, note, patches, most)


def _patches_of(octree: Octree, counts: list[int], bounds: Sequence[float]) -> tuple[Patch, ...]:
    """A patch for each square of an octree that holds points, as far as it lies within bounds."""
    found = []
    for key, points in octree.spread(counts, _LEVELS).items():
        x0, y0, x1, y1 = octree.box(key)
        x0, x1 = (min(max(x, bounds[0]), bounds[2]) for x in (x0, x1))
        y0, y1 = (min(max(y, bounds[1]), bounds[3]) for y in (y0, y1))
        found.append(Patch(x0, y0, x1, y1, points))
    return tuple(found)


def _few_outside(header: LasHeader, sample: Iterable[Records], claim: _Hull) -> bool:
    """Whether in x and y no more points of a sample than can be strays lie outside of bounds that the rest fills."""
    places = np.concatenate([_plan_view(header, records) for records in sample], axis=1)
    tolerance = np.asarray(header.scales[:2])
    low, high = claim.low[:2] - tolerance, claim.high[:2] + tolerance
    inside = np.all((places >= low[:, None]) & (places <= high[:, None]), axis=0)
    if not few(int(np.count_nonzero(~inside)), places.shape[1]):
        return False
    return bool(np.all(2 * np.ptp(places[:, inside], axis=1) >= high - low))


def _plan_view(header: LasHeader, records: Records) -> Array:
    """Places of records in units of the CRS, shape (2, n)."""
    with np.errstate(over="ignore", invalid="ignore"):
        axes = [records[n] * header.scales[i] + header.offsets[i] for i, n in enumerate("XY")]
    return np.stack(axes).astype(np.float64)


@dataclass(frozen=True)
class _Hull:
    """Lowest and highest x, y, z, float64, shape (3,) each; infinite where there is no point."""

    low: Array
    high: Array

    @classmethod
    def of(cls, header: LasHeader, blocks: Iterable[Records]) -> _Hull:
        """The hull of some records, without coordinates that are not finite."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for block in blocks:
            for axis, name in enumerate("XYZ"):
                scale, offset = header.scales[axis], header.offsets[axis]
                values = block[name]
                with np.errstate(over="ignore", invalid="ignore"):
                    ends = np.array([int(values.min()), int(values.max())]) * scale + offset
                    if not np.all(np.abs(ends) < FARTHEST):
                        places = values.astype(np.float64) * scale + offset
                        places = places[np.abs(places) < FARTHEST]
                        if places.size == 0:
                            continue
                        ends = np.array([places.min(), places.max()])
                low[axis], high[axis] = min(low[axis], ends[0]), max(high[axis], ends[1])
        return cls(low, high)

    def holds(self, other: _Hull, tolerance: Sequence[float]) -> bool:
        """Whether another one lies inside, but for rounding."""
        inside = np.all(other.low >= self.low - tolerance) and np.all(other.high <= self.high + tolerance)
        return bool(inside)

    def trimmed(self, near: _Hull) -> _Hull | None:
        """The same, ending in x and y where ``near`` does if it reaches far beyond; None if it does not."""
        if not np.all(np.isfinite(near.low)):
            return None
        allowed = FAR + _TIMES * float(max(near.high[:2] - near.low[:2]))
        west, east = self.low < near.low - allowed, self.high > near.high + allowed
        west[2] = east[2] = False
        if not (west.any() or east.any()):
            return None
        return _Hull(np.where(west, near.low, self.low), np.where(east, near.high, self.high))


def _chunk_start(header: LasHeader, point: int) -> int:
    """The first point of the chunk that holds ``point``, from where decoding it costs least."""
    layout = header.laz
    if layout is None:
        return point
    if layout.chunk_size is not None:
        return point // layout.chunk_size * layout.chunk_size
    ends = np.cumsum(layout.counts)
    chunk = int(np.searchsorted(ends, point, side="right"))
    return int(ends[chunk] - layout.counts[chunk])
