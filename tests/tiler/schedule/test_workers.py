"""Tasks that kill, block or fill their workers are given up, and all other tasks are done."""

from __future__ import annotations

import copy
import json
import logging
import os
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from threading import Thread, Timer
from types import SimpleNamespace
from typing import Any

import dask
import psutil
import pytest
from distributed import LocalCluster

from tests.integration.cloud import Cable
from tests.scenes.running import wait_until_gone
from tests.tiler.schedule import calls
from tests.waiting import PATIENCE_SECONDS, wait_until
from tiler.errors import ConfigError, ConnectionLostError
from tiler.schedule import (
    TRIES,
    Executor,
    Outcome,
    SerialExecutor,
    Task,
    TaskLimits,
    limits_memory,
)
from tiler.schedule.fork_server import FORKS, child_environment
from tiler.schedule.workers import DaskExecutor


def task(value: int, **arguments: Any) -> Task:
    return Task(
        "stage", f"t{value}", "digest", calls.square, {"value": value, **arguments}, points=10
    )


@pytest.fixture(scope="module")
def two() -> Iterator[DaskExecutor]:
    executor = DaskExecutor(
        2, limits=TaskLimits(memory_bytes=1 << 30, seconds=PATIENCE_SECONDS)
    )
    yield executor
    executor.close()


def run(
    executor: Executor, tasks: list[Task], folder: Path
) -> tuple[dict[int, Outcome], Counter[int]]:
    """The last outcome of each task by its value, and how many were tried again."""
    ends: dict[int, Outcome] = {}
    again: Counter[int] = Counter()
    for outcome in executor.run(calls.run_task, str(folder), tasks):
        value = outcome.task.arguments["value"]
        assert value not in ends, "an outcome after the last word"
        if outcome.again:
            again[value] += 1
        else:
            ends[value] = outcome
    return ends, again


def tries(folder: Path, value: int) -> list[str]:
    """Processes that worked on a task, in order."""
    names = [path.name.split("-") for path in (folder / f"tries-{value}").iterdir()]
    return [process for process, _ in sorted(names, key=lambda name: int(name[1]))]


def others(n: int) -> list[Task]:
    return [task(100 + i, wait=0.02) for i in range(n)]


@pytest.mark.parametrize(
    ("does", "cause"),
    [
        ("leave", "killed its worker 3 times: it crashed (exit code 7)"),
        ("crash", f"killed its worker 3 times: it {calls.CRASHED}"),
        pytest.param(
            *("kill", "3 times: it was killed (SIGKILL), probably because memory ran out"),
            marks=pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL here"),
        ),
        pytest.param(
            *("allocate", "Unable to allocate 8.00 GiB"),
            marks=pytest.mark.skipif(not limits_memory(), reason="memory is not limited here"),
        ),
    ],
)
def test_a_task_that_kills_its_workers_is_given_up_and_the_others_are_done(
    two: DaskExecutor, does: str, cause: str, tmp_path: Path
) -> None:
    ends, again = run(two, [*others(5), task(1, does=does), *others(8)[5:]], tmp_path)
    assert ends[1].record is None
    assert cause in str(ends[1].error)
    assert again[1] == TRIES - 1
    assert len(tries(tmp_path, 1)) == TRIES
    for value in range(100, 108):
        assert ends[value].record == {"square": value**2}


def test_a_task_that_hangs_is_given_up(tmp_path: Path) -> None:
    executor = DaskExecutor(2, limits=TaskLimits(seconds=0.3))
    try:
        ends, again = run(executor, [task(1, does="hang")], tmp_path)
    finally:
        executor.close()
    assert "killed its worker 3 times: it did not end within 0.3 s" in str(ends[1].error)
    assert again == {1: TRIES - 1}


def test_a_task_is_tried_again_on_another_worker(two: DaskExecutor, tmp_path: Path) -> None:
    ends, again = run(two, [task(1, does="stumble", times=1), *others(4)], tmp_path)
    assert ends[1].record == {"square": 1}
    assert again == {1: 1}
    first, second = tries(tmp_path, 1)
    assert first != second


