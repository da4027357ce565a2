"""Running of a task on a worker: the work, then the commit. A failure is an outcome and not an exception."""

from __future__ import annotations

import ctypes
import gc
import time
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil

from ptd.kernel import as_int64
from tiler.core.records import to_json
from tiler.errors import CorruptStoreError, DiskFullError, StoreAccessError, TilerError
from tiler.schedule import Outcome, Task
from tiler.store import open_store, packed_by_one_thread

KEPT_SHARE = 20
"""Ratio of a worker's memory to the freed memory that it may keep between tasks of one
stage."""

# These options of mallopt are from malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_MAX = -4
_M_ARENA_MAX = -8

_FATAL = (DiskFullError, StoreAccessError)
"""Errors that every other task would meet as well."""
_NO_GLIBC = (OSError, AttributeError, TypeError)

_kept_bytes = 0
"""Memory in bytes that this process may keep between tasks, or 0 to keep as little as
possible."""
_last_stage = ""
"""Stage of the last task of this process."""


def peak_rss_bytes() -> int:
    """Return the largest resident memory of this process so far, in bytes."""
    memory = psutil.Process().memory_info()
    peak = getattr(memory, "peak_wset", None)
    if peak is not None:  # This system is Windows.
        return int(peak)
    try:
        # `getrusage` would include the peak of the process that forked this one.
        with open("/proc/self/status", encoding="ascii") as status:
            line = next(line for line in status if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024
    except (OSError, StopIteration):  # Other systems only have the current memory.
        return int(memory.rss)


def _give_back() -> None:
    """Return freed memory to the system if it is more than `prepare` allows a worker to keep.

    The allocator of the C library keeps freed memory in pieces that are too small for the
    arrays of the next stage, so a worker would grow with each task. However, memory that the
    next task uses again is cheaper than new pages, which the system has to clear, and on a
    virtual machine often to request from the host.
    """
    if _resident_bytes() > _kept_bytes:
        _give_all_back()


def _begin_stage(stage: str) -> None:
    """Return all freed memory to the system before the first task of a stage, since its arrays have other sizes."""
    global _last_stage
    if stage != _last_stage:
        _give_all_back()
        _last_stage = stage


def _give_all_back() -> None:
    with suppress(*_NO_GLIBC):
        _c_library().malloc_trim(0)


def _keep_freed_memory() -> None:
    """Let the allocator also keep freed large arrays, which it returns to the system by default.

    Each worker does this itself. If the server of forks did it, all children would inherit the setting, which prevents
    `mremap`. Children that read files need `mremap` for growing buffers.
    """
    with suppress(*_NO_GLIBC):
        for option, value in (
            (_M_MMAP_MAX, 0),
            (_M_TRIM_THRESHOLD, 2**31 - 1),
            (_M_ARENA_MAX, 1),
        ):
            _c_library().mallopt(option, value)


def _resident_bytes() -> int:
    return int(psutil.Process().memory_info().rss)


def _c_library() -> Any:
    return ctypes.CDLL(None)


def load_kernels() -> None:
    """Call a kernel, since the first call loads most of numba."""
    as_int64(0)


def prepare(memory_bytes: int) -> None:
    """Load shared kernels before workers are forked, and set the freed memory that each worker may keep.

    Parameters
    ----------
    memory_bytes : int
        Memory that a worker may use. It may keep a twentieth of it between tasks of a stage.
    """
    global _kept_bytes
    load_kernels()
    _kept_bytes = _resident_bytes() + memory_bytes // KEPT_SHARE


def run_task(store_url: str, task: Task) -> Outcome:
    """Run a task and commit its record, so that it counts as done even if the command ends."""
    with packed_by_one_thread():
        return _run(store_url, task, commit=True)


def compute(store_url: str, task: Task) -> Outcome:
    """Run a task without a commit, since the command keeps its record."""
    with packed_by_one_thread():
        return _run(store_url, task, commit=False)


def _run(store_url: str, task: Task, commit: bool) -> Outcome:
    start = time.monotonic()
    if _kept_bytes:
        _keep_freed_memory()
    _begin_stage(task.stage)
    # Reset the peak of `peak_rss_bytes`, if the system can.
    with suppress(OSError), open("/proc/self/clear_refs", "w", encoding="ascii") as peak:
        peak.write("5")
    kind: type[BaseException]
    damaged: tuple[str, ...] = ()
    try:
        record = to_json(task.work(open_store(store_url), **task.arguments))
        if commit:
            store = open_store(store_url)  # Another process may have removed the store.
            for part in Outcome(task, record).of_parts():
                store.commit(
                    part.task.stage, part.task.key, part.task.digest, part.record or {}
                )
    except (KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except TilerError as error:
        text = str(error)
        kind = type(error)
        again = error.again
        if isinstance(error, CorruptStoreError):
            damaged = error.keys
    except BaseException as error:  # noqa: BLE001 - Every error (also a panic) is an outcome, and other tasks continue.
        where = traceback.extract_tb(error.__traceback__)[-1]
        kind = type(error)
        again = True
        text = f"{kind.__name__}: {error} ({Path(where.filename).name}:{where.lineno})"
        gc.collect()
    else:
        _give_back()
        return Outcome(
            task, record, seconds=time.monotonic() - start, peak_rss_bytes=peak_rss_bytes()
        )
    _give_back()
    return Outcome(
        task,
        record=None,
        error=text,
        error_kind=kind.__name__,
        seconds=time.monotonic() - start,
        peak_rss_bytes=peak_rss_bytes(),
        again=again,
        fatal=issubclass(kind, _FATAL),
        damaged=damaged,
    )
