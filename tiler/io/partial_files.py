"""Files that get their name only once they are whole; until then they have a temporary name in the same folder."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tiler.errors import first_line

_ONE_MORE_BYTES = 1 << 22
LONGEST_NAME = 255
"""Longest name of a file on most file systems, in bytes."""

IN_USE = (5, 32)
"""Numbers of Windows' errors for a file that another process has open."""
IN_USE_SECONDS = 5.0
"""Time for which such a file is tried again: a scanner of new files has each of them open for a moment."""

SCRATCH_PREFIX = ".tiler-"
"""Beginning of the names of all temporary files and folders of tiler."""


def name_bytes(path: str | Path) -> int:
    """Bytes of the name of a file, without its folder."""
    return len(os.fsencode(os.path.basename(path)))


def partial_path(target: Path, kind: str = "") -> Path:
    """The temporary path of a file until it is whole, in the same folder.

    Parameters
    ----------
    target : Path
        Final path of the file.
    kind : str
        Distinguishes several temporary files of one target.
    """
    name = f"{SCRATCH_PREFIX}{target.name}{kind and f'.{kind}'}.partial"
    if name_bytes(name) > LONGEST_NAME:
        short = hashlib.blake2b(os.fsencode(name), digest_size=16).hexdigest()
        name = f"{SCRATCH_PREFIX}{short}.partial"
    return target.with_name(name)


@contextmanager
def appearing(target: Path) -> Iterator[Path]:
    """Give a temporary path to write to; the file replaces ``target`` if the block ends without an error."""
    partial = partial_path(target)
    try:
        yield partial
        replace_file(partial, target)
    finally:
        with suppress(OSError):  # an error of the block must not be hidden
            partial.unlink(missing_ok=True)


def replace_file(source: str | Path, target: str | Path) -> None:
    """Give a file another name, in place of the file that has it; raises OSError.

    Windows refuses this while a process has one of the files open, so there it is tried for `IN_USE_SECONDS`.
    """
    began = time.monotonic()
    while True:
        try:
            os.replace(source, target)
            return
        except PermissionError as error:
            waits = getattr(error, "winerror", None) in IN_USE  # other systems have no such number
            if not waits or time.monotonic() - began > IN_USE_SECONDS:
                raise
            time.sleep(0.05)


def cause_of(partial: Path, error: BaseException) -> Exception:
    """The reason why GDAL could not write a file.

    GDAL does not say that a disk is full or that a file may not grow, so one more write asks the system. If that write
    succeeds, the reason is the first error in the chain, which is GDAL's own.
    """
    try:
        if is_scratch(partial.name) and partial.exists():
            with open(partial, "ab") as stream:
                stream.write(bytes(_ONE_MORE_BYTES))
                stream.flush()
                os.fsync(stream.fileno())
    except OSError as refused:
        return refused
    while error.__cause__ is not None:
        error = error.__cause__
    return error if isinstance(error, Exception) else Exception(first_line(error))


def write_whole(target: Path, content: bytes) -> None:
    """Write a file that gets its name once it is whole and on the disk; raises OSError."""
    with appearing(target) as partial, open(partial, "wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def is_scratch(name: str) -> bool:
    """Whether `partial_path` makes such a name, or GDAL or SQLite derive it from one while they write."""
    if not name.startswith(SCRATCH_PREFIX):
        return False
    return name.endswith(".partial") or ".partial." in name or ".partial-" in name


def sync_folder(folder: Path) -> None:
    """Write the names in a folder to the disk, if the system can open folders; raises OSError."""
    if not hasattr(os, "O_DIRECTORY"):  # Windows
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
