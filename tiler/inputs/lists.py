"""Reading of lists of clouds (``.vpc``, EPT) in a child process with limits, as for untrusted data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from tiler.io.locations import as_path
from tiler.schedule import call_isolated
from tiler.schedule.guard import MEMORY_BYTES

Read = TypeVar("Read")

LIST_BYTES = 1 << 28
"""Maximum size of a list in bytes. pdal_wrench writes some kilobytes per cloud."""
MAX_CLOUDS = 1 << 18
"""Maximum number of clouds in a list. A URL takes 1.4 kB of memory before any cloud is read."""
LIST_SECONDS = 300.0
"""Maximum time in seconds for reading a whole ``.vpc`` or hierarchy, however slow its server
is."""


def read_list(
    text: str, function: Callable[..., Read], *arguments: Any, in_process: bool = False
) -> Read:
    """Call ``function(*arguments)`` in a child process and return its result.

    Parameters
    ----------
    text : str
        Path or URL of the list.
    function : callable
        Function of a module, since function, arguments and result are pickled.
    in_process : bool
        Call the function in this process, without limits.

    Raises
    ------
    InputError
        The list cannot be read within `LIST_SECONDS` and `MEMORY_BYTES`.
    """
    if in_process:
        return function(*arguments)
    return call_isolated(
        function,
        *arguments,
        paths=(as_path(text),),
        memory_bytes=MEMORY_BYTES,
        seconds=LIST_SECONDS,
        remedy="get it again, or give the clouds themselves",
        smaller="give the clouds themselves",
    )
