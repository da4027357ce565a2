"""Where things lie: on a path, or at a URL that fsspec knows; clouds are read from both alike."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from glob import has_magic
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, cast
from urllib.parse import unquote, urlsplit

from tiler.errors import ConfigError, refused_write

BLOCK_BYTES = 1 << 22
"""Bytes of an object asked for at once: some chunks of points."""
ASKED_AT_ONCE = 16
"""Objects whose size is asked for at the same time."""
KEPT_BLOCKS = 8
"""Blocks of an object that are kept while it is read: those of its header, its table and its points."""


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


LONGEST_NAME = 255
"""Bytes of the name of a file, on most file systems."""


SCRATCH_PREFIX = ".tiler-"
"""How the names of files and folders begin that are tiler's own and nobody else's."""


def partial_path(target: Path, kind: str = "") -> Path:
    """Where a file is written until it is whole: a name of tiler's own beside it, that no file of the user has.

    Parameters
    ----------
    target : Path
        The file's final name.
    kind : str
        Tells several such files of one target apart.
    """
    name = f"{SCRATCH_PREFIX}{target.name}{kind and f'.{kind}'}.partial"
    if len(os.fsencode(name)) > LONGEST_NAME:
        short = hashlib.blake2b(os.fsencode(name), digest_size=16).hexdigest()
        name = f"{SCRATCH_PREFIX}{short}.partial"
    return target.with_name(name)


@contextmanager
def appearing(target: Path) -> Iterator[Path]:
    """Where to write a file that gets its name, and replaces what has it, only when the block ends well."""
    partial = partial_path(target)
    try:
        yield partial
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)


def is_scratch(name: str) -> bool:
    """Whether a name is one that `partial_path` makes, or that GDAL and SQLite make of it while they write."""
    return name.startswith(SCRATCH_PREFIX) and (
        name.endswith(".partial") or ".partial." in name or ".partial-" in name
    )


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


def open_cloud(path: Path, block_bytes: int = BLOCK_BYTES) -> BinaryIO:
    """Open for reading, anywhere in it, in pieces of ``block_bytes`` where it is a URL; raises OSError."""
    if not is_url(path):
        return open(path, "rb")
    from fsspec.caching import BlockCache
    from fsspec.spec import AbstractBufferedFile

    with storage_errors():
        opened = cast(Any, path).open("rb", block_size=block_bytes)
        if isinstance(opened, AbstractBufferedFile):
            # A decoder jumps between the points, their table at the end and the header: each block is asked for once.
            # Not by options of `open`: not all file systems take them.
            opened.cache = BlockCache(block_bytes, opened._fetch_range, opened.size, KEPT_BLOCKS)
        return cast(BinaryIO, _Guarded(opened))


def digest_of_file(path: Path) -> str:
    """Digest of all bytes of a path or URL; raises OSError."""
    digest = hashlib.blake2b(digest_size=16)
    with open_cloud(path) as stream:
        while part := stream.read(BLOCK_BYTES):
            digest.update(part)
    return digest.hexdigest()


def second_view(file: BinaryIO, path: Path) -> BinaryIO:
    """The same file once more, with a place of its own; of a URL with the blocks that were asked for already."""
    return cast(BinaryIO, _Guarded(file.shared)) if isinstance(file, _Guarded) else open(path, "rb")


class _Guarded(io.RawIOBase):
    """A file of fsspec whose every error is an OSError; several may share one, used by one thread.

    Parameters
    ----------
    shared : file object
        Left open: nothing but its blocks are to be freed, and others may read it.
    """

    def __init__(self, shared: Any) -> None:
        self.shared = shared
        self._place = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        if whence == io.SEEK_END:
            self._place = int(self.shared.seek(offset, whence))
        else:
            self._place = offset + (self._place if whence == io.SEEK_CUR else 0)
        return self._place

    def tell(self) -> int:
        return self._place

    def readinto(self, target: Any) -> int:
        with storage_errors():
            self.shared.seek(self._place)
            try:
                data = self.shared.read(len(target))
            except ValueError as error:
                if "http" not in self.shared.fs.protocol:
                    raise
                raise OSError("its server gives no parts of files, no range requests; download it") from error
        target[: len(data)] = data
        self._place += len(data)
        return len(data)


def list_clouds(url: str, suffixes: tuple[str, ...]) -> list[Path]:
    """The clouds at a URL: an object, all below a folder, or those that a glob matches.

    Raises
    ------
    ConfigError
        There is nothing, or it cannot be listed.
    """
    cloud_path(url)  # says which library lacks
    path = url.partition("?")[0] if url.startswith("http") else url
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
