"""Files that get their name once they are whole."""

from __future__ import annotations

import errno
import os
import re
from pathlib import Path
from typing import Any

import pytest

import cli
import ptd
import tiler
from tiler.errors import write_error
from tiler.io import atomic_files
from tiler.io.atomic_files import partial_path, replace_file


class Refusing:
    """`os.replace` that is refused some times."""

    def __init__(self, times: int, winerror: int | None) -> None:
        self.times, self.winerror, self.calls, self.really = times, winerror, 0, os.replace

    def __call__(self, source: Any, target: Any) -> None:
        self.calls += 1
        if self.calls <= self.times:
            error = PermissionError(errno.EACCES, "refused", str(source))
            if self.winerror is not None:
                error.winerror = self.winerror  # type: ignore[attr-defined]
            raise error
        self.really(source, target)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    source, target = tmp_path / "source", tmp_path / "target"
    source.write_text("new", "utf-8")
    target.write_text("old", "utf-8")
    return source, target


@pytest.mark.parametrize("winerror", [5, 32])
def test_a_file_that_windows_has_in_use_is_replaced_once_it_is_free(
    winerror: int, files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    refusing = Refusing(2, winerror)
    monkeypatch.setattr(os, "replace", refusing)
    replace_file(*files)
    assert refusing.calls == 3
    assert files[1].read_text("utf-8") == "new"


def test_a_file_that_stays_in_use_ends_in_the_error(
    files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(atomic_files, "IN_USE_SECONDS", 0.1)
    monkeypatch.setattr(os, "replace", Refusing(1000, 32))
    with pytest.raises(PermissionError) as refused:
        replace_file(*files)
    told = str(write_error("dtm.tif", refused.value))
    assert told.startswith("dtm.tif: ")
    assert "another program has it open" in told
    assert "close it there" in told
    assert files[1].read_text("utf-8") == "old"


def test_on_windows_the_path_of_the_temporary_file_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    target = Path("/" + "a" * 100 + "/" + "b" * 144)
    refused = FileNotFoundError(2, "no such file", str(partial_path(target)))
    with monkeypatch.context() as windows:
        windows.setattr(os, "name", "nt")
        told = [str(write_error(str(target), error)) for error in (refused, Exception("x"))]
        short = str(write_error("/dtm.tif", refused.__class__(2, "no such file", "/dtm.tif")))
    assert all("temporary file has more than 259 characters" in text for text in told)
    assert "characters" not in short


def test_other_systems_refuse_for_good_and_are_asked_once(
    files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    refusing = Refusing(1000, None)
    monkeypatch.setattr(os, "replace", refusing)
    with pytest.raises(PermissionError):
        replace_file(*files)
    assert refusing.calls == 1


def test_no_other_code_gives_a_file_another_name() -> None:
    found = []
    for package in (tiler, ptd, cli):
        for path in Path(str(package.__file__)).parent.rglob("*.py"):
            if re.search(r"os\.(replace|rename)\(", path.read_text("utf-8")):
                found.append(path.name)
    assert found == ["atomic_files.py"]
