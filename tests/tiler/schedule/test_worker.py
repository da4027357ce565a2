"""The outcome that a worker reports for a task."""

from __future__ import annotations

import platform
import re
import sys
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from tiler.core.lattice import CoordFrame, Lattice
from tiler.schedule import ChildProcess, Task, limits_memory
from tiler.schedule.worker import compute, peak_rss_bytes, prepare, run_task
from tiler.store import StoreMeta, TileStore, create_store


def takes(_: TileStore, *, megabytes: int) -> dict[str, Any]:
    """Fill some megabytes in pieces, of which every other one is freed before the rest."""
    pieces = [np.ones(1 << 14) for _ in range(megabytes * 8)]
    del pieces[::2]
    return {"pieces": len(pieces)}


@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="peaks begin anew on Linux alone"
)
def test_each_task_reports_its_own_peak(tmp_path: Path) -> None:
    url = str(tmp_path / "store.zarr")
    create_store(
        url, StoreMeta(CoordFrame(), Lattice(Fraction(50_000)), Lattice(Fraction(500)), False)
    )
    large, small = (
        run_task(url, Task("s", f"{size}", "d", takes, {"megabytes": size}, 1))
        for size in (256, 1)
    )
    assert large.record == {"pieces": 1024}
    assert large.peak_rss_bytes - small.peak_rss_bytes > 200 << 20
    assert peak_rss_bytes() < large.peak_rss_bytes


def resident_after(url: str) -> int:
    """Resident bytes of this process after a task that held 256 MB."""
    run_task(url, Task("s", "large", "d", takes, {"megabytes": 256}, 1))
    return int(psutil.Process().memory_info().rss)


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="other allocators give back at once"
)
def test_a_worker_keeps_freed_memory_up_to_a_twentieth_of_what_it_may_have(
    tmp_path: Path,
) -> None:
    url = str(tmp_path / "store.zarr")
    create_store(
        url, StoreMeta(CoordFrame(), Lattice(Fraction(50_000)), Lattice(Fraction(500)), False)
    )
    left = []
    for memory_bytes in (64 << 20, 8 << 30):
        with ChildProcess(None, partial(prepare, memory_bytes)) as guard:
            left.append(guard.call(resident_after, url, seconds=300.0))
    assert left[1] - left[0] > 200 << 20


def peak_of_small_task(url: str, stage: str) -> int:
    """Peak of a small task of a stage after one of the stage `s` that held 256 MB."""
    run_task(url, Task("s", "large", "d", takes, {"megabytes": 256}, 1))
    return run_task(url, Task(stage, "small", "d", takes, {"megabytes": 1}, 1)).peak_rss_bytes


@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="peaks begin anew on Linux alone"
)
@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="other allocators give back at once"
)
def test_the_first_task_of_a_stage_begins_without_what_its_worker_kept(tmp_path: Path) -> None:
    url = str(tmp_path / "store.zarr")
    create_store(
        url, StoreMeta(CoordFrame(), Lattice(Fraction(50_000)), Lattice(Fraction(500)), False)
    )
    peaks = []
    for stage in ("next", "s"):
        with ChildProcess(None, partial(prepare, 8 << 30)) as guard:
            peaks.append(guard.call(peak_of_small_task, url, stage, seconds=300.0))
    assert peaks[1] - peaks[0] > 200 << 20


def grown() -> int:
    """Grow a buffer to 700 MB piece by piece, and return its length."""
    buffer, piece = bytearray(), bytes(1 << 20)
    for _ in range(700):
        buffer += piece
    return len(buffer)


@pytest.mark.skipif(not limits_memory(), reason="memory is not limited here")
def test_a_reader_that_is_forked_beside_workers_has_all_of_its_memory() -> None:
    """Without `mremap`, the reader would need the old and the new buffer at the same time."""
    with (
        ChildProcess(None, partial(prepare, 4 << 30)) as worker,
        ChildProcess(1 << 30) as reader,
    ):
        worker.call(peak_rss_bytes, seconds=300.0)
        assert reader.call(grown, seconds=300.0) == 700 << 20


def stumbles(_: TileStore) -> dict[str, Any]:
    raise OSError("a passing fault")


def test_an_error_names_its_line_without_folders(small_store: TileStore) -> None:
    outcome = compute(small_store.url, Task("stage", "key", "digest", stumbles))
    assert re.fullmatch(r"OSError: a passing fault \(test_worker\.py:\d+\)", str(outcome.error))
