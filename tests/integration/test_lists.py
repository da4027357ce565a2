"""Files that name clouds (.vpc, EPT) and servers that harm: one line within limits of memory and time."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

pytest.importorskip("aiohttp", reason="no http: aiohttp is not installed")

from cli.main import main
from tests.integration.command import assert_one_line
from tests.tiler.servers import http_server, stalling_server
from tiler.errors import InputError
from tiler.inputs import find_inputs, lists
from tiler.io import locations
from tiler.schedule import limits_memory

LISTS = b'{"type": "FeatureCollection", "features": [[]' + b",[]" * 3_000_000 + b"]}"
"""Of 9 MB, which take 200 MB as objects of Python."""
CUBE = {"dataType": "laszip", "bounds": [0, 0, 0, 1, 1, 1]}


def ept(folder: Path, page: bytes) -> Path:
    """The description of point tiles, with the first page of their hierarchy."""
    (folder / "ept-hierarchy").mkdir()
    (folder / "ept-hierarchy/0-0-0-0.json").write_bytes(page)
    (folder / "ept.json").write_text(json.dumps(CUBE))
    return folder / "ept.json"


@pytest.mark.skipif(
    not limits_memory(), reason="the memory of a process cannot be limited here"
)
@pytest.mark.parametrize("kind", ["vpc", "ept.json", "page", "info"])
def test_memory_ends_with_a_line(
    kind: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(lists, "MEMORY_BYTES", 128 << 20)
    path = tmp_path / "town.vpc" if kind == "vpc" else ept(tmp_path, LISTS)
    if kind in ("vpc", "ept.json"):
        path.write_bytes(LISTS)
    assert main(["info" if kind == "info" else "plan", str(path)]) == 3
    line = "the process that reads it needs more than the 128 MiB of memory that it may have"
    assert_one_line(capsys.readouterr().err, f"{path}: {line}")


@pytest.mark.parametrize("name", ["town.vpc", "ept.json"])
@pytest.mark.parametrize("parts", [0, 100])
def test_a_server_that_stops_is_given_up(
    name: str, parts: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that sends nothing more is quiet, one that sends a byte now and then takes too long."""
    monkeypatch.setattr(locations, "QUIET_SECONDS", 0.3)
    monkeypatch.setattr(locations, "REQUEST_SECONDS", 1.0)
    with stalling_server(parts) as server:
        with pytest.raises(
            InputError, match=r"cannot be read \(its server did not answer in time\)"
        ):
            find_inputs([f"{server}/{name}"], in_process=True)
        monkeypatch.setattr(lists, "LIST_SECONDS", 1.0)
        assert main(["plan", f"{server}/{name}"]) == 3
    assert_one_line(
        capsys.readouterr().err,
        f"{server}/{name}: the process that reads it did not end within 1 s",
    )


def test_a_cloud_on_such_a_server_is_given_up(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tiler.inputs.sources.INSPECTION_SECONDS", 1.0)
    with stalling_server() as server:
        assert main(["info", f"{server}/town.laz"]) == 3
    assert_one_line(
        capsys.readouterr().err, f"{server}/town.laz: the process that reads it did not end"
    )


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
def test_a_pipe_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lists, "LIST_SECONDS", 0.5)
    os.mkfifo(tmp_path / "town.vpc")
    with pytest.raises(
        InputError, match=r"town\.vpc: the process that reads it did not end within 0\.5 s"
    ):
        find_inputs([str(tmp_path / "town.vpc")])


def vpc(path: Path, *hrefs: str) -> Path:
    features = [{"type": "Feature", "assets": {"data": {"href": href}}} for href in hrefs]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def test_schemes_are_known_in_capitals(tmp_path: Path) -> None:
    vpc(tmp_path / "town.vpc", "./a.laz", "HTTPS://Host/B.laz?Key=1")
    ept(tmp_path, b'{"0-0-0-0": 5}')
    with http_server(tmp_path) as server:
        shouted = server.replace("http", "HTTP")
        found = [
            *map(
                str,
                find_inputs([f"{shouted}/town.vpc", f"{shouted}/ept.json"], in_process=True),
            )
        ]
        assert str(locations.list_inputs(f"{shouted}/", (".vpc",))[0]) == f"{server}/town.vpc"
    assert found == [
        f"{server}/a.laz",
        f"{server}/ept-data/0-0-0-0.laz",
        "https://Host/B.laz?Key=1",
    ]
    assert locations.plain_scheme("SimpleCache::S3://B/C") == "simplecache::s3://B/C"
    assert locations.plain_scheme("./A/b") == "./A/b"


def test_no_list_names_more_clouds_than_the_command_has_room_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiler.inputs.lists.MAX_CLOUDS", 2)
    monkeypatch.setattr("tiler.inputs.point_tiles.MAX_CLOUDS", 2)
    path = vpc(tmp_path / "town.vpc", "a.laz", "b.laz", "c.laz")
    with pytest.raises(
        InputError, match="names 3 clouds, 2 at most can be read; write it again"
    ):
        find_inputs([str(path)], in_process=True)
    path = ept(tmp_path, b'{"0-0-0-0": 5, "1-0-0-0": 5, "1-1-0-0": 5}')
    with pytest.raises(InputError, match="twice, or more than 2 nodes"):
        find_inputs([str(path)], in_process=True)


@pytest.mark.parametrize("place", ["", "https://host/"])
def test_half_of_a_character_names_no_cloud(
    place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = vpc(tmp_path / "town.vpc", f"{place}\ud800.laz")
    assert main(["plan", str(path)]) == 3
    assert_one_line(
        capsys.readouterr().err, "its feature 1 names", "which holds half of a character"
    )


@pytest.mark.parametrize(
    "href", ["/etc/a.laz", "../a.laz", "%2e%2e/a.laz", "file:///etc/a.laz"]
)
def test_list_on_a_server_names_no_file_of_this_machine(
    href: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vpc(tmp_path / "town.vpc", href)
    with http_server(tmp_path) as server:
        assert main(["plan", f"{server}/town.vpc"]) == 3
    assert_one_line(capsys.readouterr().err, "town.vpc", f"names {href!r}, which")
