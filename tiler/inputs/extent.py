"""Extent of a file: bounds from the header, checked against a sample of points, and patches of estimated density.

The mean density over a file's bounds is wrong if flight strips run diagonally, or cross. A run of successive points
gives the density at its position or, if the order of the file is random, the density of the whole file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ptd.arrays import Float64
from ptd.matched.evidence import Evidence
from tiler.core.dates import are_gps_times
from tiler.core.units import FARTHEST
from tiler.errors import InputError
from tiler.io.las.headers import LasHeader
from tiler.io.las.octree import Octree
from tiler.io.las.point_formats import as_standard_times, evidence, returns
from tiler.io.las.reader import EVERYTHING, PointReader, Records, rows_at_once

_PLACES = 32
"""Maximum number of positions in the file at which a sample is read. A small file with one
chunk has one position."""
_SAMPLE = 1024
"""Number of points read at each position."""
_LEAST = 8192
"""Minimum number of points in the whole sample, if the file has as many."""
_SCAN = 1 << 19
"""Number of points read at a time if all are read."""
_BLOCK_BYTES = 1 << 19
"""Bytes of an object that are read at a time, about the size of a chunk's coordinates."""
_WIDEST = 1e6
"""Longest credible extent in units of the CRS. Within it, the distance of any two positions
fits int32 counts."""

FEW = 10
"""Maximum number of strays of a group."""
SHARE = 1000
"""Minimum ratio of all points to the strays of a group."""

FAR = 1000.0
"""Distance in units of the CRS above which points count as far apart."""
_TIMES = 4
"""The bounds may extend beyond the sample by `FAR` plus this multiple of its width."""
_LEVELS = 4
"""Deepest level of an octree whose squares become patches. It has at most 256 squares."""


@dataclass(frozen=True)
class Extent:
    """Bounds of a file, checked against its points.

    Attributes
    ----------
    bounds : tuple of 6 float or None
        Lowest x, y, z, highest x, y, z in units of the CRS; None without points.
    claimed : bool
        Whether these are the bounds of the header and contain a sample of the points, apart from a few strays. Points
        outside are strays if they are few.
    note : str or None
        Note for the user.
    patches : tuple of DensityPatch
        Estimate of the distribution of the points over the bounds.
    returns : int
        Largest number of returns of a pulse in the sample; 0 or 1 for clouds without pulses.
    evidence : Evidence
        Evidence on the source of the cloud, found in the fields of the sample.
    times : tuple of 2 float, or None
        First and last adjusted standard GPS time in the sample without the first and last percent of its valid times,
        or None if it has none.
    """

    bounds: tuple[float, ...] | None
    claimed: bool
    note: str | None = None
    patches: tuple[DensityPatch, ...] = ()
    returns: int = 0
    evidence: Evidence = field(default_factory=Evidence)
    times: tuple[float, float] | None = None


def can_be_strays(number: int, total: int) -> bool:
    """Return whether ``number`` of the ``total`` points of a survey or a file are few enough to be strays."""
    return number <= FEW and number * SHARE <= total


