"""Runs in processes of their own that start at once and can be killed at any moment."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from typing import Any

from tests.waiting import PATIENCE_SECONDS


def forked(work: Callable[..., object], *arguments: Any, **settings: Any) -> BaseProcess:
    """Start ``work`` in a process forked from a server that is warm, see `warmed`."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.invariants.warmed"])
    process = context.Process(target=work, args=arguments, kwargs=settings)
    process.start()
    return process


def ended(process: BaseProcess) -> int:
    """Wait for the end of a process; its exit code."""
    process.join(PATIENCE_SECONDS)
    assert process.exitcode is not None, "still at work"
    return process.exitcode
