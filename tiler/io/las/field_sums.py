"""Sums of the fields of point records, from which statistics follow. They are exact, so the order does not matter."""

from __future__ import annotations

from collections.abc import Iterator

import lazrs
import numpy as np

from ptd.arrays import AnyArray
from tiler.core.records import KnownSums
from tiler.io.las.headers import LasHeader
from tiler.io.las.point_formats import class_and_flags, colours, returns
from tiler.io.las.reader import Records

COORDINATE_FIELDS = ("X", "Y", "Z")
CLASSES = "Classification"

_RETURNS = 15
"""Largest return number for which a header counts points."""
_NOTHING = [2**63, -(2**63), 0, 0]
"""Lowest, highest, sum and sum of squares of an empty set of values."""


class FieldSums:
    """Accumulator of the sums of the fields of point records.

    Parameters
    ----------
    header : LasHeader

    Attributes
    ----------
    points : int
    by_return : list of int
        Number of points by return number, from 1.
    fields : dict of str to list of int
        Lowest and highest value, sum and sum of squares by the name of the field.
    times : list of float
        First and last adjusted standard time, or empty.
    """

    def __init__(self, header: LasHeader) -> None:
        self.header = header
        self.points = 0
        self.by_return = [0] * _RETURNS
        self.fields: dict[str, list[int]] = {}
        self.times: list[float] = []

    def add(self, records: Records) -> None:
        """Add all fields of records."""
        number = returns(records, self.header.point_format)[0]
        counts = np.bincount(np.minimum(number, _RETURNS), minlength=_RETURNS + 1)[1:].tolist()
        self.by_return = [a + b for a, b in zip(self.by_return, counts, strict=True)]
        for name, values in _fields(records, self.header.point_format):
            if values.size:
                self._join(name, sums_of(values))
        if self.header.has_standard_times:
            times = records["gps_time"][np.isfinite(records["gps_time"])]
            if times.size:
                self._join_times([float(times.min()), float(times.max())])
        self.add_classes(records)

    def add_classes(self, records: Records) -> None:
        """Add the classes of records whose other fields are known (`join`)."""
        self.points += len(records)
        classes = class_and_flags(records, self.header.point_format)[0]
        if classes.size:
            self._join(CLASSES, sums_of(classes))

    def join(self, known: KnownSums) -> None:
        """Add the fields of records that were added elsewhere, without their number and classes."""
        for name, sums in known["fields"].items():
            self._join(name, sums)
        self._join_times(known["times"])

    def without_classes(self) -> KnownSums:
        """Return what `join` adds."""
        fields = {name: sums for name, sums in self.fields.items() if name != CLASSES}
        return {"fields": fields, "times": self.times}

    def _join(self, name: str, sums: list[int]) -> None:
        low, high, total, squares = self.fields.get(name, _NOTHING)
        self.fields[name] = [
            min(low, sums[0]),
            max(high, sums[1]),
            total + sums[2],
            squares + sums[3],
        ]

    def _join_times(self, times: list[float]) -> None:
        known = [*self.times, *times]
        self.times = [min(known), max(known)] if known else []


def layers_with_fields(header: LasHeader) -> int:
    """Return the layers of point formats 6 to 10 that `FieldSums.add` needs."""
    layers = (
        lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
        | lazrs.SELECTIVE_DECOMPRESS_Z
        | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION
        | lazrs.SELECTIVE_DECOMPRESS_INTENSITY
        | lazrs.SELECTIVE_DECOMPRESS_RGB
    )
    if header.has_standard_times:
        layers |= lazrs.SELECTIVE_DECOMPRESS_GPS_TIME
    return int(layers)


def _fields(records: Records, point_format: int) -> Iterator[tuple[str, AnyArray]]:
    """Yield the fields with the names that PDAL and QGIS use, and their values, without the classes."""
    for name in COORDINATE_FIELDS:
        yield name, records[name]
    yield "Intensity", records["intensity"]
    number, of = returns(records, point_format)
    yield "ReturnNumber", number
    yield "NumberOfReturns", of
    rgb = colours(records, point_format)
    if rgb is not None:
        yield from zip(("Red", "Green", "Blue"), rgb, strict=True)


def sums_of(values: AnyArray) -> list[int]:
    """Return the exact lowest, highest, sum and sum of squares of integers of at most 32 bits."""
    if values.dtype.itemsize <= 2:
        counts = np.bincount(values)
        distinct = np.flatnonzero(counts)
        total = int((distinct * counts[distinct]).sum())
        return [
            int(distinct[0]),
            int(distinct[-1]),
            total,
            int((distinct * distinct * counts[distinct]).sum()),
        ]
    # Fields of records are not contiguous, so that each pass over them is slow.
    raised = values.astype(np.int64)
    low, high, n = int(raised.min()), int(raised.max()), values.size
    raised -= low
    total = int(raised.sum())
    if n * (high - low) ** 2 < 1 << 63:
        squares = int(np.dot(raised, raised))
    else:  # Sums of products of 16-bit halves fit into int64 for up to 2**31 values.
        upper, lower = raised >> 16, raised & 0xFFFF
        parts = [int(np.dot(a, b)) for a, b in ((upper, upper), (upper, lower), (lower, lower))]
        squares = (parts[0] << 32) + (parts[1] << 17) + parts[2]
    return [low, high, total + n * low, squares + 2 * low * total + n * low * low]
