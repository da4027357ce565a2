"""``events.jsonl``: every event of every run on an OUT, one JSON object a line."""

from __future__ import annotations

import errno
import json
import os
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from tiler.errors import refused_write


class EventLog:
    """A listener that appends each event to a file; a context manager that closes it.

    A line is written whole and flushed at once, so that the file can be followed while the run works and
    holds everything up to a crash. A line that a killed run left unfinished is ended before the next is written.

    Parameters
    ----------
    path : Path
        The file; it is created with its folder, or continued.

    Raises
    ------
    ProcessingError
        The file cannot be written, now or later.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # Not buffered: what could not be written must not come up again when the file is closed.
            self._stream = open(path, "a+b", buffering=0)  # noqa: SIM115 - closed by close()
            if self._stream.tell() > 0:
                self._stream.seek(-1, 2)
                if self._stream.read(1) != b"\n":
                    self._stream.write(b"\n")
        except OSError as error:
            raise refused_write(str(path), error, path.parent) from error

    def __call__(self, event: str, fields: dict[str, Any]) -> None:
        """Append one event: ``{"time": UTC time in ISO 8601, "event": name, ...fields}``."""
        time = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"time": time, "event": event, **fields}, default=str)
        try:
            data = line.encode() + b"\n"
            if self._stream.write(data) != len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise refused_write(str(self._path), error, self._path.parent) from error

    def close(self) -> None:
        """Close the file; a later event would raise ValueError."""
        self._stream.close()

    def __enter__(self) -> EventLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
