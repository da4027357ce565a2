"""The wheel and the sdist: built without a network, complete, equal, and installed in a clean environment."""

from __future__ import annotations

import os
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from tests.integration.command import ROOT, ended
from tiler.version import __version__

pytestmark = [pytest.mark.slow, pytest.mark.processes]

PACKAGES = ("tiler", "ptd", "cli")
BUILD_OFFLINE = """
import runpy, socket
def refuse(*arguments):
    raise OSError("a build needs no network")
socket.socket.connect = socket.getaddrinfo = refuse
runpy.run_module("hatchling", run_name="__main__")
"""


def build(source: Path, target: Path) -> Path:
    """The wheel of a folder of sources; the sdist lies beside it."""
    made = ended(
        [sys.executable, "-c", BUILD_OFFLINE, "build", "--directory", target], cwd=source
    )
    assert made.returncode == 0, made.stdout + made.stderr
    return target / f"tiler_dtm-{__version__}-py3-none-any.whl"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(ROOT, tmp_path_factory.mktemp("dist"))


def test_the_wheel_has_all_files_of_the_packages_and_its_licence(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    facts = {name for name in names if ".dist-info/" in name}
    assert f"tiler_dtm-{__version__}.dist-info/licenses/LICENSE" in facts
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*")]
    wanted = {
        p.relative_to(ROOT).as_posix()
        for p in files
        if p.is_file() and "__pycache__" not in p.parts
    }
    assert names - facts == wanted


def test_the_sdist_builds_the_same_wheel_and_has_what_its_tests_read(
    wheel: Path, tmp_path: Path
) -> None:
    with tarfile.open(wheel.parent / f"tiler_dtm-{__version__}.tar.gz") as archive:
        archive.extractall(tmp_path, filter="data")
    source = tmp_path / f"tiler_dtm-{__version__}"
    assert build(source, tmp_path / "dist").read_bytes() == wheel.read_bytes()
    tests = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "tests/test_packaging.py",
    ]
    done = ended(tests, cwd=source)
    assert done.returncode == 0, done.stdout


def test_a_clean_environment_runs_the_wheel_and_not_the_checkout(
    wheel: Path, tmp_path: Path
) -> None:
    """The dependencies come from this environment: `.ci/run` installs them anew."""
    venv.create(tmp_path / "clean", with_pip=True)
    python = tmp_path / "clean/bin/python"
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    install = [python, "-m", "pip", "install", "--no-index", "--no-deps", "--quiet", wheel]
    made = ended(install, env=clean)
    assert made.returncode == 0, made.stderr
    found = "import site; print(site.getsitepackages()[0])"
    own, theirs = (
        Path(ended([p, "-c", found], env=clean).stdout.strip())
        for p in (python, sys.executable)
    )
    (own / "dependencies.pth").write_text(f"{theirs}\n")
    asked = ended(
        [python, "-c", "import tiler; print(tiler.__file__)"], env=clean, cwd=tmp_path
    )
    assert Path(asked.stdout.strip()).is_relative_to(own), asked.stderr
    command = tmp_path / "clean/bin/tiler"
    assert __version__ in ended([command, "--version"], env=clean, cwd=tmp_path).stdout
    done = ended([command, "qgis", "package", tmp_path / "plugin.zip"], env=clean, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
