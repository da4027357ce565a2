"""Storage of a store: bytes by key, on a local path or at any fsspec URL, through zarr's stores.

Every `put` is atomic (a rename on local disks, one PUT on object stores): a reader gets the old
object, the new object, or no object.
"""

from __future__ import annotations

import asyncio
import errno
import json
import os
import uuid
import zlib
from collections.abc import AsyncIterator, Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zarr.abc.store import OffsetByteRequest, Store
from zarr.core.buffer import default_buffer_prototype
from zarr.core.sync import sync
from zarr.storage import FsspecStore, LocalStore

from tiler.errors import (
    ConfigError,
    DiskFullError,
    ProcessingError,
    StoreAccessError,
    StoreError,
    write_error,
)
from tiler.io.atomic_files import replace_file
from tiler.io.locations import (
    plain_scheme,
    storage_errors,
    validate_escaped,
    without_local_scheme,
)
from tiler.redaction import stored
from tiler.store import layout

_REQUESTS_AT_ONCE = 64
_FROM_START = OffsetByteRequest(0)
"""Range of a whole object. Without a range, s3fs asks for the size first, and lists the key if
there is no object."""
_NO_HARD_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)
"""Errors of file systems without hard links, as on memory sticks and some network shares."""


@dataclass(frozen=True)
class StoreSize:
    """Number of objects in a store and their total size in bytes."""

    objects: int
    size_bytes: int


def local_path(url: str) -> Path | None:
    """Return the folder at a URL, or None if the URL is not on a local file system."""
    path = without_local_scheme(url)
    return None if "://" in path or "::" in path else Path(path)


class Storage:
    """Objects of one store by key. Calls block, and may come from several processes.

    Parameters
    ----------
    url : str
        A local path, or any URL that fsspec opens (``s3://bucket/name``, ``memory://name``).

    Raises
    ------
    ConfigError
        The scheme of the URL is unknown, or the package that reads it is not installed.
    """

    def __init__(self, url: str) -> None:
        url = plain_scheme(url)
        self.url = url
        self.root = local_path(url)
        self.zarr_store: Store
        if self.root is not None:
            self.zarr_store = LocalStore(self.root)
        else:
            validate_escaped(url)
            try:
                self.zarr_store = FsspecStore.from_url(url)
            except (ImportError, ValueError) as error:
                raise ConfigError(
                    f"{url}: cannot be opened ({error}); give a local path, or install 'tiler-dtm[cloud]'"
                ) from error

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Storage) and other.url == self.url

    def __hash__(self) -> int:
        return hash(self.url)

    def _path(self, key: str) -> str:
        r"""Return the path of an object in a folder. A path that begins with ``\\?\`` may not contain slashes."""
        return f"{self.root}{os.sep}{key.replace('/', os.sep)}"

    def get(self, key: str) -> bytes | None:
        """Return the object's bytes, or None if there is no such object."""
        return self.get_many([key])[0]

    def get_many(self, keys: Sequence[str]) -> list[bytes | None]:
        """Return the bytes of each object in the order of the keys, None for missing ones. Remote requests overlap."""
        if self.root is not None:
            return [_file_bytes(self._path(key)) for key in keys]
        prototype = default_buffer_prototype()
        gate = asyncio.Semaphore(_REQUESTS_AT_ONCE)

        async def one(key: str) -> bytes | None:
            async with gate:
                buffer = await self.zarr_store.get(key, prototype, _FROM_START)
            return None if buffer is None else buffer.to_bytes()

        async def every() -> list[bytes | None]:
            return await asyncio.gather(*map(one, keys))

        try:
            with storage_errors():
                return sync(every())
        except OSError as error:
            raise StoreAccessError(
                f"{self.url}: cannot be read ({error}); check its server and your credentials, then run again"
            ) from error

    def put(self, key: str, data: bytes) -> None:
        """Write an object in place of an older one with the same key."""
        try:
            if self.root is not None:
                _write_file(self._path(key), data)
            else:
                sync(
                    self.zarr_store.set(key, default_buffer_prototype().buffer.from_bytes(data))
                )
        except OSError as error:
            raise store_write_error(self.url, key, error) from error

    def put_json_new(self, key: str, body: Any) -> bool:
        """Write a value as `put_json` does, unless an object exists. A later `get_json` shows whose object it is.

        Returns
        -------
        bool
            Whether only one of two writers can succeed on this storage, as on local file systems with hard links. If
            not, the object of the last writer stays.
        """
        data = _sealed(key, body)
        try:
            sync(
                self.zarr_store.set_if_not_exists(
                    key, default_buffer_prototype().buffer.from_bytes(data)
                )
            )
        except OSError as error:
            if error.errno not in _NO_HARD_LINKS:
                raise store_write_error(self.url, key, error) from error
            self.put(key, data)
            return False
        return self.root is not None

    def delete(self, key: str) -> None:
        """Remove an object if it exists."""
        try:
            if self.exists():
                sync(self.zarr_store.delete(key))
        except OSError as error:
            raise store_write_error(self.url, key, error) from error

    def delete_folder(self, prefix: str, keep: Collection[str] = ()) -> None:
        """Remove every object of the layout in ``prefix`` except the keys of ``keep``, then the empty folders.

        Files that do not belong to the layout stay, and so does a folder that is a link.
        """
        if self.root is not None:
            try:
                self._delete_files(
                    self.root / prefix, lambda key: layout.is_ours(key) and key not in keep
                )
            except OSError as error:
                raise store_write_error(self.url, prefix, error) from error
            return
        from fsspec.core import url_to_fs

        filesystem, root = url_to_fs(self.url)
        filesystem.invalidate_cache()
        gone = []
        for name in filesystem.find(f"{root}/{prefix}".rstrip("/")):
            key = name.removeprefix(root).lstrip("/")
            if layout.is_ours(key) and key not in keep:
                gone.append(name)
        if gone:
            filesystem.rm(gone)

    def _delete_files(self, folder: Path, unwanted: Callable[[str], bool]) -> None:
        """Remove files in a folder of a local store by their keys, then the empty folders."""
        assert self.root is not None  # Callers check this.
        for subfolder, _, names in os.walk(folder, topdown=False):
            for name in names:
                path = Path(subfolder, name)
                if unwanted(path.relative_to(self.root).as_posix()):
                    path.unlink(missing_ok=True)
            with suppress(OSError):
                os.rmdir(subfolder)

    def remove_scratch(self) -> None:
        """Remove the temporary files that killed writes left on a local disk. Object stores have no such files."""
        if self.root is not None:
            self._delete_files(self.root, layout.is_scratch)

    def names(self, prefix: str) -> list[str]:
        """Return the sorted names of the objects and folders directly in ``prefix``."""
        if not self.exists():
            return []
        return sorted(
            name.rstrip("/") for name in sync(_collected(self.zarr_store.list_dir(prefix)))
        )

    def keys(self, folder: str) -> list[str]:
        """Return the keys of all objects in an existing folder, in any order."""
        return sync(_collected(self.zarr_store.list_prefix(f"{folder}/")))

    def exists(self) -> bool:
        """Return whether the folder of a local store exists, or True for object stores, which have no folders.

        Callers call this before they list, because the first request to zarr's local store
        would create the folder.
        """
        return self.root is None or self.root.is_dir()

    def usage(self) -> StoreSize:
        """Count the objects and their bytes. This lists the whole store."""
        from fsspec.core import url_to_fs

        if not self.exists():
            return StoreSize(0, 0)
        location = self.url if self.root is None else str(self.root.absolute())
        filesystem, path = url_to_fs(location)
        sizes = [entry["size"] for entry in filesystem.find(path, detail=True).values()]
        return StoreSize(len(sizes), sum(sizes))

    def put_json(self, key: str, body: Any) -> None:
        """Write a JSON-able value with a checksum, and without passwords and tokens in its URLs."""
        self.put(key, _sealed(key, body))

    def get_json(self, key: str) -> Any:
        """Return the value that `put_json` wrote, or None if there is none. Raise StoreError if it is damaged."""
        data = self.get(key)
        if data is None:
            return None
        return parse_json(key, data, f"{self.url}: {key}")


