"""Systems that lack what POSIX alone has: every module can be imported; a run gives the same and says what it lacks."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.integration.command import ROOT, assert_one_line, command, ended, environment
from tests.scenes import bare_system, windows_files
from tiler.simulate import DemoScene

pytestmark = pytest.mark.processes

IMPORT_ALL = """
import importlib, pathlib, sys
import cli
for package in ("ptd", "tiler", "cli"):
    for path in sorted(pathlib.Path(package).rglob("*.py")):
        if "plugin" in path.parts:
            continue  # runs in QGIS alone, and imports its libraries
        name = ".".join(path.with_suffix("").parts).removesuffix(".__init__")
        importlib.import_module(name)
assert sys.modules["tiler.schedule.guard"]._resource is None
print(sum(name.startswith(("ptd", "tiler", "cli")) for name in sys.modules))
"""


MAX_LENGTH_BELOW_OUT = 120
"""Of the 259 characters of a path that Windows takes, so many lie below OUT at most, in this
run."""
LIKE_WINDOWS = """
import builtins, os, pathlib, subprocess, sys, tempfile

def refused(kind, winerror, do, *arguments):
    try:
        do(*arguments)
    except kind as error:
        assert error.winerror == winerror, error
    else:
        raise AssertionError((do, arguments))

pathlib.Path("a").write_text("a")
pathlib.Path("b").write_text("b")
with open("a"):
    for call in ((os.replace, "a", "c"), (os.replace, "b", "a"), (os.rename, "a", "c"), (os.remove, "a")):
        refused(PermissionError, 32, *call)
pathlib.Path("a").replace("c")
refused(FileExistsError, 183, os.rename, "b", "c")
assert pathlib.Path("C").read_text() == "a" and os.path.exists("B")
pathlib.Path("New").mkdir()
assert os.listdir("new") == []
assert os.path.basename(os.path.realpath("NEW")) == "New"
for name in ("a:b", "nul", "con.txt", "end.", "a*"):
    refused(OSError, 123, open, name, "w")
refused(FileNotFoundError, 3, open, "x" * 200 + "/" + "y" * 200, "w")
with open("b", "rb") as stream:
    try:
        os.fsync(stream.fileno())
    except OSError:
        pass
    else:
        raise AssertionError("synced")
other = subprocess.Popen([sys.executable, "-c", "f = open('b'); print(); input()"], stdin=-1, stdout=-1)
other.stdout.readline()
refused(PermissionError, 32, os.remove, "b")
other.communicate(b"\\n")
os.remove("b")
with tempfile.TemporaryDirectory() as folder:
    pathlib.Path(folder, "x").touch()
print("done")
"""


@pytest.fixture
def bare(tmp_path: Path) -> dict[str, str]:
    """The environment of processes that lack what POSIX alone has."""
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(Path(bare_system.__file__).read_text("utf-8"))
    paths = environment()
    return {**paths, "PYTHONPATH": os.pathsep.join((str(folder), paths["PYTHONPATH"]))}


@pytest.fixture
def windows(tmp_path: Path) -> dict[str, Any]:
    """How processes are started whose files behave as on Windows, with a code page for what they print."""
    folder = tmp_path / "windows"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(Path(windows_files.__file__).read_text("utf-8"))
    (folder / "bare_system.py").write_text(Path(bare_system.__file__).read_text("utf-8"))
    paths = environment()
    own = {
        "PYTHONPATH": os.pathsep.join((str(folder), paths["PYTHONPATH"])),
        "PYTHONIOENCODING": "cp1252:strict",
    }
    return {"env": {**paths, **own}, "encoding": "cp1252", "start_new_session": True}


@pytest.mark.slow
def test_files_behave_as_on_windows(windows: dict[str, Any], tmp_path: Path) -> None:
    """What the layer of the next test refuses, so that the next test means something."""
    done = ended([sys.executable, "-c", LIKE_WINDOWS], cwd=tmp_path, **windows)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == ["done"]


@pytest.mark.slow
def test_a_run_with_files_as_on_windows_gives_the_same(
    windows: dict[str, Any], demo: DemoScene, tmp_path: Path
) -> None:
    """From the clouds to the files, then resumed, changed and cleaned; the cloud is named in another case."""
    cloud = shutil.copy(demo.paths[0], tmp_path / "Town.laz")
    options = (
        "--method",
        "classic",
        "--workers",
        2,
        "--tile-size",
        64,
        "--products",
        "dtm,hillshade",
    )
    plain, out = tmp_path / "plain", tmp_path / "out"
    whole = ended(command("run", cloud, "-o", plain, *options))
    assert whole.returncode == 0, whole.stderr
    named = tmp_path / "TOWN.LAZ"
    made = ended(command("run", named, "-o", out, *options), **windows)
    assert made.returncode == 0, made.stderr
    for name in ("dtm.tif", "hillshade.tif"):
        assert (out / name).read_bytes() == (plain / name).read_bytes()
    for path in out.rglob("*"):
        assert not windows_files.ILLEGAL.search(path.name), path
        assert not windows_files.DEVICES.fullmatch(path.name), path
        assert len(str(path.relative_to(out))) <= MAX_LENGTH_BELOW_OUT, path
    again = ended(command("run", named, "-o", out, *options, "--json"), **windows)
    assert again.returncode == 0, again.stderr
    assert not any(stage["computed"] for stage in json.loads(again.stdout)["stages"].values())
    changed = ended(
        command("run", named, "-o", out, *options[:-2], "--resolution", 2), **windows
    )
    assert changed.returncode == 0, changed.stderr
    assert (out / "outdated/hillshade.tif").is_file()
    other = ended(command("run", cloud, "-o", out, *options), **windows)
    assert other.returncode == 2, "it would have the same place"
    assert_one_line(other.stderr, "classified/Town.laz: already exists")
    cleaned = ended(command("clean", out), **windows)
    assert cleaned.returncode == 0, cleaned.stderr


@pytest.mark.slow
def test_every_module_can_be_imported(bare: dict[str, str]) -> None:
    made = ended([sys.executable, "-c", IMPORT_ALL], cwd=ROOT, env=bare)
    assert (made.returncode, made.stderr) == (0, "")
    assert int(made.stdout) > 300


@pytest.mark.slow
def test_a_run_gives_the_same(bare: dict[str, str], demo: DemoScene, tmp_path: Path) -> None:
    dtms = []
    for name, env in (("bare", bare), ("whole", environment())):
        out = tmp_path / name
        made = ended(command("run", demo.paths[0], "-o", out, "--method", "classic"), env=env)
        assert made.returncode == 0, made.stderr
        dtms.append((out / "dtm.tif").read_bytes())
    assert dtms[0] == dtms[1]
