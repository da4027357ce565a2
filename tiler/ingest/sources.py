"""What each input holds, and how it is read in pieces."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path
from typing import Any, TypeVar

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds
from tiler.errors import InputError, ProcessingError
from tiler.ingest.extent import find_extent
from tiler.ingest.georeference import Georeference, georeference
from tiler.ingest.patches import Patch
from tiler.io.cloud_reading import fetched_bytes
from tiler.io.las.columns import RGB_FORMATS
from tiler.io.las.headers import LasHeader, read_header
from tiler.io.las.laz import LazDamage, LazLayout
from tiler.io.las.octree import Octree, read_octree
from tiler.io.las.reader import count_decodable, rows_at_once
from tiler.io.locations import State, stat_cloud
from tiler.schedule.guard import Died, Guard, NotStartedError

Read = TypeVar("Read")

INSPECTION_SECONDS = 60.0
BYTES_PER_SECOND = 1e6
"""Slower than any disk and decoder: an inspection that reads all points of a file may take so long."""

_LARGEST_CHUNK = 4_000_000
"""Points; chunks of more are divided: what they claim to hold must not be allocated at once."""


@dataclass(frozen=True)
class SourceInfo:
    """A file that can be read.

    Attributes
    ----------
    path : Path
    state : State
        Size and time of change, to see whether it changed.
    digest : str
        Of the bytes before the points and of the table of chunks.
    version : str
        Of LAS.
    point_format, record_length, points : int
    compressed, copc, has_rgb, salvaged : bool
    scales : tuple of 3 float
    georeference : Georeference
    bounds : tuple of 6 float or None
        Lowest x, y, z, highest x, y, z in units of the CRS, see `tiler.ingest.extent`; None where there
        are no points.
    claimed : bool
        The bounds are the header's, and a sample of points lies inside.
    returns : int
        Largest number of returns of a pulse in a sample of points; 0 or 1 for clouds without pulses.
    notes : tuple of str
        What people should know.
    patches : tuple of Patch
        How the points are spread, estimated from a few.
    chunks : int, or tuple of int
        Points of each chunk of a LAZ file, one number where all but the last have the same; 0 where there is none.
    octree : Octree or None
        Of a COPC file.
    octree_damage : str
        Why a COPC file has none that can be used.
    fetched : int
        Bytes that were read of it for all this, where it is at a URL.
    created : tuple of int
        Year and day of the year on which the file was made, as its header says; 0 where it does not.
    """

    path: Path
    state: State
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
    notes: tuple[str, ...]
    patches: tuple[Patch, ...] = ()
    chunks: int | tuple[int, ...] = 0
    created: tuple[int, int] = (0, 0)
    octree: Octree | None = None
    octree_damage: str = ""
    fetched: int = 0

    @property
    def size(self) -> int:
        """Size of the file in bytes."""
        return self.state.size

    @property
    def stamp(self) -> list[Any]:
        """As `LasHeader.stamp`: what a task holds against the file that it reads."""
        return [*self.state.to_json(), self.digest]

    def to_json(self) -> dict[str, Any]:
        """A JSON-able description."""
        return {
            "path": str(self.path),
            "size": self.size,
            "mtime_ns": self.state.mtime_ns,
            "digest": self.digest,
            "version": self.version,
            "point_format": self.point_format,
            "points": self.points,
            "compressed": self.compressed,
            "copc": self.copc,
            "salvaged": self.salvaged,
            "crs": self.georeference.name or None,
            "bounds": self.bounds and list(self.bounds),
            "notes": list(self.notes),
        }


def inspect(path: Path, salvage: bool = False) -> SourceInfo:
    """What a file holds, checked against its bytes and a sample of its points; raises InputError."""
    before = fetched_bytes()
    header = read_header(path, salvage)
    header = replace(header, point_count=count_decodable(header))
    notes = list(header.notes)
    if header.point_count == 0:
        notes.append("has no points")
    place = georeference(header)
    octree, damage = _octree(header)
    extent = find_extent(header, octree)
    if extent.note:
        notes.append(extent.note)
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
        salvaged=salvage and bool(header.notes),
        scales=header.scales,
        georeference=place,
        bounds=extent.bounds,
        claimed=extent.claimed,
        returns=extent.returns,
        notes=(*notes, *(place.notes if place.kind != "missing" else ())),
        patches=extent.patches,
        chunks=_chunks(header.laz),
        created=header.created,
        octree=octree,
        octree_damage=damage,
        fetched=fetched_bytes() - before,
    )


def _octree(header: LasHeader) -> tuple[Octree | None, str]:
    """The octree of a COPC file, or why it cannot be used."""
    if not header.point_count or not any(v.is_copc for v in header.vlrs):
        return None, ""
    try:
        return read_octree(header), ""
    except LazDamage as damage:
        return None, str(damage)


def inspect_guarded(guard: Guard, path: Path, salvage: bool = False) -> SourceInfo:
    """`inspect` in a child process."""
    return read_guarded(guard, inspect, path, salvage)


def read_guarded(guard: Guard, function: Callable[..., Read], path: Path, *arguments: Any) -> Read:
    """``function(path, ...)`` in a child process: a file that makes it crash, hang or eat memory is an InputError."""
    try:
        seconds = INSPECTION_SECONDS + stat_cloud(path).st_size / BYTES_PER_SECOND
        return guard.call(function, path, *arguments, seconds=seconds)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror or error}); name a readable file"
        ) from error
    except NotStartedError as error:
        raise ProcessingError(
            f"{path}: the process that reads it {error}; end other programs, then run again"
        ) from error
    except Died as died:
        raise InputError(f"{path}: the process that reads it {died}; get the file again") from died


def claimed_bounds(info: SourceInfo) -> Bounds | None:
    """What the header of a source says it covers, in absolute counts, a unit wider: some writers round carelessly.

    None where it is known not to be true.
    """
    if info.bounds is None or not info.claimed:
        return None
    x0, y0, _, x1, y1, _ = info.bounds
    low = (math.floor((x0 - 1) * COUNTS_PER_UNIT), math.floor((y0 - 1) * COUNTS_PER_UNIT))
    return Bounds(*low, *(math.ceil((v + 1) * COUNTS_PER_UNIT) for v in (x1, y1)))


def pieces(info: SourceInfo, size: int = 1_000_000) -> list[tuple[int, int]]:
    """Ranges (start, count) that hold each point of a source once, of about ``size`` points.

    They begin and end with chunks of a LAZ file, so that no chunk is decoded twice, unless a chunk is absurdly large.
    """
    if info.points == 0:
        return []
    size = rows_at_once(info.record_length, size)
    largest = rows_at_once(info.record_length, _LARGEST_CHUNK)
    if isinstance(info.chunks, tuple):
        return _whole_chunks(info.chunks, size, largest)
    step = size
    if 0 < info.chunks <= largest:
        step = max(size // info.chunks, 1) * info.chunks
    return [(start, min(step, info.points - start)) for start in range(0, info.points, step)]


def window_pieces(
    info: SourceInfo, chunks: Sequence[int], size: int = 1_000_000
) -> list[tuple[tuple[int, int], ...]]:
    """The records of some chunks in pieces of about ``size`` points, each of one or more ranges (start, count).

    Parameters
    ----------
    info : SourceInfo
        Of a file whose chunks have their own sizes.
    chunks : sequence of int
        Numbers of chunks, ascending.
    size : int
    """
    counts = [info.chunks] * len(chunks) if isinstance(info.chunks, int) else info.chunks
    starts = [0, *accumulate(counts)]
    found: list[list[tuple[int, int]]] = []
    room = 0
    for chunk in chunks:
        start, count = starts[chunk], counts[chunk]
        if count == 0:
            continue
        if not found or count > room:
            found.append([])
            room = rows_at_once(info.record_length, size)
        piece = found[-1]
        if piece and sum(piece[-1]) == start:
            piece[-1] = (piece[-1][0], piece[-1][1] + count)
        else:
            piece.append((start, count))
        room -= count
    return [tuple(piece) for piece in found]


def _chunks(layout: LazLayout | None) -> int | tuple[int, ...]:
    """`SourceInfo.chunks` of a file, so that its pieces are known without reading its header again."""
    if layout is None:
        return 0
    if layout.chunk_size is None or (layout.rebuilt and layout.counts.size):
        return tuple(layout.counts.tolist())
    return layout.chunk_size


def _whole_chunks(counts: Sequence[int], size: int, largest: int) -> list[tuple[int, int]]:
    """Neighbouring chunks of their own sizes, together at most ``size`` where one alone is not more."""
    ranges: list[tuple[int, int]] = []
    start = held = 0
    for count in counts:
        if held and held + count > size:
            ranges.append((start, held))
            start, held = start + held, 0
        held += count
    if held:
        ranges.append((start, held))
    return [
        (start + i, min(size, count - i))
        for start, count in ranges
        for i in range(0, count, size if count > largest else count)
    ]
