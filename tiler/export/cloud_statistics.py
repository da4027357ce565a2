"""Exact statistics of the points of a cloud, which do not depend on the pieces in which the points come."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.export.records import PointStatistics
from tiler.io.las.headers import LasHeader
from tiler.io.las.point_formats import class_and_flags, colours, returns
from tiler.io.las.reader import Records

COORDINATES = ("X", "Y", "Z")

_RETURNS = 15
"""Largest return number for which a header counts points."""
_NOTHING = [2**63, -(2**63), 0, 0]
"""Lowest, highest, sum and sum of squares of an empty set of values."""


class CloudStatistics:
    """Accumulator of statistics of the fields of point records.

    The sums are integers, so that the result does not depend on the order.

    Parameters
    ----------
    header : LasHeader
    """

    def __init__(self, header: LasHeader) -> None:
        self._header = header
        self._sums: dict[str, list[int]] = {}
        self._times: list[float] = []
        self.points = 0
        self.by_return = [0] * _RETURNS

    def add(self, records: Records) -> None:
        """Add records to the statistics."""
        self.points += len(records)
        number = returns(records, self._header.point_format)[0]
        counts = np.bincount(np.minimum(number, _RETURNS), minlength=_RETURNS + 1)[1:].tolist()
        self.by_return = [a + b for a, b in zip(self.by_return, counts, strict=True)]
        for name, values in _fields(records, self._header.point_format):
            sums = self._sums.setdefault(name, list(_NOTHING))
            if values.size:
                low, high, total, squares = sums_of(values)
                sums[:] = [
                    min(sums[0], low),
                    max(sums[1], high),
                    sums[2] + total,
                    sums[3] + squares,
                ]
        names = records.dtype.names or ()
        if "gps_time" in names and self._header.global_encoding & 1:
            times = records["gps_time"][np.isfinite(records["gps_time"])]
            if times.size:
                known = [float(times.min()), float(times.max()), *self._times]
                self._times = [min(known), max(known)]

    def to_json(self) -> PointStatistics:
        """Return the statistics as plain values."""
        header = self._header
        scales = dict(
            zip(COORDINATES, zip(header.scales, header.offsets, strict=True), strict=True)
        )
        fields = {}
        if not self.points:
            return {"fields": {}, "gps": self._times or None}
        for name, (low, high, total, squares) in self._sums.items():
            scale, offset = scales.get(name, (1.0, 0.0))
            variance = (squares * self.points - total * total) / self.points**2
            fields[name] = {
                "minimum": low * scale + offset,
                "maximum": high * scale + offset,
                "average": total / self.points * scale + offset,
                "variance": variance * scale * scale,
                "stddev": math.sqrt(variance) * scale,
            }
        return {"fields": fields, "gps": self._times or None}


def _fields(records: Records, point_format: int) -> Iterator[tuple[str, npt.NDArray[Any]]]:
    """Yield the fields with the names that PDAL and QGIS use, and their values."""
    for name in COORDINATES:
        yield name, records[name]
    yield "Intensity", records["intensity"]
    number, of = returns(records, point_format)
    yield "ReturnNumber", number
    yield "NumberOfReturns", of
    yield "Classification", class_and_flags(records, point_format)[0]
    rgb = colours(records, point_format)
    if rgb is not None:
        yield from zip(("Red", "Green", "Blue"), rgb, strict=True)


def sums_of(values: npt.NDArray[Any]) -> tuple[int, int, int, int]:
    """Return the exact lowest, highest, sum and sum of squares of integers of at most 32 bits."""
    if values.dtype.itemsize <= 2:
        counts = np.bincount(values)
        distinct = np.flatnonzero(counts)
        total = int((distinct * counts[distinct]).sum())
        return (
            int(distinct[0]),
            int(distinct[-1]),
            total,
            int((distinct * distinct * counts[distinct]).sum()),
        )
    low, high, n = int(values.min()), int(values.max()), values.size
    raised = values.astype(np.int64) - low
    total = int(raised.sum())
    if n * (high - low) ** 2 < 1 << 63:
        squares = int(np.dot(raised, raised))
    else:  # Sums of products of 16-bit halves fit into int64 for up to 2**31 values.
        upper, lower = raised >> 16, raised & 0xFFFF
        parts = [int(np.dot(a, b)) for a, b in ((upper, upper), (upper, lower), (lower, lower))]
        squares = (parts[0] << 32) + (parts[1] << 17) + parts[2]
    return low, high, total + n * low, squares + 2 * low * total + n * low * low
