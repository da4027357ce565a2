"""Standard output and error of a command; a reader that closes the pipe (``tiler ... | head``) is no error."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from tiler.errors import refused_write

NAMES = ("stdout", "stderr")


@contextmanager
def open_streams(own_process: bool) -> Iterator[None]:
    """Let a command write as if somebody read all of it, and be told where its results cannot be written.

    A run whose output goes to ``| head`` or ``| true`` goes on to its end. What a full disk refuses of the results is
    an error; of the progress it is not.

    Parameters
    ----------
    own_process : bool
        The command is all that this process does: its streams are not given back, as Python writes to them at the end.
    """
    before = {name: getattr(sys, name) for name in NAMES}
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        for name, stream in before.items():
            if stream is None:  # closed by whoever started the process
                setattr(sys, name, nowhere)
            elif own_process:
                setattr(sys, name, _patient(stream, name))
        try:
            yield
        finally:
            for name, stream in before.items():
                if stream is None or not own_process:
                    setattr(sys, name, stream)


def _patient(stream: TextIO, name: str) -> TextIO:
    """The same stream, over a `_Patient` one."""
    try:
        raw = _Patient(stream.fileno(), name)
    except OSError:  # whoever calls put something else in its place
        return stream
    buffered = io.BufferedWriter(raw)
    return io.TextIOWrapper(
        buffered, stream.encoding, stream.errors, line_buffering=bool(stream.line_buffering)
    )


class _Patient(io.FileIO):
    """A standard stream whose writes fail once at most, and not at all where nobody reads or it tells of progress."""

    def __init__(self, descriptor: int, called: str) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._called = called
        self._lost = False

    def write(self, data: Any) -> int:
        """Write what the stream takes; what it does not take any more is dropped."""
        if not self._lost:
            try:
                return super().write(data)
            except OSError as error:
                self._lost = True
                if not isinstance(error, BrokenPipeError) and self._called == "stdout":
                    raise refused_write(self._called, error) from error
        return memoryview(data).nbytes
