"""SIGTERM at any moment of any command: it ends, its children too, and nothing that was done is lost."""

from __future__ import annotations

import random
import signal
import subprocess
import time
from pathlib import Path

import psutil
import pytest

from cli.main import COMMANDS
from tests.integration.command import command, environment, started, tiler
from tests.invariants import clouds
from tests.invariants.runs import output_digests
from tests.scenes.running import wait_until_gone
from tests.waiting import PATIENCE_SECONDS, wait_until

pytestmark = [pytest.mark.slow, pytest.mark.processes]

INSTANTS, INSTANTS_OF_A_RUN = 1, 3
OPTIONS = ("--method", "classic", "--workers", "2", "--resolution", "1", "--tile-size", "64", "--halo", "80")
JOBS = ("run", "ingest", "filter", "grid", "export")
ENDED_ITSELF = (0, 2, 3, 5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloud of a second or two, checkpoints, and a finished run, for commands that look at one."""
    folder = tmp_path_factory.mktemp("sigterm")
    clouds.write(folder / "town.laz", clouds.city(192.0, 2.0))
    lines = [f"{500_000 + 5 * i},{5_400_000 + 5 * i},100" for i in range(1, 30)]
    (folder / "points.csv").write_text("x,y,z\n" + "\n".join(lines))
    assert tiler("run", folder / "town.laz", "-o", folder / "done", *OPTIONS).returncode == 0
    return folder


def arguments(name: str, folder: Path, out: Path) -> list[str]:
    """A call that works for a while."""
    town, done = str(folder / "town.laz"), folder / "done"
    checks = ["--points", str(folder / "points.csv"), "--strips", str(done / "classified" / "town.laz")]
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
        "clean": ["clean", str(done)],
        "simulate": ["simulate", str(out / "scene.laz"), "--size", "300"],
        "config": ["config", "--template"],
        "qgis": ["qgis", "package", str(out / "plugin.zip")],
        "demo": ["demo", "-o", str(out), "--method", "classic", "--workers", "2"],
    }[name]


def interrupted(call: list[str], after: float, begun: Path | None = None, **variables: str) -> int:
    """Start a command, send SIGTERM some seconds after a file is there, and see what becomes of it; its exit code."""
    process = started(command(*call), stdout=subprocess.DEVNULL, env={**environment(), **variables})
    if begun is not None:
        wait_until(begun.exists, process)
    time.sleep(after)
    children = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
    process.send_signal(signal.SIGTERM)
    _, error = process.communicate(timeout=PATIENCE_SECONDS)
    wait_until_gone(children)
    # Before the command has begun, and after it is done, the signal ends Python itself.
    assert process.returncode in (130, -signal.SIGTERM, *ENDED_ITSELF), error
    if process.returncode == 130:
        assert error.splitlines()[-1].startswith("tiler: interrupted")
        assert "Traceback" not in error
    return process.returncode


@pytest.mark.parametrize("name", COMMANDS)
def test_in_every_command(name: str, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "whole").mkdir()
    began = time.monotonic()
    call = arguments(name, folder, tmp_path / "whole")
    whole = tiler(*call)
    assert whole.returncode == 0, whole.stderr
    length, rng = time.monotonic() - began, random.Random(name)
    instants = INSTANTS_OF_A_RUN if name == "run" else INSTANTS
    for number in range(instants):
        out = tmp_path / str(number)
        out.mkdir()
        interrupted(arguments(name, folder, out), length * (number + rng.random()) / instants)
        if name == "run":
            assert tiler(*arguments(name, folder, out)).returncode == 0
            assert output_digests(out) == output_digests(folder / "done")


def test_while_kernels_compile(folder: Path, tmp_path: Path) -> None:
    """Which takes a minute, most of it in a library."""
    for number, after in enumerate((1.0, 9.0)):
        out = tmp_path / str(number)
        call = [*arguments("run", folder, out), "--method", "auto"]
        # From the usual place, kernels that were compiled before would be taken over.
        cache = str(tmp_path / f"cache{number}")
        variables = {"NUMBA_CACHE_DIR": cache, "XDG_CACHE_HOME": cache}
        assert interrupted(call, after, out / "events.jsonl", **variables) in (130, 0)
