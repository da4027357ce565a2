"""Names, links and folders that are not what they seem."""

from __future__ import annotations

import json
import os
import shutil
import uuid
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tiler.config import RunConfig
from tiler.errors import ConfigError, InputError
from tiler.inputs import find_inputs, inspect
from tiler.io.cloud_formats import FORMAT_NAMES
from tiler.io.locations import as_path
from tiler.plan import make_plan
from tiler.plan.inspection import output_names


def test_links_to_folders_are_not_followed_and_named(make_cloud: Any, tmp_path: Path) -> None:
    make_cloud("in/a.las", n=3)
    (tmp_path / "in" / "round").symlink_to(tmp_path / "in")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "in" / "away").symlink_to(tmp_path / "elsewhere")
    notes: list[str] = []
    assert [p.name for p in find_inputs([str(tmp_path / "in")], note=notes.append)] == ["a.las"]
    assert sum("is a link to a folder, not followed" in note for note in notes) == 2
    shutil.move(tmp_path / "in" / "a.las", tmp_path / "elsewhere" / "a.las")
    assert [p.name for p in find_inputs([str(tmp_path / "in" / "away")])] == ["a.las"], (
        "named itself, it is"
    )


@pytest.mark.parametrize("pattern", ["", "*", "*.zip"])
def test_a_folder_of_packed_clouds_has_the_advice_to_unpack_them(
    pattern: str, tmp_path: Path
) -> None:
    for name in ("a.laz.gz", "tiles.zip", "readme.txt"):
        (tmp_path / name).write_bytes(b"PK\x03\x04")
    with pytest.raises(InputError) as caught:
        find_inputs([os.path.join(tmp_path, pattern)])
    assert " file there, but packed files (" in str(caught.value)
    assert str(tmp_path / "tiles.zip") in str(caught.value)
    assert str(caught.value).endswith(
        f"; unpack them and give the {FORMAT_NAMES} files in them"
    )


