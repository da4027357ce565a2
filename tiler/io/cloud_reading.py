"""Opens files on a path or at a URL for reading anywhere in them; whatever a library raises is an OSError."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any, BinaryIO, cast

from tiler.io.locations import is_url, storage_errors

BLOCK_BYTES = 1 << 22
"""Bytes of an object asked for at once: some chunks of points."""
KEPT_BLOCKS = 8
"""Blocks of an object that are kept while it is read: those of its header, its table and its points."""


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
