"""What a worker does with a task: the work, then the commit; a failure is an outcome, not an exception."""

from __future__ import annotations

import ctypes
import gc
import time
import traceback
from contextlib import suppress
from typing import Any

import psutil

from ptd.kernel import wide
from tiler.errors import DamagedError, DiskFullError, TilerError
from tiler.schedule import Outcome, Task
from tiler.store import open_store

KEPT_SHARE = 10
"""Between tasks a worker keeps one in so many bytes of its memory at most: freed arrays, for those of the next task."""

_M_TRIM_THRESHOLD, _M_MMAP_MAX, _M_ARENA_MAX = -1, -4, -8  # of malloc.h
_NO_GLIBC = (OSError, AttributeError, TypeError)

_kept_bytes = 0
"""How large this process may stay between tasks; 0: as small as it can."""


def peak_rss_bytes() -> int:
    """Largest resident memory of this process so far."""
    try:
        # `getrusage` of a child begins with the peak of the process that started it.
        with open("/proc/self/status", encoding="ascii") as status:
            line = next(line for line in status if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024
    except (OSError, StopIteration):  # not Linux
        memory = psutil.Process().memory_info()
        return int(getattr(memory, "peak_wset", memory.rss))  # of Windows; else what it is now


def _forget_peak() -> None:
    """Let `peak_rss_bytes` begin anew, where the system can: a task is told of with its own peak."""
    with suppress(OSError), open("/proc/self/clear_refs", "w", encoding="ascii") as peak:
        peak.write("5")


def _give_back() -> None:
    """Return freed memory to the system where there is more than `prepare` lets a worker keep.

    The allocator of the C library keeps what a task freed, in pieces too small for the next stage's arrays: a worker
    would grow with the number of tasks that it has done. But a page that comes anew from the system is cleared first,
    and on a virtual machine often fetched from the host: what the next task uses again costs neither.
    """
    if _resident_bytes() > _kept_bytes:
        _give_all_back()


def _give_all_back() -> None:
    with suppress(*_NO_GLIBC):
        _c_library().malloc_trim(0)


def _keep_freed_memory() -> None:
    """Have the allocator keep large arrays as well that are freed, which it gives back one by one otherwise.

    By the worker itself: what the process does that children are forked from would hold for all of them, and those
    that read files need `mremap`, which this takes from a buffer that grows.
    """
    with suppress(*_NO_GLIBC):
        for option, value in ((_M_MMAP_MAX, 0), (_M_TRIM_THRESHOLD, 2**31 - 1), (_M_ARENA_MAX, 1)):
            _c_library().mallopt(option, value)


def _resident_bytes() -> int:
    return int(psutil.Process().memory_info().rss)


def _c_library() -> Any:
    return ctypes.CDLL(None)


def load_kernels() -> None:
    """Call a kernel, the first of which loads most of numba."""
    wide(0)


def prepare(memory_bytes: int) -> None:
    """Before workers are forked: load what each would load by itself, and say how much freed memory it may keep.

    Parameters
    ----------
    memory_bytes : int
        Allowed for a worker; a tenth of it may stay with the process between tasks.
    """
    global _kept_bytes
    load_kernels()
    _kept_bytes = _resident_bytes() + memory_bytes // KEPT_SHARE


def perform(store_url: str, task: Task) -> Outcome:
    """Run a task and commit what it returns, so that it counts as done whatever becomes of the command."""
    return _worked(store_url, task, committed=True)


def compute(store_url: str, task: Task) -> Outcome:
    """Run a task of which nothing is committed: the command keeps what it returns."""
    return _worked(store_url, task, committed=False)


def _worked(store_url: str, task: Task, committed: bool) -> Outcome:
    start = time.monotonic()
    if _kept_bytes:
        _keep_freed_memory()
    if task.starts_small:
        _give_all_back()
    _forget_peak()
    kind: type[BaseException]
    damaged: tuple[str, ...] = ()
    try:
        record = task.work(store_url, task.arguments)
        if committed:
            store, made = open_store(store_url), record["parts"] if task.parts else [record]
            for part, its_record in zip(task.parts or (task,), made, strict=True):
                store.commit(part.stage, part.key, part.digest, its_record)
    except (KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except TilerError as error:
        text, kind, again = str(error), type(error), error.again
        damaged = error.keys if isinstance(error, DamagedError) else ()
    except BaseException as error:  # noqa: BLE001 - whatever a task dies of, panics too, is recorded; the others go on
        where = traceback.extract_tb(error.__traceback__)[-1]
        kind, again = type(error), True
        text = f"{kind.__name__}: {error} ({where.filename.rsplit('/', 1)[-1]}:{where.lineno})"
        gc.collect()
    else:
        _give_back()
        return Outcome(task, record, None, None, time.monotonic() - start, peak_rss_bytes())
    _give_back()
    seconds, peak = time.monotonic() - start, peak_rss_bytes()
    return Outcome(
        task, None, text, kind.__name__, seconds, peak, again, issubclass(kind, DiskFullError), damaged
    )