def test_an_unreadable_folder_is_named(
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
    assert "shut: cannot be listed (Permission denied); skipped" in note


@pytest.mark.parametrize(
    "kind", ["pipe", "device", "dangling link", "folder", "link to itself"]
)
def test_a_pipe_is_refused_without_waiting_for_it(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.las"
    if kind == "pipe":
        if not hasattr(os, "mkfifo"):
            pytest.skip("no pipes with names")
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to(
            {"device": "/dev/zero", "dangling link": "nowhere", "link to itself": path}[kind]
        )
    with pytest.raises(InputError, match=r"odd\.las: (is not a regular file|cannot be read)"):
        inspect(path)


def test_inputs_that_cannot_be_opened_are_refused(tmp_path: Path) -> None:
    for text in ("", "x" * 5000):
        with pytest.raises(ConfigError, match=f"give {FORMAT_NAMES} files"):
            find_inputs([text])
    for one, other in (("a.las", "b.las"), ("b.las", "a.las")):
        (tmp_path / one).symlink_to(other)
    for inputs in ("a.las", "*.las", ""):
        with pytest.raises(
            InputError, match=r"las: cannot be read \(Too many levels of symbolic links"
        ):
            make_plan([str(tmp_path / inputs)], RunConfig(in_process=True, on_error="stop"))


@pytest.mark.parametrize(
    "name",
    [b"gr\xfc\xdfe.las", b"line\nbreak.las", b"\x1b[2Jclear.las", b"-o.las", b"a b;$(c).las"],
)
def test_any_name_is_read_and_kept(name: bytes, make_cloud: Any, tmp_path: Path) -> None:
    if os.name == "nt" and (not name.isascii() or min(name) < 32):
        pytest.skip("no such names")
    path = Path(os.fsdecode(os.path.join(os.fsencode(tmp_path / "in"), name)))
    path.parent.mkdir()
    shutil.move(make_cloud("plain.las", n=50), path)
    plan = make_plan([str(tmp_path / "in")], RunConfig(in_process=True))
    assert plan.inputs.cloud_names == {path: Path(path.name).with_suffix(".laz")}


def test_classified_files_stay_below_their_folder(
    make_cloud: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make_cloud("a/b/one.las", n=3)
    (tmp_path / "a" / "two.las").symlink_to(make_cloud("c/two.las", n=3))
    monkeypatch.chdir(tmp_path / "a" / "b")
    for inputs in (["../"], ["../b/../../a"], [str(tmp_path / "a")], [str(path), "../two.las"]):
        names = output_names(inputs, [inspect(p) for p in find_inputs(inputs)])
        assert all(".." not in n.parts and not n.is_absolute() for n in names.values()), names
        assert sorted(n.name for n in names.values()) == ["one.laz", "two.laz"]


def test_inputs_whose_results_would_have_one_name_are_refused(
    make_cloud: Any, tmp_path: Path
) -> None:
    paths = [make_cloud("a/Cloud.las", n=3), make_cloud("b/cloud.laz", n=3)]
    with pytest.raises(ConfigError, match="would both become classified/"):
        make_plan([str(p) for p in paths], RunConfig(in_process=True))


NAMES = {
    "west": "west",
    "east": "east",
    ".hidden": ".hidden",
    "tile.1": "tile.1",
    "tile.2": "tile.2",
    "north.las": "north",
    "south.v2.LAZ": "south.v2",
}


@pytest.mark.parametrize("suffix", [".laz", ".las", ".copc.laz"])
def test_classified_files_lose_only_the_suffix_of_a_cloud(
    suffix: str, make_cloud: Any, tmp_path: Path
) -> None:
    inputs = [str(shutil.move(make_cloud("c.las", n=3), tmp_path / name)) for name in NAMES]
    sources = [inspect(Path(path)) for path in inputs]
    names = output_names(inputs, sources, suffix).values()
    assert [name.as_posix() for name in names] == [f"{stem}{suffix}" for stem in NAMES.values()]


@pytest.mark.parametrize(
    ("url", "name"),
    [
        ("http://server/a/east.laz?token=abc.def/ghi", "east.laz"),
        ("http://server/get?token=abc.def", "get.laz"),
        ("s3://bucket/a/east.laz?versionId=abc", "east.laz"),
    ],
)
def test_classified_files_of_urls_have_no_query_in_their_names(
    url: str, name: str, make_cloud: Any
) -> None:
    pytest.importorskip("upath")
    source = replace(inspect(make_cloud("a.laz", n=3)), path=as_path(url))
    for given in (url, url.rpartition("/a/")[0]):
        (written,) = output_names([given], [source]).values()
        assert written.name == name


RUN: dict[str, Any] = {
    name: {} for name in ("state", "version", "configuration", "plan", "stages")
}


def a_run(folder: Path) -> None:
    """Write the file by which tiler recognises the folder of a run."""
    (folder / "run.json").write_text(json.dumps(RUN))


def found(notes: list[str], root: Path, *inputs: object, **options: Any) -> list[str]:
    """Inputs by their path below a folder; ``notes`` receives the notes."""
    notes.clear()
    paths = find_inputs([str(i) for i in inputs], note=notes.append, **options)
    return sorted(path.relative_to(root).as_posix() for path in paths)


def test_results_of_a_run_in_any_folder_are_no_inputs(make_cloud: Any, tmp_path: Path) -> None:
    root, notes = tmp_path / "in", list[str]()
    make_cloud("in/a.las", n=3)
    for out in ("", "out/", "b/other/"):
        for made in ("classified/a.laz", "classified/b/c.laz", "outdated/classified/a.laz"):
            make_cloud(f"in/{out}{made}", n=3)
        a_run(root / out)
    make_cloud("in/b/mine/classified/m.las", n=3)
    make_cloud("in/out/own.las", n=3)
    (root / ".tiler-scratch").mkdir()
    make_cloud("in/.tiler-scratch/s.laz", n=3)
    mine = ["a.las", "b/mine/classified/m.las", "out/own.las"]
    assert found(notes, root, root) == mine
    assert sum("is the result of a run, left out; give it" in note for note in notes) == 6
    assert found(notes, root, root / "**" / "*.la?") == mine
    assert found(notes, root, root / "*") == mine
    assert found(notes, root, root, out=root / "out") == mine
    named = ["out/classified/a.laz", "out/classified/b/c.laz"]
    for place in (root / "out/classified", root / "out/classified/**/*.laz"):
        assert found(notes, root, place) == named
    assert found(notes, root, root / "out" / "classified" / "a.laz") == named[:1]
    (root / "out" / "own.las").unlink()
    line = r"no \.las.* file there .*out[/\\]classified is the result of a run, left out"
    with pytest.raises(InputError, match=line):
        find_inputs([str(root / "out")])
    assert found(notes, root, root / "out", results=True) == named, "as `evaluate` wants it"


def test_results_are_recognised_by_a_damaged_run_file(make_cloud: Any, tmp_path: Path) -> None:
    make_cloud("a.las", n=3)
    make_cloud("out/classified/a.laz", n=3)
    (tmp_path / "out" / "run.json").write_text('{"state": "do')
    assert found([], tmp_path, tmp_path) == ["a.las", "out/classified/a.laz"], (
        "of another program"
    )
    (tmp_path / "out" / "events.jsonl").write_text("")
    assert found([], tmp_path, tmp_path) == ["a.las"]


def test_a_folder_of_results_that_is_a_link_into_the_inputs(
    make_cloud: Any, tmp_path: Path
) -> None:
    make_cloud("in/a.las", n=3)
    make_cloud("in/made/a.laz", n=3)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "classified").symlink_to(tmp_path / "in" / "made")
    a_run(tmp_path / "out")
    assert found([], tmp_path, tmp_path / "in", out=tmp_path / "out") == ["in/a.las"]


def test_a_run_does_not_overwrite_the_results_that_it_reads(
    make_cloud: Any, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    make_cloud("out/classified/a.laz", n=3)
    for known in (False, True):
        with pytest.raises(ConfigError, match=r"classified: contains .*a\.laz"):
            make_plan([str(out / "classified")], RunConfig(in_process=True), out)
        if not known:
            a_run(out)


@pytest.mark.parametrize("pattern", ["", "/", "/**/*.laz"])
def test_results_at_a_url(pattern: str, make_cloud: Any) -> None:
    pytest.importorskip("upath")
    url = f"memory://{uuid.uuid4().hex}"
    data = make_cloud("a.laz", n=3).read_bytes()
    for name in (
        "a.laz",
        "out/classified/a.laz",
        "out/outdated/b.laz",
        "else/classified/c.laz",
    ):
        as_path(f"{url}/{name}").write_bytes(data)
    as_path(f"{url}/out/run.json").write_bytes(json.dumps(RUN).encode())
    names = {str(path).removeprefix(f"{url}/") for path in find_inputs([f"{url}{pattern}"])}
    assert names == {"a.laz", "else/classified/c.laz"}
    assert len(find_inputs([f"{url}/out/classified{pattern}"])) == 1
