"""Names, links and folders that are not what they seem."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from tiler.config import RunConfig
from tiler.errors import ConfigError, InputError
from tiler.ingest import find_inputs, inspect
from tiler.plan import make_plan, output_names


def test_links_to_folders_are_not_followed_and_named(make_cloud: Any, tmp_path: Path) -> None:
    make_cloud("in/a.las", n=3)
    (tmp_path / "in" / "round").symlink_to(tmp_path / "in")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "in" / "away").symlink_to(tmp_path / "elsewhere")
    notes: list[str] = []
    assert [p.name for p in find_inputs([str(tmp_path / "in")], note=notes.append)] == ["a.las"]
    assert sum("is a link to a folder, not followed" in note for note in notes) == 2
    shutil.move(tmp_path / "in" / "a.las", tmp_path / "elsewhere" / "a.las")
    assert [p.name for p in find_inputs([str(tmp_path / "in" / "away")])] == ["a.las"], "named itself, it is"


def test_a_folder_that_cannot_be_looked_into_is_named(
    make_cloud: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_cloud("in/a.las", n=3)
    (tmp_path / "in" / "shut").mkdir()
    scan = os.scandir

    def refusing(path: Any) -> Any:
        if str(path).endswith("shut"):
            raise PermissionError(13, "Permission denied", str(path))
        return scan(path)

    monkeypatch.setattr(os, "scandir", refusing)
    notes: list[str] = []
    assert len(find_inputs([str(tmp_path / "in")], note=notes.append)) == 1
    (note,) = notes
    assert "shut: cannot be looked into (Permission denied); what it holds is left out" in note


@pytest.mark.parametrize("kind", ["pipe", "device", "dangling link", "folder", "link to itself"])
def test_what_is_no_file_is_refused_and_not_waited_for(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.las"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to({"device": "/dev/zero", "dangling link": "nowhere", "link to itself": path}[kind])
    with pytest.raises(InputError, match=r"odd\.las: (is no regular file|cannot be read)"):
        inspect(path)


def test_inputs_that_are_no_place_are_refused(tmp_path: Path) -> None:
    for text in ("", "x" * 5000):
        with pytest.raises(ConfigError, match="name LAS or LAZ files"):
            find_inputs([text])
    for one, other in (("a.las", "b.las"), ("b.las", "a.las")):
        (tmp_path / one).symlink_to(other)
    for inputs in ("a.las", "*.las", ""):
        with pytest.raises(InputError, match=r"las: cannot be read \(Too many levels of symbolic links"):
            make_plan([str(tmp_path / inputs)], RunConfig(in_process=True, on_error="stop"))


@pytest.mark.parametrize(
    "name", [b"gr\xfc\xdfe.las", b"line\nbreak.las", b"\x1b[2Jclear.las", b"-o.las", b"a b;$(c).las"]
)
def test_any_name_is_read_and_kept(name: bytes, make_cloud: Any, tmp_path: Path) -> None:
    path = Path(os.fsdecode(os.path.join(os.fsencode(tmp_path / "in"), name)))
    path.parent.mkdir()
    shutil.move(make_cloud("plain.las", n=50), path)
    plan = make_plan([str(tmp_path / "in")], RunConfig(in_process=True))
    assert plan.names == {path: Path(path.name).with_suffix(".laz")}


def test_classified_files_stay_below_their_folder(make_cloud: Any, tmp_path: Path) -> None:
    path = make_cloud("a/b/one.las", n=3)
    (tmp_path / "a" / "two.las").symlink_to(make_cloud("c/two.las", n=3))
    cwd = os.getcwd()
    os.chdir(tmp_path / "a" / "b")
    try:
        for inputs in (["../"], ["../b/../../a"], [str(tmp_path / "a")], [str(path), "../two.las"]):
            names = output_names(inputs, [inspect(p) for p in find_inputs(inputs)])
            assert all(".." not in n.parts and not n.is_absolute() for n in names.values()), names
            assert sorted(n.name for n in names.values()) == ["one.laz", "two.laz"]
    finally:
        os.chdir(cwd)


def test_names_that_would_become_one_are_refused(make_cloud: Any, tmp_path: Path) -> None:
    paths = [make_cloud("a/Cloud.las", n=3), make_cloud("b/cloud.laz", n=3)]
    with pytest.raises(ConfigError, match="would both become classified/"):
        make_plan([str(p) for p in paths], RunConfig(in_process=True))


def test_results_of_a_run_are_not_its_inputs(make_cloud: Any, tmp_path: Path) -> None:
    make_cloud("in/a.las", n=3)
    for out in ("in", "in/out", "in/other"):
        make_cloud(f"{out}/classified/a.laz", n=3)
        for name in ("run.json", "events.jsonl"):
            (tmp_path / out / name).write_text("{}")
    notes: list[str] = []
    out, everything = tmp_path / "in" / "out", str(tmp_path / "in" / "**" / "*.la?")
    assert [p.name for p in find_inputs([str(tmp_path / "in")], (out,), notes.append)] == ["a.las"]
    assert sum("result of a run, left out" in note for note in notes) == 2, "and OUT is known"
    assert out / "classified" / "a.laz" not in find_inputs([everything], (out,))
    assert len(find_inputs([str(out / "classified")])) == 1, "named, it is read"
    with pytest.raises(ConfigError, match=r"classified: holds .*a\.laz"):
        make_plan([str(out / "classified")], RunConfig(in_process=True), out)
    assert [p.parent for p in find_inputs([str(out)])] == [out / "classified"], (
        "named itself: as `evaluate` does"
    )
    with pytest.raises(InputError, match="is the result of a run"):
        find_inputs([str(out)], (out,))
