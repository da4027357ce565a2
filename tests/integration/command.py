"""The command line in a process of its own, as people call it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT_SECONDS = 900.0
"""For a loaded machine that compiles the kernels; nothing takes that long where all is well."""


def environment() -> dict[str, str]:
    """The one of this process, in which the checkout is found from any folder."""
    paths = [p for p in (os.environ.get("PYTHONPATH"), str(ROOT)) if p]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "cli.main", *(str(a) for a in arguments)]


def tiler(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(
        command(*arguments),
        capture_output=True,
        text=True,
        env=environment(),
        check=False,
        timeout=TIMEOUT_SECONDS,
    )


def assert_one_line(error: str, *parts: str) -> None:
    """What ends a command is one line on stderr, no traceback."""
    lines = error.strip().splitlines()
    assert len(lines) == 1, error
    assert lines[0].startswith("tiler: error: ")
    assert "Traceback" not in error
    for part in parts:
        assert part in lines[0]
