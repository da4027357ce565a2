"""Digests of whole files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tiler.core.records import Record
from tiler.errors import InputError
from tiler.io.cloud_reading import digest_of_file
from tiler.io.las.reader import validate_unchanged
from tiler.io.locations import FileState, as_path, reading_remedy


@dataclass(frozen=True)
class ReadFiles:
    """Arguments of `read_files`: location and state of each file, as found by the plan."""

    files: tuple[tuple[str, FileState], ...]


@dataclass(frozen=True, slots=True)
class DigestsRecord(Record):
    """Record of files: digest of all bytes, or error, of each file by its location."""

    digests: dict[str, str]
    errors: dict[str, str]


def read_files(store_url: str, work: ReadFiles) -> DigestsRecord:
    """Read all bytes of some files. This is a `tiler.schedule.task.Work`."""
    record = DigestsRecord({}, {})
    for location, state in work.files:
        try:
            record.digests[location] = _digest(as_path(location), state)
        except InputError as error:
            record.errors[location] = str(error)
    return record


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
