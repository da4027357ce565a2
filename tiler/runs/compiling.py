"""Compilation of a run's kernels in child processes, parallel to work without kernels."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ptd.cells import sample_per_cell, sort_in_cells
from ptd.frame import CellLattice
from ptd.kernel import compiled_count
from ptd.matched.evidence import DIM, LIDAR, concluded
from ptd.precompile import (
    compile_once,
    filters_name,
    gridding_name,
    has_kinds,
    is_compiled,
    warm_filters,
    warm_gridding,
    warm_last_pass,
    why_not_compiled,
)
from tiler.errors import first_line
from tiler.io.las.class_layer import ClassEncoder
from tiler.io.las.point_formats import is_legacy
from tiler.observe.events import Listener, StageFinished, StageStarted, TaskDone, Warned
from tiler.plan import KEEP, MIN_MATCHED_M2, Plan
from tiler.schedule import ChildDiedError, ChildProcess

Tell = Callable[[], None]
"""Function that is called before a compilation starts."""

STAGE = "compile"
"""Key of the stage in the progress while the run waits for kernels."""
KERNELS = {"filters": 100, "gridding": 70, "classes": 4, "sorting": 5}
"""Approximate numbers of kernels, for progress only."""
SECONDS = 1800
"""Time in seconds after which a process that compiles counts as hung."""
LOOK_SECONDS = 0.25


@dataclass(frozen=True)
class Kernels:
    """Kernels that are compiled together.

    ``name`` is written to the cache once they are compiled (`ptd.precompile`).
    """

    name: str
    compile: Callable[[Tell], None]
    count: int


def filter_kernels(method: str, kind: str | None) -> Kernels:
    """Return the kernels of a method for a kind of clouds."""
    compile_them = functools.partial(warm_filters, method, kind=kind)
    return Kernels(filters_name(method, kind), compile_them, KERNELS["filters"])


def grid_kernels(interpolation: str) -> Kernels:
    """Return the kernels of rasters.

    Natural neighbour interpolation has its own kernels. All other interpolations share theirs.
    """
    how: Literal["linear", "natural"] = "natural" if interpolation == "natural" else "linear"
    return Kernels(
        gridding_name(how), functools.partial(warm_gridding, how), KERNELS["gridding"]
    )


def _and_last_pass(compile_first: Callable[[Tell], None], tell: Tell) -> None:
    compile_first(tell)
    warm_last_pass()


def class_kernels(plan: Plan) -> Kernels | None:
    """Return the kernels that encode classes, or None if no classified cloud of the run may need them."""
    layered = any(
        source.compressed and not source.copc and not is_legacy(source.point_format)
        for source in plan.inputs.sources
    )
    if plan.writes_clouds and plan.config.classified == "laz" and layered:
        return CLASS_KERNELS
    return None


def warm_classes(notify: Tell) -> None:
    """Compile the kernels that encode classes if necessary, after a call of ``notify``."""
    points = np.arange(8, dtype=np.uint8)

    def encode() -> None:
        ClassEncoder().encode(points, points, points)

    compile_once("classes", notify, encode)


CLASS_KERNELS = Kernels("classes", warm_classes, KERNELS["classes"])


def warm_sorting(notify: Tell) -> None:
    """Compile the kernels that sort and thin the points of buckets if necessary, after a call of ``notify``."""
    counts, cells = np.arange(8, dtype=np.int32), CellLattice(1, 1, 0, 0)

    def sort() -> None:
        sort_in_cells(counts, counts, counts, cells)
        sample_per_cell(counts, counts, counts, cells)

    compile_once("sorting", notify, sort)


SORT_KERNELS = Kernels("sorting", warm_sorting, KERNELS["sorting"])


def likely_kind(plan: Plan) -> str:
    """Return the probable kind of the clouds, to compile kernels before the points are read."""
    if plan.method.kind is not None:
        return plan.method.kind
    several = any(source.returns > 1 for source in plan.inputs.sources)
    if several or plan.inputs.density < MIN_MATCHED_M2:
        return LIDAR
    pieces = plan.inputs.evidence.pieces()
    return concluded(pieces).kind if pieces else DIM


class Compiler:
    """Processes that compile the kernels of a run.

    Parameters
    ----------
    listener : callable
        Function that receives the progress while the run waits.
    note : callable
        Function that receives the reason why kernels are compiled.
    apart : bool
        Whether to compile in child processes. If not, this process compiles kernels when it needs them.
    """

    def __init__(self, listener: Listener, apart: bool, note: Callable[[str], None]) -> None:
        self._listener, self._apart, self._note = listener, apart, note
        self._begun: dict[str, tuple[threading.Event, ChildProcess]] = {}
        self._errors: dict[str, str] = {}
        self._why: dict[str, str] = {}
        self._told: set[str] = set()

    def begin(self, plan: Plan, until: str) -> None:
        """Start child processes that compile the kernels that a run will probably need.

        Nothing is done if child processes do not compile.
        """
        if not self._apart:
            return
        wanted, shares = [], False
        if plan.config.method != KEEP and until != "ingest":
            filters = filter_kernels(plan.config.method, likely_kind(plan))
            wanted.append(filters)
            shares = filters.name == filters_name("auto", LIDAR) and not is_compiled(
                filters.name
            )
        if until in ("grid", "export"):
            grid = grid_kernels(plan.config.interpolation)
            # Kernels of gridding are fewer. So their process takes a share of those of the filter.
            both = functools.partial(_and_last_pass, grid.compile)
            wanted.append(replace(grid, compile=both) if shares else grid)
        classes = class_kernels(plan)
        if until == "export" and classes is not None:
            wanted.append(classes)
        for kernels in (SORT_KERNELS, *wanted):
            if not is_compiled(kernels.name):
                self._start(kernels)

    def finish(self, kernels: Kernels) -> None:
        """Compile kernels, or wait until they are compiled."""
        if not self._apart:
            kernels.compile(lambda: self._report_why(kernels))
            return
        if is_compiled(kernels.name):
            return
        if kernels.name not in self._begun:
            self._start(kernels)
        self._report_why(kernels)
        ended, _ = self._begun[kernels.name]
        started = time.monotonic()
        reported = 0
        before = compiled_count()
        self._listener(StageStarted(STAGE, "compile kernels", tasks=kernels.count))
        finished = False
        while not finished:
            finished = ended.wait(LOOK_SECONDS)
            new = compiled_count() - before
            for _ in range(reported, new):
                self._listener(TaskDone(STAGE, "kernel"))
            reported = max(reported, new)
        self._listener(StageFinished(STAGE, round(time.monotonic() - started, 3)))
        if not is_compiled(kernels.name):
            why = f" ({self._errors[kernels.name]})" if kernels.name in self._errors else ""
            text = (
                f"kernels ({kernels.name}) could not be compiled in advance{why}, so each process compiles them "
                "itself"
            )
            self._listener(Warned(text))

    def _report_why(self, kernels: Kernels) -> None:
        why = self._why.get(kernels.name) or why_not_compiled(kernels.name)
        if why not in self._told:
            self._told.add(why)
            self._note(f"kernels are compiled, which takes half a minute or more: {why}")

    def close(self) -> None:
        """Kill the processes, also while they compile."""
        for ended, guard in self._begun.values():
            guard.kill()
            ended.wait()

    def _start(self, kernels: Kernels) -> None:
        # In Python 3.11, Ctrl-C during `join` makes a running thread appear finished. So the
        # run waits for an event.
        guard = ChildProcess(None)
        ended = threading.Event()
        # The reason is read now, because it changes once this run has compiled something.
        self._why[kernels.name] = why_not_compiled(kernels.name)

        def work() -> None:
            try:
                guard.call(kernels.compile, silent, seconds=SECONDS)
            except ChildDiedError as died:
                self._errors[kernels.name] = f"the process {died}"
            except Exception as error:  # noqa: BLE001 - an error in a thread would be lost, so `finish` reports it
                self._errors[kernels.name] = f"{type(error).__name__}: {first_line(error)}"
            finally:
                guard.close()
                ended.set()

        self._begun[kernels.name] = (ended, guard)
        threading.Thread(target=work, name=f"compile {kernels.name}", daemon=True).start()


def silent() -> None:
    """Ignore the start of a compilation."""


def kinds_of(method: str) -> tuple[str | None, ...]:
    """Return the kinds of clouds for which a method has separate kernels, or (None,) if they share its kernels."""
    return ("lidar", "dim") if has_kinds(method) else (None,)
