"""Writing of files into a folder or to a URL, completely or not at all, with their records."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tiler.export.records import FileRecord
from tiler.export.work import OutFile
from tiler.io.atomic_files import write_atomic
from tiler.io.cloud_reading import digest_of_file
from tiler.io.locations import as_path, staging_folder, state_of
from tiler.io.raster_files import raster_errors
from tiler.store import TileStore


@dataclass
class NewFile:
    """File that is written: its path on this machine, and its record, which exists once the file is complete."""

    path: Path
    record: FileRecord = field(init=False)


@contextmanager
def new_file(to: OutFile) -> Iterator[NewFile]:
    """Yield a new file. When the block ends, the file is in place and its ``record`` is set."""
    with staging_folder(to.out) as folder:
        file = NewFile(folder / to.name)
        yield file
        n_bytes, digest = file.path.stat().st_size, digest_of_file(file.path)
    state = state_of(as_path(to.location)).to_json()
    file.record = FileRecord(path=to.name, bytes=n_bytes, digest=digest, state=state)


def write_bytes(to: OutFile, content: bytes) -> FileRecord:
    """Write a small file and return its `FileRecord`. Raise ProcessingError if it cannot be written."""
    with new_file(to) as file, raster_errors(file.path):
        write_atomic(file.path, content)
    return file.record


def write_text(_: TileStore, *, to: OutFile, text: str) -> FileRecord:
    """Write a small file of text, and return its `FileRecord`."""
    return write_bytes(to, text.encode())
