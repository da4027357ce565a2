"""Where the CPU time of the whole job goes: a profile of one run in one process, by purpose, and bytes unpacked.

Each function belongs to the first purpose whose pattern its file and name match, and only its own time counts, so that
the purposes add up to the whole. The profiler slows Python functions more than kernels.
"""

from __future__ import annotations

import cProfile
import pstats
import re
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numcodecs.blosc

from tiler.config import RunConfig
from tiler.pipeline import run

PURPOSES = {
    "LAZ: decode": r"LasZipDecompressor",
    "LAZ: encode": r"LasZipCompressor|class_layer",
    "store: unpack chunks": r"blosc\.decompress",
    "store: pack chunks": r"blosc\.compress",
    "store: read and write": r"/tiler/store/|FileIO|Buffered|io\.open|posix\.",
    "triangulate and scan TINs": r"/ptd/tin/",
    "filter and surfaces": r"/ptd/",
    "ingest": r"/tiler/(ingest|inputs|io)/",
    "grid": r"/tiler/grid/",
    "rasters and vectors of others": r"rasterio|pyogrio|shapely|pyproj",
    "export and report": r"/tiler/(export|report)/",
    "digests": r"blake2|sha256|crc32c",
    "imports and kernels from the cache": r"importlib|marshal|llvmlite|numba|compile",
    "numpy and scipy": r"numpy|scipy",
    "plan, schedule, records": r"/tiler/",
    "other Python": r"",
}
"""Patterns of ``file:function`` by purpose. The last one takes the rest."""
BYTES_PER_POINT = 12
"""Bytes of the coordinates of a point in the store."""


@dataclass(frozen=True)
class Profile:
    """CPU seconds by purpose, and bytes that were unpacked from chunks of the store."""

    seconds: Mapping[str, float]
    unpacked_bytes: int

    def times_unpacked(self, points: int) -> float:
        """Return the unpacked bytes of all arrays as a multiple of the coordinates of all points."""
        return self.unpacked_bytes / (BYTES_PER_POINT * points)


def purpose_of(function: str) -> str:
    """Return the purpose of a function, given as ``file:name``."""
    return next(name for name, pattern in PURPOSES.items() if re.search(pattern, function))


def profile(paths: Sequence[Path], settings: Mapping[str, Any], out: Path) -> Profile:
    """Profile one run in this process."""
    config = RunConfig.from_mapping({**settings, "in_process": True})
    profiler = cProfile.Profile(time.process_time)
    with _counted_unpacking() as unpacked:
        profiler.enable()
        try:
            run([str(path) for path in paths], out, config)
        finally:
            profiler.disable()
    seconds: Counter[str] = Counter(dict.fromkeys(PURPOSES, 0.0))
    functions: Any = pstats.Stats(profiler)
    for (file, _, name), (_, _, own, _, _) in functions.stats.items():
        seconds[purpose_of(f"{Path(file).as_posix()}:{name}")] += own
    return Profile(dict(seconds), sum(unpacked))


@contextmanager
def _counted_unpacking() -> Iterator[list[int]]:
    """Collect the sizes of all chunks that are unpacked."""
    sizes: list[int] = []
    original = numcodecs.blosc.decompress

    def decompress(data: Any, *more: Any) -> Any:
        found = original(data, *more)
        sizes.append(len(found))
        return found

    numcodecs.blosc.decompress = decompress
    try:
        yield sizes
    finally:
        numcodecs.blosc.decompress = original


def table(found: Profile, points: int) -> str:
    """Return the purposes, the largest first, as a table for people."""
    whole = sum(found.seconds.values())
    rows = ["| purpose | CPU s | share |", "|---|---:|---:|"]
    for name, seconds in sorted(found.seconds.items(), key=lambda item: -item[1]):
        rows.append(f"| {name} | {seconds:.2f} | {seconds / whole:.1%} |")
    return "\n".join(
        [
            *rows,
            f"| **one process, with the profiler** | {whole:.2f} | 100.0% |",
            "",
            f"{found.unpacked_bytes / 1e9:.2f} GB were unpacked: the coordinates of all points "
            f"{found.times_unpacked(points):.1f} times.",
        ]
    )
