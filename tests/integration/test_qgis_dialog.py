"""The menu and the dialog of the plugin, with Qt 5 in QGIS and with Qt 6 beside modules that stand in for QGIS."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.integration.command import command, ended, environment
from tests.integration.test_qgis import MULTIPLY, PYTHON, QGIS_PROCESS
from tiler.version import __version__

pytestmark = pytest.mark.slow

SESSION = Path(__file__).with_name("qgis_dialog_session.py")


def program(path: Path, text: str) -> Path:
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


@pytest.mark.processes
@pytest.mark.parametrize("qt", [5, 6])
def test_the_dialog_finds_and_tests_the_command(qt: int, tmp_path: Path) -> None:
    python = PYTHON
    if qt == 5 and QGIS_PROCESS is None:
        pytest.skip("no QGIS here (apt-get install qgis)")
    if qt == 6:
        python = sys.executable
        loaded = ended([python, "-c", "import PyQt6.QtWidgets"])
        if loaded.returncode:
            pytest.skip(f"PyQt6 cannot be loaded: {loaded.stderr.splitlines()[-1]}")
    home = {"QGIS_CUSTOM_CONFIG_PATH": str(tmp_path / "home"), "QT_QPA_PLATFORM": "offscreen"}
    assert ended(command("qgis", "install"), env={**environment(), **home}).returncode == 0
    tiler = program(tmp_path / "tiler", f"echo tiler, version {__version__}")
    other = program(tmp_path / "other", "echo something else")
    plugins, told = tmp_path / "home/profiles/default/python/plugins", tmp_path / "told"
    variables = {**os.environ, **home, "PYTHONPATH": ""}
    done = ended([python, SESSION, plugins, tiler, other, told], env=variables)
    assert told.exists(), f"{done.stdout}\n{done.stderr}"
    found: dict[str, Any] = json.loads(told.read_text())
    assert found["qt"].startswith(f"{qt}.")
    assert (found["entries"], found["has_icon"], found["left"]) == (["The command..."], True, 0)
    assert found["blend"] == MULTIPLY
    assert found["works"]["status"] == f"{tiler} works: tiler {__version__}"
    assert found["works"]["kept"] == str(tiler)
    assert found["other"]["status"] == f"{other} is not the command tiler; give another path"
    assert found["none"]["status"].startswith(
        "/none/tiler: the command tiler was not found; install it"
    )
    assert found["none"]["install"] == "python -m pip install tiler-dtm"
