"""Compiles the kernels of a run in processes of their own, while it does what needs none."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from ptd.kernel import compiled_count
from ptd.precompile import filters_name, gridding_name, has_kinds, is_compiled, warm_filters, warm_gridding
from tiler.errors import first_line
from tiler.observe.events import Listener
from tiler.plan import KEEP, LEAST_MATCHED_M2, Plan
from tiler.schedule import Died, Guard

Tell = Callable[[], None]

STAGE = "compile"
"""Key of the stage as which it is told."""
KERNELS = {"filters": 100, "gridding": 70}
"""About how many there are, for the progress alone."""
SECONDS = 1800
"""A process that compiles for longer hangs."""
LOOK_SECONDS = 0.25


@dataclass(frozen=True)
class Kernels:
    """Kernels that are compiled together; ``name`` is told in the cache when they are (`ptd.precompile`)."""

    name: str
    compile: Callable[[Tell], None]
    count: int


def filter_kernels(method: str, kind: str | None) -> Kernels:
    """Those of a method for a kind of clouds."""
    compile_them = functools.partial(warm_filters, method, kind=kind)
    return Kernels(filters_name(method, kind), compile_them, KERNELS["filters"])


def grid_kernels(interpolation: str) -> Kernels:
    """Those of rasters; all interpolations but natural neighbours have the same."""
    how = "natural" if interpolation == "natural" else "linear"
    return Kernels(gridding_name(how), functools.partial(warm_gridding, how), KERNELS["gridding"])  # type: ignore[arg-type]


def likely_kind(plan: Plan) -> str:
    """What the cloud probably is: which kernels are compiled before the points have said so."""
    if plan.kind is not None:
        return plan.kind
    several = any(source.returns > 1 for source in plan.sources)
    return "lidar" if several or plan.density < LEAST_MATCHED_M2 else "dim"


class Compiler:
    """The processes that compile for a run.

    Parameters
    ----------
    listener : callable
        Told how far it is, while the run waits for it.
    apart : bool
        In processes of their own; else in this one, when they are needed.
    """

    def __init__(self, listener: Listener, apart: bool) -> None:
        self._listener, self._apart = listener, apart
        self._begun: dict[str, tuple[threading.Event, Guard]] = {}
        self._errors: dict[str, str] = {}

    def begin(self, plan: Plan, until: str) -> None:
        """Begin with all that a run will probably need, each in a process of its own."""
        wanted = []
        if plan.config.method != KEEP and until != "ingest":
            wanted.append(filter_kernels(plan.config.method, likely_kind(plan)))
        if until in ("grid", "export"):
            wanted.append(grid_kernels(plan.config.interpolation))
        for kernels in wanted if self._apart else ():
            if not is_compiled(kernels.name):
                self._start(kernels)

    def finish(self, kernels: Kernels) -> None:
        """Return when these are compiled."""
        if not self._apart:
            kernels.compile(
                lambda: self._listener("note", {"text": "compiling kernels (once on this machine)"})
            )
            return
        if is_compiled(kernels.name):
            return
        if kernels.name not in self._begun:
            self._start(kernels)
        ended, _ = self._begun[kernels.name]
        started, told = time.monotonic(), 0
        before = compiled_count()
        facts = {"title": "compile, once on this machine", "tasks": kernels.count, "points": 0, "done": 0}
        self._listener("stage_started", {"stage": STAGE, **facts})
        finished = False
        while not finished:
            finished = ended.wait(LOOK_SECONDS)
            new = compiled_count() - before
            for _ in range(told, new):
                done = {"key": "kernel", "points": 0, "seconds": 0.0, "peak_rss_bytes": 0}
                self._listener("task_done", {"stage": STAGE, **done})
            told = max(told, new)
        self._listener("stage_finished", {"stage": STAGE, "seconds": round(time.monotonic() - started, 3)})
        if not is_compiled(kernels.name):
            why = f" ({self._errors[kernels.name]})" if kernels.name in self._errors else ""
            text = (
                f"kernels ({kernels.name}) could not be compiled ahead{why}: each process compiles for itself"
            )
            self._listener("warning", {"text": text})

    def close(self) -> None:
        """End the processes, whatever they do."""
        for ended, guard in self._begun.values():
            guard.kill()
            ended.wait()

    def _start(self, kernels: Kernels) -> None:
        # An event, as a thread that somebody waits for counts as ended once Ctrl-C ends the waiting (Python 3.11).
        guard, ended = Guard(None), threading.Event()

        def work() -> None:
            try:
                guard.call(kernels.compile, silent, seconds=SECONDS)
            except Died as died:
                self._errors[kernels.name] = f"the process {died}"
            except Exception as error:  # noqa: BLE001 - of a thread nobody sees: `finish` tells it
                self._errors[kernels.name] = f"{type(error).__name__}: {first_line(error)}"
            finally:
                guard.close()
                ended.set()

        self._begun[kernels.name] = (ended, guard)
        threading.Thread(target=work, name=f"compile {kernels.name}", daemon=True).start()


def silent() -> None:
    """Tell nobody."""


def kinds_of(method: str) -> tuple[str | None, ...]:
    """The kinds of clouds for which a method has kernels of its own; (None,) where it has none."""
    return ("lidar", "dim") if has_kinds(method) else (None,)
