"""Files that get their name only when they are whole: until then they have a name of tiler's own beside it."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

LONGEST_NAME = 255
"""Bytes of the name of a file, on most file systems."""


SCRATCH_PREFIX = ".tiler-"
"""How the names of files and folders begin that are tiler's own and nobody else's."""


def partial_path(target: Path, kind: str = "") -> Path:
    """Where a file is written until it is whole: a name of tiler's own beside it, that no file of the user has.

    Parameters
    ----------
    target : Path
        The file's final name.
    kind : str
        Tells several such files of one target apart.
    """
    name = f"{SCRATCH_PREFIX}{target.name}{kind and f'.{kind}'}.partial"
    if len(os.fsencode(name)) > LONGEST_NAME:
        short = hashlib.blake2b(os.fsencode(name), digest_size=16).hexdigest()
        name = f"{SCRATCH_PREFIX}{short}.partial"
    return target.with_name(name)


@contextmanager
def appearing(target: Path) -> Iterator[Path]:
    """Where to write a file that gets its name, and replaces what has it, only when the block ends well."""
    partial = partial_path(target)
    try:
        yield partial
        os.replace(partial, target)
    finally:
        with suppress(OSError):  # what went wrong before is what is told
            partial.unlink(missing_ok=True)


def write_whole(target: Path, content: bytes) -> None:
    """Write a file that appears when it is whole and on the disk; raises OSError."""
    with appearing(target) as partial, open(partial, "wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def is_scratch(name: str) -> bool:
    """Whether a name is one that `partial_path` makes, or that GDAL and SQLite make of it while they write."""
    return name.startswith(SCRATCH_PREFIX) and (
        name.endswith(".partial") or ".partial." in name or ".partial-" in name
    )


def sync_folder(folder: Path) -> None:
    """Make the names in a folder last, where the system can open folders; raises OSError."""
    if not hasattr(os, "O_DIRECTORY"):  # Windows
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