def test_a_task_that_kills_its_worker_once_is_done_at_the_second_try(
    two: DaskExecutor, tmp_path: Path
) -> None:
    ends, _ = run(two, [task(1, does="leave", times=1), *others(4)], tmp_path)
    assert all(outcome.record for outcome in ends.values())
    assert len(ends) == 5


def test_a_task_is_not_tried_again_if_that_cannot_help(
    two: DaskExecutor, tmp_path: Path
) -> None:
    ends, again = run(two, [task(1, does="fail")], tmp_path)
    assert ends[1].error == "cloud.las: bad"
    assert not again


def test_a_single_worker_is_a_process_of_its_own(tmp_path: Path) -> None:
    executor = DaskExecutor(1)
    try:
        ends, again = run(executor, [task(1, does="crash", times=2), *others(2)], tmp_path)
    finally:
        executor.close()
    assert all(outcome.record for outcome in ends.values())
    assert again == {1: 2}
    assert len(set(tries(tmp_path, 1))) == 3
    assert str(os.getpid()) not in tries(tmp_path, 1)


def test_workers_can_be_ended_during_their_work(tmp_path: Path) -> None:
    before = set(psutil.Process().children(recursive=True))
    level = logging.getLogger("distributed").level
    executor = DaskExecutor(2)
    outcomes = executor.run(
        calls.run_task, str(tmp_path), [task(1), task(2, wait=900), task(3, wait=900)]
    )
    next(outcomes)

    def workers() -> set[psutil.Process]:
        return set(psutil.Process().children(recursive=True)) - before

    # The server of forks is included; the second worker may not have started when the first one
    # is done.
    wait_until(lambda: len(workers()) == 2 + FORKS)
    at_work = workers()
    executor.close()
    wait_until_gone(at_work)
    assert logging.getLogger("distributed").level == level


def listening() -> set[Any]:
    """Addresses on which this process and its children accept connections."""
    here = psutil.Process()
    return {
        c.laddr
        for p in (here, *here.children())
        for c in p.net_connections()
        if c.status == "LISTEN"
    }


LISTENING_BEFORE = listening()
"""Those of pytest's plugins."""


def test_workers_of_this_machine_open_no_port(two: DaskExecutor, tmp_path: Path) -> None:
    run(two, others(2), tmp_path)
    assert listening() <= LISTENING_BEFORE


