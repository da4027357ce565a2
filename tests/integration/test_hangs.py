"""Files that would be read for ever, or take all memory: refused with one line; SIGTERM ends what is stuck."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from cli.main import main
from tests.integration.command import assert_one_line, command, started
from tests.integration.hanging import endless_geopackage, huge_raster
from tests.invariants import clouds
from tests.scenes.running import wait_until_gone
from tests.waiting import PATIENCE_SECONDS, wait_until


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clouds.write(tmp_path_factory.mktemp("cloud") / "town.laz", clouds.city(60.0))


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("hostile")
    return {
        "area": endless_geopackage(folder / "area.gpkg"),
        "points": endless_geopackage(folder / "points.gpkg", "POINT"),
        "raster": huge_raster(folder / "huge.tif"),
    }


def asked(cloud: Path, hostile: dict[str, Path], out: Path) -> dict[str, list[str]]:
    """Commands that read such a file."""
    raster, area, points = (str(hostile[kind]) for kind in ("raster", "area", "points"))
    return {
        "plan --aoi": ["plan", str(cloud), "--aoi", area],
        "check --points": ["check", raster, "--points", points],
        "info": ["info", raster],
        "run --aoi": ["run", str(cloud), "-o", str(out), "--aoi", area],
        "check --tile-size": ["check", raster, "--tile-size", "500"],
        "evaluate --dtm": ["evaluate", "--dtm", raster, "--true-dtm", raster],
    }


DEFAULT = ("plan --aoi", "check --points", "info")
SLOW = [
    pytest.param(n, marks=pytest.mark.slow)
    for n in ("run --aoi", "check --tile-size", "evaluate --dtm")
]


@pytest.mark.parametrize("name", [*DEFAULT, *SLOW])
def test_what_never_ends_is_given_up(
    name: str,
    cloud: Path,
    hostile: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("tiler.schedule.guarded_calls.MIN_SECONDS", 1.0)
    monkeypatch.setattr("tiler.schedule.guarded_calls.BYTES_PER_SECOND", 1e8)
    assert main(asked(cloud, hostile, tmp_path / "out")[name]) == 3
    assert_one_line(
        capsys.readouterr().err,
        "the process that reads it did not end within",
        str(next(iter(hostile.values())).parent),
    )


def test_settings_without_end_are_not_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "endless.toml").symlink_to("/dev/zero")
    (tmp_path / "deep.toml").write_text("a = " + "[" * 100_000)
    (tmp_path / "long.toml").write_text("a = " + "9" * 5000)
    for name, part in (
        ("endless", ": has more than 1 MiB"),
        ("deep", ": not valid TOML"),
        ("long", ": not valid TOML"),
    ):
        assert main(["config", "--config", str(tmp_path / f"{name}.toml")]) == 2
        assert_one_line(capsys.readouterr().err, f"{name}.toml{part}")


def end_of(call: list[str], at_work: Callable[[psutil.Process], bool]) -> str:
    """Send SIGTERM to a command a moment after it is at work; it ends, its children too. What it said."""
    process = started(call)
    wait_until(lambda: at_work(psutil.Process(process.pid)), process)
    time.sleep(0.2)
    children = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGTERM)
    _, error = process.communicate(timeout=PATIENCE_SECONDS)
    wait_until_gone(children)
    assert process.returncode == 130, error
    return error


no_sigterm = pytest.mark.skipif(
    sys.platform == "win32", reason="Windows kills a process instead of sending it SIGTERM"
)


@no_sigterm
@pytest.mark.processes
@pytest.mark.parametrize("name", ["plan --aoi", pytest.param("info", marks=pytest.mark.slow)])
def test_sigterm_ends_the_reading_of_what_never_ends(
    name: str, cloud: Path, hostile: dict[str, Path], tmp_path: Path
) -> None:
    call = command(*asked(cloud, hostile, tmp_path / "out")[name])
    error = end_of(call, lambda process: len(process.children(recursive=True)) > 1)
    assert error.splitlines()[-1].startswith("tiler: interrupted")


STUCK = """
import ctypes, pathlib, sys
import cli.commands.methods as methods
def stuck(*arguments, **settings):
    for _ in range(1000):
        try:
            pathlib.Path(__file__).with_name("ready").touch()
            {}
        except KeyboardInterrupt:
            pass
methods.command.callback = stuck
from cli.main import main
sys.argv = ["tiler", "methods"]
sys.exit(main())
"""


def interrupted(folder: Path, program: str, grace_seconds: float) -> str:
    """What a program says that is interrupted once it is stuck, for a minute each time."""
    grace = f"import cli.ending\ncli.ending.GRACE_SECONDS = {grace_seconds}\n"
    (folder / "stuck.py").write_text(grace + program)
    return end_of(
        [sys.executable, str(folder / "stuck.py")], lambda _: (folder / "ready").exists()
    )


@no_sigterm
@pytest.mark.processes
def test_an_interruption_of_which_a_library_makes_an_error_is_one(tmp_path: Path) -> None:
    """As a compressor does whose file is written by Python."""
    stuck = STUCK.format("__import__('time').sleep(60)").replace(
        "pass", "raise ValueError('write')"
    )
    assert interrupted(tmp_path, stuck, grace_seconds=900) == "tiler: interrupted\n"


@no_sigterm
@pytest.mark.processes
@pytest.mark.parametrize(
    "what",
    [
        pytest.param("ctypes.CDLL(None).usleep(60_000_000)", id="C"),
        pytest.param("__import__('time').sleep(60)", id="swallowed", marks=pytest.mark.slow),
    ],
)
def test_what_does_not_let_go_is_ended_by_force(what: str, tmp_path: Path) -> None:
    """A library that computes and looks at no signal, and one that swallows the interruption."""
    error = interrupted(tmp_path, STUCK.format(what), grace_seconds=1)
    assert error == "tiler: interrupted; the work did not stop, so the process was ended\n"
