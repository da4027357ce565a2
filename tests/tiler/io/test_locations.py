"""Paths and URLs are read and listed in the same way."""

from __future__ import annotations

import os
import uuid
from contextlib import suppress
from pathlib import Path

import pytest

from tiler.errors import ConfigError, ProcessingError
from tiler.io import cloud_reading, locations
from tiler.io.atomic_files import partial_path
from tiler.io.result_folder import below


@pytest.fixture
def folder() -> str:
    """A URL with objects below it."""
    pytest.importorskip("upath", reason="no URLs: universal-pathlib is not installed")
    url = f"memory://{uuid.uuid4().hex}"
    for name in ("a.laz", "b/c.LAS", "b/readme.txt"):
        locations.as_path(f"{url}/{name}").write_bytes(bytes(range(200)) * 3)
    return url


def test_clouds_are_listed(folder: str) -> None:
    def names(url: str) -> list[str]:
        return [
            str(p).removeprefix(folder) for p in locations.list_inputs(url, (".las", ".laz"))
        ]

    assert names(folder) == names(f"{folder}/") == ["/a.laz", "/b/c.LAS"]
    assert names(f"{folder}/**/*.LAS") == ["/b/c.LAS"]
    assert names(f"{folder}/b/readme.txt") == [
        "/b/readme.txt"
    ]  # a file that is named itself need not have a suffix of clouds
    with pytest.raises(ConfigError, match="nothing there; give .* objects"):
        locations.list_inputs(f"{folder}/nowhere", (".las",))


def test_any_part_of_an_object_is_read(folder: str) -> None:
    path = locations.as_path(f"{folder}/a.laz")
    assert locations.stat_location(path).st_size == locations.sizes_at([str(path)])[0] == 600
    with cloud_reading.open_location(path) as stream:
        assert stream.seek(250) == 250
        assert stream.read(3) == bytes((50, 51, 52))
        assert stream.tell() == 253
        stream.seek(-2, 2)
        assert stream.read(10) == bytes((198, 199))
        buffer = bytearray(4)
        stream.seek(0)
        assert stream.readinto(buffer) == 4  # type: ignore[attr-defined]
        assert buffer == bytes((0, 1, 2, 3))


def test_two_views_of_an_object_have_their_own_positions(folder: str) -> None:
    path = locations.as_path(f"{folder}/a.laz")
    with (
        cloud_reading.open_location(path, 100) as stream,
        cloud_reading.reopen(stream, path) as other,
    ):
        assert stream.seek(210) == 210
        assert other.read(2) == bytes((0, 1))
        assert stream.read(2) == bytes((10, 11))
        stream.seek(-1, 2)
        assert stream.read() == bytes((199,))
        assert (other.tell(), stream.tell()) == (2, 600)


def test_a_file_at_a_url_appears_when_it_is_whole(folder: str) -> None:
    with locations.staging_folder(f"{folder}/out") as scratch:
        (scratch / "x.tif").write_bytes(b"whole")
        assert locations.state_at(f"{folder}/out/x.tif") is None
    assert locations.sizes_at([f"{folder}/out/x.tif"]) == [5]
    assert not scratch.exists()
    with suppress(ZeroDivisionError), locations.staging_folder(f"{folder}/out") as scratch:
        (scratch / "y.tif").write_bytes(b"half")
        raise ZeroDivisionError
    assert locations.state_at(f"{folder}/out/y.tif") is None
    assert not scratch.exists()


def test_a_path_is_a_path(tmp_path: Path) -> None:
    assert locations.as_path(str(tmp_path)) == tmp_path
    with locations.staging_folder(str(tmp_path)) as folder:
        assert folder == tmp_path
    assert locations.state_at(str(tmp_path / "nowhere")) is None
    assert locations.joined("a/", "b", "c/d.tif") == str(Path("a/b/c/d.tif"))
    assert locations.joined("s3://a/", "b", "c/d.tif") == "s3://a/b/c/d.tif"


def test_paths_on_windows_have_its_own_separators(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as windows:
        windows.setattr(os, "sep", "\\")
        assert locations.joined("job/out", "sheets/a.tif") == r"job\out\sheets\a.tif"
        assert locations.joined("C:\\", "dtm.tif") == r"C:\dtm.tif"
        assert locations.joined("s3://a", "b/c.tif") == "s3://a/b/c.tif"
        assert below("job/out", locations.joined("job/out", "sheets/a.tif")) == "sheets/a.tif"
        assert locations.with_slashes(r"job\out\dtm.tif") == "job/out/dtm.tif"


def test_a_url_that_no_library_knows_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"nosuch://x/y: cannot be read .*tiler-dtm\[cloud\]"):
        locations.as_path("nosuch://x/y").exists()


def test_writing_to_an_unknown_url_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"x")
    with pytest.raises(ProcessingError, match="cannot be written"):
        locations.upload_file(tmp_path / "x", "nosuch://x/y")


def test_a_long_name_has_a_short_temporary_name(tmp_path: Path) -> None:
    assert partial_path(tmp_path / "a.laz") == tmp_path / ".tiler-a.laz.partial"
    long = [tmp_path / ("ä" * 125 + end) for end in ("1.laz", "2.laz")]
    found = {partial_path(path) for path in long}
    assert len(found) == 2, "each has its own"
    for path in found:
        path.write_bytes(b"")


def test_exhausted_memory_is_not_an_error_of_the_server() -> None:
    """An answer that expands hugely: the process that reads it reports its limit."""
    with pytest.raises(MemoryError), locations.storage_errors():
        raise MemoryError


@pytest.mark.parametrize("url", ["file://localhost/data/out", "FILE://out"])
def test_a_url_of_a_file_has_a_whole_path(url: str) -> None:
    with pytest.raises(ConfigError, match="give a whole path after file://"):
        locations.local_or_url(url)


def test_only_urls_of_this_machine_become_paths(tmp_path: Path) -> None:
    assert locations.local_or_url(f"file://{tmp_path.as_posix()}") == tmp_path.as_posix()
    for place in ("out", "s3://bucket/out", "zip::file:///data/out.zip"):
        assert locations.local_or_url(place) == place
