"""Links in OUT lead no write to files elsewhere, also where another user made them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cli.main import main
from tests.invariants import clouds
from tests.invariants.runs import do
from tests.scenes.folders import content
from tiler.apps.demo import MARK
from tiler.errors import ConfigError
from tiler.io.atomic_files import clear_partial, partial_path, write_atomic
from tiler.report.runfile import record_end

pytestmark = pytest.mark.usefixtures("in_this_process")

PARTIAL = """run.json report.html stac.json classified.vpc classified/hill.laz dtm.tif.plain dtm.tif.cog
contours.gpkg mask.tif.plain mask.tif.cog"""
"""Files that a run writes under a temporary name first."""


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    return clouds.write(tmp_path / "in" / "hill.laz", clouds.city(60.0, 1.0))


@pytest.fixture
def victim(tmp_path: Path) -> Path:
    """A file of the user elsewhere."""
    path = tmp_path / "elsewhere" / "profile"
    path.parent.mkdir()
    path.write_text('"state": "running"')
    return path


def test_events_are_not_appended_through_a_link(
    cloud: Path, victim: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    do(cloud, out)
    (out / "events.jsonl").unlink()
    (out / "events.jsonl").symlink_to(victim)
    before = content(out)
    assert main(["run", str(cloud), "-o", str(out), "--method", "classic", "--force"]) == 2
    line = capsys.readouterr().err.strip()
    assert f"-o {out}/events.jsonl is a link" in line
    assert "remove the link" in line
    assert line.count("\n") == 0
    assert victim.read_text() == '"state": "running"'
    assert content(out) == before
    (out / "events.jsonl").unlink()
    assert do(cloud, out).exit_code == 0


@pytest.mark.parametrize("folder", ["classified", "outdated", "dtm", "stac"])
def test_nothing_is_written_to_a_folder_that_is_a_link(
    folder: str, cloud: Path, victim: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / folder).symlink_to(victim.parent)
    with pytest.raises(ConfigError, match=rf"-o {out}/{folder} is a link, .*; remove the link"):
        do(cloud, out, sheets="40", force=True)
    assert [path.name for path in victim.parent.iterdir()] == ["profile"]
    assert [path.name for path in out.iterdir()] == [folder]


def test_a_nested_folder_of_clouds_that_is_a_link(victim: Path, tmp_path: Path) -> None:
    for name in ("a/one.laz", "b/two.laz"):
        clouds.write(tmp_path / "in" / name, clouds.city(40.0, 1.0))
    out = tmp_path / "out"
    (out / "classified").mkdir(parents=True)
    (out / "classified" / "b").symlink_to(victim.parent)
    with pytest.raises(ConfigError, match=r"classified/b is a link"):
        do(tmp_path / "in", out, force=True)
    (out / "classified" / "b").unlink()
    assert do(tmp_path / "in", out, force=True).exit_code == 0


def test_a_link_that_comes_during_the_run_is_noticed(
    cloud: Path, victim: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    do(cloud, out, until="grid")
    monkeypatch.setattr("tiler.plan.validation._validate_links", lambda *_: None)
    (out / "classified").symlink_to(victim.parent)
    with pytest.raises(ConfigError, match="classified is a link"):
        do(cloud, out)
    assert [path.name for path in victim.parent.iterdir()] == ["profile"]


def test_an_out_that_is_a_link_is_used(cloud: Path, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to("disk")
    assert do(cloud, tmp_path / "out").exit_code == 0
    assert (tmp_path / "disk" / "classified" / "hill.laz").is_file()


def test_temporary_names_that_are_links_are_removed(
    cloud: Path, victim: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    links = []
    for name in PARTIAL.split():
        target, _, kind = name.partition(".tif.")
        target = f"{target}.tif" if kind else name
        partial = partial_path(out / target, kind)
        links += [
            partial,
            *(partial.with_name(partial.name + end) for end in (".ovr.tmp", "-journal")),
        ]
    for link in links:
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(victim)
    assert do(cloud, out, products="dtm,mask,contours").exit_code == 0
    assert victim.read_text() == '"state": "running"'
    assert not [path for path in links if path.exists() and path.name.endswith(".partial")]
    assert {"dtm.tif", "mask.tif", "contours.gpkg"} <= {path.name for path in out.iterdir()}


@pytest.mark.parametrize("name", ["run.json", "report.html", "dtm.tif", "classified/hill.laz"])
def test_a_result_that_is_a_link_is_replaced_itself(
    name: str, cloud: Path, victim: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    do(cloud, out)
    (out / name).unlink()
    (out / name).symlink_to(victim)
    assert do(cloud, out, force=True).exit_code == 0
    assert victim.read_text() == '"state": "running"'
    assert not (out / name).is_symlink()
    assert (out / name).stat().st_size > 100


def test_the_state_of_a_failed_run_is_not_written_through_a_link(
    victim: Path, tmp_path: Path
) -> None:
    (tmp_path / "run.json").symlink_to(victim)
    record_end(tmp_path, "failed", 4)
    assert victim.read_text() == '"state": "running"'
    (tmp_path / "run.json").unlink()
    (tmp_path / "run.json").write_text('{"state": "running"}')
    record_end(tmp_path, "failed", 4)
    assert json.loads((tmp_path / "run.json").read_text())["state"] == "failed"


def test_a_long_temporary_name_can_be_cleared(tmp_path: Path) -> None:
    target = tmp_path / ("n" * 240)
    clear_partial(partial_path(target))
    write_atomic(target, b"1")
    assert [path.name for path in tmp_path.iterdir()] == [target.name]


@pytest.mark.parametrize("folder", ["points", "labels"])
def test_a_folder_of_the_store_that_is_a_link(
    folder: str, cloud: Path, victim: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    do(cloud, out)
    target = victim.parent / folder
    (out / "store.zarr" / folder).rename(target)
    (out / "store.zarr" / folder).symlink_to(target)
    before = content(victim.parent)
    with pytest.raises(ConfigError, match=rf"store.zarr/{folder} is a link"):
        do(cloud, out, overwrite=True)
    assert content(victim.parent) == before


def test_classified_files_are_not_written_through_a_link(
    victim: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a/one.laz", "b/two.laz"):
        clouds.write(tmp_path / "in" / name, clouds.city(40.0, 1.0))
    (tmp_path / "done").mkdir()
    (tmp_path / "done" / "b").symlink_to(victim.parent)
    given = ["classify", tmp_path / "in", tmp_path / "done", "--method", "classic"]
    assert main([str(text) for text in given]) == 2
    assert "done/b is a link" in capsys.readouterr().err
    assert [path.name for path in victim.parent.iterdir()] == ["profile"]


@pytest.mark.parametrize("name", ["input", "input/truth", "input/{mark}"])
def test_a_demo_is_not_written_through_a_link(
    name: str, victim: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link = tmp_path / "demo" / name.format(mark=MARK)
    link.parent.mkdir(parents=True)
    link.symlink_to(victim if "mark" in name else victim.parent)
    before = victim.stat()
    assert main(["demo", "-o", str(tmp_path / "demo")]) == 2
    assert f"-o {link} is a link" in capsys.readouterr().err
    assert victim.stat().st_mtime_ns == before.st_mtime_ns
    assert [path.name for path in victim.parent.iterdir()] == ["profile"]


def test_a_simulated_cloud_is_not_written_through_a_link(victim: Path, tmp_path: Path) -> None:
    path = tmp_path / "scene.laz"
    for target in (path, tmp_path / "scene_dtm.tif"):
        partial_path(target).symlink_to(victim)
    assert main(["simulate", str(path), "--size", "60"]) == 0
    assert path.is_file()
    assert victim.read_text() == '"state": "running"'
