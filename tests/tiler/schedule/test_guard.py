"""A child that dies costs one call."""

from __future__ import annotations

import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.integration.command import started
from tests.scenes.running import wait_until_gone
from tests.tiler.schedule import calls
from tests.waiting import PATIENCE_SECONDS
from tiler.errors import InputError, ProcessingError
from tiler.inputs.sources import read_in_child
from tiler.schedule import (
    ChildDiedError,
    ChildProcess,
    ChildStartError,
    fork_server_running,
    limits_memory,
    prepare_children,
)
from tiler.schedule import guard as guard_module
from tiler.schedule.fork_server import FORKS


@pytest.fixture(scope="module")
def guard() -> Iterator[ChildProcess]:
    with ChildProcess(memory_bytes=1 << 30) as guard:
        yield guard


def test_one_child_answers_all_calls(guard: ChildProcess) -> None:
    assert [guard.call(calls.double, i, seconds=PATIENCE_SECONDS) for i in range(50)] == list(
        range(0, 100, 2)
    )
    first = guard.call(calls.pid, seconds=PATIENCE_SECONDS)
    assert first == guard.call(calls.pid, seconds=PATIENCE_SECONDS) != os.getpid()


def test_an_error_of_the_call_is_raised(guard: ChildProcess) -> None:
    child = guard.call(calls.pid, seconds=PATIENCE_SECONDS)
    with pytest.raises(InputError, match="cloud.las: no good"):
        guard.call(calls.fail, "cloud.las: no good", seconds=PATIENCE_SECONDS)
    assert guard.call(calls.pid, seconds=PATIENCE_SECONDS) == child


@pytest.mark.parametrize(
    ("work", "arguments", "seconds", "fate"),
    [
        (calls.crash, (), PATIENCE_SECONDS, re.escape(calls.CRASHED)),
        (calls.abort, (), PATIENCE_SECONDS, re.escape(calls.ABORTED)),
        (calls.leave, (), PATIENCE_SECONDS, r"crashed \(exit code 7\)"),
        (calls.sleep, (), 0.5, r"did not end within 0\.5 s"),
        (calls.hang_with_the_lock, (), 0.5, r"did not end within 0\.5 s"),
        pytest.param(
            *(calls.allocate, (4,), PATIENCE_SECONDS, "needs more than the 1024 MiB"),
            marks=pytest.mark.skipif(not limits_memory(), reason="memory is not limited here"),
        ),
    ],
)
def test_a_child_that_dies_is_replaced(
    guard: ChildProcess,
    work: Callable[..., Any],
    arguments: tuple[Any, ...],
    seconds: float,
    fate: str,
) -> None:
    with pytest.raises(ChildDiedError, match=f"^{fate}"):
        guard.call(work, *arguments, seconds=seconds)
    assert guard.call(calls.double, 21, seconds=PATIENCE_SECONDS) == 42


OF_ANOTHER_PROCESS = f"""
from tests.tiler.schedule import calls
from tiler.schedule import ChildProcess
with ChildProcess() as guard:
    print(guard.call(calls.pid, seconds={PATIENCE_SECONDS}), flush=True)
    guard.call(calls.hang_with_the_lock, seconds={3 * PATIENCE_SECONDS})
"""


@pytest.mark.processes
def test_a_child_that_holds_the_lock_ends_when_its_parent_is_killed() -> None:
    with started([sys.executable, "-c", OF_ANOTHER_PROCESS]) as parent:
        assert parent.stdout is not None
        child = psutil.Process(int(parent.stdout.readline()))
        time.sleep(0.3)  # Usually it hangs by now; it has to end in either case.
        parent.kill()
    wait_until_gone([child])


