"""Points that occur twice: with the same x, y, z and GPS time, in one file or in several.

Each point becomes a digest of 128 bits. The digests of a file are divided among temporary files by their highest bits,
and compared file by file, so that memory does not grow with the points. Only the digests of points in the bounds of
another input are kept until all inputs were read. Their folder is a temporary one with a locked file, so that the next
check knows if its process was killed.
"""

from __future__ import annotations

import platform
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Any

import numpy as np

from ptd.arrays import Float64, Indices, UInt64
from tiler.errors import write_error
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
COORDINATE_STEP = 1e-5
"""Largest difference, in units of the CRS, of coordinates that are equal. Files store the same position with different
rounding errors if their offsets differ."""

DIGESTS_PER_PART = 2_000_000
"""Mean number of digests in a temporary file, which is compared in memory."""

_LANES = ((0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9), (0xD1B54A32D192ED03, 0x94D049BB133111EB))
"""First value and odd factor of each half of a digest (Steele et al. 2014, OOPSLA, SplitMix)."""

Digests = UInt64


def digests(coordinates: Sequence[Float64], times: Float64 | None) -> Digests:
    """Return the digests of points, uint64, shape (n, 2).

    Parameters
    ----------
    coordinates : sequence of float64, shape (n,)
        x, y and z in units of the CRS.
    times : float64, shape (n,), or None
        GPS times, or None if the points have none.
    """
    # Adding 0.0 turns -0.0 into 0.0.
    columns = [np.rint(axis / COORDINATE_STEP) + 0.0 for axis in coordinates]
    if times is not None:
        columns.append(times + 0.0)
    found = np.empty((len(columns[0]), 2), np.uint64)
    for lane, (start, factor) in enumerate(_LANES):
        mixed = np.full(len(found), start, np.uint64)
        for column in columns:
            mixed ^= column.view(np.uint64)
            mixed *= np.uint64(factor)
            mixed ^= mixed >> np.uint64(29)
        found[:, lane] = mixed * np.uint64(factor)
    return found


def number_of_parts(points: int) -> int:
    """Return the number of parts for some points, a power of two."""
    return 1 << max(-(-points // DIGESTS_PER_PART) - 1, 0).bit_length()


class DigestFiles:
    """Digests in temporary files, divided by their highest bits.

    Parameters
    ----------
    folder : Path
        Folder that exists.
    name : str
        Beginning of the names of the files.
    n_parts : int
        Number of files, a power of two.
    """

    def __init__(self, folder: Path, name: str, n_parts: int) -> None:
        self._folder, self._name, self._n = folder, name, n_parts

    def path(self, part: int) -> Path:
        """Return the path of a part, which exists if it has digests."""
        return self._folder / f"{self._name}-{part}"

    def add(self, found: Digests) -> None:
        """Append digests, uint64, shape (n, 2). Raise DiskFullError if the disk is full."""
        if not len(found):
            return
        if self._n > 1:
            parts = found[:, 0] >> np.uint64(65 - self._n.bit_length())
            order = np.argsort(parts.astype(np.uint16), kind="stable")
            found = found[order]
            ends = np.searchsorted(parts[order], np.arange(self._n), side="right")
        else:
            ends = np.array([len(found)])
        start = 0
        for part, end in enumerate(ends.tolist()):
            if end > start:
                self._append(self.path(part), found[start:end])
            start = end

    def _append(self, path: Path, found: Digests) -> None:
        try:
            with open(path, "ab") as stream:
                stream.write(found.tobytes())
        except OSError as error:
            raise write_error(str(path), error, self._folder) from error

    def take(self) -> Iterator[Digests]:
        """Yield the digests of each part, uint64, shape (n, 2), and remove its file."""
        for part in range(self._n):
            yield read_digests(self.path(part))
            self.path(part).unlink(missing_ok=True)


def read_digests(path: Path) -> Digests:
    """Return the digests in a file, or none if it does not exist."""
    if not path.exists():
        return np.empty((0, 2), np.uint64)
    return np.fromfile(path, np.uint64).reshape(-1, 2)


def repeated(found: Digests) -> Indices:
    """Return the rows of the digests, shape (n, 2), that equal that of an earlier row."""
    halves = np.sort(found[:, 0])
    again = np.unique(halves[1:][halves[1:] == halves[:-1]])
    if not again.size:
        return np.empty(0, np.intp)
    # Only these few need to be compared as a whole.
    at = np.minimum(np.searchsorted(again, found[:, 0]), again.size - 1)
    rows = np.flatnonzero(again[at] == found[:, 0])
    _, first = np.unique(found[rows], axis=0, return_index=True)
    return np.delete(rows, first)


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
