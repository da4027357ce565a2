"""Waiting for what comes, however slow or busy the machine is."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from typing import Any

PATIENCE_SECONDS = 250.0
"""Longest wait of a test: enough for a loaded machine that compiles the kernels, less than the
`timeout` of a test, so that the test itself says what did not come."""

_PAUSE_SECONDS = 0.005


def wait_until(
    condition: Callable[[], object], process: subprocess.Popen[Any] | None = None
) -> None:
    """Wait until a condition holds.

    Parameters
    ----------
    condition : callable
        Returns something true once it holds.
    process : subprocess.Popen, optional
        Brings it about: if it ends before, the wait fails with what it said.
    """
    began = time.monotonic()
    while True:
        # Asked before the look, so that what a process does last is seen.
        ended = None if process is None else process.poll()
        if condition():
            return
        if process is not None and ended is not None:
            raise AssertionError(
                f"the process ended with {ended} before: {process.communicate()}"
            )
        assert time.monotonic() - began < PATIENCE_SECONDS, "it never came"
        time.sleep(_PAUSE_SECONDS)
