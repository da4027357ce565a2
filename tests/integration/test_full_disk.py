"""A disk that fills up at any stage: one line, code 4, nothing half-written; with more room the command goes on."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.command import ended
from tests.invariants import clouds
from tests.invariants.runs import (
    EVERY_STAGE,
    WITH_EVERY_STAGE,
    all_digests,
    do,
    output_digests,
    settings,
)
from tiler.errors import (
    ConfigError,
    CorruptStoreError,
    DiskFullError,
    ProcessingError,
    StoreAccessError,
)
from tiler.ingest.tasks import points as ingest_tasks
from tiler.observe.events import Event, Note, StageStarted
from tiler.observe.json_lines import EventLog
from tiler.pipeline import run
from tiler.store import TileStore
from tiler.store.storage import _write_file as write_file

SHARES = (0.02, 0.4, 0.6, 0.95)
"""Of the room that the whole job takes."""


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clouds.write(tmp_path_factory.mktemp("cloud") / "city.laz", clouds.city(150.0, 4.0))


@pytest.fixture(scope="module")
def whole(cloud: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "out"
    do(cloud, out)
    return out


@pytest.fixture(scope="module")
def whole_of_every_stage(cloud: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("every") / "out"
    do(cloud, out, **WITH_EVERY_STAGE)
    return out


GROWING = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from tiler.store import TileStore
from tiler.errors import TilerError
from tiler.io.raster_files import RasterMetadata, plain_geotiff

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, resource.RLIM_INFINITY))
try:
    look = RasterMetadata("EPSG:25832", "m", "heights", {})
    with plain_geotiff(Path(sys.argv[1]), 2048, 2048, (1, 0, 0, 0, -1, 0), look) as raster:
        raster.write(np.random.default_rng(0).random((2048, 2048), dtype=np.float32), 0, 0)
except TilerError as error:
    print(type(error).__name__, error)
"""
"""A raster in a process whose files may have 1 MiB."""


