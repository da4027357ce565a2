"""Arrays as the layout wants them: made, checked before zarr sees them, read without silent zeros."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import zarr
from zarr.abc.store import ByteRequest
from zarr.codecs import BloscCodec, BytesCodec, Crc32cCodec
from zarr.core.array_spec import ArrayConfigParams
from zarr.core.buffer import Buffer, BufferPrototype
from zarr.core.metadata import ArrayV3Metadata
from zarr.errors import ContainsArrayError
from zarr.storage import StorePath, WrapperStore

from tiler.errors import StoreError
from tiler.store.layout import ALLOWED_CODECS, ArrayKind
from tiler.store.storage import Storage, failed_write

ZarrArray: TypeAlias = "zarr.Array[Any]"  # a string: older zarr 3.1 has no generic array


class _Complete(WrapperStore[Any]):
    """A store in which a missing chunk is an error: zarr would read it as the fill value."""

    async def get(
        self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        value = await super().get(key, prototype, byte_range)
        if value is None and not key.endswith("zarr.json"):
            raise StoreError(f"{self._store}: {key} is missing; run again with --overwrite")
        return value


def create_array(
    storage: Storage,
    path: str,
    shape: tuple[int, ...],
    kind: ArrayKind,
    attributes: dict[str, Any] | None = None,
) -> ZarrArray:
    """A new array, or the one that another task made at the same time with the same arguments."""
    blosc = BloscCodec(typesize=kind.shuffled, cname="zstd", clevel=kind.level, shuffle="shuffle")
    try:
        zarr.create_array(
            storage.zarr_store, name=path, shape=shape, chunks=kind.chunks, dtype=kind.dtype, fill_value=kind.fill,
            serializer=BytesCodec(), filters=None, compressors=[blosc, Crc32cCodec()], attributes=attributes,
            zarr_format=3,
        )  # fmt: skip
    except ContainsArrayError:
        pass
    except OSError as error:
        raise failed_write(storage.url, path, error) from error
    array = find_array(storage, path, kind)
    if array is None:
        raise StoreError(f"{storage.url}: {path} vanished while it was made; is another run at work here?")
    return array


def find_array(storage: Storage, path: str, kind: ArrayKind) -> ZarrArray | None:
    """The array at ``path``; None where there is none.

    Its metadata are checked before zarr builds anything from them.

    Raises
    ------
    StoreError
        The array is not one that tiler writes.
    """
    data = storage.get(f"{path}/zarr.json")
    if data is None:
        return None
    metadata = _checked(data, f"{storage.url}: {path}", kind)
    store = storage.zarr_store if kind.sparse else _Complete(storage.zarr_store)
    parsed = ArrayV3Metadata.from_dict(metadata)
    config: ArrayConfigParams = {"write_empty_chunks": not kind.sparse}
    return zarr.Array(zarr.AsyncArray(parsed, StorePath(store, path), config))


def open_array(storage: Storage, path: str, kind: ArrayKind) -> ZarrArray:
    """The array at ``path``; raises StoreError where there is none, or a foreign one."""
    array = find_array(storage, path, kind)
    if array is None:
        raise StoreError(f"{storage.url}: there is no {path}; run the stage that writes it first")
    return array


def _checked(data: bytes, where: str, kind: ArrayKind) -> dict[str, Any]:
    """The metadata of an array if tiler could have written them."""
    try:
        metadata: dict[str, Any] = json.loads(data)
        found = {
            "zarr_format": metadata["zarr_format"],
            "node_type": metadata["node_type"],
            "data_type": metadata["data_type"],
            "chunks": tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"]),
        }
        codecs = {codec["name"] for codec in metadata["codecs"]}
        transformers = metadata.get("storage_transformers")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StoreError(f"{where}: its metadata are damaged; run again with --overwrite") from error
    wanted = {"zarr_format": 3, "node_type": "array", "data_type": kind.dtype, "chunks": kind.chunks}
    if found != wanted or transformers:
        raise StoreError(f"{where}: not an array that this version writes; run again with --overwrite")
    if not codecs <= ALLOWED_CODECS:
        strange = ", ".join(sorted(map(str, codecs - ALLOWED_CODECS)))
        raise StoreError(f"{where}: codec {strange} is not allowed in a store; run again with --overwrite")
    return metadata


def read(storage: Storage, array: ZarrArray, selection: Any) -> npt.NDArray[Any]:
    """Values of an array; raises StoreError where a chunk is damaged or missing."""
    with _damage(storage, array):
        return np.asarray(array[selection])


def write(storage: Storage, array: ZarrArray, selection: Any, values: npt.NDArray[Any]) -> None:
    """Write whole chunks of an array; raises ProcessingError where the file system refuses."""
    try:
        with _damage(storage, array):
            array[selection] = values
    except OSError as error:
        raise failed_write(storage.url, array.path, error) from error


@contextmanager
def _damage(storage: Storage, array: ZarrArray) -> Iterator[None]:
    # A wrong checksum is a ValueError of the crc32c codec, a chunk of another size one of the bytes codec,
    # a broken frame a RuntimeError of blosc.
    try:
        yield
    except (ValueError, RuntimeError) as error:
        reason = str(error).split(". ")[0]
        raise StoreError(
            f"{storage.url}: {array.path} is damaged ({reason}); run again with --overwrite"
        ) from error
