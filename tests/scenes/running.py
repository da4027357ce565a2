"""Commands that run while a test looks at them."""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import psutil

from tests.waiting import wait_until

IS_WINE = sys.platform == "win32" and hasattr(ctypes.WinDLL("ntdll"), "wine_get_version")
"""Whether this Windows is Wine."""


def wait_for(out: Path, event: str, stage: str, process: subprocess.Popen[str]) -> None:
    """Wait until an event of a stage is in the log."""
    wait_until(lambda: has_event(out, event, stage), process)


def has_event(out: Path, event: str, stage: str) -> bool:
    """Whether an event of a stage is in the log of a run."""
    log = out / "events.jsonl"
    # A line that is being written is read in part.
    lines = log.read_text().splitlines(keepends=True) if log.exists() else []
    events = [json.loads(line) for line in lines if line.endswith("}\n")]
    return any(e["event"] == event and e.get("stage") == stage for e in events)


def wait_until_gone(processes: Iterable[psutil.Process]) -> None:
    """Wait until processes have ended."""
    wanted = list(processes)
    wait_until(lambda: not any(map(_works, wanted)))


def _works(process: psutil.Process) -> bool:
    """Whether a process is more than an entry that nobody has taken note of yet, as in containers without an init."""
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False
