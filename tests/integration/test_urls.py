"""Clouds by http:// and ftp://: single objects, folders and globs are read as files are, and changes are noticed."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import laspy
import pytest

pytest.importorskip("upath", reason="no URLs: universal-pathlib is not installed")
pytest.importorskip("aiohttp", reason="no http: aiohttp is not installed")

from tests.invariants import clouds
from tests.invariants.runs import dtm, settings
from tests.tiler.servers import ftp_server, http_server
from tiler.core.records import SpoolRecord
from tiler.errors import InputError
from tiler.ingest.spool import SpoolPiece, spool_piece
from tiler.ingest.tasks import points as ingest_tasks
from tiler.inputs import inspect
from tiler.io.locations import as_path, list_inputs, location, state_of
from tiler.pipeline import RunResult, run
from tiler.store import TileStore

SUFFIXES = (".las", ".laz")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two neighbouring clouds of more than a block each; one holds what looks like a link."""
    folder = tmp_path_factory.mktemp("served")
    cloud = clouds.city(160.0)
    (folder / "a").mkdir()
    for name, side in (("west.las", cloud.xyz[:, 0] < 80), ("east.laz", cloud.xyz[:, 0] >= 80)):
        las = laspy.read(clouds.write(folder / "a" / name, cloud.take(side)))
        las.header.generating_software = "see http://127.0.0.1/x"
        las.write(folder / "a" / name)
    (folder / "a" / "readme.txt").write_text("no cloud")
    assert (folder / "a" / "west.las").stat().st_size > 1 << 18
    return folder


@pytest.fixture(scope="module")
def servers(folder: Path) -> Iterator[dict[str, str]]:
    with ExitStack() as stack:
        yield {
            "http": stack.enter_context(http_server(folder)),
            "ftp": stack.enter_context(ftp_server(folder)),
        }


def names(url: str) -> list[str]:
    """What is found, as it is named to workers."""
    return [location(path) for path in list_inputs(url, SUFFIXES)]


@pytest.mark.parametrize("protocol", ["http", "ftp"])
def test_what_is_found_is_named_by_its_whole_url(
    protocol: str, servers: dict[str, str], folder: Path
) -> None:
    server = servers[protocol]
    both = [f"{server}/a/east.laz", f"{server}/a/west.las"]
    assert names(f"{server}/a") == names(f"{server}/a/") == names(f"{server}/a/*.la*") == both
    assert names(f"{server}/a/*.laz") == both[:1]
    for url in both:
        assert names(url) == [url]
        assert (
            state_of(as_path(url)).size
            == (folder / "a" / url.rpartition("/")[2]).stat().st_size
        )
        assert inspect(as_path(url)).points > 1000
    with pytest.raises(InputError, match=r"no\.laz: cannot be read"):
        inspect(*list_inputs(f"{server}/a/no.laz", SUFFIXES))


def test_a_token_stays_with_its_object(servers: dict[str, str]) -> None:
    url = f"{servers['http']}/a/east.laz?token=abc"
    assert names(url) == [url]
    assert inspect(as_path(url)).points > 1000


def test_a_wrong_password_is_told_and_its_connection_is_closed(servers: dict[str, str]) -> None:
    wrong = servers["ftp"].replace("%401@", "@") + "/a"
    with pytest.raises(InputError, match="cannot be listed .*530 not you"):
        names(wrong)
    with pytest.raises(InputError, match="cannot be read .*530 not you"):
        inspect(as_path(f"{wrong}/east.laz"))
    gc.collect()  # a socket that is still open warns here, and a warning is an error


def test_an_ftp_connection_that_is_replaced_is_closed(servers: dict[str, str]) -> None:
    system: Any = as_path(f"{servers['ftp']}/a/east.laz").fs
    first = system.ftp
    system._connect()  # fsspec does so if a server does not stop sending
    assert first.sock is None
    assert system.ftp.sock is not None


def test_an_ftp_connection_is_closed_before_its_socket_is_collected(
    servers: dict[str, str],
) -> None:
    circle: list[Any] = [as_path(f"{servers['ftp']}/a/east.laz")]
    circle.append(circle)
    socket = circle[0].fs.ftp.sock
    # what only the circle holds now comes after the socket in the collector's list
    gc.collect()
    del circle, socket
    # it ends the objects of a circle in the order of its list; an open socket would warn
    gc.collect()


def do(inputs: list[str], out: Path) -> RunResult:
    return run(inputs, out, settings())


def test_a_run_on_urls_is_a_run_on_files(
    servers: dict[str, str], folder: Path, tmp_path: Path
) -> None:
    do([str(folder / "a")], tmp_path / "files")
    urls = [f"{servers['http']}/a/west.las", f"{servers['ftp']}/a/east.laz"]
    assert do(urls, tmp_path / "urls").exit_code == 0
    assert (dtm(tmp_path / "urls")[0] == dtm(tmp_path / "files")[0]).all()
    for name in ("west.laz", "east.laz"):
        ours, theirs = (tmp_path / out / "classified" / name for out in ("urls", "files"))
        assert ours.read_bytes() == theirs.read_bytes()
    assert do(urls, tmp_path / "urls").did_nothing


def test_an_object_that_is_replaced_is_left_out(
    servers: dict[str, str], folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the same size, in another order: the tag tells."""
    cloud = clouds.city(60.0)
    path = clouds.write(folder / "b" / "c.las", cloud)
    back = clouds.write(tmp_path / "back.las", clouds.Cloud(cloud.xyz[::-1], cloud.truth[::-1]))

    def changed(store: TileStore, *, work: SpoolPiece) -> SpoolRecord:
        os.replace(back, path)
        return spool_piece(store, work=work)

    monkeypatch.setattr(ingest_tasks, "spool_piece", changed)
    with pytest.raises(
        InputError, match="c.las: left out: was replaced or changed during the run"
    ):
        do([f"{servers['http']}/b/c.las"], tmp_path / "out")


def test_a_server_that_gives_no_parts_is_told_of(tmp_path: Path) -> None:
    clouds.write(tmp_path / "west.las", clouds.city(160.0, 2.0))
    with http_server(tmp_path, parts=False) as server:
        line = r"west\.las: .*its server does not support range requests"
        with pytest.raises(InputError, match=line):
            inspect(as_path(f"{server}/west.las"))
