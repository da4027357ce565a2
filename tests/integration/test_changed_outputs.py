"""A file of OUT that is not as it was written is made again, and whatever stood in its place is kept."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from tests.invariants.runs import computed, do, output_digests

FILES = ("dtm.tif", "classified/hill.laz")


@pytest.fixture
def out(cloud: Path, tmp_path: Path) -> Path:
    do(cloud, tmp_path / "out", products="dtm,slope")
    return tmp_path / "out"


def flip(path: Path, unseen: bool) -> bytes:
    """Flip a bit in the middle of a file, and leave its time as it was; its bytes afterwards."""
    before, data = path.stat(), bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    if unseen:
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    return bytes(data)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("verify", [True, False])
def test_a_flipped_bit_is_found(name: str, verify: bool, cloud: Path, out: Path) -> None:
    before = output_digests(out)
    spoilt = flip(out / name, unseen=verify)
    result = do(cloud, out, products="dtm,slope", verify=verify)
    assert result.exit_code == 0
    assert {stage: n for stage, n in computed(result).items() if n} == {"export": 1}
    assert output_digests(out) == before
    assert (out / "outdated" / name).read_bytes() == spoilt
    (note,) = [text for text in result.summary["notes"] if "changed since" in text]
    assert note == f"{name}: changed since a run wrote them; moved to outdated/ and made again"
    assert do(cloud, out, products="dtm,slope", verify=True).did_nothing


def test_what_size_and_time_do_not_show_takes_verify(cloud: Path, out: Path) -> None:
    flip(out / "dtm.tif", unseen=True)
    assert do(cloud, out, products="dtm,slope").did_nothing


@pytest.mark.parametrize("verify", [True, False])
def test_a_touched_file_is_read_and_left(verify: bool, cloud: Path, out: Path) -> None:
    for name in FILES:
        (out / name).touch()
    inode = (out / "dtm.tif").stat().st_ino
    assert do(cloud, out, products="dtm,slope", verify=verify).did_nothing
    assert (out / "dtm.tif").stat().st_ino == inode


def test_a_mosaic_is_verified(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "sheets"
    do(cloud, out, sheets="40")
    sheet = min((out / "dtm").iterdir())
    before = sheet.read_bytes(), (out / "dtm.vrt").read_bytes()
    flip(sheet, True)
    flip(out / "dtm.vrt", True)
    result = do(cloud, out, sheets="40", verify=True)
    assert computed(result)["export"] == computed(result)["mosaic"] == 1
    assert (sheet.read_bytes(), (out / "dtm.vrt").read_bytes()) == before


def test_a_product_that_this_run_does_not_make_is_put_aside(cloud: Path, out: Path) -> None:
    spoilt = flip(out / "slope.tif", unseen=True)
    assert "slope.tif" in do(cloud, out).summary["outputs"]
    result = do(cloud, out, verify=True)
    assert set(result.summary["outputs"]) == {
        *FILES,
        "outline.gpkg",
        "review.gpkg",
        "classified.vpc",
        "stac.json",
    }
    assert (out / "outdated" / "slope.tif").read_bytes() == spoilt
    told = "slope.tif: changed since a run wrote it; moved to outdated/"
    assert any(told in note for note in result.summary["notes"])


@pytest.mark.parametrize("settings", [{"clean_store": True}, {"store": "another.zarr"}])
def test_a_new_store_keeps_what_was_changed(
    settings: dict[str, Any], cloud: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(out.parent)
    before = output_digests(out)
    for name in FILES:
        (out / name).write_bytes(b"mine")
    result = do(cloud, out, products="dtm,slope", overwrite=True, **settings)
    assert output_digests(out) == before
    assert [(out / "outdated" / name).read_bytes() for name in FILES] == [b"mine", b"mine"]
    told = "classified/hill.laz, dtm.tif: changed since a run wrote them; moved to outdated/ and made again"
    assert told in result.summary["notes"]
    assert sorted(path.name for path in (out / "outdated").iterdir()) == [
        "classified",
        "dtm.tif",
    ]


def test_what_is_put_aside_never_replaces_what_was(cloud: Path, out: Path) -> None:
    first = flip(out / "dtm.tif", unseen=False)
    do(cloud, out, products="dtm,slope")
    second = b"mine"
    (out / "dtm.tif").write_bytes(second)
    second_cloud = flip(out / "classified" / "hill.laz", unseen=False)
    result = do(cloud, out, products="dtm,slope")
    assert any("moved to outdated/2/" in note for note in result.summary["notes"])
    assert (out / "outdated" / "dtm.tif").read_bytes() == first
    assert (out / "outdated" / "2" / "dtm.tif").read_bytes() == second
    assert (out / "outdated" / "2" / "classified" / "hill.laz").read_bytes() == second_cloud
