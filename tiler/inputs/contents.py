"""Digests of whole files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tiler.errors import InputError
from tiler.io.cloud_reading import digest_of_file
from tiler.io.las.reader import validate_unchanged
from tiler.io.locations import FileState, as_path, reading_remedy
from tiler.store import TileStore


def read_files(
    _: TileStore, *, files: tuple[tuple[str, FileState], ...]
) -> Mapping[str, dict[str, str]]:
    """Read all bytes of some files, given their locations and their states as found by the plan.

    Returns
    -------
    dict
        ``digests`` and ``errors``: digest of all bytes, or error, of each file by its location.
    """
    digests, errors = dict[str, str](), dict[str, str]()
    for location, state in files:
        try:
            digests[location] = _digest(as_path(location), state)
        except InputError as error:
            errors[location] = str(error)
    return {"digests": digests, "errors": errors}


def _digest(path: Path, state: FileState) -> str:
    """Return the digest of all bytes of a file.

    Raise InputError if the file cannot be read, or is not in ``state`` before and after
    reading.
    """
    validate_unchanged(path, state)
    try:
        digest = digest_of_file(path)
    except OSError as error:
        validate_unchanged(path, state)
        reason = error.strerror or error
        raise InputError(
            f"{path}: cannot be read ({reason}); {reading_remedy(path, 'check the disk and the permissions')}"
        ) from error
    validate_unchanged(path, state)
    return digest
