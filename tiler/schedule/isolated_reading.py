"""Reads files of unknown origin in a child process with limits of time and memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import psutil

from tiler.errors import InputError, ProcessingError
from tiler.io.locations import stat_cloud
from tiler.schedule.guard import MEMORY_BYTES, Died, Guard, NotStartedError

Result = TypeVar("Result")

LEAST_SECONDS = 60.0
BYTES_PER_SECOND = 1e6
"""Slower than any disk and decoder: reading all of a file may take so long."""


def seconds_for(paths: Sequence[Path]) -> float:
    """How long reading some files may take; one that is not there counts nothing. Raises OSError."""
    size = 0
    for path in paths:
        try:
            size += stat_cloud(path).st_size
        except (FileNotFoundError, NotADirectoryError):
            continue  # who reads it says so
    return LEAST_SECONDS + size / BYTES_PER_SECOND


def read_apart(
    function: Callable[..., Result], *arguments: Any, paths: Sequence[Path], memory_bytes: int = MEMORY_BYTES
) -> Result:
    """``function(*arguments)`` in a child process of its own.

    A small file can hold a view without end, or claim to be a raster of a million times a million pixels.

    Parameters
    ----------
    function : callable
        Of a module; arguments and result are pickled.
    paths : sequence of Path
        The files that it reads: their sizes say how long it may take, and the first is named if it fails.
    memory_bytes : int
        What it may allocate.

    Raises
    ------
    InputError
        Reading crashed, took too long, or needed too much memory.
    Exception
        What the function raised.
    """
    names = ", ".join(map(str, paths))
    try:
        with Guard(memory_bytes) as guard:
            return guard.call(function, *arguments, seconds=seconds_for(paths))
    except NotStartedError as error:
        raise ProcessingError(
            f"{names}: the process that reads it {error}; end other programs, then run again"
        ) from error
    except Died as died:
        raise InputError(f"{names}: the process that reads it {died}; get the file again") from died


def half_of_memory() -> int:
    """Bytes that reading may take where that grows with what is compared, or with the blocks of a raster."""
    return psutil.virtual_memory().total // 2
