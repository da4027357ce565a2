"""A delivery has what the run wrote, its manifest tells the truth, and a change of any file is found."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import pytest
import rasterio

from cli.main import main
from tests.scenes.finished import Finished
from tiler.apps.delivery import MANIFEST, PAGE, UNDER_WAY, deliver, verify
from tiler.errors import ConfigError, InputError, ProcessingError
from tiler.observe.events import (
    Event,
    JobStarted,
    RunFinished,
    StageFinished,
    StageStarted,
    TaskDone,
)


@pytest.fixture
def out(finished_run: Finished, tmp_path: Path) -> Path:
    shutil.copytree(finished_run[0], tmp_path / "out")
    return tmp_path / "out"


@pytest.fixture
def delivery(out: Path, tmp_path: Path) -> Path:
    deliver(out, tmp_path / "delivery")
    return tmp_path / "delivery"


def manifest(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / MANIFEST).read_text())
    return content


def change_manifest(folder: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    content = manifest(folder)
    change(content)
    (folder / MANIFEST).write_text(json.dumps(content))


def test_the_manifest_has_the_facts_of_each_file(out: Path, delivery: Path) -> None:
    content = manifest(delivery)
    entries = {entry["path"]: entry for entry in content["files"]}
    written = json.loads((out / "run.json").read_text())["outputs"]
    assert entries.keys() == (written.keys() - {"review.gpkg"}) | {
        "report.html",
        PAGE,
    }
    for name, entry in entries.items():
        path = delivery / name
        if name != PAGE:
            assert path.read_bytes() == (out / name).read_bytes()
            assert path.stat().st_mtime_ns == (out / name).stat().st_mtime_ns
        assert entry["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
        assert entry["bytes"] == path.stat().st_size
    terrain = entries["dtm.tif"]
    with rasterio.open(delivery / "dtm.tif") as raster:
        assert (terrain["columns"], terrain["rows"]) == (raster.width, raster.height)
        assert terrain["bounds"] == list(raster.bounds)
        assert (terrain["nodata"], terrain["dtype"]) == (raster.nodata, raster.dtypes[0])
        assert terrain["crs"] == f"EPSG:{raster.crs.to_epsg()}"
    for name, entry in entries.items():
        if entry["kind"] == "cloud":
            with laspy.open(delivery / name) as cloud:
                assert entry["points"] == cloud.header.point_count
    assert content["verdicts"]["complete"] is True
    assert not (delivery / UNDER_WAY).exists()


def test_missing_changed_and_extra_files_are_told(
    delivery: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["verify", str(delivery)]) == 0
    spoilt = bytearray((delivery / "dtm.tif").read_bytes())
    spoilt[-1] ^= 1
    (delivery / "dtm.tif").write_bytes(spoilt)
    (delivery / "stac.json").unlink()
    (delivery / "mine.txt").write_text("mine")
    capsys.readouterr()
    assert main(["verify", str(delivery)]) == 5
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == ["missing  stac.json", "changed  dtm.tif", "extra    mine.txt"]
    assert lines[3].startswith("verified ")


def test_a_second_delivery_replaces_only_what_changed(out: Path, delivery: Path) -> None:
    times = {path: path.stat().st_mtime_ns for path in delivery.rglob("*") if path.is_file()}
    (delivery / "stac.json").write_text("changed by the client")
    os.utime(out / "dtm.tif")  # touched, with the same bytes
    change_manifest(
        delivery,
        lambda content: content["files"].append(
            {"path": "gone.tif", "bytes": 3, "sha256": hashlib.sha256(b"old").hexdigest()}
        ),
    )
    (delivery / "gone.tif").write_bytes(b"old")
    made = deliver(out, delivery)
    assert made.removed == ["gone.tif"]
    assert not (delivery / "gone.tif").exists()
    found = verify(delivery)
    assert (found.missing, found.changed, found.extra) == ([], [], [])
    same = {path for path, time in times.items() if path.stat().st_mtime_ns == time}
    assert same >= times.keys() - {delivery / MANIFEST}


def test_files_that_are_not_delivered_any_more_are_removed_and_others_named(
    out: Path, delivery: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A client changed one of the files, another is the client's own, and a killed delivery left a third."""
    run = json.loads((out / "run.json").read_text())
    gone = sorted(name for name in run["outputs"] if name.endswith((".laz", ".vpc")))
    (delivery / gone[0]).write_bytes(b"new")
    for name in ("mine.txt", "dtm/killed.tif"):
        (delivery / name).parent.mkdir(exist_ok=True)
        (delivery / name).write_bytes(b"other")
    for name in gone:
        del run["outputs"][name]
    (out / "run.json").write_text(json.dumps(run))
    left = sorted([gone[0], "mine.txt", "dtm/killed.tif"])
    assert main(["deliver", str(out), "--to", str(delivery)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1:-1] == [
        f"removed    {name}, which this run does not deliver" for name in gone[1:]
    ]
    assert lines[-1] == f"left       {', '.join(left)}, changed or not of a delivery"
    assert not any((delivery / name).exists() for name in gone[1:])
    assert verify(delivery).extra == left


def test_a_page_that_no_delivery_wrote_is_not_replaced(out: Path, delivery: Path) -> None:
    change_manifest(
        delivery,
        lambda content: content.update(
            files=[entry for entry in content["files"] if entry["path"] != PAGE]
        ),
    )
    (delivery / PAGE).write_text("mine")
    (delivery / "dtm.tif").write_bytes(b"older")
    with pytest.raises(
        ConfigError, match=r"its index\.html is not of a delivery; move it away"
    ):
        deliver(out, delivery)
    assert (delivery / PAGE).read_text() == "mine"
    assert (delivery / "dtm.tif").read_bytes() == b"older"


def test_nothing_is_removed_through_a_link(out: Path, delivery: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "old.tif").write_bytes(b"old")
    (delivery / "more").symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    change_manifest(
        delivery,
        lambda content: content["files"].append(
            {"path": "more/old.tif", "bytes": 3, "sha256": hashlib.sha256(b"old").hexdigest()}
        ),
    )
    with pytest.raises(ConfigError, match="link"):
        deliver(out, delivery)
    assert (tmp_path / "elsewhere" / "old.tif").exists()


def test_a_name_that_is_too_long_is_missing(delivery: Path) -> None:
    change_manifest(
        delivery,
        lambda content: content["files"].append({"path": 3000 * "a", "bytes": 1, "sha256": ""}),
    )
    assert verify(delivery).missing == [3000 * "a"]


def test_a_file_that_cannot_be_read_is_one_line(
    delivery: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def damaged(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("tiler.apps.delivery.open", damaged, raising=False)
    with pytest.raises(
        InputError, match=r"cannot be read \(Input/output error\); copy it again"
    ):
        verify(delivery)


def test_the_progress_counts_the_blocks_of_all_files(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiler.apps.delivery.BLOCK_BYTES", 1000)
    for work in (
        lambda listen: deliver(out, tmp_path / "to", listen),
        lambda listen: verify(tmp_path / "to", listen),
    ):
        events: list[Event] = []
        work(events.append)
        job, first, *middle, last, end = events
        assert isinstance(job, JobStarted)
        assert isinstance(end, RunFinished)
        assert isinstance(first, StageStarted)
        assert isinstance(last, StageFinished)
        assert all(isinstance(event, TaskDone) for event in middle)
        assert {event.stage for event in (first, *middle, last)} == {first.stage}
        sizes = {e["path"]: e["bytes"] for e in manifest(tmp_path / "to")["files"]}
        if first.stage == "copy":  # The page is made, not copied.
            del sizes[PAGE]
        assert first.tasks == len(middle) == sum(-(-size // 1000) for size in sizes.values())


@pytest.mark.parametrize("command", ["deliver", "verify"])
def test_the_progress_is_shown_in_the_form_of_other_commands(
    command: str, out: Path, delivery: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = {"deliver": ["deliver", str(out), "--to"], "verify": ["verify"]}[command]
    call = [*given, str(delivery)]
    assert main([*call, "--progress", "json", "--json"]) == 0
    told = capsys.readouterr()
    lines = [json.loads(line) for line in told.err.splitlines()]
    assert (lines[0]["done"], lines[-2]["done"]) == (0, lines[-2]["total"])
    assert (lines[-1]["message"], lines[-1]["progress"]) == ("done", 1.0)
    assert isinstance(json.loads(told.out), dict)
    for quiet in (["-q"], ["-q", "--progress", "plain"], ["--progress", "none"], []):
        assert main([*call, *quiet]) == 0
        assert capsys.readouterr().err == ""


def test_a_delivery_that_was_killed_goes_on(out: Path, tmp_path: Path) -> None:
    (tmp_path / "to").mkdir()
    (tmp_path / "to" / UNDER_WAY).touch()
    (tmp_path / "to" / "dtm.tif").write_bytes(b"a part")
    deliver(out, tmp_path / "to")
    assert verify(tmp_path / "to").changed == []


@pytest.mark.parametrize("is_first", [True, False])
def test_a_delivery_that_stops_in_the_middle_is_incomplete_until_it_is_repeated(
    is_first: bool, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    to, run = tmp_path / "to", json.loads((out / "run.json").read_text())
    if not is_first:
        deliver(out, to)
    gone = next(name for name in run["outputs"] if name.endswith(".laz"))
    del run["outputs"][gone]
    (out / "run.json").write_text(json.dumps(run))
    opened = []

    def full(path: Any, mode: str = "r", **kwargs: Any) -> Any:
        opened.append(mode)
        if opened.count("xb") == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return open(path, mode, **kwargs)

    with monkeypatch.context() as patch:
        patch.setattr("tiler.apps.delivery.open", full, raising=False)
        with pytest.raises(ProcessingError, match=r"cannot be written \(No space left"):
            deliver(out, to)
    assert not (to / MANIFEST).exists()
    with pytest.raises(InputError, match="to: is incomplete, because"):
        verify(to)
    made = deliver(out, to)
    assert (made.removed, made.left) == ([] if is_first else [gone], [])
    found = verify(to)
    assert (found.missing, found.changed, found.extra) == ([], [], [])


def test_a_result_that_somebody_changed_is_not_delivered(out: Path, tmp_path: Path) -> None:
    spoilt = bytearray((out / "dtm.tif").read_bytes())
    spoilt[-1] ^= 1
    (out / "dtm.tif").write_bytes(spoilt)
    with pytest.raises(
        InputError, match=r"dtm\.tif: changed since the run wrote it; run again"
    ):
        deliver(out, tmp_path / "to")
    assert not (tmp_path / "to" / "dtm.tif").exists()
    assert not (tmp_path / "to" / MANIFEST).exists()


def forget_catalogue(content: dict[str, Any]) -> None:
    content["files"] = [entry for entry in content["files"] if entry["path"] != "stac.json"]


DAMAGES: dict[str, Callable[[Path, Path], Any]] = {
    "missing; run again": lambda out, to: (out / "stac.json").unlink(),
    "changed since the run": lambda out, to: (out / "stac.json").write_text("changed"),
    "cannot be read": lambda out, to: (
        (out / "stac.json").unlink() or (out / "stac.json").mkdir()
    ),
    "stac.json is not of a delivery": lambda out, to: change_manifest(to, forget_catalogue),
}


@pytest.mark.parametrize("reason", DAMAGES)
def test_a_refused_delivery_changes_nothing(
    reason: str, out: Path, delivery: Path, tmp_path: Path
) -> None:
    DAMAGES[reason](out, delivery)

    def content() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in delivery.rglob("*") if path.is_file()}

    before = content()
    with pytest.raises((ConfigError, InputError), match=reason):
        deliver(out, delivery)
    assert content() == before
    if reason != "stac.json is not of a delivery":
        with pytest.raises(InputError, match=reason):
            deliver(out, tmp_path / "new")
        assert not (tmp_path / "new").exists()


def test_folders_that_cannot_be_used_are_refused(out: Path, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    for to, reason in (
        (tmp_path / "full", "is not empty"),
        (out / "inside", "lies in it"),
        (tmp_path, "contains OUT"),
        ("s3://bucket/to", "is a URL"),
    ):
        with pytest.raises(ConfigError, match=reason):
            deliver(out, to)
    with pytest.raises(ConfigError, match="has no results"):
        deliver(tmp_path / "full", tmp_path / "to")
    run = json.loads((out / "run.json").read_text())
    (out / "run.json").write_text(json.dumps({**run, "state": "running"}))
    with pytest.raises(ConfigError, match="is not finished"):
        deliver(out, tmp_path / "to2")


@pytest.mark.parametrize(
    "path", ["", ".", "/etc/passwd", "../out/run.json", "a/../../b", "..\\b", "C:/b", "C:b"]
)
def test_a_manifest_that_leads_out_of_its_folder_is_refused(delivery: Path, path: str) -> None:
    change_manifest(delivery, lambda content: content["files"][0].update(path=path))
    with pytest.raises(InputError, match="leads out of the folder"):
        verify(delivery)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"format": 99, "files": []}',
        '{"format": 1, "files": [1]}',
        '{"format": 1, "files": [{"path": "a"}]}',
        '{"format": 1, "files": [{"path": "a", "bytes": 1e999, "sha256": ""}]}',
        '{"format": 1, "files": [{"path": "a", "bytes": 1, "sha256": ""}, '
        '{"path": "a", "bytes": 2, "sha256": ""}]}',
    ],
)
def test_a_damaged_manifest_is_one_line(delivery: Path, text: str) -> None:
    (delivery / MANIFEST).write_text(text)
    with pytest.raises(InputError, match="cannot be used as a manifest") as error:
        verify(delivery)
    assert "\n" not in str(error.value)
