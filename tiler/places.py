"""Where things lie: on a path, or at a URL that fsspec knows; clouds are read from both alike."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from glob import has_magic
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, cast

from tiler.errors import ConfigError, refused_write

BLOCK_BYTES = 1 << 22
"""Of an object, asked for at once: the bytes of some chunks of points."""


def is_url(text: str | Path) -> bool:
    """Whether it is no path of this machine."""
    return "://" in str(text)


def cloud_path(text: str | Path) -> Path:
    """A path, or what behaves as one for a URL (``s3://bucket/town.laz``); ConfigError where no library knows it."""
    if not is_url(text):
        return Path(text)
    try:
        from upath import UPath

        return cast(Path, UPath(str(text)))
    except (ImportError, ValueError) as error:
        raise ConfigError(
            f"{text}: cannot be read ({error}); copy it here, or install 'tiler-dtm[cloud]'"
        ) from error


@contextmanager
def storage_errors() -> Iterator[None]:
    """What a library of an object store raises, as an OSError: some of them have exceptions of their own."""
    try:
        yield
    except (OSError, ImportError):
        raise
    except Exception as error:
        raise OSError(f"{type(error).__name__}: {error}") from error


def stat_cloud(path: Path) -> os.stat_result:
    """Size and time of change of a path or URL; raises OSError."""
    with storage_errors():
        return path.stat()


def open_cloud(path: Path) -> BinaryIO:
    """Open for reading, anywhere in it, in pieces of `BLOCK_BYTES` where it is a URL; raises OSError."""
    if not is_url(path):
        return open(path, "rb")
    with storage_errors():
        opened = cast(Any, path).open("rb", block_size=BLOCK_BYTES, cache_type="readahead")
        return cast(BinaryIO, _Guarded(opened))


class _Guarded(io.RawIOBase):
    """A file of fsspec whose every error is an OSError.

    Parameters
    ----------
    file : file object
    """

    def __init__(self, file: Any) -> None:
        self._file = file

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return int(self._file.seek(offset, whence))

    def tell(self) -> int:
        return int(self._file.tell())

    def readinto(self, target: Any) -> int:
        with storage_errors():
            data = self._file.read(len(target))
        target[: len(data)] = data
        return len(data)

    def close(self) -> None:
        if not self.closed:
            self._file.close()
        super().close()


def list_clouds(url: str, suffixes: tuple[str, ...]) -> list[Path]:
    """The clouds at a URL: an object, all below a folder, or those that a glob matches.

    Raises
    ------
    ConfigError
        There is nothing, or it cannot be listed.
    """
    from fsspec.core import url_to_fs

    cloud_path(url)  # says which library lacks
    try:
        with storage_errors():
            system, place = url_to_fs(url)
            found = system.glob(place) if has_magic(place) else system.find(place)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{url}: cannot be listed ({error}); see to the URL and its credentials") from error
    if not found:
        raise ConfigError(f"{url}: nothing there; name LAS or LAZ objects, folders or globs")
    names = found if found == [place] else [n for n in found if n.lower().endswith(suffixes)]
    return [cloud_path(system.unstrip_protocol(name)) for name in sorted(names)]


def joined(place: str, *names: str) -> str:
    """A path or URL below another one."""
    return "/".join((place.rstrip("/"), *names))


def size_at(place: str) -> int | None:
    """Bytes of a file at a path or URL; None where there is none."""
    try:
        return stat_cloud(cloud_path(place)).st_size
    except FileNotFoundError:
        return None


def put_file(path: Path, url: str) -> None:
    """Copy a file to a URL, where it appears when it is whole; raises ProcessingError."""
    from fsspec.core import url_to_fs

    try:
        with storage_errors():
            system, place = url_to_fs(url)
            system.put_file(str(path), place)
    except OSError as error:
        raise refused_write(url, error) from error


@contextmanager
def folder_for(place: str) -> Iterator[Path]:
    """Where to write what belongs into a folder: in itself, or where that is a URL in one that is then copied there."""
    if not is_url(place):
        yield Path(place)
        return
    with TemporaryDirectory(prefix="tiler-") as scratch:
        yield Path(scratch)
        for path in sorted(Path(scratch).iterdir()):
            put_file(path, joined(place, path.name))


def try_write(url: str) -> None:
    """Write an object and remove it again; raises OSError where that fails."""
    from fsspec.core import url_to_fs

    with storage_errors():
        system, place = url_to_fs(url)
        system.pipe_file(place, b"tiler")
        system.rm_file(place)