def find_extent(header: LasHeader, octree: Octree | None = None) -> Extent:
    """Find the bounds of a file from its header and a sample of its points.

    The bounds of the header are used if they are credible and contain the sample. A few strays
    may lie outside if the rest of the sample fills the bounds. Otherwise all points are read.
    Bounds that extend very far beyond the sample are cut to it, since they contain strays or an
    empty area that the plan must not count. The sample of an octree is its root, whose points
    span the whole file.

    Raises
    ------
    InputError
        The points cannot be decoded, or no point has finite coordinates.
    """
    if header.point_count == 0:
        return Extent(None, False)
    root = (
        None
        if octree is None
        else octree.root(header, rows_at_once(header.record_length, _SCAN))
    )
    with PointReader(header, EVERYTHING, _BLOCK_BYTES, [root] if root else None) as reader:
        if root is not None:
            sample = [reader.read(*root)]
        else:
            last = header.point_count - 1
            starts = sorted(
                {_chunk_start(header, last * i // (_PLACES - 1)) for i in range(_PLACES)}
            )
            length = max(_SAMPLE, _LEAST // len(starts))
            sample = [reader.read(s, min(length, header.point_count - s)) for s in starts]
        most = max(
            int(returns(records, header.point_format)[1].max(initial=0)) for records in sample
        )
        together = np.concatenate(sample)
        told = evidence(together, header.point_format)
        near = _BoundingBox.around(header, sample)
        claim = _BoundingBox(np.array(header.mins), np.array(header.maxs))
        note = None
        credible = bool(np.all(claim.high - claim.low <= _WIDEST))
        claimed = credible and claim.holds(near, header.scales)
        if credible and not claimed and _few_outside(header, sample, claim):
            claimed = True
            near = _BoundingBox(
                np.maximum(near.low, claim.low), np.minimum(near.high, claim.high)
            )
        if not claimed:
            claim = _BoundingBox.around(header, reader.pieces(_SCAN))
            if header.has_bounds:
                note = "its points lie outside the bounds that its header gives: read from the points"
    if not np.all(np.isfinite(claim.low)):
        raise InputError(
            f"{header.path}: none of its {header.point_count} points has finite coordinates; get the file again"
        )
    trimmed = claim.trimmed(near)
    if trimmed is not None:
        claim, claimed = trimmed, False
        note = "a few of its points, or the bounds of its header, lie far from all others: the plan leaves them out"
    low, high = claim.low.tolist(), claim.high.tolist()
    runs = [_plan_view(header, block) for block in sample]
    if octree is not None and header.laz is not None:
        everywhere = np.concatenate(runs, axis=1)
        patches = _patches_of(
            octree, header.laz.counts.tolist(), everywhere, (*low[:2], *high[:2])
        )
    else:
        patches = find_patches(runs, header.point_count, (*low[:2], *high[:2]))
    times = _times_of(header, together)
    return Extent((*low, *high), claimed, note, patches, most, told, times)


def _times_of(header: LasHeader, records: Records) -> tuple[float, float] | None:
    """Return the first and last valid adjusted standard GPS time of records, without the first and last percent."""
    if not header.has_standard_times:
        return None
    times = as_standard_times(records, header)["gps_time"]
    times = np.sort(times[are_gps_times(times)])
    n_left_out = times.size // 100
    return (float(times[n_left_out]), float(times[-1 - n_left_out])) if times.size else None


def _patches_of(
    octree: Octree, counts: list[int], sample: Float64, bounds: Sequence[float]
) -> tuple[DensityPatch, ...]:
    """Return a patch for each square of an octree with points, clipped to the bounds."""
    patches = []
    level = max(
        *(key[0] for key in octree.keys),
        math.isqrt(sample.shape[1] // _IN_CELL).bit_length() - 1,
    )
    for key, points in octree.spread(counts, sample, min(level, _LEVELS)).items():
        x0, y0, x1, y1 = octree.box(key)
        patch = DensityPatch(
            x0=min(max(x0, bounds[0]), bounds[2]),
            y0=min(max(y0, bounds[1]), bounds[3]),
            x1=min(max(x1, bounds[0]), bounds[2]),
            y1=min(max(y1, bounds[1]), bounds[3]),
            points=points,
        )
        patches.append(patch)
    return tuple(patches)


def _few_outside(header: LasHeader, sample: Iterable[Records], claim: _BoundingBox) -> bool:
    """Return whether the points of a sample fill ``claim`` in x and y, except for a few strays.

    Points fill ``claim`` if they extend over at least half of its width and height.
    """
    positions = np.concatenate([_plan_view(header, records) for records in sample], axis=1)
    tolerance = np.asarray(header.scales[:2])
    low = claim.low[:2] - tolerance
    high = claim.high[:2] + tolerance
    inside = np.all((positions >= low[:, None]) & (positions <= high[:, None]), axis=0)
    if not can_be_strays(int(np.count_nonzero(~inside)), positions.shape[1]):
        return False
    return bool(np.all(2 * np.ptp(positions[:, inside], axis=1) >= high - low))


def _plan_view(header: LasHeader, records: Records) -> Float64:
    """Return x and y of records in units of the CRS, float64, shape (2, n)."""
    with np.errstate(over="ignore", invalid="ignore"):
        axes = [records[n] * header.scales[i] + header.offsets[i] for i, n in enumerate("XY")]
    return np.stack(axes).astype(np.float64)


@dataclass(frozen=True)
class _BoundingBox:
    """Lowest and highest x, y, z, float64, shape (3,) each, infinite without points."""

    low: Float64
    high: Float64

    @classmethod
    def around(cls, header: LasHeader, blocks: Iterable[Records]) -> _BoundingBox:
        """Return the box around some records.

        Coordinates that are not finite, or not below `FARTHEST`, are ignored.
        """
        low = np.full(3, np.inf)
        high = np.full(3, -np.inf)
        for block in blocks:
            for axis, name in enumerate("XYZ"):
                scale, offset = header.scales[axis], header.offsets[axis]
                values = block[name]
                with np.errstate(over="ignore", invalid="ignore"):
                    ends = np.array([int(values.min()), int(values.max())]) * scale + offset
                    if not np.all(np.abs(ends) < FARTHEST):
                        coordinates = values.astype(np.float64) * scale + offset
                        coordinates = coordinates[np.abs(coordinates) < FARTHEST]
                        if coordinates.size == 0:
                            continue
                        ends = np.array([coordinates.min(), coordinates.max()])
                low[axis] = min(low[axis], ends[0])
                high[axis] = max(high[axis], ends[1])
        return cls(low, high)

    def holds(self, other: _BoundingBox, tolerance: Sequence[float]) -> bool:
        """Return whether this box contains another one, apart from rounding."""
        inside = np.all(other.low >= self.low - tolerance) and np.all(
            other.high <= self.high + tolerance
        )
        return bool(inside)

    def trimmed(self, near: _BoundingBox) -> _BoundingBox | None:
        """Return the box, with each side in x and y that is far outside ``near`` moved to ``near``.

        None if no side is far outside, or if ``near`` is empty.
        """
        if not np.all(np.isfinite(near.low)):
            return None
        allowed = FAR + _TIMES * float(max(near.high[:2] - near.low[:2]))
        west, east = self.low < near.low - allowed, self.high > near.high + allowed
        west[2] = east[2] = False
        if not (west.any() or east.any()):
            return None
        return _BoundingBox(
            np.where(west, near.low, self.low), np.where(east, near.high, self.high)
        )


def _chunk_start(header: LasHeader, point: int) -> int:
    """Return the first point of the chunk of ``point``, where decoding must start."""
    layout = header.laz
    if layout is None:
        return point
    if layout.chunk_size is not None:
        return point // layout.chunk_size * layout.chunk_size
    ends = np.cumsum(layout.counts)
    chunk = int(np.searchsorted(ends, point, side="right"))
    return int(ends[chunk] - layout.counts[chunk])


_PER_CELL = 4.0
"""Mean number of points per occupied cell for which `local_density` chooses the size of its
cells."""
_ROUNDS = 6

# A long run is divided if its rectangle is mostly empty.
_LONG = 10_000.0
"""Minimum length of a long run in units of the CRS."""
_LONG_VOID = 1000.0
"""Ratio of the area of its rectangle to the area that its points fill, above which it is
divided."""

# A run of many points is divided if its rectangle is partly empty.
_MANY = 512
_VOID = 2.0
"""Ratio of the area of its rectangle to the area of all points that the run represents, above
which it is divided."""

# If the order of the file is random, patches are cells of the bounds.
_SPANS = 0.7
"""Share of both sides of the bounds that each run must span for the order to count as
random."""
_CELLS = 16
"""Maximum number of cells along a side."""
_IN_CELL = 8
"""Mean number of points of the sample per cell."""


@dataclass(frozen=True)
class DensityPatch:
    """Rectangle from x0, y0 to x1, y1 in units of the CRS, with its estimated number of points."""

    x0: float
    y0: float
    x1: float
    y1: float
    points: float


def find_patches(
    runs: Sequence[Float64], points: int, bounds: Sequence[float]
) -> tuple[DensityPatch, ...]:
    """Estimate the patches of a file: one or more per run, or one per cell if its order is random.

    Together they contain all points. The rectangle of a run is widened until, at the density of
    the run, it contains all points up to the next run.

    Parameters
    ----------
    runs : sequence of float64, shape (2, n)
        x and y of successive points, at even distances in the file.
    points : int
        Number of points in the file.
    bounds : sequence of 4 float
        Lowest x, y and highest x, y, within which all patches lie.
    """
    low = np.array(bounds[:2])
    high = np.array(bounds[2:])
    inside = [
        run[:, np.all((run >= low[:, None]) & (run <= high[:, None]), axis=0)] for run in runs
    ]
    inside = [run for run in inside if run.shape[1]]
    if not inside:
        return (
            (DensityPatch(bounds[0], bounds[1], bounds[2], bounds[3], points),)
            if points
            else ()
        )
    if all(np.all(np.ptp(run, axis=1) >= _SPANS * (high - low)) for run in inside):
        return _cells(np.concatenate(inside, axis=1), points, low, high)
    share = points / len(inside)
    divided = [_divide(run, share) for run in inside]
    if any(len(parts) > 1 for parts in divided):
        # The runs of a small file overlap. So some are left out, until they have about as many
        # points as the file.
        step = max(round(sum(run.shape[1] for run in inside) / points), 1)
        divided = divided[::step]
        share = points / len(divided)
    patches = []
    for parts in divided:
        total = sum(part.shape[1] for part in parts)
        patches += [_patch(part, share * part.shape[1] / total, low, high) for part in parts]
    return tuple(patches)


def _cells(
    sample: Float64,
    points: int,
    low: Float64,
    high: Float64,
) -> tuple[DensityPatch, ...]:
    """Return a patch per cell of the bounds with points of a sample of the whole file."""
    total = sample.shape[1]
    across = min(max(math.isqrt(total // _IN_CELL), 1), _CELLS)
    side = (high - low) / across
    indices = np.floor((sample - low[:, None]) / np.where(side > 0, side, 1.0)[:, None]).astype(
        np.int64
    )
    cells, held = np.unique(np.minimum(indices, across - 1), axis=1, return_counts=True)
    corners = (low + cells.T * side).tolist()
    return tuple(
        DensityPatch(x, y, x + float(side[0]), y + float(side[1]), points * number / total)
        for (x, y), number in zip(corners, held.tolist(), strict=True)
    )


def _divide(run: Float64, points: float) -> list[Float64]:
    """Divide a run that represents ``points`` points, until no part is diagonal or has a large gap."""
    sides = np.ptp(run, axis=1)
    density = local_density(run)
    total = run.shape[1]
    jumps = sides.max() >= _LONG and sides.prod() > _LONG_VOID * total / density
    diagonal = total > _MANY and sides.prod() > _VOID * points / density
    if not jumps and not diagonal:
        return [run]
    axis = int(np.argmax(sides))
    first = run[axis] <= run[axis].min() + sides[axis] / 2
    parts = []
    for half in (run[:, first], run[:, ~first]):
        parts += _divide(half, points * half.shape[1] / total)
    return parts


def _patch(
    run: Float64,
    points: float,
    low: Float64,
    high: Float64,
) -> DensityPatch:
    first, last = run.min(axis=1), run.max(axis=1)
    wide, tall = (last - first).tolist()
    area = points / local_density(run)
    # The margin m solves (wide + 2 m) (tall + 2 m) = area.
    margin = (math.sqrt((wide - tall) ** 2 + 4 * area) - wide - tall) / 4
    first, last = first - max(margin, 0.0), last + max(margin, 0.0)
    # A patch that extends beyond the bounds is moved inside instead of clipped, so that it
    # keeps its area.
    shift = np.maximum(low - first, 0) - np.maximum(last - high, 0)
    first, last = np.maximum(first + shift, low), np.minimum(last + shift, high)
    last = np.maximum(last, first)
    return DensityPatch(
        float(first[0]), float(first[1]), float(last[0]), float(last[1]), points
    )


def local_density(run: Float64) -> float:
    """Return the points per square unit of the occupied cells, with about `_PER_CELL` points per cell.

    The error is at most a factor of two for points distributed over a plane. For a single scan
    line the density is too low by a factor of two to four.
    """
    n = run.shape[1]
    first, sides = run.min(axis=1), np.ptp(run, axis=1)
    cell = math.sqrt(
        _PER_CELL * max(float(sides[0] * sides[1]), float(sides.max()) ** 2 / n**2, 1e-12) / n
    )
    density = 0.0
    for _ in range(_ROUNDS):
        column, row = np.floor((run - first[:, None]) / cell).astype(np.int64)
        occupied = len(np.unique(column * (int(row.max()) + 1) + row))
        held = n / occupied
        density = n / (occupied * cell**2)
        if _PER_CELL / 1.5 <= held <= _PER_CELL * 1.5:
            break
        cell *= min(max(math.sqrt(_PER_CELL / held), 0.1), 10.0)
    return density
