"""Ctrl-C and kill on the whole process group: 130, no process left behind, and the same command goes on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from ptd.precompile import warm_filters, warm_gridding
from tests.integration.command import started
from tests.integration.held import held, hold
from tests.invariants import clouds
from tests.invariants.runs import do, output_digests, the_store
from tests.scenes.running import IS_WINE, wait_for, wait_until_gone
from tests.waiting import PATIENCE_SECONDS
from tiler.runs.compiling import warm_sorting

pytestmark = pytest.mark.processes

STAGES = ("spool", "assemble", "filter0", "grid-dtm", "export")
OPTIONS = "--method classic --workers 2 --resolution 1 --tile-size 64 --halo 80 --memory 1GiB"


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of some tiles; the kernels are compiled."""
    warm_sorting(lambda: None)
    warm_filters("classic", lambda: None)
    warm_gridding("linear", lambda: None)
    return clouds.write(tmp_path_factory.mktemp("cloud") / "city.laz", clouds.city(160.0, 1.5))


@pytest.fixture(scope="module")
def undisturbed(cloud: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    do(cloud, out)
    return output_digests(out)


Start = Callable[..., subprocess.Popen[str]]

IN_CONSOLE = """
import ctypes, os, signal, subprocess, sys
key = getattr(signal, sys.argv[1])
signal.signal(signal.SIGINT, signal.SIG_IGN)
signal.signal(signal.SIGBREAK, signal.SIG_IGN)
ctypes.WinDLL("kernel32").SetConsoleCtrlHandler(None, False)  # children take Ctrl-C, whoever started this
child = subprocess.Popen(sys.argv[2:], stdin=subprocess.DEVNULL)
sys.stdin.readline()
os.kill(0, key)
sys.exit(child.wait())
"""
"""Program of a console of Windows: a command runs in it, and a line of its input presses a key there."""


@pytest.fixture
def start(interruptible: None) -> Iterator[Start]:
    """The command at the head of a process group or a console of its own; what a test leaves is ended."""
    processes: list[subprocess.Popen[str]] = []

    def begin(cloud: Path, out: Path, *console: object) -> subprocess.Popen[str]:
        hold(out)
        call = [*console, *held("run", cloud, "-o", out, *OPTIONS.split())]
        own = {
            "creationflags": getattr(subprocess, "CREATE_NO_WINDOW", 0),
            "stdin": subprocess.PIPE,
        }
        processes.append(started(call, start_new_session=True, **own))
        return processes[-1]

    yield begin
    for process in processes:
        if process.poll() is None:
            if hasattr(os, "killpg"):
                os.killpg(process.pid, signal.SIGKILL)
            process.kill()
            process.communicate()


INTERRUPTS = (
    [
        pytest.param("CTRL_C_EVENT", id="ctrl-c"),
        pytest.param(
            "CTRL_BREAK_EVENT",
            id="ctrl-break",
            marks=pytest.mark.skipif(IS_WINE, reason="Wine tells no program of Ctrl-Break"),
        ),
    ]
    if sys.platform == "win32"
    else [
        pytest.param("SIGINT", id="ctrl-c"),
        pytest.param("SIGTERM", id="a batch system's SIGTERM", marks=pytest.mark.slow),
    ]
)


@pytest.mark.parametrize("interrupt", INTERRUPTS)
def test_an_interrupt_ends_it_and_the_command_goes_on(
    interrupt: str,
    start: Start,
    cloud: Path,
    undisturbed: dict[str, str],
    tmp_path: Path,
) -> None:
    """Each goes to every process: by the terminal to its group, by a batch system to all of a job."""
    out = tmp_path / "out"
    in_console = [sys.executable, "-c", IN_CONSOLE, interrupt] if os.name == "nt" else []
    process = start(cloud, out, *in_console)
    wait_for(out, "task_done", "filter0", process)
    group = psutil.Process(process.pid).children(recursive=True)
    assert len(group) >= 2
    if sys.platform == "win32":
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.flush()
    else:
        os.killpg(process.pid, getattr(signal, interrupt))
    _, error = process.communicate(timeout=PATIENCE_SECONDS)
    assert process.returncode == 130, error
    assert error.splitlines()[-1] == "tiler: interrupted; run the same command again to resume"
    assert "Traceback" not in error
    wait_until_gone(group)
    assert json.loads((out / "run.json").read_text())["state"] == "interrupted"
    assert not list(out.rglob("*.partial*"))
    # The job again, here: nothing that was finished is done once more, and the bytes are those
    # of a run in peace.
    store = the_store(out)
    before = {stage: len(store.committed(stage)) for stage in STAGES}
    assert before["filter0"]
    stages = do(cloud, out).summary["stages"]
    for stage in STAGES:
        assert stages[stage]["done"] == before[stage]
        assert stages[stage]["computed"] == stages[stage]["tasks"] - before[stage]
    assert output_digests(out) == undisturbed


def test_kill_of_the_command_alone_takes_its_workers_along_and_it_goes_on(
    start: Start, cloud: Path, undisturbed: dict[str, str], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    process = start(cloud, out)
    wait_for(out, "task_done", "filter0", process)
    group = psutil.Process(process.pid).children(recursive=True)
    assert len(group) >= 2
    process.kill()
    process.communicate(timeout=PATIENCE_SECONDS)
    wait_until_gone(group)
    do(cloud, out)
    assert output_digests(out) == undisturbed
