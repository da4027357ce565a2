"""Inspection of inputs, and their division into pieces."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path
from typing import Any, TypeVar

from ptd.matched.evidence import Evidence
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.errors import InputError, ProcessingError
from tiler.inputs.extent import DensityPatch, find_extent
from tiler.inputs.georeference import Georeference, georeference
from tiler.io.cloud_reading import fetched_bytes
from tiler.io.las.headers import LasHeader, read_header
from tiler.io.las.layout import CorruptLazError, LazLayout
from tiler.io.las.octree import Octree, read_octree
from tiler.io.las.point_formats import RGB_FORMATS
from tiler.io.las.reader import count_decodable, rows_at_once
from tiler.io.locations import FileState, reading_remedy, stat_location, with_slashes
from tiler.schedule.guard import ChildDiedError, ChildProcess, ChildStartError

Read = TypeVar("Read")

INSPECTION_SECONDS = 60.0
"""Maximum time of an inspection in seconds. Large files may take longer."""
BYTES_PER_SECOND = 1e6
"""Lowest speed of an inspection that reads all points of a file. Every disk and decoder is
faster."""

_MAX_CHUNK = 4_000_000
"""Maximum number of points of an undivided chunk. Damaged files may claim chunks that do not
fit into memory."""


@dataclass(frozen=True)
class SourceInfo:
    """Description of a file that can be read.

    Attributes
    ----------
    path : Path
    state : FileState
        Size and time of change, by which later changes are detected.
    digest : str
        Digest of the bytes before the points, and of the table of chunks.
    version : str
        Version of LAS.
    point_format, record_length, points : int
    stated_points : int
        Number of points that the header states, 0 if it states none.
    unread_points : int
        Number of records behind the last of them, which are not read.
    compressed, copc, has_rgb, salvaged : bool
    scales : tuple of 3 float
    georeference : Georeference
    bounds : tuple of 6 float or None
        Lowest x, y, z, highest x, y, z in units of the CRS, see `tiler.inputs.extent`; None without points.
    claimed : bool
        Whether the bounds are those of the header and contain a sample of the points.
    returns : int
        Largest number of returns of a pulse in a sample of points; 0 or 1 for clouds without pulses.
    evidence : Evidence
        Evidence in the fields of a sample of points on the source of the cloud.
    notes : tuple of str
        Notes for the user.
    patches : tuple of DensityPatch
        Estimate of the distribution of the points.
    chunks : int, or tuple of int
        Number of points in each chunk of a LAZ file. It is one number if all chunks but the last are equal, and 0
        without chunks.
    octree : Octree or None
        Octree of a COPC file.
    octree_damage : str
        Reason why the octree of a COPC file cannot be used, or an empty text.
    has_crs : bool
        Whether the file itself defines its CRS.
    fetched : int
        Bytes that the inspection read, if the file is at a URL.
    created : tuple of int
        Year and day of the year of the file's creation, from the header; 0 if unknown.
    times : tuple of 2 float, or None
        First and last adjusted standard GPS time in a sample of points (`Extent.times`), or None if they have none.
    """

    path: Path
    state: FileState
    digest: str
    version: str
    point_format: int
    record_length: int
    points: int
    compressed: bool
    copc: bool
    has_rgb: bool
    salvaged: bool
    scales: tuple[float, float, float]
    georeference: Georeference
    bounds: tuple[float, ...] | None
    claimed: bool
    returns: int
    evidence: Evidence
    notes: tuple[str, ...]
    patches: tuple[DensityPatch, ...] = ()
    chunks: int | tuple[int, ...] = 0
    created: tuple[int, int] = (0, 0)
    times: tuple[float, float] | None = None
    octree: Octree | None = None
    octree_damage: str = ""
    has_crs: bool = True
    fetched: int = 0
    stated_points: int = 0
    unread_points: int = 0

    @property
    def is_incomplete(self) -> bool:
        """Whether points of a damaged file are, or may be, lost."""
        is_short = self.points < self.stated_points or not self.stated_points
        return bool(self.unread_points) or (self.salvaged and is_short)

    @property
    def size(self) -> int:
        """Size of the file in bytes."""
        return self.state.size

    @property
    def stamp(self) -> list[Any]:
        """The value of `LasHeader.stamp`, which a task compares with that of the file that it reads."""
        return [*self.state.to_json(), self.digest]

    def to_json(self) -> dict[str, Any]:
        """Return a JSON-able description."""
        return {
            "path": with_slashes(self.path),
            "size": self.size,
            "mtime_ns": self.state.mtime_ns,
            "digest": self.digest,
            "version": self.version,
            "point_format": self.point_format,
            "points": self.points,
            "stated_points": self.stated_points,
            "incomplete": self.is_incomplete,
            "compressed": self.compressed,
            "copc": self.copc,
            "salvaged": self.salvaged,
            "crs": self.georeference.name or None,
            "bounds": self.bounds and list(self.bounds),
            "notes": list(self.notes),
        }


def inspect(path: Path, salvage: bool = False) -> SourceInfo:
    """Read the header of a file, and check it against the bytes and a sample of the points.

    Raise InputError if the file cannot be read.
    """
    bytes_before = fetched_bytes()
    header = read_header(path, salvage)
    header = replace(header, point_count=count_decodable(header))
    notes = list(header.notes)
    if header.point_count == 0:
        notes.append("has no points")
    file_crs = georeference(header)
    has_crs = file_crs.kind != "missing"
    octree, damage = _octree(header)
    extent = find_extent(header, octree)
    if extent.note:
        notes.append(extent.note)
    if has_crs:
        notes += file_crs.notes
    return SourceInfo(
        path=header.path,
        state=header.state,
        digest=header.digest,
        version="{}.{}".format(*header.version),
        point_format=header.point_format,
        record_length=header.record_length,
        points=header.point_count,
        compressed=header.laz is not None,
        copc=any(v.is_copc for v in header.vlrs),
        has_rgb=header.point_format in RGB_FORMATS,
        salvaged=header.salvaged,
        scales=header.scales,
        georeference=file_crs,
        bounds=extent.bounds,
        claimed=extent.claimed,
        returns=extent.returns,
        evidence=extent.evidence,
        notes=tuple(notes),
        patches=extent.patches,
        chunks=_chunks(header.laz),
        created=header.created,
        times=extent.times,
        octree=octree,
        octree_damage=damage,
        has_crs=has_crs,
        fetched=fetched_bytes() - bytes_before,
        stated_points=header.stated_points,
        unread_points=header.unread_points,
    )


def _octree(header: LasHeader) -> tuple[Octree | None, str]:
    """Return the octree of a COPC file, or the reason why it cannot be used."""
    if not header.point_count or not any(v.is_copc for v in header.vlrs):
        return None, ""
    try:
        return read_octree(header), ""
    except CorruptLazError as damage:
        return None, str(damage)


def inspect_in_child(guard: ChildProcess, path: Path, salvage: bool = False) -> SourceInfo:
    """Call `inspect` in a child process."""
    return read_in_child(guard, inspect, path, salvage)


def read_in_child(
    guard: ChildProcess, function: Callable[..., Read], path: Path, *arguments: Any
) -> Read:
    """Call ``function(path, ...)`` in a child process and return its result.

    Raise InputError if the child crashes, hangs or needs too much memory, or ProcessingError if
    it cannot start.
    """
    try:
        seconds = INSPECTION_SECONDS + stat_location(path).st_size / BYTES_PER_SECOND
        return guard.call(function, path, *arguments, seconds=seconds)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror or error}); {reading_remedy(path, 'give a readable file')}"
        ) from error
    except ChildStartError as error:
        raise ProcessingError(
            f"{path}: the process that reads it {error}; end other programs, then run again"
        ) from error
    except ChildDiedError as died:
        raise InputError(
            f"{path}: the process that reads it {died}; get the file again"
        ) from died


def header_bounds(info: SourceInfo) -> Bounds | None:
    """Return the bounds in the header of a source in absolute counts, or None if they are wrong.

    They are widened by one unit, since some writers round inaccurately.
    """
    if info.bounds is None or not info.claimed:
        return None
    x0, y0, _, x1, y1, _ = info.bounds
    return Bounds(
        math.floor((x0 - 1) * COUNTS_PER_UNIT),
        math.floor((y0 - 1) * COUNTS_PER_UNIT),
        math.ceil((x1 + 1) * COUNTS_PER_UNIT),
        math.ceil((y1 + 1) * COUNTS_PER_UNIT),
    )


def pieces(info: SourceInfo, size: int = 1_000_000) -> list[tuple[int, int]]:
    """Return ranges (start, count) of about ``size`` points that together form a source.

    They consist of whole chunks of a LAZ file, so that no chunk is decoded twice. Only
    extremely large chunks are divided.
    """
    if info.points == 0:
        return []
    size = rows_at_once(info.record_length, size)
    largest = rows_at_once(info.record_length, _MAX_CHUNK)
    if isinstance(info.chunks, tuple):
        return _whole_chunks(info.chunks, size, largest)
    step = size
    if 0 < info.chunks <= largest:
        step = max(size // info.chunks, 1) * info.chunks
    return [(start, min(step, info.points - start)) for start in range(0, info.points, step)]


def window_pieces(
    info: SourceInfo, chunks: Sequence[int], size: int = 1_000_000
) -> list[tuple[tuple[int, int], ...]]:
    """Divide the records of some chunks into pieces of about ``size`` points, each with one or more ranges.

    Parameters
    ----------
    info : SourceInfo
    chunks : sequence of int
        Numbers of chunks, ascending.
    size : int
        Number of points.

    Returns
    -------
    list of tuple of (int, int)
        Ranges (start, count) of each piece.
    """
    counts = [info.chunks] * len(chunks) if isinstance(info.chunks, int) else info.chunks
    starts = [0, *accumulate(counts)]
    all_pieces: list[list[tuple[int, int]]] = []
    room = 0
    for chunk in chunks:
        start, count = starts[chunk], counts[chunk]
        if count == 0:
            continue
        if not all_pieces or count > room:
            all_pieces.append([])
            room = rows_at_once(info.record_length, size)
        piece = all_pieces[-1]
        if piece and sum(piece[-1]) == start:
            piece[-1] = (piece[-1][0], piece[-1][1] + count)
        else:
            piece.append((start, count))
        room -= count
    return [tuple(piece) for piece in all_pieces]


def _chunks(layout: LazLayout | None) -> int | tuple[int, ...]:
    if layout is None:
        return 0
    if layout.chunk_size is None or (layout.rebuilt and layout.counts.size):
        return tuple(layout.counts.tolist())
    return layout.chunk_size


def _whole_chunks(counts: Sequence[int], size: int, largest: int) -> list[tuple[int, int]]:
    """Join neighbouring chunks into ranges of at most ``size`` points.

    A larger chunk is a range, and is divided only if it has more than ``largest`` points.
    """
    ranges: list[tuple[int, int]] = []
    start = held = 0
    for count in counts:
        if held and held + count > size:
            ranges.append((start, held))
            start, held = start + held, 0
        held += count
    if held:
        ranges.append((start, held))
    divided_ranges = []
    for start, count in ranges:
        step = size if count > largest else count
        for first in range(0, count, step):
            divided_ranges.append((start + first, min(step, count - first)))
    return divided_ranges
