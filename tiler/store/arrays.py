"""Arrays as the layout wants them: made, checked before zarr sees them, read without silent zeros."""

from __future__ import annotations

import itertools
import json
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import zarr
from zarr.abc.store import ByteRequest
from zarr.codecs import BloscCodec, BytesCodec, Crc32cCodec
from zarr.core.array_spec import ArrayConfigParams
from zarr.core.buffer import Buffer, BufferPrototype
from zarr.core.metadata import ArrayV3Metadata
from zarr.storage import MemoryStore, StorePath, WrapperStore

from tiler.errors import DamagedError, StoreError
from tiler.store.layout import ALLOWED_CODECS, ArrayKind
from tiler.store.storage import Storage, failed_write, seal_holds, sealed

ZarrArray: TypeAlias = "zarr.Array[Any]"  # a string: older zarr 3.1 has no generic array


class _Checked(WrapperStore[Any]):
    """A store whose chunks are looked at before they are decoded.

    A missing one is an error unless the array is sparse: zarr would read it as the fill value. One that says it
    unpacks to something else than a chunk is an error, too: blosc would allocate what it says.
    """

    def __init__(self, store: Any, kind: ArrayKind) -> None:
        super().__init__(store)
        self._kind = kind

    async def get(
        self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        value = await super().get(key, prototype, byte_range)
        if key.endswith("zarr.json"):
            return value
        if value is None:
            if self._kind.sparse:
                return None
            raise DamagedError(f"{self._store}: {key} is missing; run again, and it is made anew", (key,))
        head = value[_UNPACKED].to_bytes()
        if int.from_bytes(head, "little") != self._kind.chunk_bytes:
            path = key.split("/c/")[0]
            raise DamagedError(
                f"{self._store}: {path} is damaged (a chunk of another size); run again, and it is made anew",
                (key,),
            )
        return value


_UNPACKED = slice(4, 8)
"""Where a blosc frame says how many bytes it unpacks to (C-Blosc, README_CHUNK_FORMAT)."""


def create_array(
    storage: Storage,
    path: str,
    shape: tuple[int, ...],
    kind: ArrayKind,
    attributes: dict[str, Any] | None = None,
) -> ZarrArray:
    """A new array, or the one that another task made at the same time with the same arguments."""
    create_metadata(storage, path, shape, kind, attributes)
    array = find_array(storage, path, kind)
    if array is None:
        raise StoreError(f"{storage.url}: {path} vanished while it was made; is another run at work here?")
    return array


def create_metadata(
    storage: Storage,
    path: str,
    shape: tuple[int, ...],
    kind: ArrayKind,
    attributes: dict[str, Any] | None = None,
) -> None:
    """Say that there is an array, unless somebody has said so."""
    if storage.get(_metadata_key(path)) is None:
        replace_metadata(storage, path, shape, kind, attributes or {})


def replace_metadata(
    storage: Storage, path: str, shape: tuple[int, ...], kind: ArrayKind, attributes: dict[str, Any]
) -> None:
    """Say what an array is from now on: its chunks stay as they are."""
    metadata = _metadata(shape, kind, attributes)
    storage.put(_metadata_key(path), json.dumps(sealed(metadata)).encode())


def _metadata(shape: tuple[int, ...], kind: ArrayKind, attributes: dict[str, Any]) -> dict[str, Any]:
    """What zarr writes about an array, made in memory: with its checksum it reaches the store in one piece."""
    blosc = BloscCodec(typesize=kind.shuffled, cname=kind.codec, clevel=kind.level, shuffle="shuffle")
    written: dict[str, Buffer] = {}
    zarr.create_array(
        MemoryStore(written), shape=shape, chunks=kind.chunks, dtype=kind.dtype, fill_value=kind.fill,
        serializer=BytesCodec(), filters=None, compressors=[blosc, Crc32cCodec()], attributes=attributes,
        zarr_format=3,
    )  # fmt: skip
    metadata: dict[str, Any] = json.loads(written["zarr.json"].to_bytes())
    return metadata


def _metadata_key(path: str) -> str:
    return f"{path}/zarr.json"


def find_metadata(storage: Storage, path: str, kind: ArrayKind) -> dict[str, Any] | None:
    """What is said of the array at ``path``; None where there is none.

    Raises
    ------
    StoreError
        The array is not one that tiler writes.
    """
    data = storage.get(_metadata_key(path))
    return None if data is None else _checked(data, f"{storage.url}: {path}", path, kind)


def find_array(storage: Storage, path: str, kind: ArrayKind) -> ZarrArray | None:
    """The array at ``path``; None where there is none.

    Its metadata are checked before zarr builds anything from them.

    Raises
    ------
    StoreError
        The array is not one that tiler writes.
    """
    metadata = find_metadata(storage, path, kind)
    if metadata is None:
        return None
    store = _Checked(storage.zarr_store, kind)
    parsed = ArrayV3Metadata.from_dict(metadata)
    config: ArrayConfigParams = {"write_empty_chunks": not kind.sparse}
    return zarr.Array(zarr.AsyncArray(parsed, StorePath(store, path), config))


def open_array(storage: Storage, path: str, kind: ArrayKind) -> ZarrArray:
    """The array at ``path``; raises StoreError where there is none, or a foreign one."""
    array = find_array(storage, path, kind)
    if array is None:
        raise no_array(storage, path)
    return array


def no_array(storage: Storage, path: str) -> DamagedError:
    """The error of an array that should be there."""
    return DamagedError(f"{storage.url}: there is no {path}; run the stage that writes it first", (path,))


def _checked(data: bytes, where: str, path: str, kind: ArrayKind) -> dict[str, Any]:
    """The metadata of an array if tiler could have written them."""
    try:
        metadata: dict[str, Any] = json.loads(data)
        if not seal_holds(metadata):
            raise ValueError("its checksum does not fit")
        found = {
            "zarr_format": metadata["zarr_format"],
            "node_type": metadata["node_type"],
            "data_type": metadata["data_type"],
            "chunks": tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"]),
        }
        codecs = {codec["name"] for codec in metadata["codecs"]}
        transformers = metadata.get("storage_transformers")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise DamagedError(
            f"{where}: its metadata are damaged; run again, and it is made anew", (path,)
        ) from error
    wanted = {"zarr_format": 3, "node_type": "array", "data_type": kind.dtype, "chunks": kind.chunks}
    if found != wanted or transformers:
        raise StoreError(f"{where}: not an array that this version writes; run again with --overwrite")
    if not codecs <= ALLOWED_CODECS:
        strange = ", ".join(sorted(map(str, codecs - ALLOWED_CODECS)))
        raise StoreError(f"{where}: codec {strange} is not allowed in a store; run again with --overwrite")
    return metadata


def read(storage: Storage, array: ZarrArray, selection: Any) -> npt.NDArray[Any]:
    """Values of an array; raises DamagedError, which names the chunks, where some are damaged or missing."""
    try:
        return np.asarray(array[selection])
    except (ValueError, RuntimeError, DamagedError) as error:
        raise _damage(storage, array, selection, error) from error


def write(storage: Storage, array: ZarrArray, selection: Any, values: npt.NDArray[Any]) -> None:
    """Write whole chunks of an array; raises ProcessingError where the file system refuses."""
    try:
        array[selection] = values
    except OSError as error:
        raise failed_write(storage.url, array.path, error) from error


def _damage(storage: Storage, array: ZarrArray, selection: Any, error: Exception) -> DamagedError:
    """The error that names the damaged chunks of a selection of slices.

    A wrong checksum is a ValueError of the crc32c codec, a chunk of another size one of the bytes codec, a broken
    frame a RuntimeError of blosc.
    """
    parts = selection if isinstance(selection, tuple) else (selection,)
    parts = (*parts, *[slice(None)] * (array.ndim - len(parts)))
    ranges = []
    for part, length, chunk in zip(parts, array.shape, array.chunks, strict=True):
        start, stop, _ = part.indices(length)
        ranges.append(range(start // chunk, -(-stop // chunk)))
    bad = []
    for block in itertools.product(*ranges):
        try:
            array.blocks[block]
        except (ValueError, RuntimeError, DamagedError):
            bad.append(f"{array.path}/c/{'/'.join(map(str, block))}")
    reason = (
        str(error).split(". ")[0]
        if not isinstance(error, DamagedError)
        else "a chunk is missing or of another size"
    )
    return DamagedError(
        f"{storage.url}: {array.path} is damaged ({reason}); run again, and it is made anew",
        tuple(bad) or (array.path,),
    )
