"""Writing of files into a folder or to a URL, completely or not at all, with their records."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tiler.export.work import WriteText
from tiler.io.atomic_files import write_atomic
from tiler.io.cloud_reading import digest_of_file
from tiler.io.geotiff import raster_errors
from tiler.io.locations import as_path, joined, staging_folder, state_of


@contextmanager
def new_file(out: str, name: str) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield a path for a new file, and its record, which is filled when the block ends.

    Parameters
    ----------
    out : str
        Existing folder, or a URL.
    name : str
        Name of the file.

    Yields
    ------
    Path
        Path on this machine to which the file is written.
    dict
        Record: ``path`` (the file's name), ``bytes``, ``digest`` (of all bytes), ``state`` (a
        `tiler.io.locations.FileState`).
    """
    record: dict[str, Any] = {}
    with staging_folder(out) as folder:
        target = folder / name
        yield target, record
        record |= {"path": name, "bytes": target.stat().st_size, "digest": digest_of_file(target)}
    record["state"] = state_of(as_path(joined(out, name))).to_json()


def write_bytes(out: str, name: str, content: bytes) -> dict[str, Any]:
    """Write a small file and return the record of `new_file`. Raise ProcessingError if it cannot be written."""
    with new_file(out, name) as (target, record), raster_errors(target):
        write_atomic(target, content)
    return record


def write_text(store_url: str, work: WriteText) -> dict[str, Any]:
    """Write ``<out>/<name>`` and return the record of `new_file` (a `tiler.schedule.task.Work`)."""
    return write_bytes(work.out, work.name, work.text.encode())
