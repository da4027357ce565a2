"""Records that tasks return and the store keeps as JSON, with a type for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self, TypedDict

from tiler.errors import StoreError


@dataclass(frozen=True, slots=True)
class Record:
    """Record of a task. The names of its fields are the keys of the JSON object."""

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> Self:
        """Return the record of a JSON object.

        Raises
        ------
        StoreError
            A key is missing, as in stores of other versions.
        """
        try:
            return cls(**{name: stored[name] for name in cls.__dataclass_fields__})
        except KeyError as missing:
            raise StoreError(
                f"a record of the store has no {missing}, so another version wrote it; delete the store and run again"
            ) from None

    def to_json(self) -> dict[str, Any]:
        """Return the record as a JSON object."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


@dataclass(frozen=True, slots=True, kw_only=True)
class SpoolRecord(Record):
    """Record of a piece of a source whose points were decoded.

    Attributes
    ----------
    read, stored, outside : int
        Number of records that were read, of points in the spool, and of points outside of the bounds that the header
        gives.
    dropped, unselected : dict of str to int
        Number of points that are not stored, by reason, and of points that are stored but not filtered, by selection.
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
    """

    cell: list[int]
    n: int
    n_candidates: int
    n_participating: int
    duplicates: Duplicates
    z_participating: list[int] | None
    classes: dict[str, int]
    strays: list[list[Any]]
    bounds: list[int] | None
    z: list[int] | None


def buckets_in(assembled: Mapping[str, Any]) -> list[BucketRecord]:
    """Return the records of the buckets that a task of the assembly wrote."""
    return [BucketRecord.of(stored) for stored in assembled["buckets"]]
