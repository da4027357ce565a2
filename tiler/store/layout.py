"""Layout of a store. Only this file defines paths, dtypes, chunks, codecs and the schema version.

::

    zarr.json                    root group with the schema version and the `StoreMeta` as attributes
    points/<column>              columns (rows, width, ROW_POINTS); each bucket owns whole rows
    index/<digest>.npy           rows and number of points of each bucket
    index/current.json           digest of the current index
    labels/<name>                labels of a pass, uint8, rows as in points
    elected/<name>               points that a pass made, int32 (rows, 3, ROW_POINTS), in the rows of their buckets
    rasters/zarr.json            group of the rasters, for other programs
    rasters/<name>+<set>         raster, float32 (height, width)
    spool/<piece>                points of one source piece, sorted by bucket
    records/<piece>-<bytes>      decoded records of one source piece
    commits/<stage>/<key>.json   commit of one finished task
    packs/<stage>.json           commits of finished tasks, packed into one object
    state/<name>.json            state of the run
    lock.json                    lease of the run that holds the store
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.raster import BLOCK_PIXELS
from tiler.errors import ConfigError, StoreError

SCHEMA_VERSION = 6
ROOT_ATTRIBUTE = "tiler_store"

CHUNK_SEPARATOR = "."
"""Separator of the numbers of a chunk in its key.

With a slash, each chunk would have two folders on a local disk, and making and removing these
takes longer than writing the chunk."""

RASTERS = "rasters"
"""Path of the group of the rasters."""

SET_SEPARATOR = "+"
"""Separator of the name of a raster and that of its set."""

ROW_POINTS = 131072
"""Points in a row of the columns, which is one chunk and one object.

Measurements are in docs/decisions.md, "Store layout"."""

ELECTED_PIECES = 4
"""Number of chunks in a row of elected points. A pass elects a few points in a bucket, and only they are read."""

SPOOL_CHUNK = 65536

ROOT_KEY = "zarr.json"
"""Object with the description of the store."""
LOCK_KEY = "lock.json"
INDEX_POINTER = "index/current.json"
ALLOWED_CODECS = frozenset({"bytes", "blosc", "crc32c"})


@dataclass(frozen=True)
class ArrayKind:
    """Storage parameters of one kind of array.

    Attributes
    ----------
    dtype : str
        Name of the numpy dtype, which is little-endian on disk.
    chunks : tuple of int
        Shape of a chunk.
    fill : float
        Value of every element that was never written.
    sparse : bool
        Whether chunks that hold only `fill` are not stored. If False, every chunk is stored, so that a missing
        chunk is an error and is not read as zeros.
    item : int
        Bytes that the shuffle treats as one item. 0 means the size of the dtype.
    codec : str
        Compressor within blosc. Points, labels and spool are read so often that speed matters more than size.
    level : int
        Compression level.
    pieces : int
        Number of chunks next to each other in a row.
    """

    dtype: str
    chunks: tuple[int, ...]
    fill: float = 0
    sparse: bool = False
    item: int = 0
    codec: Literal["lz4", "zstd"] = "lz4"
    level: int = 5
    pieces: int = 1

    def shape(self, rows: int) -> tuple[int, ...]:
        """Return the shape of an array with this number of rows."""
        return (rows, *self.chunks[1:-1], self.pieces * self.chunks[-1])

    @property
    def chunk_bytes(self) -> int:
        """Size of a chunk before compression, in bytes."""
        return math.prod(self.chunks) * np.dtype(self.dtype).itemsize

    @property
    def shuffled(self) -> int:
        """Size of one item for the shuffle, in bytes."""
        return self.item or np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class Column:
    """Stored column: fields of `PointBlock` next to each other.

    Attributes
    ----------
    name : str
    fields : mapping of str to slice
        Position of each field among the `width` values of a point.
    width : int
        Number of values per point.
    kind : ArrayKind
    """

    name: str
    fields: Mapping[str, slice]
    width: int
    kind: ArrayKind


def _column(name: str, dtype: str, **widths: int) -> Column:
    fields = {}
    end = 0
    for field, width in widths.items():
        fields[field] = slice(end, end + width)
        end += width
    return Column(name, fields, end, ArrayKind(dtype, (1, end, ROW_POINTS)))


# Class, flags and returns share a column, since they are read together and each column needs
# its own objects.
COLUMNS = (
    _column("xyz", "int32", xyz=3),
    _column("attributes", "uint8", classification=1, flags=1, returns=2),
    _column("rgb", "uint16", rgb=3),
    _column("origin", "int64", origin=1),
)
LABELS = ArrayKind("uint8", (1, 1, ROW_POINTS))
NOWHERE = -(2**31)
"""x of the unused positions in a bucket's rows of elected points. Elected points fill the first
positions."""
ELECTED = ArrayKind(
    "int32", (1, 3, ROW_POINTS // ELECTED_PIECES), fill=NOWHERE, pieces=ELECTED_PIECES
)


def columns(has_rgb: bool) -> tuple[Column, ...]:
    """Return the columns of a store."""
    return tuple(c for c in COLUMNS if has_rgb or c.name != "rgb")


def raster_kind(fill: float) -> ArrayKind:
    """Return the kind of a raster. A chunk is one block, and a block that holds only ``fill`` is not stored."""
    return ArrayKind(
        "float32", (BLOCK_PIXELS, BLOCK_PIXELS), fill, sparse=True, codec="zstd", level=3
    )


def record_type(has_rgb: bool) -> np.dtype[np.void]:
    """Return the dtype of one point of the spool."""
    names: list[tuple[str, Any] | tuple[str, Any, int]] = [
        ("xyz", "<i4", 3),
        ("classification", "u1"),
        ("flags", "u1"),
        ("returns", "u1", 2),
        ("origin", "<i8"),
    ]
    if has_rgb:
        names.append(("rgb", "<u2", 3))
    return np.dtype(names)


def spool_kind(has_rgb: bool) -> ArrayKind:
    """Return the kind of a piece of the spool: bytes of whole records, each an item of the shuffle."""
    return records_kind(record_type(has_rgb).itemsize)


def records_kind(record_bytes: int) -> ArrayKind:
    """Return the kind of a piece's decoded records: bytes of whole records, each an item of the shuffle."""
    return ArrayKind("uint8", (SPOOL_CHUNK, record_bytes), item=record_bytes)