def test_dask_looks_for_no_module_in_a_folder_of_its_own_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another user may have made that folder in the shared temporary folder, with modules in it."""
    asked: list[str] = []

    def note(name: str, *_: Any) -> None:
        asked.append(name)

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "shared"))
    (tmp_path / "shared").mkdir()
    monkeypatch.setattr(sys, "meta_path", [SimpleNamespace(find_spec=note), *sys.meta_path])
    before, configured = list(sys.path), copy.deepcopy(dask.config.config)
    executor = DaskExecutor(2)
    try:
        assert not {"gilknocker", "prometheus_client"} & set(asked)
        assert sys.path == before
        assert not list((tmp_path / "shared").iterdir())
        run(executor, others(2), tmp_path)
    finally:
        executor.close()
    assert sys.path == before
    assert dask.config.config == configured
    assert not list((tmp_path / "shared").iterdir())


def test_children_of_a_cluster_s_workers_import_nothing_from_folders_of_dask(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = str(tmp_path / "modules")
    for folder in (other, str(tmp_path / "dask-scratch-space" / "worker-1")):
        monkeypatch.syspath_prepend(folder)
    found = child_environment()["PYTHONPATH"].split(os.pathsep)
    assert other in found
    assert not [entry for entry in found if "dask-scratch-space" in entry]


@pytest.mark.processes
def test_the_user_s_configuration_of_dask_does_not_reach_the_workers_of_this_machine(
    tmp_path: Path,
) -> None:
    preload = tmp_path / "preload.py"
    preload.write_text("print('preloaded')\n")
    of_user = {name: {"preload": [str(preload)]} for name in ("client", "scheduler", "worker")}
    (tmp_path / "user.yaml").write_text(json.dumps({"distributed": of_user}))
    program = (
        "import dask\n"
        "from tiler.schedule.workers import DaskExecutor\n"
        "def connect(): return dask.config.get('distributed.comm.timeouts.connect')\n"
        "before, executor = connect(), DaskExecutor(1)\n"
        "print(before, connect())\n"
        "executor.close()\n"
        "print(connect())\n"
    )
    environment = {
        **os.environ,
        "DASK_CONFIG": str(tmp_path),
        "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "1ms",
    }
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_SECONDS,
        check=True,
    )
    assert done.stdout.split() == ["1ms", "30s", "1ms"]


@pytest.mark.processes
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="processes cannot be stopped here")
@pytest.mark.parametrize("stopped", ["", ".parent()"])
def test_an_executor_ends_without_orphans_while_its_processes_are_stopped(
    stopped: str, tmp_path: Path
) -> None:
    program = (
        "import psutil\n"
        "from tests.tiler.schedule import calls\n"
        "from tiler.schedule import Task, fork_server_running, workers\n"
        "workers.CLOSE_SECONDS = 0.5\n"
        "with fork_server_running():\n"
        "    executor = workers.DaskExecutor(1)\n"
        "    task = Task('stage', 't', 'digest', calls.square, {'value': 2}, points=1)\n"
        f"    list(executor.run(calls.run_task, {str(tmp_path)!r}, [task]))\n"
        "    child = psutil.Process().children(recursive=True)[-1]\n"
        "    print(child.pid, child.ppid())\n"
        f"    child{stopped}.suspend()\n"
        "    executor.close()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        timeout=PATIENCE_SECONDS,
        check=False,
    )
    pids = [int(number) for number in done.stdout.split()]
    try:
        assert (done.returncode, done.stderr, len(pids)) == (0, "", 2)
        wait_until(lambda: not any(map(psutil.pid_exists, pids)))
    finally:
        for pid in filter(psutil.pid_exists, pids):
            os.kill(pid, signal.SIGKILL)


@pytest.mark.processes
def test_a_configuration_of_dask_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "user.yaml").write_text("distributed: [\n  x: : {\n")
    program = (
        "from tiler.errors import ConfigError\n"
        "from tiler.schedule import import_dask, make_executor\n"
        "import_dask()\n"
        "try: make_executor(1)\n"
        "except ConfigError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "DASK_CONFIG": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_SECONDS,
        check=True,
    )
    assert done.stderr == ""
    assert done.stdout.count("\n") == 1
    assert done.stdout.startswith("the configuration of Dask cannot be read (")
    assert "user.yaml" in done.stdout


def test_executors_made_at_the_same_time_restore_the_configuration_of_dask() -> None:
    before, made = copy.deepcopy(dask.config.config), list[DaskExecutor]()
    level = logging.getLogger("distributed").level
    threads = [Thread(target=lambda: made.append(DaskExecutor(1))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for executor in made:
        executor.close()
    assert len(made) == 4
    assert dask.config.config == before
    assert logging.getLogger("distributed").level == level


@pytest.mark.parametrize(("times", "record"), [(2, {"square": 1}), (3, None)])
def test_the_serial_executor_tries_as_often(
    times: int, record: dict[str, int] | None, tmp_path: Path
) -> None:
    ends, again = run(
        SerialExecutor(), [task(1, does="stumble", times=times), *others(1)], tmp_path
    )
    assert ends[1].record == record
    assert again == {1: TRIES - 1}
    assert ends[100].record


def test_larger_tasks_may_take_longer() -> None:
    limits = TaskLimits(seconds=10)
    assert limits.seconds_of(Task("s", "k", "d", calls.square, {}, points=5_000_000)) == 50
    assert limits.seconds_of(task(1)) == 10


@pytest.mark.parametrize("address", ["garbage", "tcp://host", "ftp://host:8786", ""])
def test_a_malformed_address_is_refused_at_once(address: str) -> None:
    level = logging.getLogger("distributed").level
    with pytest.raises(ConfigError, match="no Dask scheduler answers there"):
        DaskExecutor(2, address)
    assert logging.getLogger("distributed").level == level


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    """Address of a scheduler with one worker."""
    options = {
        "threads_per_worker": 1,
        "processes": False,
        "protocol": "tcp",
        "memory_limit": 0,
    }
    with LocalCluster(
        n_workers=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", **options
    ) as cluster:
        yield int(cluster.scheduler_address.rsplit(":", 1)[1])


@pytest.mark.processes
@pytest.mark.parametrize("for_good", [False, True])
def test_the_connection_breaks_while_a_result_is_fetched(
    for_good: bool,
    port: int,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The task is done again over a new connection; without one, the run ends with a one-line error."""
    cable = Cable(port)
    cable.start()
    executor = DaskExecutor(1, cable.address)
    if for_good:
        executor._client._timeout = 1  # for reconnecting
    fetch = executor._client._gather_remote

    async def cut(*arguments: Any) -> Any:
        executor._client._gather_remote = fetch
        cable.cut(for_good)
        return await fetch(*arguments)

    executor._client._gather_remote = cut
    try:
        if for_good:
            with pytest.raises(
                ConnectionLostError, match="the connection broke and was not restored"
            ):
                run(executor, others(2), tmp_path)
            with pytest.raises(ConnectionLostError):
                executor.machines()
            assert not [r for r in caplog.records if r.name == "distributed.client"], (
                "said by Dask as well"
            )
            return
        ends, again = run(executor, others(2), tmp_path)
    finally:
        executor.close()
        cable.cut(for_good=True)
    assert all(outcome.record for outcome in ends.values())
    assert sum(again.values()) >= 1


