"""Memory that a worker needs, in bytes by stage and window, and memory and cores of the machine.

The factors are measured ratios of the peak resident memory of workers to the points of their
windows (docs/decisions.md, "The plan").
"""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from fractions import Fraction
from pathlib import Path, PurePosixPath

import numpy as np
import psutil

from ptd.arrays import Float64, Int64
from tiler.plan.method import PlannedPass, nested

BASE_BYTES = 260 << 20
"""Bytes of a worker before the first point: interpreter and libraries (210 MB), and the chunks that it keeps."""
READ_BYTES = 60
"""Bytes per candidate that a window reads: columns and sorting."""
VERTEX_BYTES = 200
"""Bytes per candidate that may become a vertex: its columns while it is tested, and its share of the TIN.

The same number of bytes is assumed per cell of a raster. 35 bytes per cell were measured while
large objects are found. The surface needs more, see `ELECTED_SHARE`.
"""
BUCKET_POINT_BYTES = 200
"""Bytes per point while its bucket is labelled."""
HELD_BYTES = 64 << 20
"""Maximum bytes of decoded buckets that a worker keeps to label their neighbours."""
HELD_SHARE = 16
"""Ratio of the memory above `BASE_BYTES` to the bytes of these buckets, if the result is below
`HELD_BYTES`."""
ASSEMBLY_POINT_BYTES = 800
"""Bytes per point while its bucket is assembled: fragments, keys and their order."""
SPOOL_POINT_BYTES = 160
"""Bytes per point while a part of a file is decoded and sorted."""
GROUND_BYTES = 200
"""Bytes per ground point in a block's window: coordinates and the TIN (123 measured on a
city)."""
PIECE_BYTES = 160
"""Bytes per piece of a breakline, for all breaklines of the run. Pieces are half a pixel long
or longer."""
NEAR_PIECE_BYTES = 650
"""Further bytes per piece of a breakline in a block's window, which is a vertex of the TIN (460
measured)."""
WIDE_TILE = 2 + 2 * math.sqrt(2)
"""Ratio of the side of a tile to its halo at which halos double the work."""
JOINED_BYTES = 1 << 30
"""Maximum memory of a worker for a joined tile of candidates, in bytes. A tile of 1.4 km of dense LiDAR with a halo of
229 m fits.

Larger tiles do not save time (213 M points: 413 CPU s in 18 tiles per pass, 415 in 12), and
smaller tiles are distributed more evenly among workers.
"""
ELECTED_SHARE = 5 / 8
"""Share of the memory above `BASE_BYTES` for which tiles of passes on elected points are cut by
`filter_bytes`. In windows of 0.5 to 10 km2 the surface needs 350 to 410 bytes per cell, and
`filter_bytes` assumes 260."""
TIN_BYTES = 3 << 29
"""Maximum bytes of a TIN that blocks of the terrain share."""
EXPORT_BYTES = 128 << 20
"""Bytes of a worker that writes a file: GDAL's blocks, or the current records of a classified
cloud."""
EXPORT_POINTS = 1 << 27
"""Maximum number of points of a classified cloud whose labels are in memory, one byte per
point."""

MIN_WORKER_BYTES = 512 << 20
"""Smallest default memory of a worker. Hardly any window fits into less."""
MAX_WORKER_BYTES = 4 << 30
"""Largest default memory of a worker. More does not make runs faster."""
MACHINE_SHARE = 2
"""Ratio of the memory of the machine to the default memory of all workers together. The rest is
for the system and its cache."""
CGROUPS = Path("/sys/fs/cgroup")
"""Folder with the limits of control groups."""
GROUPS = Path("/proc/self/cgroup")
"""File that lists the control groups of this process."""


def breakline_bytes(lines: Sequence[Int64], pixel: float, window: float) -> int:
    """Return the bytes that a worker needs for breaklines in the block with most of them.

    The breaklines are divided into pieces of half a pixel or more.

    Parameters
    ----------
    lines : sequence of int64 (n, 3)
        Vertices in counts.
    pixel, window : float
        Side of a pixel, and of the window of a block, in counts.
    """
    if not lines:
        return 0
    start = np.concatenate([line[:-1, :2] for line in lines]).astype(np.float64)
    stop = np.concatenate([line[1:, :2] for line in lines]).astype(np.float64)
    pieces = np.maximum(2 * np.hypot(*(stop - start).T) / pixel, 1)
    squares = np.floor((start + stop) / 2 / window)
    return int(
        PIECE_BYTES * pieces.sum() + NEAR_PIECE_BYTES * _most_in_a_window(squares, pieces)
    )


def _most_in_a_window(squares: Float64, pieces: Float64) -> float:
    """Return the largest number of pieces in 2 x 2 neighbouring squares, since no window intersects more squares."""
    occupied, square_index = np.unique(squares, axis=0, return_inverse=True)
    counts = np.bincount(square_index.ravel(), pieces)
    windows: dict[tuple[int, int], float] = defaultdict(float)
    for (column, row), count in zip(occupied.tolist(), counts.tolist(), strict=True):
        for west, south in ((0, 0), (1, 0), (0, 1), (1, 1)):
            windows[column - west, row - south] += count
    return max(windows.values())


