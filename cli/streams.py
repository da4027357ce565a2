"""Standard output and error of a command. It is no error if a reader closes the pipe (``tiler ... | head``)."""

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
    """Let a command write its output to the end, also if its reader has gone, and raise if results cannot be written.

    A run whose output goes to ``| head`` or ``| true`` goes on to its end. A full disk is an error for the results, but
    not for the progress.

    Parameters
    ----------
    own_process : bool
        Whether the process does nothing but this command. Then its streams stay replaced, as Python writes to them at
        the end.
    """
    before = {name: getattr(sys, name) for name in NAMES}
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        for name, stream in before.items():
            if stream is None:  # closed by the program that started the process
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
    """The same stream on top of a `_Patient` one."""
    try:
        raw = _Patient(stream.fileno(), name)
    except OSError:  # the caller put something else in its place
        return stream
    buffered = io.BufferedWriter(raw)
    return io.TextIOWrapper(
        buffered, stream.encoding, stream.errors, line_buffering=bool(stream.line_buffering)
    )


class _Patient(io.FileIO):
    """A standard stream whose writes fail once at most, and not at all for progress, or where the reader has gone."""

    def __init__(self, descriptor: int, called: str) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._called = called
        self._lost = False

    def write(self, data: Any) -> int:
        """Write as long as the stream takes data, and drop the rest."""
        if not self._lost:
            try:
                return super().write(data)
            except OSError as error:
                self._lost = True
                if not isinstance(error, BrokenPipeError) and self._called == "stdout":
                    raise refused_write(self._called, error) from error
        return memoryview(data).nbytes