def points_path(column: str) -> str:
    """Return the path of a column."""
    return f"points/{column}"


def labels_path(name: str) -> str:
    """Return the path of the labels of a pass."""
    return f"labels/{safe(name)}"


def elected_path(name: str) -> str:
    """Return the path of the points that a pass elected."""
    return f"elected/{safe(name)}"


def raster_path(name: str, raster_set: str = "") -> str:
    """Return the path of a raster in a set, see `tiler.store.rasters.RasterStore`."""
    return f"{RASTERS}/{safe(f'{name}{SET_SEPARATOR}{raster_set}' if raster_set else name)}"


def spool_path(piece: str) -> str:
    """Return the path of a piece of the spool."""
    return f"spool/{safe(piece)}"


def records_path(piece: str, record_bytes: int) -> str:
    """Return the path of the records of a piece.

    The path contains the record length, since an earlier file of the same name may have had
    records of another length.
    """
    return f"records/{safe(piece)}-{record_bytes}"


def index_key(digest: str) -> str:
    """Return the key of a bucket index."""
    return f"index/{digest}.npy"


def commit_key(stage: str, key: str) -> str:
    """Return the key of the commit of a finished task."""
    return f"commits/{safe(stage)}/{safe(key)}.json"


def pack_key(stage: str) -> str:
    """Return the key of the packed commits of a stage."""
    return f"packs/{safe(stage)}.json"


def state_key(name: str) -> str:
    """Return the key of a state of the run."""
    return f"state/{safe(name)}.json"


def chunk_key(path: str, chunk: Sequence[int]) -> str:
    """Return the key of a chunk of the array at ``path``."""
    return f"{path}/{CHUNK_SEPARATOR.join(['c', *map(str, chunk)])}"


