"""Commands that run while a test looks at them."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path

from tests.integration.command import TIMEOUT_SECONDS


def wait_for(out: Path, event: str, stage: str, process: subprocess.Popen[str]) -> None:
    """Wait until an event of a stage is in the log."""
    log = out / "events.jsonl"
    began = time.monotonic()
    while time.monotonic() - began < TIMEOUT_SECONDS:
        if log.exists():
            events = [json.loads(line) for line in log.read_text().splitlines() if line.endswith("}")]
            if any(e["event"] == event and e.get("stage") == stage for e in events):
                return
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    raise AssertionError(f"no {event} of {stage}")
