"""Checks that an input is still the file that the plan read, when a task reads it again later."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tiler.errors import DiskFullError, InputError, TilerError
from tiler.io.las.headers import LasHeader, read_header
from tiler.io.locations import State, state_of

AGAIN = "run again when nothing writes to it any more"


@contextmanager
def unchanged(path: Path, stamp: list[Any] | None, salvage: bool) -> Iterator[LasHeader]:
    """The header of a file that has this stamp now, and still has it when its reader is done.

    Parameters
    ----------
    path : Path
    stamp : list, optional
        `LasHeader.stamp` as the plan found it; None: the file is taken as it is when it is opened.
    salvage : bool
        As `tiler.io.las.headers.read_header` takes it.

    Raises
    ------
    InputError
        The file is another one than before, or became one while it was read.
    """
    try:
        header = read_header(path, salvage)
        if stamp is not None and header.stamp != list(stamp):
            raise _changed(path, State(*stamp[:3]), header.state)
        yield header
    except DiskFullError:
        raise
    except TilerError:  # what is half written cannot be decoded: that is not what is wrong with it
        if stamp is not None:
            refuse_changed(path, State(*stamp[:3]))
        raise
    refuse_changed(path, header.state)


def refuse_changed(path: Path, state: State) -> None:
    """Raise InputError if a file is not what it was."""
    try:
        now = state_of(path)
    except OSError as error:
        raise InputError(
            f"{path}: went away while the run went on ({error.strerror or error}); {AGAIN}"
        ) from error
    if now != state:
        raise _changed(path, state, now)


def _changed(path: Path, before: State, now: State) -> InputError:
    how = (
        f"{before.size:,} bytes before, {now.size:,} now"
        if before.size != now.size
        else "as large as before, with another time, tag or header"
    )
    return InputError(f"{path}: was replaced or written to while the run went on ({how}); {AGAIN}")
