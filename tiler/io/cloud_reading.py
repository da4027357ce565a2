"""Random reading of files at a path or URL. Every error of a library becomes an OSError."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO, cast

from tiler.core.records import new_digest
from tiler.io.locations import is_url, storage_errors

BLOCK_BYTES = 1 << 22
"""Bytes per request to a URL, which contain several chunks of points."""
KEPT_BLOCKS = 8
"""Number of blocks of an object that are kept while it is read: blocks of its header, table and
points."""
_WITHOUT_RANGES = "its server does not support range requests"

_fetched = [0]


def fetched_bytes() -> int:
    """Return the number of bytes that this process has read from URLs so far."""
    return _fetched[0]


def open_location(
    path: Path, block_bytes: int = BLOCK_BYTES, parts: Sequence[tuple[int, int]] = ()
) -> BinaryIO:
    """Open a file for random reading. Raise OSError if it cannot be opened.

    A URL is read in blocks of ``block_bytes``. Its ``parts`` (first and end byte of each) are
    read immediately, each with one request.
    """
    if not is_url(path):
        return open(path, "rb")
    from fsspec.caching import BlockCache
    from fsspec.spec import AbstractBufferedFile

    with storage_errors():
        opened = cast(Any, path).open("rb", block_size=block_bytes)
        if getattr(opened, "size", 0) is None:
            raise OSError(_without_size(opened))
        if isinstance(opened, AbstractBufferedFile):
            # A decoder jumps between header, points and the table at the end. The cache
            # requests each block once. It is not set by options of `open`, since some file
            # systems do not accept them.
            fetch = _complete(opened._fetch_range, opened.size)
            opened.cache = BlockCache(block_bytes, fetch, opened.size, KEPT_BLOCKS)
        return cast(BinaryIO, _Guarded(opened, _read_parts(opened, cast(Any, path), parts)))


def _without_size(opened: Any) -> str:
    """Return why fsspec opened a file only as a stream."""
    info = opened.fs.info(opened.path)
    if info["size"] == 0:
        return "it is empty"
    return "its server does not report its size" if info["size"] is None else _WITHOUT_RANGES


def _complete(fetch: Callable[[int, int], bytes], size: int) -> Callable[[int, int], bytes]:
    """Return a function that fetches bytes of a file of ``size`` bytes, and checks that the server sent all of them."""

    def fetch_all(start: int, end: int) -> bytes:
        data = fetch(start, end)
        _check_answer(data, min(end, size) - start)
        return data

    return fetch_all


def _check_answer(data: bytes, wanted: int) -> None:
    """Count the bytes that a server sent. Raise OSError if they are not as many as requested."""
    _fetched[0] += len(data)
    if len(data) > wanted:
        raise OSError(_WITHOUT_RANGES)
    if len(data) < wanted:
        raise OSError(f"its server sent {len(data):,} of the {wanted:,} bytes requested")


def _read_parts(
    opened: Any, path: Any, parts: Sequence[tuple[int, int]]
) -> list[tuple[int, bytes]]:
    """Return first byte and content of each part. The requests overlap."""
    if not parts:
        return []
    starts, ends = zip(*parts, strict=True)
    contents = opened.fs.cat_ranges(
        [path.path] * len(parts), list(starts), list(ends), on_error="raise"
    )
    for data, (start, end) in zip(contents, parts, strict=True):
        _check_answer(data, end - start)
    return list(zip(starts, contents, strict=True))


def digest_of_file(path: Path) -> str:
    """Return the digest of all bytes of a path or URL. Raise OSError if it cannot be read."""
    digest = new_digest()
    with open_location(path) as stream:
        while part := stream.read(BLOCK_BYTES):
            digest.update(part)
    return digest.hexdigest()


def reopen(file: BinaryIO, path: Path) -> BinaryIO:
    """Open the same file again, with a separate position. At a URL both file objects share their blocks."""
    if isinstance(file, _Guarded):
        return cast(BinaryIO, _Guarded(file.shared, file.parts))
    return open(path, "rb")


class _Guarded(io.RawIOBase):
    """File of fsspec that raises only OSErrors. Several objects in one thread may share the file.

    Parameters
    ----------
    shared : file object
        File of fsspec. It is never closed, since other objects may read it and only its blocks use memory.
    parts : sequence of (int, bytes)
        First byte and content of parts that were read before.
    """

    def __init__(self, shared: Any, parts: Sequence[tuple[int, bytes]] = ()) -> None:
        self.shared, self.parts = shared, parts
        self._place = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        if whence == io.SEEK_END:
            self._place = int(self.shared.seek(offset, whence))
        elif whence == io.SEEK_CUR:
            self._place += offset
        else:
            self._place = offset
        return self._place

    def readinto(self, target: Any) -> int:
        for start, content in self.parts:
            if start <= self._place < start + len(content):
                known = content[self._place - start :][: len(target)]
                target[: len(known)] = known
                self._place += len(known)
                return len(known)
        with storage_errors():
            self.shared.seek(self._place)
            try:
                data = self.shared.read(len(target))
            except ValueError as error:
                if "http" not in self.shared.fs.protocol:
                    raise
                raise OSError(_WITHOUT_RANGES) from error
        target[: len(data)] = data
        self._place += len(data)
        return len(data)
