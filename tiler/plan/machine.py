"""What the machine has: cores, and the memory that this process may use of it."""

from __future__ import annotations

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
    """Logical cores of the machine."""
    return psutil.cpu_count() or 1


def memory_bytes() -> int:
    """Memory of the machine, or of the container where that is less."""
    return min((psutil.virtual_memory().total, *_container_limits()))


def fair_share(workers: int) -> int:
    """Bytes that each of some workers may use where the user does not say it; fewer than cores get no more."""
    return min(max(memory_bytes() // (SHARE * max(workers, cores())), LEAST_BYTES), MOST_BYTES)


def _container_limits() -> list[int]:
    """Limits of the control groups that this process is in, of either version; none where there is no limit."""
    found = []
    try:
        groups = GROUPS.read_text(encoding="ascii").splitlines()
    except OSError:
        return []
    for line in groups:
        _, controllers, path = line.split(":", 2)
        name = "memory.max" if not controllers else "memory.limit_in_bytes"
        if controllers and "memory" not in controllers.split(","):
            continue
        root = CGROUPS / "memory" if controllers else CGROUPS
        group = PurePosixPath(path.lstrip("/"))
        for place in (group, *group.parents):
            with suppress(
                OSError, ValueError
            ):  # "max", or a group that is not to be seen from within a container
                found.append(int((root / place / name).read_text(encoding="ascii")))
    return found
