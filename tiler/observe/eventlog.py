"""``events.jsonl``: every event of every run on an OUT, one JSON object a line."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any


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
    OSError
        The file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._stream = open(path, "a+b")  # noqa: SIM115 - closed by close()
        if self._stream.tell() > 0:
            self._stream.seek(-1, 2)
            if self._stream.read(1) != b"\n":
                self._stream.write(b"\n")

    def __call__(self, event: str, fields: dict[str, Any]) -> None:
        """Append one event: ``{"time": UTC time in ISO 8601, "event": name, ...fields}``."""
        time = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"time": time, "event": event, **fields}, default=str)
        self._stream.write(line.encode() + b"\n")
        self._stream.flush()

    def close(self) -> None:
        """Close the file; a later event would raise ValueError."""
        self._stream.close()

    def __enter__(self) -> EventLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
