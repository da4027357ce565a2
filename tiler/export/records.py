"""Records of the tasks of the stage export, with a type for each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypedDict

from tiler.core.points import Counts
from tiler.core.records import Record
from tiler.core.results import Rings


@dataclass(frozen=True, slots=True, kw_only=True)
class FileRecord(Record):
    """Record of a file in OUT.

    Attributes
    ----------
    bytes : int
        Size of the file.
    path : str, optional
        Name of the file. Classified clouds do not have it.
    digest : str, optional
        Digest of all bytes. Earlier versions did not record it.
    state : list, optional
        `tiler.io.locations.FileState` as JSON. Earlier versions did not record it.
    notes : list of str, optional
        Notes for the user.
    """

    bytes: int
    path: str | None = None
    digest: str | None = None
    state: list[Any] | None = None
    notes: list[str] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RasterFileRecord(FileRecord):
    """Record of a GeoTIFF.

    Attributes
    ----------
    pixels, valid : int
        Number of all pixels, and of pixels with a value.
    min, max, mean : float or None
        Statistics of the values. None if no pixel is valid.
    """

    pixels: int
    valid: int
    min: float | None
    max: float | None
    mean: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ContoursRecord(FileRecord):
    """Record of contour lines.

    Attributes
    ----------
    interval : float
        Difference of height between contours, in vertical units of the CRS.
    lines, vertices : int
    cut : int
        Number of lines that were divided because too many vertices were waiting.
    short : int
        Number of rings that were left out, see `tiler.export.contour_lines`.
    low, high : float or None
        Heights between which nearly all of the terrain lies. None if it is empty.
    """

    interval: float
    lines: int
    vertices: int
    cut: int
    short: int
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SpotsRecord(FileRecord):
    """Record of spot heights: interval in vertical units of the CRS, and numbers of tops and bottoms."""

    interval: float
    highs: int
    lows: int


@dataclass(frozen=True, slots=True, kw_only=True)
class OutlineFileRecord(FileRecord):
    """Record of the outline of the survey: number of polygons, and rings with few vertices for a map."""

    polygons: int
    rings: Rings | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class WaterFileRecord(FileRecord):
    """Record of the bodies of water: their number."""

    bodies: int


class PointStatistics(TypedDict):
    """Statistics of the points of a cloud.

    ``fields`` gives ``minimum``, ``maximum``, ``average``, ``variance`` and ``stddev`` by the name of the field:
    coordinates in units of the CRS, other fields as they are stored. ``gps`` has the first and the last adjusted
    standard time, or is None if no time is known.
    """

    fields: dict[str, dict[str, float]]
    gps: list[float] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudRecord(FileRecord):
    """Record of a classified cloud.

    Attributes
    ----------
    points, changed : int
        Number of points, and of points with a new class.
    classes : dict of str to int
        Number of points by new class.
    kept : dict of str to int, optional
        Number of filtered points, by class, that keep the class of an object from the source (classes that are not in
        `tiler.core.points.WITHOUT_OBJECT`). None for clouds of earlier versions, which kept no classes.
    ground : int, optional
        Number of points whose label is ground. Points of class 2 that keep the class of the source are not counted.
        None for clouds of earlier versions.
    statistics : PointStatistics
    fetched : int, optional
        Number of bytes that were read over the network.
    """

    points: int
    changed: int
    classes: Counts
    kept: Counts | None = None
    ground: int | None = None
    statistics: PointStatistics
    fetched: int | None = None
