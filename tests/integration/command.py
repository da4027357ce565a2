"""The command line in a process of its own, as people call it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.waiting import PATIENCE_SECONDS

ROOT = Path(__file__).resolve().parents[2]


def environment() -> dict[str, str]:
    """The one of this process, in which the checkout is found from any folder."""
    paths = [p for p in (os.environ.get("PYTHONPATH"), str(ROOT)) if p]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "cli.main", *(str(a) for a in arguments)]


def ended(call: Sequence[object], **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, whatever its code."""
    usual = {"env": environment(), "timeout": PATIENCE_SECONDS, "check": False}
    return subprocess.run(
        [*map(str, call)], capture_output=True, text=True, **{**usual, **options}
    )


def started(call: Sequence[object], **options: Any) -> subprocess.Popen[str]:
    """Start a program whose streams are pipes."""
    pipes = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "text": True,
        "env": environment(),
    }
    return subprocess.Popen([*map(str, call)], **{**pipes, **options})


def tiler(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command of ours to its end."""
    return ended(command(*arguments))


def assert_one_line(error: str, *parts: str) -> None:
    """What ends a command is one line on stderr, no traceback."""
    lines = error.strip().splitlines()
    assert len(lines) == 1, error
    assert lines[0].startswith("tiler: error: ")
    assert "Traceback" not in error
    for part in parts:
        assert part in lines[0]
