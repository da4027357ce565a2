"""Compilation of all kernels of methods before their first run, for example in container images and CI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ptd.kernel import cache_folder, cache_refusal, compiled_count, discard_damaged
from ptd.methods import METHODS
from ptd.precompile import is_compiled
from tiler.errors import ConfigError, ProcessingError
from tiler.plan.memory import cores
from tiler.runs.compiling import (
    CLASS_KERNELS,
    SECONDS,
    SORT_KERNELS,
    filter_kernels,
    grid_kernels,
    kinds_of,
    silent,
)
from tiler.schedule import ChildDiedError, ChildPool


@dataclass(frozen=True)
class WarmResult:
    """Folder of the machine code, number of kernels in it, and number of kernels compiled by this call.

    ``refused`` is the reason why a preferred folder is not used, if there is one.
    """

    folder: str
    kernels: int
    compiled: int
    refused: str | None = None


def warm(methods: Sequence[str]) -> WarmResult:
    """Compile the kernels of ingest, methods, rasters and classified clouds, in as many processes as there are cores.

    Raises
    ------
    ConfigError
        A method is unknown, or no folder is safe and can be written.
    ProcessingError
        The compiler crashes.
    """
    unknown = [name for name in methods if name not in METHODS]
    if unknown:
        raise ConfigError(f"no method {unknown[0]!r}; there are {', '.join(METHODS)}")
    folder = cache_folder()
    if folder is None:
        raise ConfigError(
            cache_refusal()
            or "no folder for compiled kernels can be written; set NUMBA_CACHE_DIR to one"
        )
    discard_damaged()
    n_before = compiled_count()
    needed_kernels = [
        *(filter_kernels(method, kind) for method in methods for kind in kinds_of(method)),
        *map(grid_kernels, ("linear", "natural")),
        CLASS_KERNELS,
        SORT_KERNELS,
    ]
    todo = [kernels for kernels in needed_kernels if not is_compiled(kernels.name)]
    try:
        with ChildPool(max(min(cores(), len(todo)), 1), None) as guards:
            for done in guards.each(
                lambda guard, kernels: guard.call(kernels.compile, silent, seconds=SECONDS),
                todo,
            ):
                done()
    except ChildDiedError as died:
        raise ProcessingError(
            f"compiling kernels: the process {died}; free some memory and try again"
        ) from died
    count = compiled_count()
    return WarmResult(str(folder), count, count - n_before, cache_refusal())
