"""``tiler classify`` of many files: the labels are those of a run, and files are told apart."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

import tiler
from cli.main import main
from tests.invariants import clouds
from tests.invariants.runs import settings
from tiler.apps.classify import classify_file, classify_files, is_one_file
from tiler.errors import ConfigError, ProcessingError
from tiler.export.classified import write_classified
from tiler.export.output_files import CloudCopy, CloudRecord
from tiler.store import TileStore


@pytest.fixture
def halves(tmp_path: Path) -> Path:
    """A folder with a city in two files, one of them in a folder below."""
    folder = tmp_path / "clouds"
    (folder / "east").mkdir(parents=True)
    city = clouds.city(80.0, 2.0)
    west = city.xyz[:, 0] < np.median(city.xyz[:, 0])
    clouds.write(folder / "half.laz", city.take(west))
    clouds.write(folder / "east" / "half.las", city.take(~west))
    return folder


def test_each_file_is_seen_with_its_neighbours(halves: Path, tmp_path: Path) -> None:
    facts = classify_files([str(halves)], tmp_path / "out", settings())
    whole = tmp_path / "whole.laz"
    clouds.write(whole, clouds.city(80.0, 2.0))
    classify_file(whole, tmp_path / "one.laz", settings())
    one = laspy.read(tmp_path / "one.laz")
    expected = {
        tuple(p): int(c) for p, c in zip(one.xyz.tolist(), one.classification, strict=True)
    }
    found = sorted(p.relative_to(tmp_path / "out") for p in (tmp_path / "out").rglob("*.*"))
    assert found == [Path("east/half.laz"), Path("half.laz")]
    points = 0
    for name in found:
        cloud = laspy.read(tmp_path / "out" / name)
        points += len(cloud)
        assert [expected[tuple(p)] for p in cloud.xyz.tolist()] == cloud.classification.tolist()
    assert (facts["files"], facts["points"]) == (2, len(one))
    assert facts["points"] == points
    assert facts["classes"] == {
        str(c): n for c, n in enumerate(np.bincount(one.classification)) if n
    }


def test_many_files_need_a_folder(halves: Path, tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"out\.laz: several clouds are classified into a folder; give a fo"
    ):
        classify_files([str(halves)], tmp_path / "out.laz", settings())


def test_a_folder_that_holds_the_inputs_is_refused(halves: Path) -> None:
    before = (halves / "half.laz").read_bytes()
    with pytest.raises(ConfigError, match="is an input|holds the inputs"):
        classify_files([str(halves)], halves, settings())
    assert (halves / "half.laz").read_bytes() == before


@pytest.mark.processes
def test_a_broken_file_is_left_out_and_named(
    halves: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (halves / "broken.laz").write_bytes(b"LASF" + bytes(100))
    out = tmp_path / "out"
    assert (
        main(["classify", str(halves), str(out), "--method", "classic", "--workers", "1"]) == 5
    )
    told = capsys.readouterr().out
    assert f"left out    {halves}/broken.laz: " in told
    assert sorted(p.name for p in out.rglob("*.*")) == ["half.laz", "half.laz"]


@pytest.mark.parametrize("target", ["a.laz", "clouds"])
def test_a_source_is_never_replaced(halves: Path, target: str) -> None:
    before = (halves / "half.laz").read_bytes()
    sources = [str(halves / "half.laz"), str(halves / "east" / "half.las")]
    with pytest.raises(ConfigError, match="is an input|several clouds"):
        classify_files(sources, halves if target == "clouds" else halves / target, settings())
    assert (halves / "half.laz").read_bytes() == before


def test_a_folder_below_the_inputs_is_refused(halves: Path) -> None:
    with pytest.raises(ConfigError, match="which holds the inputs; give another folder"):
        classify_files([str(halves)], halves / "out", settings())


def test_a_file_that_cannot_be_written_leaves_the_others(
    halves: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse_east(store: TileStore, *, cloud: CloudCopy) -> CloudRecord:
        if "east" in cloud.path:
            raise ProcessingError(f"{cloud.path}: cannot be written")
        return write_classified(store, cloud=cloud)

    monkeypatch.setattr("tiler.apps.classify.write_classified", refuse_east)
    facts = classify_files([str(halves)], tmp_path / "out", settings())
    east = str(halves / "east" / "half.las")
    assert facts["quarantined"] == [{"path": east, "error": f"{east}: cannot be written"}]
    assert [p.name for p in (tmp_path / "out").rglob("*.*")] == ["half.laz"]


@pytest.mark.parametrize(
    ("sources", "target", "one"),
    [
        (["a.laz"], "b.laz", True),
        (["a.laz"], "b.txt", True),
        (["a.laz"], "folder", False),
        (["a.laz", "b.laz"], "c.laz", False),
        (["*.laz"], "c.laz", False),
        (["{folder}"], "c.laz", False),
    ],
)
def test_one_file_is_told_from_many(
    tmp_path: Path, sources: list[str], target: str, one: bool
) -> None:
    assert is_one_file([s.format(folder=tmp_path) for s in sources], target) == one


@pytest.mark.processes
def test_python_takes_many_files_as_well(halves: Path, tmp_path: Path) -> None:
    result = tiler.classify([halves], tmp_path / "out", method="classic", workers=1)
    assert (result.exit_code, result.path) == (0, tmp_path / "out")
    assert len(list(result.path.rglob("*.laz"))) == 2
