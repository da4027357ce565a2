"""Which files there are, what each of them holds, and how it is read in pieces."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tiler.errors import ConfigError, InputError
from tiler.ingest.georeference import Georeference, georeference
from tiler.las.columns import RGB_FORMATS
from tiler.las.headers import LasHeader, read_header
from tiler.las.reader import COORDINATES, PointReader, Records, count_decodable

SUFFIXES = (".las", ".laz")

_SAMPLE = 4096
_SCAN = 1 << 19
_WIDEST = 1e6
"""Units of a credible extent: from anywhere within it, int32 counts reach all of it."""


@dataclass(frozen=True)
class SourceInfo:
    """A file that can be read.

    Attributes
    ----------
    path : Path
    size, mtime_ns : int
        Bytes; time of change, to see whether it changed.
    digest : str
        Of the bytes before the points.
    version : str
        Of LAS.
    point_format, record_length, points : int
    compressed, copc, has_rgb, salvaged : bool
    scales : tuple of 3 float
    georeference : Georeference
    bounds : tuple of 6 float or None
        Lowest x, y, z, highest x, y, z in units of the CRS: the header's where a sample of points
        lies inside, else those of all points; None where there are no points.
    notes : tuple of str
        What people should know.
    """

    path: Path
    size: int
    mtime_ns: int
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
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """A JSON-able description."""
        return {
            "path": str(self.path), "size": self.size, "mtime_ns": self.mtime_ns, "digest": self.digest,
            "version": self.version, "point_format": self.point_format, "points": self.points,
            "compressed": self.compressed, "copc": self.copc, "salvaged": self.salvaged,
            "crs": self.georeference.name or None, "bounds": self.bounds and list(self.bounds),
            "notes": list(self.notes),
        }  # fmt: skip


def find_inputs(
    paths: Sequence[str | Path],
    exclude: Sequence[Path] = (),
    note: Callable[[str], None] = lambda text: None,
) -> list[Path]:
    """The LAS and LAZ files of files, folders (recursively) and globs, sorted, each once.

    Parameters
    ----------
    paths : sequence of str
    exclude : sequence of Path
        Folders that are not looked into (the run's own output).
    note : callable
        Told of a file that was named twice.

    Raises
    ------
    ConfigError
        A path that is not there, or no path at all.
    InputError
        No LAS or LAZ among them.
    """
    if not paths:
        raise ConfigError("no input; name LAS or LAZ files, folders or globs")
    barred = {p.resolve() for p in exclude}
    found: dict[Path, Path] = {}
    for text in paths:
        for path in _expand(str(text), barred):
            real = path.resolve()
            if real in found:
                note(f"{path}: named twice (as {found[real]}), read once")
            else:
                found[real] = path
    if not found:
        raise InputError(
            f"{', '.join(map(str, paths))}: no .las or .laz file there; name files, folders or globs"
        )
    return sorted(found.values())


def _expand(text: str, barred: set[Path]) -> Iterator[Path]:
    path = Path(text)
    if path.is_dir():
        yield from _walk(path, barred)
    elif path.exists():
        yield path
    else:
        matches = sorted(glob.glob(text, recursive=True))
        if not matches:
            raise ConfigError(f"{text}: no such file or folder; name LAS or LAZ files, folders or globs")
        for match in map(Path, matches):
            if match.is_dir():
                yield from _walk(match, barred)
            elif match.suffix.lower() in SUFFIXES:
                yield match


def _walk(folder: Path, barred: set[Path]) -> Iterator[Path]:
    for root, folders, names in os.walk(folder):
        here = Path(root)
        folders[:] = sorted(f for f in folders if (here / f).resolve() not in barred)
        yield from (here / name for name in sorted(names) if Path(name).suffix.lower() in SUFFIXES)


def inspect(path: Path, salvage: bool = False) -> SourceInfo:
    """What a file holds, checked against its bytes and a sample of its points; raises InputError."""
    header = read_header(Path(path), salvage)
    header = replace(header, point_count=count_decodable(header))
    notes = list(header.notes)
    if header.point_count == 0:
        notes.append("has no points")
    place = georeference(header)
    bounds, remark = _bounds(header)
    if remark:
        notes.append(remark)
    return SourceInfo(
        path=header.path, size=header.size, mtime_ns=header.mtime_ns, digest=header.digest,
        version="{}.{}".format(*header.version), point_format=header.point_format,
        record_length=header.record_length, points=header.point_count, compressed=header.laz is not None,
        copc=any(v.is_copc for v in header.vlrs), has_rgb=header.point_format in RGB_FORMATS,
        salvaged=salvage and bool(header.notes), scales=header.scales, georeference=place, bounds=bounds,
        notes=(*notes, *(place.notes if place.kind != "missing" else ())),
    )  # fmt: skip


def pieces(info: SourceInfo, size: int = 1_000_000) -> list[tuple[int, int]]:
    """Ranges (start, count) that hold each point of a source once, of about ``size`` points.

    They begin and end with chunks of a LAZ file, so that no chunk is decoded twice.
    """
    if info.points == 0:
        return []
    header = read_header(info.path, info.salvaged)
    layout = header.laz
    step = size
    if layout is not None and (layout.chunk_size is None or (layout.rebuilt and layout.counts.size)):
        return _whole_chunks(layout.counts.tolist(), size)
    if layout is not None and layout.chunk_size is not None:
        step = max(size // layout.chunk_size, 1) * layout.chunk_size
    return [(start, min(step, info.points - start)) for start in range(0, info.points, step)]


def _whole_chunks(counts: Sequence[int], size: int) -> list[tuple[int, int]]:
    """Neighbouring chunks of their own sizes, together at most ``size`` where one alone is not more."""
    ranges: list[tuple[int, int]] = []
    start = held = 0
    for count in counts:
        if held and held + count > size:
            ranges.append((start, held))
            start, held = start + held, 0
        held += count
    return [*ranges, (start, held)] if held else ranges


def _bounds(header: LasHeader) -> tuple[tuple[float, ...] | None, str | None]:
    """Bounds that can be trusted, and a remark where the header's cannot."""
    if header.point_count == 0:
        return None, None
    claimed = (*header.mins, *header.maxs)
    tolerance = np.asarray(header.scales)
    with PointReader(header, COORDINATES) as reader:
        if max(hi - lo for lo, hi in zip(header.mins, header.maxs, strict=True)) <= _WIDEST:  # NaN is not
            last = header.point_count - 1
            starts = sorted({0, _chunk_start(header, last // 2), _chunk_start(header, last)})
            sample = [reader.read(s, min(_SAMPLE, header.point_count - s)) for s in starts]
            low, high = _extent(header, sample)
            if np.all(low >= header.mins - tolerance) and np.all(high <= header.maxs + tolerance):
                return claimed, None
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for start in range(0, header.point_count, _SCAN):
            block = reader.read(start, min(_SCAN, header.point_count - start))
            part_low, part_high = _extent(header, [block])
            low, high = np.minimum(low, part_low), np.maximum(high, part_high)
    return (
        *low.tolist(),
        *high.tolist(),
    ), "its points lie outside the bounds that its header gives: read from the points"


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


def _extent(
    header: LasHeader, blocks: Sequence[Records]
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Lowest and highest x, y, z of some records in units of the CRS, float64, shape (3,) each."""
    low = [min(int(b[axis].min()) for b in blocks) for axis in "XYZ"]
    high = [max(int(b[axis].max()) for b in blocks) for axis in "XYZ"]
    scales, offsets = np.asarray(header.scales), np.asarray(header.offsets)
    with np.errstate(over="ignore"):  # absurd scales: what they make infinite is dropped later, with a reason
        return np.asarray(low) * scales + offsets, np.asarray(high) * scales + offsets
