"""An input that is replaced while the run goes on is left out in one line, and nothing is written of its old points."""

from __future__ import annotations

import functools
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.runs import do, settings
from tiler.apps import classify
from tiler.errors import InputError
from tiler.export.tasks import files as file_tasks
from tiler.ingest.tasks import points as ingest_tasks
from tiler.io.las.reader import PointReader
from tiler.runs import file_digests

CHANGED = "was replaced or changed during the run"
Work = Callable[[str, dict[str, Any]], dict[str, Any]]


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path, Path]:
    """A good file; one to be replaced; and the other's points in reverse, in as many bytes."""
    cloud = clouds.city(96.0)
    west, east = (cloud.take(side) for side in (cloud.xyz[:, 0] < 48, cloud.xyz[:, 0] >= 48))
    back = clouds.Cloud(east.xyz[::-1], east.truth[::-1])
    paths = tuple(
        tmp_path / "in" / name for name in ("west.las", "east.las", "elsewhere/east.las")
    )
    for path, part in zip(paths, (west, east, back), strict=True):
        clouds.write(path, part)
    assert paths[1].stat().st_size == paths[2].stat().st_size
    return paths


def before_the_first(work: Work, change: Callable[[], object]) -> Work:
    """The work of a task, with something that happens before it is done for the first time."""
    done: list[bool] = []

    def changed(*arguments: Any, **values: Any) -> dict[str, Any]:
        if not done:
            done.append(True)
            change()
        return work(*arguments, **values)

    return changed


def by_name(old: Path, new: Path) -> None:
    os.replace(new, old)


def in_place(old: Path, new: Path) -> None:
    shutil.copyfile(new, old)


def change_before(
    patch: pytest.MonkeyPatch,
    module: Any,
    name: str,
    change: Callable[..., object],
    *paths: Path,
) -> None:
    """Let something happen to files before the work of this name is done for the first time."""
    changed = before_the_first(getattr(module, name), functools.partial(change, *paths))
    patch.setattr(module, name, changed)


@pytest.mark.parametrize("how", [by_name, in_place])
def test_replaced_before_it_is_decoded(
    files: tuple[Path, Path, Path],
    how: Callable[..., None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    good, path, other = files
    change_before(monkeypatch, ingest_tasks, "spool_piece", how, path, other)
    result = do([good, path], tmp_path / "out")
    assert result.exit_code == 5
    (left_out,) = result.summary["quarantined"]
    assert left_out["path"] == path.as_posix()
    assert CHANGED in left_out["error"]
    assert not (tmp_path / "out" / "classified" / "east.laz").exists()
    assert (tmp_path / "out" / "classified" / "west.laz").exists()
    monkeypatch.undo()
    again = do([good, path], tmp_path / "out")
    assert again.exit_code == 0
    do([good, path], tmp_path / "alone")
    for name in ("dtm.tif", "classified/east.laz"):
        assert (tmp_path / "out" / name).read_bytes() == (
            tmp_path / "alone" / name
        ).read_bytes()


def test_replaced_before_its_classes_are_written(
    files: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good, path, other = files
    change_before(monkeypatch, file_tasks, "write_classified", in_place, path, other)
    result = do([good, path], tmp_path / "out")
    assert result.exit_code == 5
    (failed,) = result.summary["failed_tasks"]
    assert failed["error"].startswith(f"{path}: {CHANGED}")
    assert os.listdir(tmp_path / "out" / "classified") == ["west.laz"]


def while_it_is_read(work: Work, old: Path, new: Path, monkeypatch: pytest.MonkeyPatch) -> Work:
    """The work of a task, with the file replaced after its first records were read."""
    read = PointReader.read

    def replacing(reader: PointReader, start: int, count: int) -> Any:
        records = read(reader, start, count)
        if reader.header.path == old and new.exists():
            os.replace(new, old)
        return records

    def changed(*arguments: Any, **values: Any) -> dict[str, Any]:
        with monkeypatch.context() as patch:
            patch.setattr(PointReader, "read", replacing)
            return work(*arguments, **values)

    return changed


@pytest.mark.parametrize(
    ("stage", "name"),
    [(ingest_tasks, "spool_piece"), (file_tasks, "write_classified")],
    ids=["spool", "write"],
)
def test_replaced_while_it_is_read(
    stage: Any,
    name: str,
    files: tuple[Path, Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    good, path, other = files
    monkeypatch.setattr(
        stage, name, while_it_is_read(getattr(stage, name), path, other, monkeypatch)
    )
    result = do([good, path], tmp_path / "out")
    assert result.exit_code == 5
    told = [*result.summary["quarantined"], *result.summary["failed_tasks"]]
    assert [CHANGED in entry["error"] for entry in told] == [True]
    assert os.listdir(tmp_path / "out" / "classified") == ["west.laz"]


def test_replaced_while_its_digest_is_made(
    files: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good, path, other = files
    change_before(monkeypatch, file_digests, "read_files", by_name, path, other)
    result = do([good, path], tmp_path / "out")
    assert [q["path"] for q in result.summary["quarantined"]] == [path.as_posix()]
    assert result.exit_code == 5


def test_the_only_input_went_away(
    files: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change_before(monkeypatch, ingest_tasks, "spool_piece", Path.unlink, files[1])
    line = r"east\.las: left out: was removed during the run \(No such file"
    with pytest.raises(InputError, match=line):
        do(files[1], tmp_path / "out")


def test_a_piece_that_is_decoded_again_is_of_the_same_file(
    files: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The spool was cleaned, another setting needs it, and the file is replaced before it is decoded again."""
    good, path, other = files
    out = tmp_path / "out"
    do([good, path], out)
    shutil.rmtree(out / "store.zarr" / "spool")
    change_before(monkeypatch, ingest_tasks, "spool_piece", by_name, path, other)
    result = do([good, path], out, keep_classes="7")
    assert result.exit_code == 5
    assert [q["path"] for q in result.summary["quarantined"]] == [path.as_posix()]


def test_an_empty_file_and_one_that_went_away(
    files: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is left holds no point: no input could be read, though one of them could."""
    path = files[1]
    empty = clouds.write(
        tmp_path / "in" / "empty.las", clouds.city(96.0).take(np.zeros(0, np.intp))
    )
    aside, line = (
        tmp_path / "aside.las",
        r"^no input could be read; the first error: .*east\.las: .*was removed during",
    )
    for module, name in ((file_digests, "read_files"), (ingest_tasks, "spool_piece")):
        with monkeypatch.context() as patch:
            change_before(patch, module, name, Path.rename, path, aside)
            with pytest.raises(InputError, match=line):
                do([empty, path], tmp_path / name)
        aside.rename(path)


def test_classify_writes_no_classes_of_another_file(
    files: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, path, other = files
    change_before(monkeypatch, classify, "write_classified", in_place, path, other)
    with pytest.raises(InputError, match=rf"east\.las: {CHANGED}"):
        classify.classify_file(path, tmp_path / "out.laz", settings())
    assert not (tmp_path / "out.laz").exists()
