"""Systems that lack what POSIX alone has: every module can be imported; a run gives the same and says what it lacks."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from tests.integration.command import ROOT, command, ended, environment
from tests.scenes import bare_system
from tiler.simulate import DemoScene

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


@pytest.fixture
def bare(tmp_path: Path) -> dict[str, str]:
    """The environment of processes that lack what POSIX alone has."""
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(Path(bare_system.__file__).read_text("utf-8"))
    paths = environment()
    return {**paths, "PYTHONPATH": os.pathsep.join((str(folder), paths["PYTHONPATH"]))}


@pytest.mark.slow
def test_every_module_can_be_imported(bare: dict[str, str]) -> None:
    made = ended([sys.executable, "-c", IMPORT_ALL], cwd=ROOT, env=bare)
    assert (made.returncode, made.stderr) == (0, "")
    assert int(made.stdout) > 300


@pytest.mark.slow
def test_a_run_gives_the_same_and_tells_what_it_lacks(
    bare: dict[str, str], demo: DemoScene, tmp_path: Path
) -> None:
    dtms = []
    for name, env in (("bare", bare), ("whole", environment())):
        out = tmp_path / name
        made = ended(command("run", demo.paths[0], "-o", out, "--method", "classic"), env=env)
        assert made.returncode == 0, made.stderr
        dtms.append((out / "dtm.tif").read_bytes())
        line = "this system cannot limit the memory of a process: a worker that needs more than planned is not stopped"
        lacks = name == "bare"
        assert made.stderr.count(line) == lacks
        assert (line in json.loads((out / "run.json").read_text())["notes"]) == lacks
        assert (line in (out / "report.html").read_text("utf-8")) == lacks
    assert dtms[0] == dtms[1]
