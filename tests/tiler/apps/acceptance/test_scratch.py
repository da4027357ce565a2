"""Temporary folders of checks that were killed are removed by the next check, those of live checks are not."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tests.tiler.apps.acceptance.pulses import Pulses, lattice
from tiler.apps.acceptance import check_clouds

HOLD = """
import sys
from tiler.apps.acceptance.duplicates import scratch_folder
with scratch_folder() as folder:
    (folder / "own-0-0").write_bytes(bytes(100))
    print(folder, flush=True)
    sys.stdin.read()
"""


def test_folders_of_killed_checks_are_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cloud = Pulses(*lattice(0, 20, 0, 20)).write(tmp_path / "a.laz")
    place = tmp_path / "tmp"
    place.mkdir()
    for name in ("TMPDIR", "TEMP", "TMP"):
        monkeypatch.setenv(name, str(place))
    monkeypatch.setattr(tempfile, "tempdir", None)
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", HOLD],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    try:
        killed, live = (Path(p.stdout.readline().strip()) for p in processes if p.stdout)
        processes[0].kill()
        processes[0].wait()
        assert {path.name for path in place.iterdir()} == {killed.name, live.name}
        assert all(folder.name.startswith(".tiler-check-") for folder in (killed, live))
        check_clouds([cloud])
        assert [path.name for path in place.iterdir()] == [live.name]
        assert (live / "own-0-0").stat().st_size == 100
    finally:
        for process in processes:
            process.kill()
            process.communicate()
    check_clouds([cloud])
    assert list(place.iterdir()) == []
