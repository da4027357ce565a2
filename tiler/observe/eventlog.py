"""Writer of ``events.jsonl``: all events of all runs with the same OUT, one JSON object per line."""

from __future__ import annotations

import errno
import json
import os
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType

from tiler.core.links import link_error, without_links
from tiler.errors import write_error
from tiler.observe.events import Event


class EventLog:
    """Listener that appends each event to a file, and context manager that closes the file.

    Each line is written immediately, so that users can follow the file and it contains
    everything before a crash. An incomplete line of a killed run is ended before the next line.

    Parameters
    ----------
    path : Path
        Path of the file, which is made together with its folder, or continued.

    Raises
    ------
    ConfigError
        The path is a link, through which nothing is written.
    ProcessingError
        The file cannot be written, now or during a later call.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        if path.is_symlink():
            raise link_error(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # Without a buffer, closing the file does not repeat a failed write.
            self._stream = open(path, "a+b", buffering=0, opener=without_links)  # noqa: SIM115 - `close` closes the file.
            if self._stream.tell() > 0:
                self._stream.seek(-1, 2)
                if self._stream.read(1) != b"\n":
                    self._stream.write(b"\n")
        except OSError as error:
            raise write_error(str(path), error, path.parent) from error

    def __call__(self, event: Event) -> None:
        """Append one event: ``{"time": UTC time in ISO 8601, "event": name, ...values}``."""
        time = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"time": time, "event": event.name, **event.to_json()}, default=str)
        try:
            data = line.encode() + b"\n"
            if self._stream.write(data) != len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise write_error(str(self._path), error, self._path.parent) from error

    def close(self) -> None:
        """Close the file. A later event would raise ValueError."""
        self._stream.close()

    def __enter__(self) -> EventLog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
