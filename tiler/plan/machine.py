"""What this process may use of the machine: cores, and memory."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

import psutil

LEAST_BYTES, MOST_BYTES = 512 << 20, 4 << 30
"""Memory of a worker by default: with less little fits, more makes no run faster."""
SHARE = 2
"""The workers together take this part of the memory by default; the rest is the system's, and its cache of files."""
CGROUPS, GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
"""Where the limits of control groups are, and where those are named that this process is in."""


def cores() -> int:
    """Logical cores that this process may use: of the machine, its set of cores, and its container."""
    known = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else psutil.cpu_count()
    return min((known or 1, *_container_cores()))


def default_workers() -> int:
    """Workers where the user does not say how many: one a core, fewer where memory has not `LEAST_BYTES` for each."""
    return max(min(cores(), memory_bytes() // LEAST_BYTES), 1)


def memory_bytes() -> int:
    """Memory of the machine, or of the container where that is less."""
    return min((psutil.virtual_memory().total, *_container_limits()))


def fair_share(workers: int) -> int:
    """Bytes that each of some workers may use where the user does not say it; fewer than cores get no more."""
    return min(max(memory_bytes() // (SHARE * max(workers, cores())), LEAST_BYTES), MOST_BYTES)


def _container_limits() -> Iterator[int]:
    """Bytes that the control groups of this process allow, as far as they limit them."""
    for group, newer in _control_groups("memory"):
        with suppress(
            OSError, ValueError
        ):  # "max", or a group that is not to be seen from within a container
            yield int((group / ("memory.max" if newer else "memory.limit_in_bytes")).read_text("ascii"))


def _container_cores() -> Iterator[int]:
    """Cores, rounded up, that the control groups of this process allow, as far as they limit them."""
    for group, newer in _control_groups("cpu"):
        names = ("cpu.max",) if newer else ("cpu.cfs_quota_us", "cpu.cfs_period_us")
        with suppress(OSError, ValueError):
            quota, period = " ".join((group / name).read_text("ascii") for name in names).split()
            if int(quota) > 0:  # -1: no limit
                yield math.ceil(int(quota) / int(period))


def _control_groups(controller: str) -> Iterator[tuple[Path, bool]]:
    """Folders of the control groups, and those above them, of this process; True for those of version 2."""
    try:
        lines = GROUPS.read_text(encoding="ascii").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers and controller not in controllers.split(","):
            continue
        root, group = CGROUPS / controller if controllers else CGROUPS, PurePosixPath(path.lstrip("/"))
        yield from ((root / place, not controllers) for place in (group, *group.parents))
