"""Modules that lie where a command is called, beside delivered clouds, are never imported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.cloud import Cluster
from tests.integration.command import ROOT, ended
from tests.invariants import clouds

pytestmark = pytest.mark.processes

MODULES = """laspy lazrs random numpy tiler ptd cli json pickle queue typing zarr dask distributed
sitecustomize usercustomize"""


NEIGHBOUR = """
import os, sys, tempfile
from pathlib import Path
shared = Path(tempfile.gettempdir(), "dask-scratch-space")
make = tempfile.mkdtemp
def watched(*arguments, **options):
    made = Path(make(*arguments, **options))
    if made.parent == shared:
        made.rename(made.with_suffix(".away"))
        made.mkdir()
        for name in ("gilknocker", "prometheus_client"):
            Path(made, name + ".py").write_text(f"open({sys.argv[3] + name!r}, 'w').close()")
    return str(made)
tempfile.mkdtemp = watched
import tiler
result = tiler.run(sys.argv[1], sys.argv[2], {"method": "classic", "resolution": 1, "workers": 1})
assert result.exit_code == 0
assert not [entry for entry in sys.path if str(shared) in entry]
"""
"""A run beside a neighbour who made Dask's folder first: what is made in it is replaced at once
by something of his."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A delivery: a cloud, and modules that leave a mark when they are imported."""
    folder = tmp_path / "delivery"
    folder.mkdir()
    clouds.write(folder / "town.laz", clouds.city(60.0))
    for name in MODULES.split():
        (folder / f"{name}.py").write_text(
            f"open({str(tmp_path / f'{name}.imported')!r}, 'w').close()\n"
        )
    return folder


def imported(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.parent.glob("*.imported"))


def tiler(
    folder: Path, *arguments: object, path: str = str(ROOT)
) -> subprocess.CompletedProcess[str]:
    """A command from there, as the installed script starts it: without the current folder in its path."""
    call = [sys.executable, "-P", "-m", "cli.main", *arguments]
    return ended(call, cwd=folder, env={**os.environ, "PYTHONPATH": path})


@pytest.mark.slow
def test_no_command_imports_what_lies_beside_the_clouds(folder: Path) -> None:
    for arguments in (
        ("info", "town.laz"),
        ("plan", "town.laz"),
        ("run", ".", "-o", "out", "--method", "classic", "--workers", 1, "--resolution", 1),
    ):
        done = tiler(folder, *arguments)
        assert done.returncode == 0, done.stderr
        assert imported(folder) == []


def test_an_empty_entry_of_pythonpath_is_not_taken_over(folder: Path) -> None:
    """What many shells make of `export PYTHONPATH=$PYTHONPATH:/opt/modules`: the interpreter itself then looks here."""
    for name in ("sitecustomize", "usercustomize", "typing", "tiler", "cli"):
        (folder / f"{name}.py").unlink()  # imported before any line of ours
    done = tiler(folder, "info", "town.laz", path=f":{ROOT}")
    assert done.returncode == 0, done.stderr
    assert imported(folder) == []


def test_settings_of_the_compiler_that_lie_there_are_not_read(folder: Path) -> None:
    (folder / ".numba_config.yaml").write_text("disable_jit: 1\n")
    code = "from ptd import kernel; print(kernel.config.DISABLE_JIT)"
    done = ended([sys.executable, "-P", "-c", code], cwd=folder)
    assert (done.returncode, done.stdout) == (0, "0\n")


def test_a_neighbour_who_made_the_temporary_folder_of_dask_has_nothing_imported(
    tmp_path: Path,
) -> None:
    cloud, shared = clouds.write(tmp_path / "town.laz", clouds.city(40.0)), tmp_path / "shared"
    (shared / "dask-scratch-space").mkdir(parents=True)
    call = [sys.executable, "-c", NEIGHBOUR, cloud, tmp_path / "out", tmp_path / "imported-"]
    done = ended(call, env={**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(shared)})
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.glob("imported-*"))
    assert [path.relative_to(shared).as_posix() for path in shared.rglob("*")] == [
        "dask-scratch-space"
    ]


@pytest.mark.slow
def test_workers_of_a_cluster_do_not_either(folder: Path) -> None:
    """Workers that are started as `docs/cluster.md` says."""
    with Cluster(folder, {"PYTHONSAFEPATH": "1"}) as cluster:
        cluster.workers(1)
        options = ("--method", "classic", "--resolution", 1, "--scheduler", cluster.address)
        done = tiler(folder, "run", folder / "town.laz", "-o", folder / "out", *options)
        assert done.returncode == 0, done.stderr
        found = json.loads((folder / "out" / "run.json").read_text())
    assert found["state"] == "done"
    assert imported(folder) == []
