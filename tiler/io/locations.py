"""Paths and URLs as one: what lies at a local path or at a URL (fsspec) is found, listed, moved and written alike."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from glob import has_magic
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast
from urllib.parse import unquote, urlsplit

from tiler.errors import ConfigError, refused_write
from tiler.io.partial_files import SCRATCH_PREFIX

ASKED_AT_ONCE = 16
"""Objects whose size is asked for at the same time."""


def is_url(text: str | Path) -> bool:
    """Whether a text is a URL and not a path of this machine."""
    return "://" in str(text)


def cloud_path(text: str | Path) -> Path:
    """A path, or what behaves as one for a URL (``s3://bucket/town.laz``); ConfigError where no library knows it."""
    if not is_url(text):
        return Path(text)
    refuse_unescaped(str(text))
    try:
        if _of_server(str(text)):
            from tiler.io.server_paths import server_path

            return cast(Path, server_path(str(text), **_login(str(text))))
        from upath import UPath

        return cast(Path, UPath(str(text)))
    except (ImportError, ValueError) as error:
        raise ConfigError(
            f"{text}: cannot be read ({error}); copy it here, or install 'tiler-dtm[cloud]'"
        ) from error


def without_query(text: str) -> str:
    """A path, or a URL without what follows the question mark of a web server's: it ends with the file's name."""
    return text.partition("?")[0] if text.startswith("http") else text


def _of_server(url: str) -> bool:
    """Whether what a URL names is reached by a host and a user: see `tiler.io.server_paths`."""
    return url.startswith(("ftp://", "sftp://", "ssh://", "smb://"))


def _login(url: str) -> dict[str, str]:
    """User and password of a URL of a server, as they are: fsspec hands them on with their escapes."""
    parts = urlsplit(url)
    named = {"username": parts.username, "password": parts.password}
    return {name: unquote(value) for name, value in named.items() if value}


def _system(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the place in it."""
    from fsspec.core import url_to_fs

    if _of_server(url):
        path = cast(Any, cloud_path(url))
        return path.fs, path.path
    found: tuple[Any, str] = url_to_fs(url)
    return found


def location(path: Path) -> str:
    """The text with which a path or URL is opened from anywhere, with what its URL holds of passwords and tokens."""
    return str(path) if is_url(path) else str(path.resolve())


def refuse_unescaped(url: str) -> None:
    """Raise ConfigError for a URL whose password breaks it apart: libraries would tell its pieces in their errors."""
    try:
        urlsplit(url.rpartition("::")[2]).port  # noqa: B018 - it is the reading that fails
    except ValueError:
        raise ConfigError(
            f"{url}: no valid URL; in its user and password write / as %2F, ? as %3F, # as %23, @ as %40, % as %25"
        ) from None


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


TAGS = ("ETag", "etag", "Content-MD5", "md5Hash", "generation", "Last-Modified")
"""Names under which object stores and servers tell one content of an object from another."""


@dataclass(frozen=True)
class State:
    """What tells, without reading it, whether a file is still the same.

    Attributes
    ----------
    size, mtime_ns : int
        Bytes; time of change, 0 where a server does not tell it.
    tag : str
        Of its content, that an object store or server gives; empty on a disk.
    """

    size: int
    mtime_ns: int
    tag: str = ""

    def to_json(self) -> list[Any]:
        """Size, time and tag."""
        return [self.size, self.mtime_ns, self.tag]


def state_of(path: Path) -> State:
    """The state of a path or URL as it is now, whatever was asked before; raises OSError."""
    if not is_url(path):
        stat = path.stat()
        return State(stat.st_size, stat.st_mtime_ns)
    with storage_errors():
        place = cast(Any, path)
        place.fs.invalidate_cache(place.fs._parent(place.path))
        found = place.stat()
        info = found.as_info()
        if info.get("size") is None:
            raise OSError("its server does not tell its size; download it")
        tag = next((str(info[name]) for name in TAGS if info.get(name)), "").removeprefix("W/").strip('"')
        return State(int(found.st_size), int(found.st_mtime_ns), tag)


def list_clouds(url: str, suffixes: tuple[str, ...]) -> list[Path]:
    """The clouds at a URL: an object, all below a folder, or those that a glob matches.

    Raises
    ------
    ConfigError
        There is nothing, or it cannot be listed.
    """
    cloud_path(url)  # says which library lacks
    path = without_query(url)
    try:
        with storage_errors():
            system, place = _system(url)
            if path.lower().endswith(suffixes) and not has_magic(path) and _is_object(system, place):
                return [cloud_path(url)]  # not listed: of some servers that would be to read all of it
            found = system.glob(place) if has_magic(place) else system.find(place)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{url}: cannot be listed ({error}); see to the URL and its credentials") from error
    if not found:
        raise ConfigError(f"{url}: nothing there; name LAS or LAZ objects, folders or globs")
    if found == [place]:
        return [cloud_path(url)]
    names = sorted(name for name in found if name.lower().endswith(suffixes))
    return [cloud_path(_url_of(name, url, place) or system.unstrip_protocol(name)) for name in names]


def _is_object(system: Any, place: str) -> bool:
    try:
        return bool(system.info(place)["type"] != "directory")
    except FileNotFoundError:
        return False


def _url_of(name: str, url: str, place: str) -> str | None:
    """The URL of what was found at another one, which begins as that does: file systems leave out host and user.

    None where the URL does not end with the place that was looked at.
    """
    head, chain, rest = (
        url.partition("::") if not url.rstrip("/").endswith(place.rstrip("/")) else (url, "", "")
    )
    head, place = head.rstrip("/"), place.rstrip("/")
    if not head.endswith(place):
        return None
    return f"{head.removesuffix(place)}{name}{chain}{rest}"


def joined(place: str, *names: str) -> str:
    """A path or URL below another one."""
    return "/".join((place.rstrip("/"), *names))


def names_in(place: str) -> list[str]:
    """Sorted names of the files and folders directly in a folder at a path or URL; empty where there is none."""
    try:
        if not is_url(place):
            return sorted(os.listdir(place))
        with storage_errors():
            system, path = _system(place)
            return sorted(name.rstrip("/").rpartition("/")[2] for name in system.ls(path, detail=False))
    except (FileNotFoundError, NotADirectoryError):
        return []


def state_at(place: str) -> State | None:
    """The state of a file at a path or URL; None where there is none."""
    try:
        return state_of(cloud_path(place))
    except (FileNotFoundError, NotADirectoryError):
        return None


def states_at(places: Sequence[str]) -> list[State | None]:
    """`state_at` of many files: of objects several are asked for at a time, as each takes its time to answer."""
    if not any(is_url(place) for place in places):
        return [state_at(place) for place in places]
    with ThreadPoolExecutor(ASKED_AT_ONCE) as threads:
        return list(threads.map(state_at, places))


def sizes_at(places: Sequence[str]) -> list[int | None]:
    """Bytes of many files at paths or URLs; None where there is none."""
    return [None if state is None else state.size for state in states_at(places)]


def read_bytes(place: str) -> bytes | None:
    """The content of a small file at a path or URL; None where there is none. Raises OSError."""
    try:
        with storage_errors():
            return cloud_path(place).read_bytes()
    except FileNotFoundError:
        return None


def move_file(place: str, target: str) -> None:
    """Give a file at a path or URL another name; at a URL it is there twice for a moment. Raises OSError."""
    if not is_url(place):
        Path(target).parent.mkdir(parents=True, exist_ok=True)
        os.replace(place, target)
        return
    with storage_errors():
        system, path = _system(place)
        system.mv(path, _system(target)[1])


def put_file(path: Path, url: str) -> None:
    """Copy a file to a URL, where it appears when it is whole; raises ProcessingError."""
    try:
        with storage_errors():
            system, place = _system(url)
            system.put_file(str(path), place)
    except OSError as error:
        raise refused_write(url, error) from error


@contextmanager
def folder_for(place: str) -> Iterator[Path]:
    """Where to write what belongs into a folder: in itself, or where that is a URL in one that is then copied there."""
    if not is_url(place):
        yield Path(place)
        return
    with TemporaryDirectory(prefix=SCRATCH_PREFIX) as scratch:
        yield Path(scratch)
        for path in sorted(Path(scratch).iterdir()):
            put_file(path, joined(place, path.name))


def try_write(url: str) -> None:
    """Write an object and remove it again; raises OSError where that fails."""
    with storage_errors():
        system, place = _system(url)
        system.pipe_file(place, b"tiler")
        system.rm_file(place)
