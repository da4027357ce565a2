"""Cores and memory that this process may use."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

import psutil

MIN_BYTES = 512 << 20
"""Smallest default memory of a worker. Hardly any window fits into less."""
MAX_BYTES = 4 << 30
"""Largest default memory of a worker. More does not make runs faster."""
SHARE = 2
"""Ratio of the memory of the machine to the default memory of all workers together. The rest is
for the system and its cache."""
CGROUPS = Path("/sys/fs/cgroup")
"""Folder with the limits of control groups."""
GROUPS = Path("/proc/self/cgroup")
"""File that lists the control groups of this process."""


def cores() -> int:
    """Return the number of logical cores that machine, affinity and container allow this process."""
    if hasattr(os, "sched_getaffinity"):
        known = len(os.sched_getaffinity(0))
    else:
        known = psutil.cpu_count() or 1
    return min((known, *_container_cores()))


def default_workers() -> int:
    """Return the default number of workers: one per core, or fewer if the memory is below `MIN_BYTES` per core."""
    return max(min(cores(), memory_bytes() // MIN_BYTES), 1)


def memory_bytes() -> int:
    """Return the memory of the machine, or of the container if it has less, in bytes."""
    return min((psutil.virtual_memory().total, *_container_limits()))


def fair_share(workers: int) -> int:
    """Return the default memory per worker in bytes.

    The memory is divided by the number of cores, or of workers if there are more workers than
    cores.
    """
    return min(max(memory_bytes() // (SHARE * max(workers, cores())), MIN_BYTES), MAX_BYTES)


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
