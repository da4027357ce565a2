"""Check that an input has not changed when a task reads it after the plan."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tiler.errors import DiskFullError, InputError, TilerError
from tiler.io.las.headers import LasHeader, read_header
from tiler.io.locations import FileState, state_of

AGAIN = "run again once the file is complete"


@contextmanager
def unchanged(path: Path, stamp: list[Any] | None, salvage: bool) -> Iterator[LasHeader]:
    """Yield the header of a file, and check before and after the block that the file has not changed.

    Parameters
    ----------
    path : Path
    stamp : list, optional
        `LasHeader.stamp` in the plan, or None to check only that the file does not change during the block.
    salvage : bool
        See `tiler.io.las.headers.read_header`.

    Raises
    ------
    InputError
        The file has changed.
    """
    try:
        header = read_header(path, salvage)
        if stamp is not None and header.stamp != list(stamp):
            raise _changed(path, FileState(*stamp[:3]), header.state)
        yield header
    except DiskFullError:
        raise
    except TilerError:
        # A partly written file cannot be decoded, and its change is the true cause.
        if stamp is not None:
            validate_unchanged(path, FileState(*stamp[:3]))
        raise
    validate_unchanged(path, header.state)


def validate_unchanged(path: Path, state: FileState) -> None:
    """Raise InputError if a file is no longer in this state."""
    try:
        now = state_of(path)
    except OSError as error:
        raise InputError(
            f"{path}: was removed during the run ({error.strerror or error}); {AGAIN}"
        ) from error
    if now != state:
        raise _changed(path, state, now)


def _changed(path: Path, before: FileState, now: FileState) -> InputError:
    how = "as large as before, with another time, tag or header"
    if before.size != now.size:
        how = f"{before.size:,} bytes before, {now.size:,} now"
    return InputError(f"{path}: was replaced or changed during the run ({how}); {AGAIN}")