class SmallDisk:
    """A tmpfs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def has(self, size_bytes: int, again: bool = False) -> None:
        options = f"size={size_bytes // 4096 * 4096},mode=700" + (",remount" if again else "")
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", options, "tmpfs", self.folder],
            capture_output=True,
            text=True,
        )
        if done.returncode:
            pytest.skip(
                f"no small disk: a tmpfs cannot be mounted here ({done.stderr.strip()})"
            )


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[SmallDisk]:
    folder = tmp_path / "disk"
    folder.mkdir()
    if shutil.which("mount") is None:
        pytest.skip("no small disk: there is no mount command here")
    yield SmallDisk(folder)
    subprocess.run(["umount", folder], capture_output=True, check=False)


def room(folder: Path) -> int:
    return sum(
        -(-path.stat().st_size // 4096) * 4096 for path in folder.rglob("*") if path.is_file()
    )


@pytest.mark.processes
@pytest.mark.parametrize(
    "share", [0.2, 0.85, *(pytest.param(s, marks=pytest.mark.slow) for s in SHARES)]
)
def test_a_disk_that_fills_up(
    share: float, cloud: Path, whole: Path, disk: SmallDisk, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Else the plan would refuse.
    monkeypatch.setattr("tiler.plan.estimates.projected_disk", lambda plan: {"store": 0})
    disk.has(int(room(whole) * share))
    out = disk.folder / "out"
    with pytest.raises(
        DiskFullError, match="the disk is full; free some space and run again"
    ) as caught:
        do(cloud, out)
    assert caught.value.exit_code == 4
    assert "\n" not in str(caught.value)
    assert not [path for path in out.rglob("*.partial*") if "store.zarr" not in path.parts]
    expected = output_digests(whole)
    for name in ("dtm.tif", f"classified/{cloud.name}"):
        if (out / name).exists():
            assert output_digests(out)[name] == expected[name]
    if (out / "run.json").exists():
        assert json.loads((out / "run.json").read_text())["state"] == "failed"
    disk.has(64 << 20, again=True)
    assert do(cloud, out).exit_code == 0
    assert output_digests(out) == expected


@pytest.mark.processes
@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(EVERY_STAGE)))
def test_a_disk_that_is_full_when_a_stage_begins(
    number: int, cloud: Path, whole_of_every_stage: Path, disk: SmallDisk
) -> None:
    """Nothing is left on the disk at that moment, or two pages."""
    stage, left, out = EVERY_STAGE[number], 8192 * (number % 2), disk.folder / "out"
    disk.has(256 << 20)

    def fill(event: Event) -> None:
        if isinstance(event, StageStarted) and event.stage == stage:
            used = shutil.disk_usage(disk.folder).used
            disk.has(used + left, again=True)

    with pytest.raises(
        DiskFullError, match="the disk is full; free some space and run again"
    ) as caught:
        run([str(cloud)], out, settings(**WITH_EVERY_STAGE), fill)
    assert "\n" not in str(caught.value)
    assert not [path for path in out.rglob("*.partial*") if "store.zarr" not in path.parts]
    expected = all_digests(whole_of_every_stage)
    assert all_digests(out).items() <= expected.items()
    json.loads((out / "run.json").read_text())
    disk.has(256 << 20, again=True)
    assert do(cloud, out, **WITH_EVERY_STAGE).exit_code == 0
    assert all_digests(out) == expected


def refusing(key: str, number: int) -> Callable[[str, bytes], None]:
    """Instead of what writes a file of a store: refuses those whose keys begin so."""

    def write(path: str, data: bytes) -> None:
        if f"/store.zarr/{key}" in path:
            raise OSError(number, os.strerror(number), path)
        write_file(path, data)

    return write


@pytest.mark.parametrize("number", [errno.EIO, errno.EFBIG])
@pytest.mark.parametrize("key", ["spool", "commits", "points", "labels", "rasters"])
def test_a_store_that_cannot_be_written_is_no_fault_of_the_inputs(
    key: str, number: int, cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiler.store.storage._write_file", refusing(key, number))
    out = tmp_path / "out"
    with pytest.raises(
        StoreAccessError, match=f"store.zarr: {key}.* cannot be written"
    ) as caught:
        do(cloud, out)
    assert caught.value.exit_code == 4
    assert os.strerror(number) in str(caught.value)
    found = json.loads((out / "run.json").read_text())
    assert (found["state"], found["quarantined"]) == ("failed", [])
    monkeypatch.undo()
    assert do(cloud, out).exit_code == 0


@pytest.mark.processes
@pytest.mark.skipif(sys.platform != "linux", reason="limits of files are the system's")
def test_a_raster_that_may_not_grow_says_why(tmp_path: Path) -> None:
    """GDAL does not, and rasterio names a previous exception."""
    call = [sys.executable, "-c", GROWING, tmp_path / ".tiler-dtm.tif.partial"]
    done = ended(call)
    assert done.stdout.startswith(
        f"ProcessingError {tmp_path}/.tiler-dtm.tif.partial: cannot be written (File "
    )
    assert "too large" in done.stdout
    assert "previous exception" not in done.stdout


@pytest.mark.processes
def test_a_read_only_out_is_one_line(cloud: Path, disk: SmallDisk) -> None:
    disk.has(64 << 20)
    (disk.folder / "out").mkdir()
    done = subprocess.run(
        ["mount", "-o", "remount,ro", disk.folder], capture_output=True, text=True
    )
    if done.returncode:
        pytest.skip(f"no read-only disk here: {done.stderr.strip()}")
    with pytest.raises(
        ConfigError, match="cannot be written; give a folder that can be written"
    ):
        do(cloud, disk.folder / "out")


def test_an_out_that_rasters_cannot_be_written_to_is_refused(
    cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out\udcff"
    with pytest.raises(ConfigError, match="its name is not UTF-8; give another folder"):
        do(cloud, out)
    assert not out.exists()


def test_an_event_log_on_a_full_disk_is_one_line() -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full here")
    with (
        pytest.raises(DiskFullError, match="No space left on device"),
        EventLog(Path("/dev/full")) as log,
    ):
        log(Note("a"))


def test_an_error_of_the_store_while_clouds_are_read_leaves_no_input_out(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only what reading the input says is the input's fault."""

    def damaged(store: TileStore, **_: Any) -> Any:
        raise CorruptStoreError(f"{store.url}: meta.json is damaged")

    monkeypatch.setattr(ingest_tasks, "spool_piece", damaged)
    with pytest.raises(ProcessingError, match="meta.json is damaged") as caught:
        do(cloud, tmp_path / "out")
    assert caught.value.exit_code == 4
    assert json.loads((tmp_path / "out" / "run.json").read_text())["quarantined"] == []