@pytest.mark.processes
@pytest.mark.parametrize("error", [OSError("no"), AttributeError("no"), RuntimeError("no")])
def test_a_worker_that_is_unfit_is_refused_whenever_it_joins(
    error: Exception, port: int, tmp_path: Path
) -> None:
    """An error in a worker is its answer and not a broken connection."""
    executor = DaskExecutor(1, f"tcp://127.0.0.1:{port}")
    try:
        run(executor, others(1), tmp_path)

        def look(ask: Callable[..., Any], worker: str) -> None:
            try:
                ask(calls.fail_with, error)
            except type(error) as answer:
                raise ConfigError(f"{worker} is unfit") from answer

        with pytest.raises(ConfigError, match="is unfit"):
            executor.on_each_worker(look)
    finally:
        executor.close()


@pytest.mark.processes
def test_a_cluster_whose_workers_come_late_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cluster without workers is refused after a while."""
    options = {
        "threads_per_worker": 1,
        "processes": False,
        "protocol": "tcp",
        "memory_limit": 0,
    }
    with LocalCluster(
        n_workers=0, host="127.0.0.1", dashboard_address="127.0.0.1:0", **options
    ) as cluster:
        monkeypatch.setattr("tiler.schedule.workers.WORKERS_SECONDS", 0.5)
        with pytest.raises(
            ConfigError, match="it has no workers; start some with `dask worker"
        ):
            DaskExecutor(1, cluster.scheduler_address)
        monkeypatch.setattr("tiler.schedule.workers.WORKERS_SECONDS", PATIENCE_SECONDS)
        Timer(1.0, cluster.scale, [1]).start()
        executor = DaskExecutor(1, cluster.scheduler_address)
        try:
            assert executor.workers == 1
            run(executor, others(1), tmp_path)
        finally:
            executor.close()


def test_the_dashboard_of_dask_groups_tasks_by_stage(two: DaskExecutor, tmp_path: Path) -> None:
    stages = ("ingest", "filter0", "grid-water-planes")
    tasks = [replace(task(value, wait=0.02), stage=stages[value % 3]) for value in range(9)]
    groups = set()
    for _ in two.run(calls.run_task, str(tmp_path), tasks):
        groups |= set(two._cluster.scheduler.task_prefixes)
    assert groups - {"stage"} == set(stages), "and those of earlier tests"


@pytest.mark.skipif(not FORKS, reason="children are not forked here")
def test_a_process_that_cannot_start_is_not_reported_as_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("A_SERVER", "that forks once")
    limits = TaskLimits(
        memory_bytes=1 << 30, seconds=PATIENCE_SECONDS, prepare=calls.refuse_forks
    )
    executor = DaskExecutor(2, limits=limits)
    try:
        ends, _ = run(executor, [task(1, wait=3), task(2, wait=3)], tmp_path)
    finally:
        executor.close()
    done, left = sorted(ends.values(), key=lambda outcome: outcome.error is not None)
    assert done.error is None
    assert str(left.error).startswith(
        "its process could not start: the system has no memory left"
    )
