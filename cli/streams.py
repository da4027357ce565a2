"""Standard output and error of a command, which may lose their reader without an error (``tiler ... | head``)."""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from tiler.errors import write_error

NAMES = ("stdout", "stderr")


@contextmanager
def open_streams(own_process: bool) -> Iterator[None]:
    """Let a command continue if the reader of its output has gone, but raise if results cannot be written.

    A run that is piped to ``head`` or ``true`` continues to its end. A full disk is an error
    for the results on stdout, but not for the progress on stderr.

    Parameters
    ----------
    own_process : bool
        Whether the process runs only this command. Then its streams stay replaced, because Python writes to them when
        it exits.
    """
    previous_streams = {name: getattr(sys, name) for name in NAMES}
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        for name, stream in previous_streams.items():
            if stream is None:  # closed by the program that started the process
                setattr(sys, name, nowhere)
            elif own_process:
                setattr(sys, name, _patient(stream, name))
        try:
            yield
        finally:
            for name, stream in previous_streams.items():
                if stream is None or not own_process:
                    setattr(sys, name, stream)


def _patient(stream: TextIO, name: str) -> TextIO:
    """Return a text stream like ``stream`` that writes through a `_Patient`."""
    try:
        raw = _Patient(stream.fileno(), name)
    except OSError:  # the caller replaced the stream by an object without a descriptor
        return stream
    buffered = io.BufferedWriter(raw)
    return io.TextIOWrapper(
        buffered, stream.encoding, stream.errors, line_buffering=bool(stream.line_buffering)
    )


class _Patient(io.FileIO):
    """Standard stream that drops output after an error. It raises the error only on stdout with a reader."""

    def __init__(self, descriptor: int, called: str) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._called = called
        self._lost = False

    def write(self, data: Any) -> int:
        """Write the data, or drop them after the first failure."""
        if not self._lost:
            try:
                return super().write(data)
            except OSError as error:
                self._lost = True
                if not _reader_has_gone(error) and self._called == "stdout":
                    raise write_error(self._called, error) from error
        return memoryview(data).nbytes


def _reader_has_gone(error: OSError) -> bool:
    # Windows has no own error for this.
    return isinstance(error, BrokenPipeError) or (
        os.name == "nt" and error.errno == errno.EINVAL
    )