def filter_bytes(
    points: float, area_m2: float, cell_m: float, step: PlannedPass, fine_m: Fraction
) -> float:
    """Return the bytes that a window of a pass needs above `BASE_BYTES`.

    The number of elected points is not known yet, so the maximum is assumed: one point per
    thinning cell. A raster has all cells of the window, including cells without points.

    Parameters
    ----------
    points : float
        Number of points of the window, candidates and others.
    area_m2 : float
        Area of the window in m2.
    cell_m : float
        Side of the method's thinning cell (`candidate_cell_m`) in metres, 0 if it has none.
    step : PlannedPass
    fine_m : Fraction
        Side of the store's cells in metres.
    """
    vertices = read = points
    if cell_m > 0:
        vertices = min(points, area_m2 / cell_m**2)
    if step.pass_.elected:
        read = vertices
    elif not step.pass_.every_point and nested(cell_m, fine_m):
        read = min(points, area_m2 / float(fine_m) ** 2)
    if step.pass_.raster_cell_m:
        raster_cells = area_m2 / step.pass_.raster_cell_m**2
        return read * READ_BYTES + raster_cells * VERTEX_BYTES
    return read * READ_BYTES + vertices * VERTEX_BYTES


def elected_bytes(memory: int) -> int:
    """Return the bytes that a tile of a pass on elected points may need by `filter_bytes`.

    ``memory`` is the memory of a worker in bytes.
    """
    return BASE_BYTES + int(ELECTED_SHARE * max(memory - BASE_BYTES, 0))


def elected_peak(size: int) -> int:
    """Return the peak bytes of a worker whose tile of elected points needs ``size`` bytes by `filter_bytes`."""
    return BASE_BYTES + int((size - BASE_BYTES) / ELECTED_SHARE)


def joined_bytes(step: PlannedPass, memory: int) -> int:
    """Return the bytes that a joined tile of a pass may need by `filter_bytes`.

    Passes that fit surfaces have halos of up to 678 m, so they may need the bytes of a tile
    whose area the halos double, with one point per square metre. ``memory`` is the memory of a
    worker in bytes.
    """
    if not step.fits_surfaces:
        return min(memory, JOINED_BYTES)
    window_m = (WIDE_TILE + 2) * step.halo_m
    enough = BASE_BYTES + int((READ_BYTES + VERTEX_BYTES) * window_m**2)
    return min(elected_bytes(memory), max(JOINED_BYTES, enough))


def held_bytes(memory: int) -> int:
    """Return the bytes of decoded buckets that a worker keeps to label their neighbours.

    ``memory`` is the memory of the worker in bytes.
    """
    return min(HELD_BYTES, max(memory - BASE_BYTES, 0) // HELD_SHARE)


def tile_peak(window_bytes: float, bucket_points: float, step: PlannedPass, memory: int) -> int:
    """Return the peak bytes of a worker with a tile of a pass.

    Parameters
    ----------
    window_bytes : float
        Bytes of the tile's window by `filter_bytes`.
    bucket_points : float
        Number of points of the fullest bucket with the margin within which its points are labelled.
    step : PlannedPass
    memory : int
        Memory of the worker, for the buckets that it keeps.
    """
    kept_bytes = held_bytes(memory) if step.pass_.label_margin_m else 0
    bucket_bytes = int(bucket_points * BUCKET_POINT_BYTES)
    return int(BASE_BYTES + window_bytes + bucket_bytes + kept_bytes)


def cores() -> int:
    """Return the number of logical cores that machine, affinity and container allow this process."""
    if hasattr(os, "sched_getaffinity"):
        known = len(os.sched_getaffinity(0))
    else:
        known = psutil.cpu_count() or 1
    return min((known, *_container_cores()))


def default_workers() -> int:
    """Return the default number of workers: one per core, or fewer if one has less than `MIN_WORKER_BYTES`."""
    return max(min(cores(), memory_bytes() // MIN_WORKER_BYTES), 1)


def memory_bytes() -> int:
    """Return the memory of the machine, or of the container if it has less, in bytes."""
    return min((psutil.virtual_memory().total, *_container_limits()))


def fair_share(workers: int) -> int:
    """Return the default memory per worker in bytes.

    The memory is divided by the number of cores, or of workers if there are more workers than
    cores.
    """
    return min(
        max(memory_bytes() // (MACHINE_SHARE * max(workers, cores())), MIN_WORKER_BYTES),
        MAX_WORKER_BYTES,
    )


def _container_limits() -> Iterator[int]:
    """Yield the memory limits of the control groups of this process, in bytes."""
    for group, is_version_2 in _control_groups("memory"):
        name = "memory.max" if is_version_2 else "memory.limit_in_bytes"
        # The text is "max" if there is no limit. The folder of the group may not exist in a
        # container.
        with suppress(OSError, ValueError):
            yield int((group / name).read_text("ascii"))


def _container_cores() -> Iterator[int]:
    """Yield the numbers of cores, rounded up, to which the control groups limit this process."""
    for group, is_version_2 in _control_groups("cpu"):
        names = ("cpu.max",) if is_version_2 else ("cpu.cfs_quota_us", "cpu.cfs_period_us")
        with suppress(OSError, ValueError):
            quota, period = " ".join(
                (group / name).read_text("ascii") for name in names
            ).split()
            if int(quota) > 0:  # Without a limit, the quota is -1.
                yield math.ceil(int(quota) / int(period))


def _control_groups(controller: str) -> Iterator[tuple[Path, bool]]:
    """Yield the folders of this process's control groups and their parents, and whether each is of version 2."""
    try:
        lines = GROUPS.read_text(encoding="ascii").splitlines()
    except OSError:
        return
    for line in lines:
        # Groups of version 2 list no controllers.
        _, controllers, path = line.split(":", 2)
        if controllers and controller not in controllers.split(","):
            continue
        root = CGROUPS / controller if controllers else CGROUPS
        group = PurePosixPath(path.lstrip("/"))
        for relative_path in (group, *group.parents):
            yield root / relative_path, not controllers
