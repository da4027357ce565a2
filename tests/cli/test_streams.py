"""What becomes of a command whose output nobody reads, or cannot be written."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import IO, Any

import pytest

from cli.output import print_json
from tests.integration.command import assert_one_line, command, environment
from tests.invariants import clouds
from tests.waiting import PATIENCE_SECONDS


def unread() -> IO[bytes]:
    """A pipe whose reader went away."""
    reading, writing = os.pipe()
    os.close(reading)
    return os.fdopen(writing, "wb")


def run(*arguments: object, **streams: IO[bytes] | int) -> Any:
    settings: dict[str, Any] = {
        "text": True,
        "env": environment(),
        "check": False,
        "timeout": PATIENCE_SECONDS,
    }
    return subprocess.run(command(*arguments), **settings, **streams)


@pytest.mark.processes
@pytest.mark.parametrize(
    ("arguments", "code"),
    [(("methods",), 0), (("config", "--template"), 0), (("--help",), 0), (("info", "no"), 3)],
)
def test_a_reader_that_went_away_is_no_failure(arguments: tuple[str, ...], code: int) -> None:
    with unread() as nobody:
        done = run(*arguments, stdout=nobody, stderr=subprocess.PIPE)
    assert done.returncode == code
    assert done.stderr.count("tiler: error") == (code != 0)
    assert done.stderr.count("\n") == (code != 0)


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252", "ascii"])
def test_json_can_be_read_back_whatever_the_code_page(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    value, written = (
        {"unit": "0.5\N{DEGREE SIGN}", "name": "M\u011bsto \U0001f3d4 \x1b"},
        io.BytesIO(),
    )
    stream = io.TextIOWrapper(written, encoding, newline="")
    monkeypatch.setattr(sys, "stdout", stream)
    print_json(value)
    stream.flush()
    text = written.getvalue().decode("utf-8")
    assert json.loads(text) == value
    assert text.isascii() == (encoding != "utf-8")


@pytest.mark.processes
@pytest.mark.slow
def test_a_run_that_nobody_listens_to_goes_on(tmp_path: Path) -> None:
    cloud = clouds.write(tmp_path / "hill.laz", clouds.city(60.0, 1.0))
    cut = tmp_path / "cut.laz"
    cut.write_bytes(cloud.read_bytes()[:-2000])
    options = ("-o", tmp_path / "out", "--method", "classic", "--in-process", "--resolution", 1)
    with unread() as nobody:
        assert run("run", cloud, cut, *options, stdout=nobody, stderr=nobody).returncode == 5
    assert (tmp_path / "out" / "dtm.tif").is_file()
    with unread() as nobody:
        assert run("run", cloud, *options, stdout=nobody, stderr=nobody).returncode == 0


@pytest.mark.processes
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")
def test_results_on_a_full_disk_are_an_error_and_progress_is_not() -> None:
    with open("/dev/full", "wb") as full:
        done = run("methods", stdout=full, stderr=subprocess.PIPE)
        assert done.returncode == 4
        assert_one_line(done.stderr, "stdout: cannot be written (No space left on device)")
        done = run("info", "no", stdout=subprocess.PIPE, stderr=full)
        assert done.returncode == 3
