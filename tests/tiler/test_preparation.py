"""Workers are forked from a process that has imported all that their tasks need."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.command import environment

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("ingest", "filter", "grid", "export")
LOADED = "import sys; from tiler.preparation import import_stages; import_stages(); print(*sys.modules)"


@pytest.mark.processes
def test_the_work_of_all_stages_is_imported_before_workers_are_forked() -> None:
    call = [sys.executable, "-c", LOADED]
    done = subprocess.run(
        call, cwd=ROOT, env=environment(), capture_output=True, text=True, check=True
    )
    modules = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for room in ROOMS
        for path in (ROOT / "tiler" / room).rglob("*.py")
        if "tasks" not in path.parts  # coordinators
    }
    assert {*modules, "tiler.inputs.contents"} - set(done.stdout.split()) == set()
