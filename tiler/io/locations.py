"""Finding, listing, moving and writing of files at local paths and at URLs (fsspec)."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from glob import has_magic
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast
from urllib.parse import unquote, urlsplit

from tiler.core.words import alternatives
from tiler.errors import ConfigError, InputError, write_error
from tiler.io.atomic_files import SCRATCH_PREFIX, replace_file

CONCURRENT_REQUESTS = 16
"""Number of objects whose state is requested at the same time."""
QUIET_SECONDS = 30.0
"""Time after which a request fails if a web server sends nothing."""
REQUEST_SECONDS = 300.0
"""Time after which a request to a web server fails."""
_MISSING = (404, 410)
"""Answers of web servers that do not have the file."""
_SCHEME = re.compile(r"(?:^|(?<=::))[A-Za-z][A-Za-z0-9+.-]*(?=::|://)")


def is_url(text: str | Path) -> bool:
    """Return whether a text is a URL and not a path on this machine."""
    return "://" in str(text)


def no_such_file(path: Path, remedy: str) -> InputError:
    """Return the error for a local file that does not exist. Only clouds are read from URLs."""
    scheme, is_rooted, rest = path.as_posix().partition(":/")
    if is_rooted and len(scheme) > 1:  # A drive of Windows has one letter.
        url = f"{scheme}://{rest.lstrip('/')}"
        return InputError(
            f"{url}: this file is not read from a URL; download it and give its path"
        )
    return InputError(f"{path}: no such file; {remedy}")


def with_slashes(place: str | Path) -> str:
    """Return a path or URL as results name it: with slashes, also on Windows."""
    return str(place).replace(os.sep, "/")


def plain_scheme(text: str) -> str:
    """Return a URL with schemes in lower case, since libraries do not support ``HTTP://``, or a path unchanged."""
    return _SCHEME.sub(lambda found: found[0].lower(), text) if is_url(text) else text


def without_local_scheme(url: str) -> str:
    """Return the path in a ``file://`` or ``local://`` URL, or any other text unchanged."""
    path = url.removeprefix("file://").removeprefix("local://")
    has_drive = path != url and os.name == "nt" and re.match("/[A-Za-z]:", path) is not None
    return path[1:] if has_drive else path


def local_or_url(place: str | Path) -> str:
    """Return the path if a URL is one of this machine (``file:///data/out``), or any other path or URL unchanged.

    Libraries for URLs make no folders there, and copy files that only have to be renamed. Raise ConfigError for
    ``file://server/out``.
    """
    text = plain_scheme(str(place))
    path = without_local_scheme(text)
    if path != text and not os.path.isabs(path):
        raise ConfigError(
            f"{place}: names a server or a relative path; give a whole path after file://, such as file:///data/out"
        )
    return str(place) if is_url(path) else path


def as_path(text: str | Path) -> Path:
    """Return a path, or an object like a path for a URL (``s3://bucket/town.laz``).

    Raise ConfigError if no library can read the URL.
    """
    if not is_url(text):
        return Path(text)
    url = plain_scheme(str(text))
    validate_escaped(url)
    try:
        if _is_on_server(url):
            from tiler.io.server_paths import server_path

            return cast(Path, server_path(url, **_login(url)))
        from upath import UPath

        return cast(Path, UPath(url, **_options(url)))
    except (ImportError, ValueError) as error:
        raise ConfigError(
            f"{text}: cannot be read ({error}); copy it here, or install 'tiler-dtm[cloud]'"
        ) from error


def without_query(text: str) -> str:
    """Return the URL of a web server without its query, so that it ends with the file name, or other text unchanged."""
    return text.partition("?")[0] if plain_scheme(text).startswith("http") else text


def _is_on_server(url: str) -> bool:
    """Return whether a URL is on an FTP, SSH or SMB server (see `tiler.io.server_paths`)."""
    return url.startswith(("ftp://", "sftp://", "ssh://", "smb://"))


def _login(url: str) -> dict[str, str]:
    """Return user and password of a URL. Their escapes are decoded here, since fsspec does not decode them."""
    parts = urlsplit(url)
    named = {"username": parts.username, "password": parts.password}
    return {name: unquote(value) for name, value in named.items() if value}


def _options(url: str) -> dict[str, Any]:
    """Return options of a file system: for web servers the timeouts, unless the configuration of fsspec sets them.

    Raise ImportError if the library for web servers is not installed.
    """
    if not url.startswith(("http://", "https://")):
        return {}
    from aiohttp import ClientTimeout
    from fsspec.config import conf

    wait = ClientTimeout(
        total=REQUEST_SECONDS, sock_connect=QUIET_SECONDS, sock_read=QUIET_SECONDS
    )
    configured = {**conf.get("http", {}), **conf.get("https", {})}.get("client_kwargs", {})
    return {"client_kwargs": {"timeout": wait, **configured}}


