"""Parts of STAC documents (SpatioTemporal Asset Catalogs): extent, dates, and contents of a cloud or raster."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from datetime import date
from typing import Any, TypedDict

import numpy as np
import shapely
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError
from shapely.geometry import polygon

from tiler.core.crs import code_of, split
from tiler.io.las.point_formats import RGB_FORMATS, is_legacy

Box = tuple[float, float, float, float]
"""Lowest x and y, highest x and y, in units of the CRS."""

UNKNOWN_DATES = {
    "start_datetime": "1970-01-01T00:00:00Z",
    "end_datetime": "9999-12-31T23:59:59Z",
}
"""Dates of a cloud of unknown age. STAC requires a time, and the time of the run would be
wrong."""

_WGS84, _DIGITS = 4326, 7
_TIMED, _INFRARED = (1, 3, 4, 5), (8, 10)
_MIN_STEPS = 8


def horizontal_code(wkt: str | None) -> str | None:
    """Return the code of the horizontal part of a CRS, such as ``EPSG:25832``, or None if it has no code."""
    horizontal = None if wkt is None else split(CRS.from_wkt(wkt))[0]
    authority = None if horizontal is None else code_of(horizontal)
    return None if authority is None else ":".join(authority)


class Globe:
    """Transformation of boxes in a CRS to longitude and latitude.

    Parameters
    ----------
    wkt : str or None
        CRS of the boxes. If it is None or local, they have no geographic coordinates.
    """

    def __init__(self, wkt: str | None) -> None:
        self._transformer: Transformer | None = None
        horizontal = None if wkt is None else split(CRS.from_wkt(wkt))[0]
        if horizontal is None:
            return
        try:
            self._transformer = Transformer.from_crs(horizontal, _WGS84, always_xy=True)
        except ProjError:  # A local CRS has no geographic coordinates.
            return

    def bbox(self, box: Box) -> list[float] | None:
        """Return west, south, east and north of a box in degrees, or None if it has no geographic coordinates.

        West is larger than east across the antimeridian.
        """
        if self._transformer is None:
            return None
        degrees = self._transformer.transform_bounds(*box, densify_pts=_MIN_STEPS)
        if not all(map(math.isfinite, degrees)):
            return None
        return [round(v, _DIGITS) for v in degrees]

    def polygon(self, box: Box) -> dict[str, Any] | None:
        """Return a box as GeoJSON in degrees, or None if it has no geographic coordinates.

        A box that crosses the antimeridian has two parts (RFC 7946, 3.1.9).
        """
        if self._transformer is None or (bbox := self.bbox(box)) is None:
            return None
        vertices = self._transformer.itransform(corners(box))
        if bbox[0] <= bbox[2]:
            return {"type": "Polygon", "coordinates": [_ring(vertices)]}
        whole = shapely.Polygon([(x % 360, y) for x, y in vertices])
        parts = [
            (shapely.clip_by_rect(whole, west, -90, west + 180, 90), -2 * west)
            for west in (0, 180)
        ]
        parts = [(polygon.orient(part), shift) for part, shift in parts if not part.is_empty]
        rings = [shapely.get_coordinates(part) + (shift, 0) for part, shift in parts]
        return {
            "type": "MultiPolygon",
            "coordinates": [[_ring(ring.tolist())] for ring in rings],
        }


def _ring(places: Iterable[Iterable[float]]) -> list[list[float]]:
    return [[round(v, _DIGITS) for v in place] for place in places]


def hull_of(boxes: Iterable[Sequence[float]]) -> list[float]:
    """Return the narrowest bbox that contains all boxes. West is larger than east across the antimeridian."""
    west, south, east, north = np.array(list(boxes)).T
    east = np.where(east < west, east + 360, east)
    hulls = []
    for turn in (0, 360):  # Longitudes run from -180 to 180, or from 0 to 360.
        turned = np.where(west < 0, turn, 0)
        hulls.append([float((west + turned).min()), float((east + turned).max())])
    narrowest = min(hulls, key=lambda ends: round(ends[1] - ends[0], _DIGITS))
    low, high = (round(x - 360, _DIGITS) if x > 180 else x for x in narrowest)
    return [low, float(south.min()), high, float(north.max())]


def corners(box: Box) -> list[list[float]]:
    """Return the counter-clockwise ring of a box."""
    x0, y0, x1, y1 = box
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]


def dates(found: Iterable[tuple[date, date] | None]) -> dict[str, str | None]:
    """Return the dates as STAC has them.

    A single day is a ``datetime``. Several days are ``start_datetime`` and ``end_datetime``,
    with ``datetime`` None.
    """
    known = [dates for dates in found if dates is not None]
    if not known:
        return {"datetime": None, **UNKNOWN_DATES}
    first = min(start for start, _ in known)
    last = max(end for _, end in known)
    if first == last:
        return {"datetime": f"{first.isoformat()}T00:00:00Z"}
    start, end = f"{first.isoformat()}T00:00:00Z", f"{last.isoformat()}T23:59:59Z"
    return {"datetime": None, "start_datetime": start, "end_datetime": end}


class SchemaField(TypedDict):
    """Field of the points of a cloud, with its size in bytes."""

    name: str
    size: int
    type: str


def schema(point_formats: Iterable[int]) -> list[SchemaField]:
    """Return ``pc:schemas``: the fields of points of these formats, with the names of PDAL and QGIS."""
    formats = set(point_formats)
    fields = [*((axis, 8, "floating") for axis in "XYZ"), ("Intensity", 2, "unsigned")]
    bytes_ = [
        "ReturnNumber",
        "NumberOfReturns",
        "ScanDirectionFlag",
        "EdgeOfFlightLine",
        "Classification",
    ]
    fields += [(name, 1, "unsigned") for name in bytes_]
    fields += [
        ("ScanAngleRank", 4, "floating"),
        ("UserData", 1, "unsigned"),
        ("PointSourceId", 2, "unsigned"),
    ]
    newer = any(not is_legacy(form) for form in formats)
    if newer or formats & set(_TIMED):
        fields.append(("GpsTime", 8, "floating"))
    if newer:
        fields.append(("ScanChannel", 1, "unsigned"))
    if formats & set(RGB_FORMATS):
        fields += [(name, 2, "unsigned") for name in ("Red", "Green", "Blue")]
    if formats & set(_INFRARED):
        fields.append(("Infrared", 2, "unsigned"))
    return [{"name": name, "size": size, "type": kind} for name, size, kind in fields]


def statistics(
    fields: Mapping[str, Mapping[str, float]], points: int, names: Sequence[str]
) -> list[dict[str, str | float]]:
    """Return ``pc:statistics`` of a cloud (`tiler.export.cloud_frame`), given the names of its schema."""
    return [
        {
            "name": name,
            "position": position,
            "count": points,
            **dict(sorted(fields[name].items())),
        }
        for position, name in enumerate(names)
        if name in fields
    ]
