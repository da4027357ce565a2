"""A disk that fills up at any stage: one line, code 4, nothing half-written; with more room the command goes on."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.invariants import clouds
from tests.invariants.runs import all_digests, do, output_digests, settings
from tiler.errors import ConfigError, DiskFullError
from tiler.observe.eventlog import EventLog
from tiler.pipeline import run

SHARES = (0.02, 0.1, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""Of the room that the whole job takes."""


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clouds.write(tmp_path_factory.mktemp("cloud") / "city.laz", clouds.city(150.0, 4.0))


@pytest.fixture(scope="module")
def whole(cloud: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "out"
    do(cloud, out)
    return out


class SmallDisk:
    """A tmpfs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def has(self, size_bytes: int, again: bool = False) -> None:
        options = f"size={size_bytes // 4096 * 4096},mode=700" + (",remount" if again else "")
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", options, "tmpfs", self.folder], capture_output=True, text=True
        )
        if done.returncode:
            pytest.skip(f"no small disk: a tmpfs cannot be mounted here ({done.stderr.strip()})")


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[SmallDisk]:
    folder = tmp_path / "disk"
    folder.mkdir()
    if shutil.which("mount") is None:
        pytest.skip("no small disk: there is no mount command here")
    yield SmallDisk(folder)
    subprocess.run(["umount", folder], capture_output=True, check=False)


def room(folder: Path) -> int:
    return sum(-(-path.stat().st_size // 4096) * 4096 for path in folder.rglob("*") if path.is_file())


@pytest.mark.parametrize("share", [0.2, 0.85, *(pytest.param(s, marks=pytest.mark.slow) for s in SHARES)])
def test_a_disk_that_fills_up(
    share: float, cloud: Path, whole: Path, disk: SmallDisk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "tiler.plan.disk.projected_disk", lambda plan: {"store": 0}
    )  # else the plan would refuse
    disk.has(int(room(whole) * share))
    out = disk.folder / "out"
    with pytest.raises(DiskFullError, match="the disk is full; free some and run again") as caught:
        do(cloud, out)
    assert caught.value.exit_code == 4
    assert "\n" not in str(caught.value)
    assert not [path for path in out.rglob("*.partial*") if "store.zarr" not in path.parts]
    expected = output_digests(whole)
    for name in ("dtm.tif", f"classified/{cloud.name}"):
        if (out / name).exists():
            assert output_digests(out)[name] == expected[name]
    if (out / "run.json").exists():
        json.loads((out / "run.json").read_text())
    disk.has(64 << 20, again=True)
    assert do(cloud, out).exit_code == 0
    assert output_digests(out) == expected


STAGES = (
    "identify",
    "spool",
    "assemble",
    "filter0",
    "grid-dtm",
    "grid-slope",
    "grid-survey",
    "grid-dtm-outlined",
    "grid-mask",
    "export",
    "mosaic",
)


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("left", [0, 8192])
def test_a_disk_that_is_full_when_a_stage_begins(
    stage: str, left: int, cloud: Path, disk: SmallDisk, tmp_path: Path
) -> None:
    """Nothing is left on the disk at that moment, or two pages."""
    changes = {"products": "dtm,slope,mask", "voids": "fill", "sheets": "64"}
    whole, out = tmp_path / "whole", disk.folder / "out"
    do(cloud, whole, **changes)
    disk.has(256 << 20)

    def fill(event: str, fields: dict[str, Any]) -> None:
        if event == "stage_started" and fields["stage"] == stage:
            used = shutil.disk_usage(disk.folder).used
            disk.has(used + left, again=True)

    with pytest.raises(DiskFullError, match="the disk is full; free some and run again") as caught:
        run([str(cloud)], out, settings(**changes), fill)
    assert "\n" not in str(caught.value)
    assert not [path for path in out.rglob("*.partial*") if "store.zarr" not in path.parts]
    expected = all_digests(whole)
    assert all_digests(out).items() <= expected.items()
    json.loads((out / "run.json").read_text())
    disk.has(256 << 20, again=True)
    assert do(cloud, out, **changes).exit_code == 0
    assert all_digests(out) == expected


def test_a_read_only_out_is_one_line(cloud: Path, disk: SmallDisk) -> None:
    disk.has(64 << 20)
    (disk.folder / "out").mkdir()
    done = subprocess.run(["mount", "-o", "remount,ro", disk.folder], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"no read-only disk here: {done.stderr.strip()}")
    with pytest.raises(ConfigError, match="cannot be written; name a folder on a disk that can"):
        do(cloud, disk.folder / "out")


def test_an_event_log_on_a_full_disk_is_one_line(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full here")
    (tmp_path / "events.jsonl").symlink_to("/dev/full")
    with (
        pytest.raises(DiskFullError, match="No space left on device"),
        EventLog(tmp_path / "events.jsonl") as log,
    ):
        log("note", {"text": "a"})