def _system(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, and the path in it."""
    from fsspec.core import url_to_fs

    url = plain_scheme(url)
    if _is_on_server(url):
        path = cast(Any, as_path(url))
        return path.fs, path.path
    system_and_path: tuple[Any, str] = url_to_fs(url, **_options(url))
    return system_and_path


def location(path: Path) -> str:
    """Return an absolute path, or the complete URL with passwords and tokens, so that any process can open it."""
    return str(path) if is_url(path) else str(path.resolve())


def validate_escaped(url: str) -> None:
    """Raise ConfigError if a password makes a URL invalid, since errors of libraries would show the password."""
    try:
        urlsplit(url.rpartition("::")[2]).port  # noqa: B018 - reading it raises the error
    except ValueError:
        raise ConfigError(
            f"{url}: not a valid URL; in user and password, use %2F for /, %3F for ?, %23 for #, %40 for @, %25 for %"
        ) from None


@contextmanager
def storage_errors() -> Iterator[None]:
    """Convert the exceptions of a library for object stores to OSErrors."""
    try:
        yield
    except MemoryError:  # The caller reports its limit.
        raise
    except Exception as error:
        # After a failed request, fsspec reports that the file is missing.
        told = _web_error(error) or (error.__cause__ and _web_error(error.__cause__))
        if told:
            raise told from error
        if isinstance(error, FileNotFoundError) and error.errno is None:
            # The text is only the path.
            raise FileNotFoundError("nothing is there") from error
        if isinstance(error, OSError | ImportError):
            raise
        raise OSError(f"{type(error).__name__}: {error}") from error


def _web_error(error: BaseException) -> OSError | None:
    """Return the error of a request to a web server in plain words, or None if it is another error."""
    if isinstance(error, TimeoutError):
        return OSError("its server did not answer in time")
    aiohttp: Any = sys.modules.get("aiohttp")
    if aiohttp is None or not isinstance(error, aiohttp.ClientError):
        return None
    if isinstance(error, aiohttp.ClientResponseError):
        kind = FileNotFoundError if error.status in _MISSING else OSError
        return kind(f"its server answered {error.status} {error.message}".rstrip())
    if isinstance(error, aiohttp.ClientConnectorError):
        cause = error.os_error
        reason = os.strerror(cause.errno) if (cause.errno or 0) > 0 else cause.strerror
        return OSError(f"its server {error.host} cannot be reached: {reason}")
    return OSError("the connection to its server broke")


def reading_remedy(place: str | Path, remedy: str) -> str:
    """Return the advice for a file that cannot be read: ``remedy`` for a path, and what to check for a URL."""
    return (
        "check the URL, its server and your credentials, or download it"
        if is_url(place)
        else remedy
    )


def stat_location(path: Path) -> os.stat_result:
    """Return size and time of the last change of a path or URL. Raise OSError if this fails."""
    with storage_errors():
        return path.stat()


TAGS = ("ETag", "etag", "Content-MD5", "md5Hash", "generation", "Last-Modified")
"""Names of the tags with which object stores and servers identify the content."""


@dataclass(frozen=True)
class FileState:
    """State of a file, which shows whether the file has changed. It is found without reading the file.

    Attributes
    ----------
    size : int
        Size in bytes.
    mtime_ns : int
        Time of the last change in nanoseconds, or 0 if a server does not report it.
    tag : str
        Tag with which an object store or server identifies the content, empty on a disk.
    """

    size: int
    mtime_ns: int
    tag: str = ""

    def to_json(self) -> list[Any]:
        """Return size, time and tag."""
        return [self.size, self.mtime_ns, self.tag]


def state_of(path: Path) -> FileState:
    """Return the current state of a path or URL, not from a cache. Raise OSError if this fails."""
    if not is_url(path):
        stat = path.stat()
        return FileState(stat.st_size, stat.st_mtime_ns)
    with storage_errors():
        url_path = cast(Any, path)
        url_path.fs.invalidate_cache(url_path.fs._parent(url_path.path))
        status = url_path.stat()
        info = status.as_info()
        if info.get("size") is None:
            raise OSError("its server does not report its size")
        tag = (
            next((str(info[name]) for name in TAGS if info.get(name)), "")
            .removeprefix("W/")
            .strip('"')
        )
        return FileState(int(status.st_size), int(status.st_mtime_ns), tag)


def list_inputs(url: str, suffixes: tuple[str, ...]) -> list[Path]:
    """Return the clouds at a URL: one object, all clouds in a folder and its subfolders, or all clouds of a glob.

    Raises
    ------
    ConfigError
        There is nothing at the URL.
    InputError
        The URL cannot be listed.
    """
    url = plain_scheme(url)
    as_path(url)  # This raises an error that names a missing library.
    path = without_query(url)
    if path.lower().endswith(suffixes) and not has_magic(path) and not _is_folder(url):
        # Listing the file would read all of it on some servers.
        return [as_path(url)]
    try:
        with storage_errors():
            system, system_path = _system(url)
            listed = (
                system.glob(system_path) if has_magic(system_path) else system.find(system_path)
            )
    except (OSError, ValueError) as error:
        raise InputError(
            f"{url}: cannot be listed ({error}); {reading_remedy(url, '')}"
        ) from error
    if not listed:
        raise ConfigError(
            f"{url}: nothing there; give {alternatives(suffixes)} objects, folders or globs"
        )
    if listed == [system_path]:
        return [as_path(url)]
    names = sorted(name for name in listed if name.lower().endswith(suffixes))
    return [
        as_path(_url_of(name, url, system_path) or system.unstrip_protocol(name))
        for name in names
    ]


def _is_folder(url: str) -> bool:
    """Return whether a URL with the name of a file is a folder. Reading the file reports errors."""
    if url.startswith("http"):  # Web servers do not tell folders from files.
        return False
    try:
        with storage_errors():
            system, place = _system(url)
            return bool(system.info(place)["type"] == "directory")
    except OSError:
        return False


def _url_of(name: str, url: str, place: str) -> str | None:
    """Return the URL of a file that was found at ``url``, since file systems leave out host and user.

    The result is None if ``url`` does not end with ``place``, the path that was listed.
    """
    place = place.rstrip("/")
    head, chain, rest = url, "", ""
    if not url.rstrip("/").endswith(place):
        head, chain, rest = url.partition("::")
    head = head.rstrip("/")
    if not head.endswith(place):
        return None
    return f"{head.removesuffix(place)}{name}{chain}{rest}"


def joined(place: str, *names: str) -> str:
    """Return the path or URL of a name in a folder. A path has the system's own separators: it is opened and shown."""
    whole = "/".join((place.rstrip("/" + os.sep), *names))
    return whole if is_url(place) else whole.replace("/", os.sep)


def names_in(place: str) -> list[str]:
    """Return the sorted names in a folder at a path or URL, or an empty list if it does not exist."""
    try:
        if not is_url(place):
            return sorted(os.listdir(place))
        with storage_errors():
            system, path = _system(place)
            return sorted(
                name.rstrip("/").rpartition("/")[2] for name in system.ls(path, detail=False)
            )
    except (FileNotFoundError, NotADirectoryError):
        return []


def state_at(place: str) -> FileState | None:
    """Return the state of a file at a path or URL, or None if it does not exist."""
    try:
        return state_of(as_path(place))
    except (FileNotFoundError, NotADirectoryError):
        return None


def states_at(places: Sequence[str]) -> list[FileState | None]:
    """Return `state_at` of many files. Requests to servers overlap, since each takes long."""
    if not any(is_url(place) for place in places):
        return [state_at(place) for place in places]
    with ThreadPoolExecutor(CONCURRENT_REQUESTS) as threads:
        return list(threads.map(state_at, places))


def sizes_at(places: Sequence[str]) -> list[int | None]:
    """Return the sizes of many files at paths or URLs, in bytes, None for each that does not exist."""
    return [None if state is None else state.size for state in states_at(places)]


def read_bytes(place: str) -> bytes | None:
    """Return the content of a small file at a path or URL, or None if it does not exist.

    Raise OSError if it cannot be read.
    """
    try:
        with storage_errors():
            return as_path(place).read_bytes()
    except FileNotFoundError:
        return None


def move_file(place: str, target: str) -> None:
    """Rename a file at a path or URL. At a URL it exists twice for a moment. Raise OSError if this fails."""
    if not is_url(place):
        Path(target).parent.mkdir(parents=True, exist_ok=True)
        replace_file(place, target)
        return
    with storage_errors():
        system, path = _system(place)
        system.mv(path, _system(target)[1])


def upload_file(path: Path, url: str) -> None:
    """Copy a file to a URL, where it appears once it is complete. Raise ProcessingError if this fails."""
    try:
        with storage_errors():
            system, system_path = _system(url)
            system.put_file(str(path), system_path)
    except OSError as error:
        raise write_error(url, error) from error


@contextmanager
def staging_folder(place: str) -> Iterator[Path]:
    """Yield a folder to write to: the folder itself, or a temporary folder whose files are then copied to the URL."""
    if not is_url(place):
        yield Path(place)
        return
    with TemporaryDirectory(prefix=SCRATCH_PREFIX) as scratch:
        yield Path(scratch)
        for path in sorted(Path(scratch).iterdir()):
            upload_file(path, joined(place, path.name))


def try_write(url: str) -> None:
    """Write an object and remove it. Raise OSError if this fails."""
    with storage_errors():
        system, system_path = _system(url)
        system.pipe_file(system_path, b"tiler")
        system.rm_file(system_path)
