"""`tiler clean`: what goes, what stays, and that later runs end as if nothing had gone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cli.main import main
from tests.invariants import clouds
from tests.invariants.runs import computed, do, output_digests, the_store
from tiler.apps.clean import clean
from tiler.errors import ConfigError, LockedError, StoreError
from tiler.store import locked_folder

MINE = """download.laz.partial a.partial.zip notes/.tiler-a.laz.partial classified/b.laz.partial store.zarr/x.partial
store.zarr/spool/notes.txt linked/.tiler-c.partial .tiler-notes"""


def test_a_clean_store_is_smaller_and_everything_in_it_is_done(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, fresh = tmp_path / "out", tmp_path / "fresh"
    west = clouds.write(tmp_path / "west.laz", clouds.city(96.0))
    moved = clouds.city(96.0, seed=2)
    east = clouds.write(
        tmp_path / "east.laz", clouds.Cloud(moved.xyz + [90.0, 0, 0], moved.truth)
    )
    do([west], out)
    before, size = output_digests(out), the_store(out).usage().size_bytes
    left = [
        out / f"store.zarr/points/xyz/0.{32 * 'a'}.partial",
        out / ".tiler-dtm.tif.cog.partial",
    ]
    for path in left:
        path.write_bytes(b"scratch")

    found = clean(out)
    assert found.scratch_files == 1
    assert not any(path.exists() for path in left)
    assert not the_store(out).pieces()
    assert found.removed_bytes > 0
    assert the_store(out).usage().size_bytes < size
    assert clean(out).removed_objects == 0
    capsys.readouterr()
    assert main(["clean", str(out), "--json"]) == 0
    names = ["scratch_files", "removed_objects", "removed_bytes", "store_bytes"]
    assert list(json.loads(capsys.readouterr().out)) == names

    again = do([west], out)
    assert again.did_nothing
    assert output_digests(out) == before

    more = do([west, east], out)
    assert more.exit_code == 0
    assert computed(more)["spool"] == 1, (
        "of the file from before, what touches the new one's buckets"
    )
    do([west, east], fresh)
    assert output_digests(out) == output_digests(fresh)


def test_what_is_no_run_is_refused_and_a_running_one_left_alone(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such folder"):
        clean(tmp_path / "nowhere")
    with pytest.raises(StoreError, match="no tile store here"):
        clean(tmp_path)
    out = tmp_path / "out"
    do([clouds.write(tmp_path / "a.laz", clouds.city(64.0))], out, until="ingest")
    with the_store(out).lock(), pytest.raises(LockedError):
        clean(out)
    with locked_folder(str(out)), pytest.raises(LockedError):
        clean(out)


def test_files_of_others_stay_whatever_their_names(tmp_path: Path) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    do([clouds.write(tmp_path / "in" / "a.laz", clouds.city(64.0))], out)
    elsewhere.mkdir()
    (out / "linked").symlink_to(elsewhere)
    mine = MINE.split()
    for name in mine:
        (out / name).parent.mkdir(exist_ok=True)
        (out / name).write_bytes(b"mine")
    (out / ".tiler-dtm.tif.cog.partial.ovr.tmp").write_bytes(b"killed")
    (out / "classified" / ".tiler-a.laz.partial").write_bytes(b"killed")
    assert clean(out).scratch_files == 2
    assert all((out / name).read_bytes() == b"mine" for name in mine)
    assert not [p for p in out.rglob(".tiler-*") if p.is_file() and p.read_bytes() == b"killed"]


def test_a_folder_that_is_no_result_is_left_alone(tmp_path: Path) -> None:
    """With --store the store alone is cleaned; a run.json of another program does not name one."""
    out, other = tmp_path / "out", tmp_path / "other"
    do([clouds.write(tmp_path / "in" / "a.laz", clouds.city(64.0))], out)
    other.mkdir()
    (other / "run.json").write_text(
        json.dumps({"configuration": {"store": str(out / "store.zarr")}})
    )
    (other / ".tiler-a.laz.partial").write_bytes(b"of another run")
    with pytest.raises(StoreError, match="no tile store here"):
        clean(other)
    assert clean(other, str(out / "store.zarr")).scratch_files == 0
    assert (other / ".tiler-a.laz.partial").exists()
