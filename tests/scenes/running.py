"""Commands that run while a test looks at them."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import psutil

from tests.integration.command import TIMEOUT_SECONDS


def wait_for(out: Path, event: str, stage: str, process: subprocess.Popen[str]) -> None:
    """Wait until an event of a stage is in the log."""

    def told() -> bool:
        log = out / "events.jsonl"
        # Who reads while a line is written may see its beginning alone.
        lines = log.read_text().splitlines(keepends=True) if log.exists() else []
        events = [json.loads(line) for line in lines if line.endswith("}\n")]
        return any(e["event"] == event and e.get("stage") == stage for e in events)

    wait_until(told, process)


def wait_until(true: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Wait until something is true of a process that is at work."""
    began = time.monotonic()
    while time.monotonic() - began < TIMEOUT_SECONDS:
        ended = process.poll() is not None  # before the look: what came at the very end is seen
        if true():
            return
        assert not ended, process.communicate()
        time.sleep(0.02)
    raise AssertionError("it never came")


def all_gone(processes: Iterable[psutil.Process]) -> bool:
    """Whether processes end soon."""
    _, alive = psutil.wait_procs(list(processes), timeout=120)
    return not any(map(_works, alive))


def _works(process: psutil.Process) -> bool:
    """Whether a process is more than an entry that nobody has taken note of yet, as in containers without an init."""
    try:
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False
