"""Digests of whole files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tiler.errors import InputError
from tiler.io.cloud_reading import digest_of_file
from tiler.io.las.unchanged import validate_unchanged
from tiler.io.locations import FileState, as_path


@dataclass(frozen=True)
class ReadFiles:
    """Arguments of `read_files`: location and state of each file, as found by the plan."""

    files: tuple[tuple[str, FileState], ...]


def read_files(store_url: str, work: ReadFiles) -> dict[str, Any]:
    """Return the ``content`` (digest) or the ``error`` of some files by their location.

    This is the function of a task.
    """
    results = {}
    for location, state in work.files:
        try:
            results[location] = {"content": _content(as_path(location), state)}
        except InputError as error:
            results[location] = {"error": str(error)}
    return results


def _content(path: Path, state: FileState) -> str:
    """Return the digest of all bytes of a file.

    Raise InputError if the file cannot be read, or is not in ``state`` before and after reading.
    """
    validate_unchanged(path, state)
    try:
        digest = digest_of_file(path)
    except OSError as error:
        validate_unchanged(path, state)
        reason = error.strerror or error
        raise InputError(f"{path}: cannot be read ({reason}); check the disk and the permissions") from error
    validate_unchanged(path, state)
    return digest