def parse_json(key: str, data: bytes, where: str) -> Any:
    """Return the value that `Storage.put_json` wrote under a key. Raise StoreError if it is damaged."""
    try:
        envelope = json.loads(data)
        body, crc = envelope["body"], envelope["crc32"]
    except (ValueError, KeyError, TypeError) as error:
        raise StoreError(
            f"{where}: damaged, not valid JSON; delete it and run again"
        ) from error
    if zlib.crc32(_canonical(body).encode(), place_checksum(key)) != crc:
        raise StoreError(
            f"{where}: damaged, its checksum does not fit; delete it and run again"
        )
    return body


SEAL = "tiler_crc32"
"""Name of the attribute with a checksum of the rest of the metadata. Zarr itself does not write
a checksum."""


def place_checksum(key: str) -> int:
    """Return the checksum of a key, which those of its object contain: a valid object under another key is damage.

    Objects without a folder, such as the lease, have one place, and other versions read them.
    """
    return zlib.crc32(key.encode()) if "/" in key else 0


def sealed(key: str, metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Return the metadata of an array or group at a key with a checksum among its attributes."""
    attributes = {**metadata.get("attributes", {})}
    attributes.pop(SEAL, None)
    text = _canonical({**metadata, "attributes": attributes})
    checksum = zlib.crc32(text.encode(), place_checksum(key))
    return {**metadata, "attributes": {**attributes, SEAL: checksum}}


def seal_holds(key: str, metadata: Mapping[str, Any]) -> bool:
    """Return whether the checksum of `sealed` fits."""
    return sealed(key, metadata) == metadata


def store_write_error(url: str, key: str, error: OSError) -> ProcessingError:
    """Return the one-line error for a write or a removal that the file system refused."""
    refused = write_error(f"{url}: {key}", error, local_path(url))
    if isinstance(refused, DiskFullError):
        return refused
    return StoreAccessError(str(refused))


def _sealed(key: str, body: Any) -> bytes:
    text = _canonical(body)
    if ":/" in text:  # A text without this contains no URL.
        text = _canonical(stored(body))
    checksum = zlib.crc32(text.encode(), place_checksum(key))
    return f'{{"crc32": {checksum}, "body": {text}}}'.encode()


def _canonical(body: Any) -> str:
    return json.dumps(body, sort_keys=True, separators=(",", ":"))


def _file_bytes(path: str) -> bytes | None:
    try:
        with open(path, "rb", buffering=0) as file:
            return file.read()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (IsADirectoryError, PermissionError):  # The second is what Windows says of a folder.
        if os.path.isdir(path):
            return None
        raise


def _write_file(path: str, data: bytes) -> None:
    """Write a file that gets its name once it is complete. A killed write leaves a `layout.is_scratch` file."""
    partial = f"{path}.{uuid.uuid4().hex}.partial"
    try:
        try:
            _fill(partial, data)
        except FileNotFoundError:  # The folder does not exist yet.
            os.makedirs(os.path.dirname(path), exist_ok=True)
            _fill(partial, data)
        replace_file(partial, path)
    except OSError:
        with suppress(OSError):
            os.unlink(partial)
        raise


def _fill(path: str, data: bytes) -> None:
    with open(path, "wb") as file:
        file.write(data)


async def _collected(items: AsyncIterator[str]) -> list[str]:
    return [item async for item in items]
