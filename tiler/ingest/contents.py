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
    """``files``: place of each file that is read, and the state in which it was found."""

    files: tuple[tuple[str, FileState], ...]


def read_files(store_url: str, work: ReadFiles) -> dict[str, Any]:
    """On a worker: place -> ``content``, or ``error``, of some files."""
    found = {}
    for place, state in work.files:
        try:
            found[place] = {"content": _content(as_path(place), state)}
        except InputError as error:
            found[place] = {"error": str(error)}
    return found


def _content(path: Path, state: FileState) -> str:
    """Digest of all bytes of a file that is in this state before and after they are read; raises InputError."""
    validate_unchanged(path, state)
    try:
        digest = digest_of_file(path)
    except OSError as error:
        validate_unchanged(path, state)
        reason = error.strerror or error
        raise InputError(f"{path}: cannot be read ({reason}); check the disk and the permissions") from error
    validate_unchanged(path, state)
    return digest
