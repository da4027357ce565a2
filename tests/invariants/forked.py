"""Runs in processes of their own that start at once and can be killed at any moment."""

from __future__ import annotations

import importlib
import multiprocessing
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from typing import Any

from tests.waiting import PATIENCE_SECONDS


def _warmed(work: Callable[..., object], *arguments: Any, **settings: Any) -> None:
    """Call ``work`` in a process that is warm. One that is forked is so before."""
    importlib.import_module("tests.invariants.warmed")
    work(*arguments, **settings)


def forked(work: Callable[..., object], *arguments: Any, **settings: Any) -> BaseProcess:
    """Start ``work`` in a process forked from a server that is warm, see `warmed`; on Windows in a new one."""
    can_fork = "forkserver" in multiprocessing.get_all_start_methods()
    context: Any = multiprocessing.get_context("forkserver" if can_fork else "spawn")
    if can_fork:
        context.set_forkserver_preload(["tests.invariants.warmed"])
    process: BaseProcess = context.Process(
        target=_warmed, args=(work, *arguments), kwargs=settings
    )
    process.start()
    return process


def ended(process: BaseProcess) -> int:
    """Wait for the end of a process; its exit code."""
    process.join(PATIENCE_SECONDS)
    assert process.exitcode is not None, "still at work"
    return process.exitcode
