"""Temporary folder of a check, with a locked file, so that the next check knows if its process was killed."""

from __future__ import annotations

import platform
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Any

from tiler.io.atomic_files import SCRATCH_PREFIX, replace_file

try:
    import fcntl
except ImportError:  # Windows does not have this module.
    _fcntl: Any = None
else:
    _fcntl = fcntl

PREFIX = f"{SCRATCH_PREFIX}check-{platform.node()}-"
"""Prefix of the folders of this machine, since locks of a shared disk may be those of one machine alone."""
_LOCK = "lock"
"""Name of the file that the process of a folder keeps locked. A folder without it is not removed."""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield a temporary folder that is removed at the end, after those of checks that were killed."""
    for folder in Path(gettempdir()).glob(f"{PREFIX}*"):
        if _is_abandoned(folder):
            shutil.rmtree(folder, ignore_errors=True)
    with TemporaryDirectory(prefix=PREFIX) as name, _locked(Path(name)):
        yield Path(name)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keep the file `_LOCK` of a folder locked. Windows does not remove a file that is open."""
    # It has its name only once it is locked, so that no other check takes it for abandoned.
    name = _LOCK if _fcntl is None else f"{_LOCK}.new"
    with open(folder / name, "xb") as stream:
        if _fcntl is not None:
            with suppress(OSError):  # Some disks of a network have no locks.
                _fcntl.flock(stream, _fcntl.LOCK_EX)
                replace_file(folder / name, folder / _LOCK)
        yield


def _is_abandoned(folder: Path) -> bool:
    lock = folder / _LOCK
    try:
        if _fcntl is None:
            lock.unlink()
        else:
            with open(lock, "r+b") as stream:
                _fcntl.flock(stream, _fcntl.LOCK_EX | _fcntl.LOCK_NB)
    except OSError:
        return False
    return True