@pytest.mark.processes
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="processes cannot be stopped here")
@pytest.mark.parametrize("whose", ["child", "server of forks", "child and server"])
def test_stopped_processes_are_killed_and_replaced(
    whose: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A stopped child cannot end itself, and a stopped server cannot kill it."""
    monkeypatch.setenv("A_SERVER", f"of its own: {tmp_path}")
    for name in ("GRACE_SECONDS", "_LOOK_SECONDS"):
        monkeypatch.setattr(f"tiler.schedule.guard.{name}", 0.2)
    with ChildProcess() as stopped:
        child = psutil.Process(stopped.call(calls.pid, seconds=PATIENCE_SECONDS))
        processes = [child] * ("child" in whose) + [child.parent()] * ("server" in whose)
        for process in processes:
            process.suspend()
        with pytest.raises(ChildDiedError, match=r"^did not end within 0\.5 s$"):
            stopped.call(calls.sleep, seconds=0.5)
        wait_until_gone([child, *processes])
        assert stopped.call(calls.double, 21, seconds=PATIENCE_SECONDS) == 42


@pytest.mark.parametrize(
    "allocate", [calls.allocate_and_wait, calls.allocate_in_a_child_and_wait]
)
def test_a_child_with_too_much_memory_is_killed_where_no_system_limits_it(
    allocate: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if the memory is a child's: in a virtual environment on Windows, a launcher starts Python."""
    if guard_module.limits_memory():  # as on macOS and Windows
        monkeypatch.setattr(guard_module, "FORKS", False)
        monkeypatch.setattr(guard_module, "limits_memory", lambda: False)
        monkeypatch.setattr(guard_module, "_child", unlimited(guard_module._child))
    with (
        ChildProcess(memory_bytes=400 << 20) as guard,
        pytest.raises(ChildDiedError, match="^needs more than the 400 MiB"),
    ):
        guard.call(allocate, seconds=PATIENCE_SECONDS)


def unlimited(start: Callable[..., Any]) -> Callable[..., Any]:
    """Start a child whose memory the system does not limit."""
    return lambda _, *arguments: start(None, *arguments)


def test_a_panic_comes_back_as_an_exception(guard: ChildProcess) -> None:
    with pytest.raises(RuntimeError, match="Panic: cannot be unpickled"):
        guard.call(calls.panic, seconds=PATIENCE_SECONDS)


def test_output_of_libraries_does_not_disturb_the_answers(guard: ChildProcess) -> None:
    assert guard.call(calls.chatter, seconds=PATIENCE_SECONDS) == "answer"
    assert guard.call(calls.double, 1, seconds=PATIENCE_SECONDS) == 2


def test_no_child_starts_without_a_call_and_none_is_left_behind() -> None:
    before = len(psutil.Process().children())
    with ChildProcess() as guard:
        assert len(psutil.Process().children()) == before
        child = psutil.Process(guard.call(calls.pid, seconds=PATIENCE_SECONDS))
    assert not child.is_running()


def test_a_function_that_the_child_cannot_import_is_an_error(
    guard: ChildProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    child = guard.call(calls.pid, seconds=PATIENCE_SECONDS)
    monkeypatch.setattr(calls.double, "__qualname__", "triple")
    monkeypatch.setattr(calls, "triple", calls.double, raising=False)
    with pytest.raises(AttributeError, match="triple"):
        guard.call(calls.double, 1, seconds=PATIENCE_SECONDS)
    assert guard.call(calls.pid, seconds=PATIENCE_SECONDS) == child


def test_children_have_the_environment_at_their_start(monkeypatch: pytest.MonkeyPatch) -> None:
    with fork_server_running(), ChildProcess() as first, ChildProcess() as second:
        assert first.call(os.getenv, "OF_NOW", seconds=PATIENCE_SECONDS) is None
        monkeypatch.setenv("OF_NOW", "set")
        assert second.call(os.getenv, "OF_NOW", seconds=PATIENCE_SECONDS) == "set"
        assert first.call(calls.double, 1, seconds=PATIENCE_SECONDS) == 2


@pytest.mark.skipif(not FORKS, reason="children are not forked here")
def test_the_preparation_is_there_in_each_child() -> None:
    with fork_server_running():
        prepare_children(calls.prepare, calls.stumble)
        found: list[str] = []
        while not found or found[-1] == "":  # the first may have been forked before
            with ChildProcess() as guard:
                found.append(guard.call(calls.prepared, seconds=PATIENCE_SECONDS))
    assert found[-1] == "by the server"


@pytest.mark.skipif(not FORKS, reason="children are not forked here")
def test_the_server_of_forks_is_shared_and_replaced_when_it_dies() -> None:
    with ChildProcess() as first, ChildProcess() as second:
        parents = {
            psutil.Process(g.call(calls.pid, seconds=PATIENCE_SECONDS)).ppid()
            for g in (first, second)
        }
        assert len(parents) == 1
        psutil.Process(parents.pop()).kill()
        for guard in (first, second):
            with pytest.raises(ChildDiedError, match="SIGKILL"):
                call_on(guard)
            assert guard.call(calls.double, 21, seconds=PATIENCE_SECONDS) == 42


def call_on(guard: ChildProcess) -> None:
    """Call until it fails: a child may answer once more before it is gone."""
    while True:
        guard.call(calls.pid, seconds=PATIENCE_SECONDS)


@pytest.mark.skipif(not FORKS, reason="children are not forked here")
def test_a_failed_fork_fails_only_its_own_call(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("A_SERVER", "of its own")
    first, second = (ChildProcess(prepare=calls.refuse_forks) for _ in range(2))
    with first, second:
        child = first.call(calls.pid, seconds=PATIENCE_SECONDS)
        with pytest.raises(
            ChildStartError, match="^could not start: the system has no memory left"
        ):
            second.call(calls.pid, seconds=PATIENCE_SECONDS)
        with pytest.raises(
            ProcessingError, match="could not start: .* end other programs, then run again$"
        ):
            read_in_child(second, calls.fail, Path(__file__))  # the file is not to blame
        assert first.call(calls.pid, seconds=PATIENCE_SECONDS) == child
