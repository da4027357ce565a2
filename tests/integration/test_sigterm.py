"""SIGTERM at any moment of any command: it ends, its children too, and nothing that was done is lost."""

from __future__ import annotations

import random
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from cli.main import COMMANDS
from tests.integration.command import command, environment, started, tiler
from tests.invariants import clouds
from tests.invariants.runs import output_digests
from tests.scenes.running import has_event, wait_until_gone
from tests.waiting import PATIENCE_SECONDS, wait_until

pytestmark = [pytest.mark.slow, pytest.mark.processes]

OPTIONS = (
    "--method",
    "classic",
    "--workers",
    "2",
    "--resolution",
    "1",
    "--tile-size",
    "64",
    "--halo",
    "80",
)
JOBS = ("run", "ingest", "filter", "grid", "export")
LAST_STAGE = {
    "ingest": "assemble",
    "filter": "filter0",
    "grid": "grid-dtm",
    "export": "export",
    "demo": "export",
}
ENDED_ITSELF = (0, 2, 3, 5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloud of a second or two, checkpoints, and a finished run, for commands that look at one."""
    folder = tmp_path_factory.mktemp("sigterm")
    clouds.write(folder / "town.laz", clouds.city(192.0, 2.0))
    lines = [f"{500_000 + 5 * i},{5_400_000 + 5 * i},100" for i in range(1, 30)]
    (folder / "points.csv").write_text("x,y,z\n" + "\n".join(lines))
    assert tiler("run", folder / "town.laz", "-o", folder / "done", *OPTIONS).returncode == 0
    assert tiler("deliver", folder / "done", "--to", folder / "delivery").returncode == 0
    return folder


def arguments(name: str, folder: Path, out: Path) -> list[str]:
    """A call that works for a while."""
    town, done = str(folder / "town.laz"), folder / "done"
    checks = [
        "--points",
        str(folder / "points.csv"),
        "--strips",
        str(done / "classified" / "town.laz"),
    ]
    return {
        **{job: [job, town, "-o", str(out), *OPTIONS] for job in JOBS},
        "plan": ["plan", town, *OPTIONS],
        "classify": ["classify", town, str(out / "classified.laz"), "--method", "classic"],
        "preview": ["preview", town, "-o", str(out / "preview.png"), "--method", "classic"],
        "info": ["info", town],
        "methods": ["methods"],
        "warm": ["warm", "classic"],
        "evaluate": ["evaluate", town, "--method", "classic", "--maps", str(out / "maps")],
        "check": [
            "check",
            str(done / "dtm.tif"),
            *checks,
            "--tile-size",
            "64",
            "--figures",
            str(out / "figures"),
        ],
        "report": ["report", str(done)],
        "review": ["review", str(done), "--page", str(out / "review.html")],
        "statement": [
            "review",
            str(done),
            "--statement",
            "--page",
            str(out / "statement.html"),
        ],
        "deliver": ["deliver", str(done), "--to", str(out / "delivery")],
        "verify": ["verify", str(folder / "delivery")],
        "clean": ["clean", str(done)],
        "simulate": ["simulate", str(out / "scene.laz"), "--size", "300"],
        "config": ["config", "--template"],
        "qgis": ["qgis", "package", str(out / "plugin.zip")],
        "demo": ["demo", "-o", str(out), "--method", "classic", "--workers", "2"],
    }[name]


def interrupted(
    call: list[str], is_time: Callable[[subprocess.Popen[str]], bool], **variables: str
) -> int:
    """Start a command, send SIGTERM once it is time, and return its exit code."""
    process = started(
        command(*call), stdout=subprocess.DEVNULL, env={**environment(), **variables}
    )
    wait_until(lambda: process.poll() is not None or is_time(process))
    children = (
        psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
    )
    process.send_signal(signal.SIGTERM)
    _, error = process.communicate(timeout=PATIENCE_SECONDS)
    wait_until_gone(children)
    # Before the command has begun, and after it is done, the signal ends Python itself.
    assert process.returncode in (130, -signal.SIGTERM, *ENDED_ITSELF), error
    if process.returncode == 130:
        assert error.splitlines()[-1].startswith("tiler: interrupted")
        assert "Traceback" not in error
    return process.returncode


def after_cpu_seconds(seconds: float) -> Callable[[subprocess.Popen[str]], bool]:
    """Return a condition that does not depend on how busy the machine is.

    The process and its children have used so much CPU time.
    """

    def is_time(process: subprocess.Popen[str]) -> bool:
        try:
            command = psutil.Process(process.pid)
            times = [each.cpu_times() for each in (command, *command.children(recursive=True))]
        except psutil.NoSuchProcess:
            return process.poll() is not None
        return sum(used.user + used.system for used in times) >= seconds

    return is_time


@pytest.mark.parametrize("seconds", [0.0, 0.1, 0.2, 0.3, 0.45])
def test_at_the_start_of_any_command(seconds: float, folder: Path, tmp_path: Path) -> None:
    """All commands start with the same code."""
    interrupted(arguments("plan", folder, tmp_path), after_cpu_seconds(seconds))


@pytest.mark.parametrize(
    "name", [*(name for name in COMMANDS if name not in LAST_STAGE), "statement"]
)
def test_at_work(name: str, folder: Path, tmp_path: Path) -> None:
    seconds = random.Random(name).uniform(0.6, 1.3)
    interrupted(arguments(name, folder, tmp_path), after_cpu_seconds(seconds))


@pytest.mark.parametrize("name", LAST_STAGE)
def test_in_its_last_stage(name: str, folder: Path, tmp_path: Path) -> None:
    call = arguments(name, folder, tmp_path)
    assert interrupted(
        call, lambda _: has_event(tmp_path, "stage_started", LAST_STAGE[name])
    ) in (130, 0)


@pytest.mark.parametrize("stage", ["spool", "filter0", "export"])
def test_a_run_goes_on_from_any_stage(stage: str, folder: Path, tmp_path: Path) -> None:
    call = arguments("run", folder, tmp_path)
    assert interrupted(call, lambda _: has_event(tmp_path, "stage_started", stage)) in (130, 0)
    assert tiler(*call).returncode == 0
    assert output_digests(tmp_path) == output_digests(folder / "done")


@pytest.mark.parametrize("n_kernels", [1, 20])
def test_while_kernels_compile(n_kernels: int, folder: Path, tmp_path: Path) -> None:
    # From the usual place, kernels that were compiled before would be taken over.
    cache = tmp_path / "cache"
    variables = {"NUMBA_CACHE_DIR": str(cache), "XDG_CACHE_HOME": str(cache)}
    call = [*arguments("run", folder, tmp_path / "out"), "--method", "auto"]
    code = interrupted(
        call, lambda _: len(list(cache.rglob("*.nbc"))) >= n_kernels, **variables
    )
    assert code in (130, 0)