def chunk_numbers(name: str) -> tuple[int, ...] | None:
    """Return the numbers of the chunk whose key ends in ``name``, or None if this is not the name of a chunk."""
    first, *numbers = name.split(CHUNK_SEPARATOR)
    if first != "c" or not numbers:
        return None
    if not all(part.isascii() and part.isdigit() for part in numbers):
        return None
    return tuple(map(int, numbers))


_NAME = r"[A-Za-z0-9_+=-][A-Za-z0-9._+=-]{0,199}"
_SAFE = re.compile(_NAME)
_HEX = "[0-9a-f]{32}"
# Up to schema 3 the keys of chunks had slashes, and --overwrite removes stores of these
# schemas.
_KEYS = re.compile(
    r"zarr\.json|lock\.json"
    rf"|(points|labels|elected|rasters|spool|records)/({_NAME}/)?zarr\.json"
    rf"|(points|labels|elected|rasters|spool|records)/{_NAME}/c([./][0-9]+)+"
    rf"|index/(current\.json|{_HEX}\.npy)"
    rf"|commits/{_NAME}/{_NAME}\.json|(packs|state)/{_NAME}\.json|trial/{_HEX}"
)
FOLDERS = (
    "points",
    "labels",
    "elected",
    "rasters",
    "spool",
    "records",
    "index",
    "commits",
    "packs",
    "state",
    "trial",
)
"""Folders of a store."""
# Files have temporary names until they are complete.
_SCRATCH = re.compile(rf"(({'|'.join(FOLDERS)})/(.+/)?)?[^/]+\.{_HEX}\.partial")


def is_scratch(key: str) -> bool:
    """Return whether a key is a temporary name, which a killed write can leave."""
    return _SCRATCH.fullmatch(key) is not None


def is_ours(key: str) -> bool:
    """Return whether a key belongs to the layout. Other files in the folder of a store are never removed."""
    return _KEYS.fullmatch(key) is not None or is_scratch(key)


def safe(name: str) -> str:
    """Return the name. Raise StoreError if some file system or object store does not allow it in a path."""
    if _SAFE.fullmatch(name) is None:
        raise StoreError(
            f"{name!r} is not a valid name of an object in a store; use letters, digits and . _ + = -"
        )
    return name


@dataclass(frozen=True)
class StoreMeta:
    """Properties that all points of a store share.

    Attributes
    ----------
    frame : CoordFrame
        Frame that gives the int32 counts their meaning.
    bucket : Lattice
        Lattice of the buckets, the units of storage. Its size is in counts.
    fine : Lattice
        Lattice of the cells with one candidate each. Its size divides the size of a bucket.
    has_rgb : bool
        Whether the points keep their colours, which is the case if the method of the first run uses colours.

    Raises
    ------
    ConfigError
        The size of a bucket is not a multiple of the size of a fine cell.
    """

    frame: CoordFrame
    bucket: Lattice
    fine: Lattice
    has_rgb: bool

    def __post_init__(self) -> None:
        cells = self.bucket.size / self.fine.size
        if cells.denominator != 1 or cells < 1:
            raise ConfigError(
                f"bucket size {self.bucket.size} is not a multiple of the candidate cell {self.fine.size} (in counts); "
                "use a bucket size that is a multiple of the candidate cell"
            )

    def to_json(self) -> dict[str, Any]:
        """Return an exact JSON-able description, which `from_json` reads."""
        return {
            "frame": self.frame.to_json(),
            "bucket": self.bucket.to_json(),
            "fine": self.fine.to_json(),
            "has_rgb": self.has_rgb,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> StoreMeta:
        """Read the description that `to_json` wrote. Raise StoreError if it is damaged."""
        try:
            return cls(
                frame=CoordFrame.from_json(data["frame"]),
                bucket=Lattice.from_json(data["bucket"]),
                fine=Lattice.from_json(data["fine"]),
                has_rgb=bool(data["has_rgb"]),
            )
        except (KeyError, TypeError, ValueError, ZeroDivisionError, ConfigError) as error:
            raise StoreError(
                f"its description is damaged ({error}); run again with --overwrite"
            ) from error
