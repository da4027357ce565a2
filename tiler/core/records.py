"""Records that tasks return and the store keeps as JSON, and digests, which decide what a run has to do again.

Modules that start before numpy is loaded import this one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Generic, Self, TypedDict, TypeVar

from tiler.errors import StoreError
from tiler.redaction import stored

if TYPE_CHECKING:
    from ptd.arrays import AnyArray


@dataclass(frozen=True, slots=True)
class Record:
    """Record of a task. The names of its fields are the keys of the JSON object.

    Fields with the default None are left out of the object while their value is None.
    """

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> Self:
        """Return the record of a JSON object.

        Raises
        ------
        StoreError
            A key is missing, as in stores of other versions.
        """
        try:
            known = {
                name: stored[name]
                for name, field in cls.__dataclass_fields__.items()
                if name in stored or field.default is MISSING
            }
        except KeyError as missing:
            raise StoreError(
                f"a record of the store has no {missing}, so another version wrote it; delete the store and run again"
            ) from None
        return cls(**known)

    def to_json(self) -> dict[str, Any]:
        """Return the record as a JSON object."""
        values = {}
        for name, field in self.__dataclass_fields__.items():
            value = getattr(self, name)
            if value is not None or field.default is MISSING:
                values[name] = value
        return values


Part = TypeVar("Part")


@dataclass(frozen=True, slots=True)
class JoinedRecord(Record, Generic[Part]):
    """Record of a task with parts: the record of each part."""

    parts: list[Part]


AnyRecord = TypeVar("AnyRecord", bound=Record)


def to_json(value: Any) -> Any:
    """Return a value as JSON can hold it: a record as an object, also in lists, mappings and fields of records."""
    if isinstance(value, Record):
        return {name: to_json(entry) for name, entry in value.to_json().items()}
    if isinstance(value, Mapping):
        return {name: to_json(entry) for name, entry in value.items()}
    if isinstance(value, list) and any(isinstance(entry, Record) for entry in value):
        return [to_json(entry) for entry in value]
    return value


def records_of(
    kind: type[AnyRecord], commits: Mapping[str, tuple[str, Mapping[str, Any]]]
) -> list[AnyRecord]:
    """Return the records of tasks in the order of their commits, with a type.

    Raises
    ------
    StoreError
        See `Record.of`.
    """
    return [kind.of(stored) for _, stored in commits.values()]


class KnownSums(TypedDict):
    """Sums of the fields of records, without the classes.

    ``fields`` has the lowest and highest value, the sum and the sum of squares by the name of the field. ``times`` has
    the first and the last adjusted standard time, or is empty.
    """

    fields: dict[str, list[int]]
    times: list[float]


@dataclass(frozen=True, slots=True, kw_only=True)
class SpoolRecord(Record):
    """Record of a piece of a source whose points were decoded.

    Attributes
    ----------
    read, stored, outside : int
        Number of records that were read, of points in the spool, and of points outside of the bounds that the header
        gives.
    dropped, unselected : dict of str to int
        Number of points that are not stored, by reason, and of points that are stored but not filtered, by the
        setting that excludes them.
    largest_rounding : float
        Largest change of a coordinate in units of the CRS.
    buckets, left : list of [ix, iy, number]
        Points in each bucket, and points of buckets that the run does not need.
    identity : str, optional
        Digest of the bytes and settings on which the points depend.
    fetched : int
        Bytes that were read from a URL.
    bounds : [x0, y0, x1, y1], optional
        Bounds of the stored points in absolute counts, half-open. None without points.
    z : [lowest, highest], optional
        Range of heights in counts.
    sums : KnownSums, optional
        Sums of the fields of the records that were read (`tiler.io.las.field_sums`). None if the task did not keep
        the classes for the classified cloud.
    """

    read: int
    stored: int
    outside: int
    dropped: dict[str, int]
    unselected: dict[str, int]
    largest_rounding: float
    buckets: list[list[int]]
    left: list[list[int]]
    identity: str | None
    fetched: int
    bounds: list[int] | None
    z: list[int] | None
    sums: KnownSums | None = None


class Duplicates(TypedDict):
    """Numbers of duplicate points within one source and between sources."""

    within: int
    between: int


@dataclass(frozen=True, slots=True, kw_only=True)
class BucketRecord(Record):
    """Record of a bucket of the store.

    Attributes
    ----------
    cell : [ix, iy]
        Index of the bucket.
    n, n_candidates, n_participating : int
        Number of all points, of candidates, and of points that take part in the filter.
    n_measured : int
        Number of positions with a point that decides the default pixel: one that is neither excluded by a flag nor
        noise.
    duplicates : Duplicates
    z_participating : [lowest, highest], optional
        Range of heights of the points that take part, in counts. None without such points.
    classes : dict of str to int
        Points by class of the input.
    strays : list of [source, record, x, y, z]
        Points far from all others of their file: numbers of the source and of the record, and position.
    bounds : [x0, y0, x1, y1], optional
        Bounds of the points without strays in absolute counts, half-open. None without points.
    z : [lowest, highest], optional
        Range of their heights in counts.
    outranked : list of [source, points, cells], optional
        Points that do not count because another survey counts there, and cells with such points
        (`tiler.core.surveys`). The source is the first one of the survey. None if no other survey is near.
    """

    cell: list[int]
    n: int
    n_candidates: int
    n_participating: int
    n_measured: int = (
        0  # Earlier versions did not record it. Their buckets are assembled again.
    )
    duplicates: Duplicates
    z_participating: list[int] | None
    classes: dict[str, int]
    strays: list[list[Any]]
    bounds: list[int] | None
    z: list[int] | None
    outranked: list[list[int]] | None = None


@dataclass(frozen=True, slots=True)
class AssembledRecord(Record):
    """Record of a task of the assembly: the buckets that it wrote."""

    buckets: list[BucketRecord]


def buckets_in(assembled: Mapping[str, Any]) -> list[BucketRecord]:
    """Return the records of the buckets that a task of the assembly wrote."""
    return [BucketRecord.of(stored) for stored in assembled["buckets"]]


@dataclass(frozen=True, slots=True, kw_only=True)
class TileRecord(Record):
    """Record of a tile of a pass of the filter.

    Attributes
    ----------
    points, ground, low_noise, unclassified, kept : int
        Number of labelled points, in all and by label.
    marked : int
        Number of labels that are not certified.
    tries, halo : int
        Number of windows that were tried, and the halo of the last one in counts.
    window_points : int
        Number of points in the last window.
    core_area, window_area : int
        Area of the tile, and of all windows that were tried, in square counts.
    cells : list of [ix, iy]
        Buckets of the tile.
    labels : str
        Digest of the labels.
    elected : str, optional
        Digest of the elected points. None if the pass elects no points.
    elected_points : list of int, optional
        Number of elected points of each bucket.
    partial : mapping
        Part of the state after the pass, which `Pass.reduce` combines.
    stats : mapping
        Figures of the method, for its developers.
    """

    points: int
    ground: int
    low_noise: int
    unclassified: int
    kept: int
    marked: int
    tries: int
    halo: int
    window_points: int
    core_area: int
    window_area: int
    cells: list[list[int]]
    labels: str
    elected: str | None = None
    elected_points: list[int] | None = None
    partial: Mapping[str, Any]
    stats: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockRecord(Record):
    """Record of a block of a raster.

    Attributes
    ----------
    filled : int
        Number of pixels or cells that have a value.
    checksum : str
        Checksum of the pixels, empty before they are written.
    pixels : int, optional
        Number of pixels. Rasters of coarse cells that no step makes do not have it.
    """

    filled: int
    checksum: str = ""
    pixels: int | None = None


NOT_IN_DIGEST = {"digest": False}
"""Metadata of an argument of a task that affects how the task runs, but not its result."""


def digest_of(*parts: Any) -> str:
    """Return a short stable digest of JSON-able values and dataclasses, without fields that are `NOT_IN_DIGEST`.

    The digest does not depend on the order of keys, or on passwords and tokens in URLs.
    """
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), default=argument_to_json)
    if ":/" in text:
        text = json.dumps(stored(json.loads(text)), sort_keys=True, separators=(",", ":"))
    return digest_of_bytes(text.encode())


def argument_to_json(value: Any) -> Any:
    """Convert a value in the arguments of a task for JSON: a dataclass to its fields, a fraction to text."""
    if isinstance(value, Fraction):
        return str(value)
    if is_dataclass(value):
        return {
            f.name: getattr(value, f.name)
            for f in fields(value)
            if f.metadata.get("digest", True)
        }
    raise TypeError(
        f"{type(value).__name__} is not allowed in the arguments of a task; use a JSON-able value"
    )


def new_digest() -> hashlib.blake2b:
    """Return a BLAKE2b of 16 bytes, to which bytes can be added part by part."""
    return hashlib.blake2b(digest_size=16)


def digest_of_bytes(*parts: bytes) -> str:
    """Return the digest of bytes, one part after the other."""
    digest = new_digest()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def digest_of_arrays(*arrays: AnyArray) -> str:
    """Return one digest of the values of all arrays, row by row."""
    digest = new_digest()
    for array in arrays:  # One copy of an array at a time, since arrays may be large.
        digest.update(array.tobytes())
    return digest.hexdigest()
