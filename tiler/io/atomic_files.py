"""Files that get their name once they are complete. Until then they have a temporary name in the same folder."""

from __future__ import annotations

import filecmp
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tiler.core.file_names import without_links
from tiler.core.records import digest_of_bytes
from tiler.errors import first_line, is_in_use

_ONE_MORE_BYTES = 1 << 22
MAX_NAME_LENGTH = 255
"""Length of the longest file name on most file systems, in bytes."""

IN_USE_SECONDS = 5.0
"""Time for retries for a file in use, since virus scanners open each new file for a
moment."""

SCRATCH_PREFIX = ".tiler-"
"""Prefix of the names of temporary files and folders outside of a store."""

_DERIVED_SUFFIXES = (".ovr", ".ovr.tmp", ".msk", ".msk.ovr.tmp", ".aux.xml", "-journal", "-wal")
"""Suffixes, after the name of a temporary file, of the files that GDAL and SQLite write next to it."""


def name_bytes(path: str | Path) -> int:
    """Return the length of the name of a file, without its folder, in bytes."""
    return len(os.fsencode(os.path.basename(path)))


def partial_path(target: Path, kind: str = "") -> Path:
    """Return the temporary path of a file until it is complete, in the same folder.

    Parameters
    ----------
    target : Path
        Final path of the file.
    kind : str
        Text that distinguishes several temporary files of one target.
    """
    name = f"{SCRATCH_PREFIX}{target.name}{kind and f'.{kind}'}.partial"
    if name_bytes(name) > MAX_NAME_LENGTH:
        short = digest_of_bytes(os.fsencode(name))
        name = f"{SCRATCH_PREFIX}{short}.partial"
    return target.with_name(name)


def clear_partial(partial: Path) -> None:
    """Remove what is at a temporary path before a file is written there. Raise OSError if this fails.

    It is a file of a killed run, or a link that another user made, since the name is known. A
    write through such a link would change the file to which it leads. GDAL and SQLite would also
    write through links with the names of their further files.
    """
    partial.unlink(missing_ok=True)
    for suffix in _DERIVED_SUFFIXES:
        derived = partial.with_name(f"{partial.name}{suffix}")
        if os.path.lexists(derived):
            derived.unlink(missing_ok=True)


@contextmanager
def atomic_path(target: Path) -> Iterator[Path]:
    """Yield a temporary path for a file that replaces ``target`` if the block succeeds."""
    partial = partial_path(target)
    clear_partial(partial)
    try:
        yield partial
        replace_different(partial, target)
    finally:
        with suppress(OSError):  # This error must not hide an error of the block.
            partial.unlink(missing_ok=True)


def replace_different(source: str | Path, target: str | Path) -> None:
    """Rename a file as `replace_file` does, but leave a file with the same bytes as it is, with its time."""
    if os.path.isfile(target) and filecmp.cmp(source, target, shallow=False):
        os.unlink(source)
    else:
        replace_file(source, target)


def replace_file(source: str | Path, target: str | Path) -> None:
    """Rename a file, in place of a file with the new name. Raise OSError if this fails.

    Windows refuses this while a process has one of the files open, so it is retried for
    `IN_USE_SECONDS` there.
    """
    began = time.monotonic()
    while True:
        try:
            os.replace(source, target)
            return
        except PermissionError as error:
            if not is_in_use(error) or time.monotonic() - began > IN_USE_SECONDS:
                raise
            time.sleep(0.05)


def cause_of(partial: Path, error: BaseException) -> Exception:
    """Return the reason why GDAL could not write a file.

    GDAL does not report that a disk is full or that a file may not grow, so one more write
    shows the system's error. If this write succeeds, the reason is the first error in the
    chain, which is GDAL's own.
    """
    try:
        if is_scratch(partial.name) and partial.exists():
            with open(partial, "ab", opener=without_links) as stream:
                stream.write(bytes(_ONE_MORE_BYTES))
                stream.flush()
                os.fsync(stream.fileno())
    except OSError as refused:
        return refused
    while error.__cause__ is not None:
        error = error.__cause__
    return error if isinstance(error, Exception) else Exception(first_line(error))


def write_atomic(target: Path, content: bytes) -> None:
    """Write a file that gets its name once it is complete and on the disk. Raise OSError if this fails."""
    with atomic_path(target) as partial, open(partial, "xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def is_scratch(name: str) -> bool:
    """Return whether a name is from `partial_path`, or GDAL or SQLite derived it from such a name while writing."""
    if not name.startswith(SCRATCH_PREFIX):
        return False
    return name.endswith(".partial") or ".partial." in name or ".partial-" in name


def sync_folder(folder: Path) -> None:
    """Write the names in a folder to the disk, if the system can open folders. Raise OSError if this fails."""
    if not hasattr(os, "O_DIRECTORY"):  # Windows cannot open folders.
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
