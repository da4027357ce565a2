"""Counts of the points of one file: classes, flags, returns, swaths, times, first returns and heights in cells.

Only cells are kept, so memory does not grow with the points. A `Survey` has the cells of all files without strays: a
few first returns far from all others, as in a run.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np

from ptd.arrays import Bool, Float64, Indices, Int64, UInt8, UInt16, UInt64
from tiler.apps.acceptance.duplicates import (
    DigestFiles,
    digests,
    number_of_parts,
    repeated,
)
from tiler.core.lattice import COUNTS_PER_UNIT, Cell, Lattice
from tiler.core.points import (
    KEY_POINT_FLAG,
    NOISE,
    OVERLAP_FLAG,
    SYNTHETIC_FLAG,
    WATER,
    WITHHELD_FLAG,
)
from tiler.core.words import counted, listed
from tiler.ingest.strays import far_buckets
from tiler.inputs import FAR
from tiler.inputs.extent import can_be_strays
from tiler.io.las.headers import LasHeader, read_header
from tiler.io.las.point_formats import class_and_flags, coordinate, returns
from tiler.io.las.reader import QUALITY, PointReader, Records

WEEK_SECONDS = 604_800
STANDARD_TIMES, WEEK_TIMES, NO_TIMES = "adjusted standard", "week seconds", "none"
GPS_KINDS = (STANDARD_TIMES, WEEK_TIMES, NO_TIMES)
CONTRADICTED_TIMES = "week seconds, but some are outside a week"
DOUBTFUL_TIMES = "adjusted standard, but all are those of a week"
"""Times that would be of the week from 14 September 2011 on, and are more probably week seconds with the wrong bit."""
_STANDARD_BIT = 0x01
_USUAL_OFFSET = 1000
"""Offset in millions of seconds of adjusted standard times of LAS 1.4."""
UNADJUSTED_TIMES = "standard, but not adjusted"
LATEST_SECONDS = 0.8e9
"""Adjusted time, in 2037, above which times are taken as not adjusted. Those are above 1e9 since 2011."""

FLAG_BITS = {
    "withheld": WITHHELD_FLAG,
    "overlap": OVERLAP_FLAG,
    "synthetic": SYNTHETIC_FLAG,
    "key": KEY_POINT_FLAG,
}

SIDE_BITS = 24
"""Bits of a column or a row in the key of a cell. The other 16 are the point source id."""
_SIDE_CELLS = 1 << SIDE_BITS
_EDGE = 1e-6
"""Shift of the edges of cells, in cells. Coordinates often lie exactly on the edges of cells of round sizes, where
rounding errors would decide."""

HEIGHT_CELL_FACTOR = 2
"""Side of the cells for heights, in sides of the cells for first returns: four nominal pulse spacings, so that a cell
has a few points of each swath."""
STEPS_PER_METRE = 1000
"""Heights are rounded to millimetres, so that sums of them do not depend on their order."""
MAX_HEIGHT_M = 16_000
"""Largest absolute height that is summed."""
OFFSET_STEPS = 1024
"""Steps per cell to which the position of a point inside its cell is rounded down."""
N_SUMS = 10
"""Number of sums per cell of heights."""

Bounds = tuple[float, ...]
Keys = UInt64


MAX_NAMED = 5
"""Number of places and of files that the note names."""


@dataclass(frozen=True)
class Cells:
    """Lattice of square cells whose edges are multiples of their side.

    Attributes
    ----------
    side : float
        In units of the CRS.
    column, row : int
        First column and row whose points are counted. Each cell has its column and row counted from there.
    """

    side: float
    column: int
    row: int

    @classmethod
    def around(cls, x: float, y: float, side: float) -> Cells:
        """Return cells whose middle one contains a position."""
        half = _SIDE_CELLS // 2
        return cls(side, math.floor(x / side) - half, math.floor(y / side) - half)

    @property
    def of_heights(self) -> Cells:
        """The larger cells in which heights are summed."""
        factor = HEIGHT_CELL_FACTOR
        return Cells(self.side * factor, self.column // factor, self.row // factor)

    def keys(self, x: Float64, y: Float64, source: UInt16) -> Keys:
        """Return the keys of the cells of points. Points too far away have none."""
        column = np.floor(x / self.side + _EDGE) - self.column
        row = np.floor(y / self.side + _EDGE) - self.row
        near = _inside(column) & _inside(row)
        if not near.all():
            column, row, source = column[near], row[near], source[near]
        return self._encoded(column, row, source)

    def height_sums(
        self, x: Float64, y: Float64, height_m: Float64, source: UInt16
    ) -> tuple[Keys, Int64]:
        """Return the distinct keys of the cells of points, sorted, and sums per cell, int64, shape (n, `N_SUMS`).

        The sums are the number of points, those of their heights z in millimetres and of z z, those of their offsets x
        and y from the lowest corner in `OFFSET_STEPS`, and those of x x, y y, x y, x z and y z. Points too far away or
        too high are left out. Sums beyond 2**63 wrap around.
        """
        x, y = x / self.side + _EDGE - self.column, y / self.side + _EDGE - self.row
        column, row = np.floor(x), np.floor(y)
        near = _inside(column) & _inside(row) & (np.abs(height_m) <= MAX_HEIGHT_M)
        if not near.all():
            x, y, height_m, source = x[near], y[near], height_m[near], source[near]
            column, row = column[near], row[near]
        height = np.rint(height_m * STEPS_PER_METRE).astype(np.int64)
        offset_x = ((x - column) * OFFSET_STEPS).astype(np.int64)
        offset_y = ((y - row) * OFFSET_STEPS).astype(np.int64)
        keys = self._encoded(column, row, source)
        order, first = _grouped(keys)
        z, dx, dy = height[order], offset_x[order], offset_y[order]
        products = (z, z * z, dx, dy, dx * dx, dy * dy, dx * dy, dx * z, dy * z)
        sums = (np.add.reduceat(values, first) for values in products)
        return keys[order][first], np.stack((np.diff(first, append=keys.size), *sums), axis=1)

    @staticmethod
    def _encoded(column: Float64, row: Float64, source: UInt16) -> Keys:
        found = source.astype(np.uint64) << np.uint64(2 * SIDE_BITS)
        found |= row.astype(np.uint64) << np.uint64(SIDE_BITS)
        found |= column.astype(np.uint64)
        return found


def _inside(index: Float64) -> Bool:
    inside: Bool = (index >= 0) & (index < _SIDE_CELLS)
    return inside


def decoded(keys: Keys) -> tuple[Int64, Int64, Int64]:
    """Return point source ids, columns and rows of keys."""
    mask = np.uint64(_SIDE_CELLS - 1)
    source = (keys >> np.uint64(2 * SIDE_BITS)).astype(np.int64)
    column = (keys & mask).astype(np.int64)
    row = ((keys >> np.uint64(SIDE_BITS)) & mask).astype(np.int64)
    return source, column, row


def places_of(keys: Keys, factor: int) -> tuple[Int64, Int64]:
    """Return the distinct columns and rows of cells ``factor`` times as large, without their point source ids."""
    _, column, row = decoded(np.unique(keys & np.uint64((1 << 2 * SIDE_BITS) - 1)))
    if factor > 1:
        large = np.unique((row // factor << SIDE_BITS) | column // factor)
        column, row = large & (_SIDE_CELLS - 1), large >> SIDE_BITS
    return column, row


def _grouped(keys: Keys) -> tuple[Indices, Indices]:
    """Return the order that sorts keys, and the position of the first of each distinct key in it."""
    order = np.argsort(keys, kind="stable")  # It is fast for sorted pieces.
    sorted_keys = keys[order]
    is_first = np.r_[True, sorted_keys[1:] != sorted_keys[:-1]][: keys.size]
    return order, np.flatnonzero(is_first)


class CellCounter:
    """Number of points by key, or several sums. Pieces are merged once they have as many cells as the merged ones."""

    def __init__(self) -> None:
        self._keys: list[Keys] = []
        self._counts: list[Int64] = []
        self._waiting = 0

    def add(self, keys: Keys, counts: Int64 | None = None) -> None:
        """Count keys, each once, or ``counts`` times. Counts and sums are of distinct, sorted keys."""
        if counts is None:
            keys, counts = np.unique(keys, return_counts=True)
        if not keys.size:
            return
        self._keys.append(keys)
        self._counts.append(counts)
        if len(self._keys) > 1:
            self._waiting += keys.size
        if self._waiting > self._keys[0].size:
            self.merge()

    def merge(self) -> tuple[Keys, Int64]:
        """Return the distinct keys, sorted, and their counts."""
        if not self._keys:
            return np.empty(0, np.uint64), np.empty(0, np.int64)
        if len(self._keys) > 1:
            keys, counts = np.concatenate(self._keys), np.concatenate(self._counts)
            order, first = _grouped(keys)
            self._keys = [keys[order][first]]
            self._counts = [np.add.reduceat(counts[order], first, axis=0)]
            self._waiting = 0
        return self._keys[0], self._counts[0]


def merged(pieces: Iterable[tuple[Keys, Int64]]) -> tuple[Keys, Int64]:
    """Return the distinct keys of several files, sorted, and the sums of their counts."""
    counter = CellCounter()
    for keys, counts in pieces:
        counter.add(keys, counts)
    return counter.merge()


@dataclass
class FileCounts:
    """Facts of a file's header, and counts of its points.

    Attributes
    ----------
    path : Path
    version : str
    point_format, points : int
    wkt_bit : bool
        Whether the header says that the CRS is in the WKT record.
    scale_m : float
        Largest scale factor in metres.
    stated_returns : tuple of int
        Number of points by return in the header.
    outside : int
        Number of points outside the bounds in the header. All, if the header has no bounds.
    returns, classes : int64
        Number of points by return number (0 to 15) and by class.
    flags : dict
        Number of points by the names in `FLAG_BITS`.
    wrong_returns : int
        Number of points whose return number is 0 or above the number of returns.
    sources : dict
        Number of points by point source id.
    with_intensity : int
        Number of points whose intensity is not 0.
    times : tuple of float or None
        Least and largest GPS time that is a number, None without one.
    times_kind : str
    first_returns : int
        Number of first returns that are not withheld.
    keys, counts : array
        Cells with these points (`Cells`), and their numbers.
    height_keys, height_sums : array
        Cells of single returns of swaths on land, and their sums (`Cells.height_sums`).
    too_high : int
        Number of such returns with heights beyond `MAX_HEIGHT_M`, which are not summed.
    duplicates : int
        Number of points that equal an earlier one of this file, without those in the bounds of other files.
    """

    path: Path
    version: str
    point_format: int
    points: int
    wkt_bit: bool
    scale_m: float
    stated_returns: tuple[int, ...]
    outside: int = 0
    returns: Int64 = field(default_factory=lambda: np.zeros(16, np.int64))
    classes: Int64 = field(default_factory=lambda: np.zeros(256, np.int64))
    flags: dict[str, int] = field(default_factory=lambda: dict.fromkeys(FLAG_BITS, 0))
    wrong_returns: int = 0
    sources: dict[int, int] = field(default_factory=dict)
    with_intensity: int = 0
    times: tuple[float, float] | None = None
    times_kind: str = NO_TIMES
    first_returns: int = 0
    keys: Keys = field(default_factory=lambda: np.empty(0, np.uint64))
    counts: Int64 = field(default_factory=lambda: np.empty(0, np.int64))
    height_keys: Keys = field(default_factory=lambda: np.empty(0, np.uint64))
    height_sums: Int64 = field(default_factory=lambda: np.empty((0, N_SUMS), np.int64))
    too_high: int = 0
    duplicates: int = 0

    @property
    def has_stated_returns(self) -> bool:
        """Whether the header states the number of points by return that were counted."""
        n = len(self.stated_returns)
        # Headers before LAS 1.4 have no room for later returns.
        return self.stated_returns == tuple(self.returns[1 : n + 1].tolist())


@dataclass(frozen=True)
class DigestPlan:
    """Where a file keeps its digests, and the bounds of other inputs, whose points may equal its own.

    Attributes
    ----------
    folder : Path
    name : str
        Name that only this file has.
    n_shared_parts : int
        Number of parts of the digests that are compared with other files.
    others : tuple of bounds
        Lowest x, y, highest x, y of each.
    """

    folder: Path
    name: str
    n_shared_parts: int
    others: tuple[Bounds, ...]


def count_file(
    path: Path,
    cells: Cells | None,
    plan: DigestPlan | None,
    units_m: tuple[float, float] = (1.0, 1.0),
) -> FileCounts:
    """Count the points of a file, piece by piece.

    Parameters
    ----------
    path : Path
    cells : Cells or None
        Cells of the first returns. None: do not count them, and do not sum heights.
    plan : DigestPlan or None
        How to find duplicates. None: do not look for them.
    units_m : (float, float)
        Metres per unit of x and y, and per unit of the heights.
    """
    header = read_header(path)
    unit_m, height_unit_m = units_m
    found = FileCounts(
        path,
        "{}.{}".format(*header.version),
        header.point_format,
        header.point_count,
        header.prefers_wkt,
        max(max(header.scales[:2]) * unit_m, header.scales[2] * height_unit_m),
        header.points_by_return,
    )
    sources = np.zeros(1 << 16, np.int64)
    first_returns, heights = CellCounter(), CellCounter()
    own = shared = None
    if plan is not None:
        own = DigestFiles(plan.folder, f"own-{plan.name}", number_of_parts(header.point_count))
        shared = DigestFiles(plan.folder, f"shared-{plan.name}", plan.n_shared_parts)
    with PointReader(header, QUALITY) as reader:
        for records in reader.pieces():
            flags, single = _count_fields(found, records, header)
            sources += np.bincount(records["point_source_id"], minlength=sources.size)
            x, y, z = (coordinate(records, header, axis) for axis in range(3))
            # Points without a return number count as first returns.
            first = returns(records, header.point_format)[0] <= 1
            first &= (flags & WITHHELD_FLAG) == 0
            found.first_returns += int(first.sum())
            if cells is not None:
                of_swath = records["point_source_id"]
                first_returns.add(cells.keys(x[first], y[first], of_swath[first]))
                height_m = z[single] * height_unit_m
                found.too_high += int(np.count_nonzero(np.abs(height_m) > MAX_HEIGHT_M))
                heights.add(
                    *cells.of_heights.height_sums(
                        x[single], y[single], height_m, of_swath[single]
                    )
                )
            if plan is not None and own is not None and shared is not None:
                times = records["gps_time"] if _has_time(records) else None
                of_points = digests((x, y, z), times)
                near = _in_any(x, y, plan.others)
                own.add(of_points[~near])
                shared.add(of_points[near])
    found.sources = {int(s): int(sources[s]) for s in np.flatnonzero(sources)}
    found.times_kind = _kind_of_times(header, found.times)
    found.keys, found.counts = first_returns.merge()
    height_keys, height_sums = heights.merge()
    if height_keys.size:
        found.height_keys, found.height_sums = height_keys, height_sums
    if own is not None:
        found.duplicates = sum(repeated(part).size for part in own.take())
    return found


def _has_time(records: Records) -> bool:
    return "gps_time" in (records.dtype.names or ())


def _count_fields(found: FileCounts, records: Records, header: LasHeader) -> tuple[UInt8, Bool]:
    """Add the fields of some records to the counts, and return their flags and the mask of the points for heights."""
    codes, flags = class_and_flags(records, header.point_format)
    found.classes += np.bincount(codes, minlength=256)
    by_flags = np.bincount(flags, minlength=256)
    for name, bit in FLAG_BITS.items():
        found.flags[name] += int(by_flags[(np.arange(256) & bit) > 0].sum())
    number, of_pulse = returns(records, header.point_format)
    found.returns += np.bincount(number, minlength=16)
    found.wrong_returns += int(((number == 0) | (number > of_pulse)).sum())
    found.with_intensity += int(np.count_nonzero(records["intensity"]))
    found.outside += _number_outside(records, header)
    if _has_time(records) and len(records):
        times = records["gps_time"]
        finite = times if np.isfinite(times).all() else times[np.isfinite(times)]
        if finite.size:
            low, high = float(finite.min()), float(finite.max())
            before = found.times or (low, high)
            found.times = min(low, before[0]), max(high, before[1])
    # A pulse with one return met an opaque surface. The level of water may change between two swaths.
    single = (of_pulse <= 1) & ((flags & WITHHELD_FLAG) == 0) & ~np.isin(codes, (*NOISE, WATER))
    return flags, single & (records["point_source_id"] > 0)


def _number_outside(records: Records, header: LasHeader) -> int:
    """Return the number of points outside the bounds in the header by more than half a step."""
    outside = np.zeros(len(records), np.bool_)
    for axis, name in enumerate("XYZ"):
        steps = records[name]
        low, high = (
            (bound[axis] - header.offsets[axis]) / header.scales[axis]
            for bound in (header.mins, header.maxs)
        )
        if len(steps) and not (low - 0.5 <= steps.min() and steps.max() <= high + 0.5):
            outside |= ~((steps >= low - 0.5) & (steps <= high + 0.5))
    return int(outside.sum())


def _in_any(x: Float64, y: Float64, boxes: Sequence[Bounds]) -> Bool:
    inside = np.zeros(x.size, np.bool_)
    for x0, y0, x1, y1 in boxes:
        inside |= (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
    return inside


def _kind_of_times(header: LasHeader, times: tuple[float, float] | None) -> str:
    """Return the kind of GPS times by the header, or that the times contradict it."""
    if times is None:
        return NO_TIMES
    if header.time_offset not in (None, _USUAL_OFFSET):
        return f"standard with an offset of {header.time_offset} million seconds"
    low, high = times
    is_week = low >= 0 and high <= WEEK_SECONDS
    if header.global_encoding & _STANDARD_BIT:
        if high > LATEST_SECONDS:
            return UNADJUSTED_TIMES
        return DOUBTFUL_TIMES if is_week else STANDARD_TIMES
    return WEEK_TIMES if is_week else CONTRADICTED_TIMES


@dataclass(frozen=True)
class Survey:
    """Cells of the first returns of all files that are not strays.

    Attributes
    ----------
    keys, counts : uint64 and int64, shape (n,)
        Keys of `Cells`, sorted, and number of first returns in each.
    note : str
        Note about strays, or about clouds that lie far apart. Empty without them.
    is_apart : bool
        Whether more first returns than strays are farther away than cells reach. The cells do not have them.
    """

    keys: Keys
    counts: Int64
    note: str = ""
    is_apart: bool = False


def survey_of(files: Sequence[FileCounts], cells: Cells) -> Survey:
    """Return the cells of the first returns of all files, without strays."""
    keys, counts = merged((file.keys, file.counts) for file in files)
    total = sum(file.first_returns for file in files)
    n_beyond = total - int(counts.sum())
    if n_beyond and not can_be_strays(n_beyond, total):
        return Survey(keys, counts, _far_apart(files, n_beyond), is_apart=True)
    strays = _strays(keys, counts, cells)
    n_strays = int(counts[strays].sum()) + n_beyond
    if not n_strays:
        return Survey(keys, counts)
    _, columns, rows = decoded(keys[strays])
    x = (columns + cells.column + 0.5) * cells.side
    y = (rows + cells.row + 0.5) * cells.side
    places = [f"around {a:.1f} {b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    places += ["farther than cells reach"] if n_beyond else []
    names = [
        str(file.path)
        for file in files
        if _reaches_beyond(file) or np.isin(keys[strays], file.keys).any()
    ]
    note = (
        f"{listed(names, MAX_NAMED, 'files')}: {counted(n_strays, 'first return')} far from all others left out of "
        f"the rows of cells, {listed(places, MAX_NAMED, 'places')}"
    )
    return Survey(keys[~strays], counts[~strays], note)


def _far_apart(files: Sequence[FileCounts], n_beyond: int) -> str:
    names = [str(file.path) for file in files if _reaches_beyond(file)]
    return (
        f"{listed(names, MAX_NAMED, 'files')}: the clouds lie farther apart than cells reach, and no cell has "
        f"{counted(n_beyond, 'first return')} of these files; check only clouds that lie together, or withhold points "
        "far from all others"
    )


def _reaches_beyond(file: FileCounts) -> bool:
    return file.first_returns > int(file.counts.sum())


def _strays(keys: Keys, counts: Int64, cells: Cells) -> Bool:
    """Return the mask of the cells in which all first returns are strays."""
    _, columns, rows = decoded(keys)
    side = max(FAR, cells.side)
    x, y = (
        np.floor((of_cells + first + 0.5) * (cells.side / side)).astype(np.int64)
        for of_cells, first in ((columns, cells.column), (rows, cells.row))
    )
    strays = np.zeros(keys.size, np.bool_)
    if not keys.size or max(np.ptp(x), np.ptp(y)) < 2:
        return strays
    width = int(np.ptp(x)) + 1
    bucket = (y - y.min()) * width + x - x.min()
    # Cells of a row follow each other, so few of them remain to be sorted.
    starts = np.flatnonzero(np.r_[True, bucket[1:] != bucket[:-1]])
    found, inverse = np.unique(bucket[starts], return_inverse=True)
    numbers = np.bincount(inverse, np.add.reduceat(counts, starts)).astype(np.int64)
    buckets = {
        Cell(number % width, number // width): n
        for number, n in zip(found.tolist(), numbers.tolist(), strict=True)
    }
    far = far_buckets(buckets, Lattice(Fraction(side) * COUNTS_PER_UNIT))
    if far:
        strays = np.isin(bucket, [cell.iy * width + cell.ix for cell in far])
    return strays
