"""Outputs are compared with inputs as files, not by their names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.scenes.windows_paths import junction_or_skip, spelled
from tiler.errors import ConfigError
from tiler.io.overwrite_check import (
    Target,
    check_folder,
    check_names,
    check_targets,
    without_extended_prefix,
)


@pytest.fixture
def read(tmp_path: Path) -> Path:
    path = tmp_path / "in" / "a.laz"
    path.parent.mkdir()
    path.write_bytes(b"points")
    return path


@pytest.mark.parametrize(
    "kind",
    [
        *("same", "dots", "link", "hard link", "link of a folder", "junction", "file URL"),
        *("extended path", "device path", "UNC path"),
    ],
)
def test_an_input_is_recognised_by_any_name(kind: str, read: Path, tmp_path: Path) -> None:
    target: str | Path = read
    if kind == "dots":
        target = tmp_path / "in" / ".." / "in" / "a.laz"
    elif kind == "link":
        target = tmp_path / "b.laz"
        target.symlink_to(read)
    elif kind == "hard link":
        target = tmp_path / "b.laz"
        os.link(read, target)
    elif kind == "link of a folder":
        (tmp_path / "out").symlink_to(tmp_path / "in")
        target = tmp_path / "out" / "a.laz"
    elif kind == "junction":
        junction_or_skip(tmp_path / "out", tmp_path / "in")
        target = tmp_path / "out" / "a.laz"
    elif kind == "file URL":
        target = read.as_uri()
    elif kind.endswith("path"):
        target = spelled(kind, read)
    with pytest.raises(
        ConfigError, match=r"^-o .* is an input \(.*a\.laz\); give another output"
    ):
        check_targets([Target("-o", target)], [tmp_path / "none", read])
    check_targets([Target("-o", tmp_path / "c.laz")], [read])


@pytest.mark.parametrize("kind", ["extended path", "device path"])
def test_a_folder_is_recognised_by_any_spelling(kind: str, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    for one, other in (
        (spelled(kind, tmp_path), tmp_path),
        (tmp_path, spelled(kind, tmp_path)),
    ):
        with pytest.raises(ConfigError, match="contains"):
            check_folder("--store", one, [other / "out"])


def test_a_file_that_does_not_exist_yet_is_recognised_by_its_path(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path)
    with pytest.raises(ConfigError, match="is an input"):
        check_targets([Target("", tmp_path / "link" / "x")], [tmp_path / "x"])


def test_urls_are_compared_as_text() -> None:
    with pytest.raises(ConfigError, match="s3://b/a.laz is an input"):
        check_targets([Target("", "s3://b/a.laz")], ["s3://b/a.laz"])
    check_targets([Target("", "s3://b/a.laz")], ["s3://b/b.laz", "b/a.laz"])


def test_a_name_must_have_the_suffix_of_its_kind(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"-o .*a\.laz: its suffix does not match the kind of file; use \.png"
    ):
        check_targets([Target("-o", tmp_path / "a.laz", (".png",))], [])
    check_targets([Target("-o", tmp_path / "a.PNG", (".png",))], [])


@pytest.mark.parametrize(
    ("folder", "other", "what"),
    [
        ("out", "out", "is the same as"),
        ("out/", "out/../out", "is the same as"),
        (".", "out/a.laz", "contains"),
        ("link", "out/a.laz", "contains"),
        ("s3://b/x", "s3://b/x/y", "contains"),
        ("s3://b/x/", "s3://b/x", "is the same as"),
        ("file:///", "out", "contains"),
    ],
)
def test_a_folder_that_a_command_fills_must_hold_nothing_else(
    folder: str, other: str, what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "link").symlink_to("out")
    with pytest.raises(
        ConfigError, match=f"^--store {folder}: {what} {other}; give another folder"
    ):
        check_folder("--store", folder, [other])
    check_folder("--store", "out/store.zarr", ["out", "outside", "s3://b"])


def test_a_name_that_is_too_long_is_refused(tmp_path: Path) -> None:
    check_targets([Target("-o", tmp_path / f"{'ä' * 125}a.png")], [])
    with pytest.raises(
        ConfigError,
        match=r"^-o ä{20}\.\.\.: its name has 256 bytes, 255 are possible; give a shorter name$",
    ):
        check_targets([Target("-o", tmp_path / f"{'ä' * 126}.png")], [])


@pytest.mark.skipif(os.name != "nt", reason="other systems have no such names")
@pytest.mark.parametrize("name", ["NUL", "aux.laz", "com1", "ab:c.laz"])
def test_a_name_that_windows_does_not_allow_is_refused(name: str, tmp_path: Path) -> None:
    check_names("-o", tmp_path / "auxiliary.laz")
    with pytest.raises(ConfigError, match=f"-o .*'{name}' .*; give another name$"):
        check_names("-o", tmp_path / name / "out")


@pytest.mark.parametrize(
    ("path", "plain"),
    [
        (r"\\?\C:\a", r"C:\a"),
        (r"\\.\c:\a", r"c:\a"),
        (r"\\?\UNC\server\share\a", r"\\server\share\a"),
        (r"\\server\share", r"\\server\share"),
        (r"\\?\Volume{1}\a", r"\\?\Volume{1}\a"),
    ],
)
def test_an_extended_prefix_of_windows_is_no_part_of_the_place(path: str, plain: str) -> None:
    assert without_extended_prefix(path) == plain
