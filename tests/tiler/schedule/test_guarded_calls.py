"""Several children at a time: results come in the order of the calls, even if a later call ends first or crashes."""

from __future__ import annotations

import time
from contextlib import suppress

import psutil

from tests.tiler.schedule import calls
from tests.waiting import PATIENCE_SECONDS, wait_until
from tiler.errors import InputError
from tiler.schedule import ChildDiedError, ChildPool, ChildProcess
from tiler.schedule.fork_server import FORKS
from tiler.schedule.guarded_calls import AHEAD


def work(guard: ChildProcess, item: int) -> int:
    if item == 3:
        return guard.call(calls.crash, seconds=PATIENCE_SECONDS) or 0
    if item == 5:
        guard.call(calls.fail, "five", seconds=PATIENCE_SECONDS)
    if item % 4 == 0:
        time.sleep(0.02)
    return guard.call(calls.double, item, seconds=PATIENCE_SECONDS)


def test_results_and_errors_come_in_order() -> None:
    found: list[object] = []
    with ChildPool(2) as guards:
        for result in guards.each(work, range(12)):
            try:
                found.append(result())
            except (ChildDiedError, InputError) as error:
                found.append(str(error))
    assert found == [0, 2, 4, calls.CRASHED, 8, "five", 12, 14, 16, 18, 20, 22]


def test_few_calls_begin_before_the_first_result_is_taken() -> None:
    begun = []

    def note(guard: ChildProcess, item: int) -> int:
        begun.append(item)
        return item

    with ChildPool(2) as guards:
        results = guards.each(note, range(1000))
        assert next(results)() == 0
        assert len(begun) <= 2 * AHEAD + 1
        assert [result() for result in results] == list(range(1, 1000))


def test_no_child_outlives_an_early_end() -> None:
    def hang(guard: ChildProcess, item: int) -> None:
        guard.call(calls.sleep, seconds=PATIENCE_SECONDS)

    with ChildPool(2) as guards:
        next(guards.each(hang, range(100)))
        wait_until(lambda: len(_children()) == 2)
    assert not _children()


def _children() -> list[psutil.Process]:
    if not FORKS:
        return psutil.Process().children()
    found: list[psutil.Process] = []
    for process in psutil.Process().children():
        with suppress(psutil.NoSuchProcess):  # the process ended meanwhile
            if "tiler.schedule.guarded" in process.cmdline():
                found += process.children()
    return found
