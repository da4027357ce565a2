"""Files in OUT: values of the calls that write them, their records, and writing of a file completely or not at all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypedDict

from tiler.core.drawn_sheets import StoredAreas
from tiler.core.lattice import Cell
from tiler.core.points import Counts
from tiler.core.raster import RasterSpec
from tiler.core.records import NOT_IN_DIGEST, Record
from tiler.core.results import Rings
from tiler.core.selection import ONLY_GROUND
from tiler.io.atomic_files import write_atomic
from tiler.io.cloud_reading import digest_of_file
from tiler.io.locations import as_path, joined, staging_folder, state_of
from tiler.io.raster_files import raster_errors
from tiler.store import KeptPiece, TileStore


@dataclass(frozen=True)
class OutFile:
    """File with a name in an existing folder or at a URL."""

    out: str
    name: str

    @property
    def location(self) -> str:
        """Path or URL of the file."""
        return joined(self.out, self.name)


@dataclass(frozen=True)
class ProductInfo:
    """Product of a file, and what its metadata say.

    Attributes
    ----------
    product : str
        Key of `tiler.core.products.PRODUCTS`, which defines data type and colours.
    tags : mapping of str to str
        Tags with the provenance (TILER_VERSION, TILER_METHOD, TILER_PARAMETERS, TILER_INPUTS).
    nodata : float or None
        Nodata value of the file, or None for the nodata value of the product.
    """

    product: str
    tags: Mapping[str, str]
    nodata: float | None = None


@dataclass(frozen=True, kw_only=True)
class RasterPart:
    """Raster of the store, or a sheet of it, that a file contains.

    Attributes
    ----------
    raster : str
        Name of the raster in the store.
    spec : RasterSpec
        Pixels of the file.
    fill : float
        Value of pixels beyond the raster and the area.
    whole : RasterSpec or None
        Pixels of the raster in the store if the file is a sheet, else None.
    area : str or None
        Key in the store of the requested area.
    """

    raster: str
    spec: RasterSpec
    fill: float
    whole: RasterSpec | None = None
    area: str | None = None


@dataclass(frozen=True)
class SheetFile:
    """File of a sheet: product, path in OUT, pixels, percentage without a value, lowest and highest value.

    ``clip`` is the area of a drawn sheet and those before it that overlap it.
    """

    product: str
    path: str
    spec: RasterSpec
    void_percent: float
    low: float | None
    high: float | None
    clip: StoredAreas | None = None


@dataclass(frozen=True, kw_only=True)
class NewClasses:
    """New classes of points in the store.

    Attributes
    ----------
    labels : str
        Name of the final labels in the store.
    cells : tuple of Cell
        Buckets that contain the points.
    area, edits, waters : str or None
        Keys in the store of the area, of edits, and of bodies of water whose points become water.
    low_is_noise : bool
        True if returns from far below the level of water become low noise.
    reclass : str
        Rule that selects the classes that change, see `tiler.core.points.written_classes`.
    """

    labels: str
    cells: tuple[Cell, ...]
    area: str | None = None
    edits: str | None = field(default=None, metadata=NOT_IN_DIGEST)
    waters: str | None = field(default=None, metadata=NOT_IN_DIGEST)
    low_is_noise: bool = False
    reclass: str = ONLY_GROUND


@dataclass(frozen=True, kw_only=True)
class CloudCopy(NewClasses):
    """Copy of a source with its new classes.

    Attributes
    ----------
    path : str
        Path or URL of the source.
    source : int
        Number of the source in the store.
    out : str
        Path or URL of the classified cloud.
    salvage : bool
        True if the readable part of a damaged source is used.
    stamp : list or None
        Fingerprint of the source in the plan, which distinguishes a file that was only touched from a changed file.
    ranges : tuple of (int, int)
        First record and number of records of the whole chunks to read. Only points inside the area are written. Empty
        if all points of the source are written.
    copc : bool
        True for COPC, False for LAZ or LAS by the name of ``out``.
    pieces : tuple of KeptPiece
        Pieces whose records the store may have kept. If it has not, the source is decoded again.
    threads : int
        Number of threads that compress, more than one if there are fewer clouds than workers.
    wkt : str or None
        CRS to write, if the source has no readable CRS.
    """

    path: str
    source: int
    out: str
    salvage: bool = False
    stamp: list[Any] | None = field(default=None, metadata=NOT_IN_DIGEST)
    ranges: tuple[tuple[int, int], ...] = ()
    copc: bool = False
    pieces: tuple[KeptPiece, ...] = field(default=(), metadata=NOT_IN_DIGEST)
    threads: int = field(default=1, metadata=NOT_IN_DIGEST)
    wkt: str | None = None


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
    pixels : int
        Number of all pixels.
    own, valid : int
        Number of pixels that belong to the file, and of those with a value. Pixels beside the polygon of a drawn sheet
        do not belong to it.
    min, max, mean : float or None
        Statistics of the values of these pixels. None if no pixel is valid.
    """

    pixels: int
    valid: int
    own: int
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


@dataclass(frozen=True, slots=True, kw_only=True)
class ReviewFileRecord(FileRecord):
    """Record of the places to review: numbers of those that are open, right as they are, and edits.

    ``right`` are the problems that the run found again at places that are right as they are: kind, cause, west, south,
    east and north of each.
    """

    open: int
    ok: int
    fixed: int
    right: list[list[str | float]] = field(default_factory=list)


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


@dataclass
class NewFile:
    """File that is written: its path on this machine, and its record, which exists once the file is complete."""

    path: Path
    record: FileRecord = field(init=False)


@contextmanager
def new_file(to: OutFile) -> Iterator[NewFile]:
    """Yield a new file. When the block ends, the file is in place and its ``record`` is set."""
    with staging_folder(to.out) as folder:
        file = NewFile(folder / to.name)
        yield file
        n_bytes, digest = file.path.stat().st_size, digest_of_file(file.path)
    state = state_of(as_path(to.location)).to_json()
    file.record = FileRecord(path=to.name, bytes=n_bytes, digest=digest, state=state)


def write_bytes(to: OutFile, content: bytes) -> FileRecord:
    """Write a small file and return its `FileRecord`. Raise ProcessingError if it cannot be written."""
    with new_file(to) as file, raster_errors(file.path):
        write_atomic(file.path, content)
    return file.record


def write_text(_: TileStore, *, to: OutFile, text: str) -> FileRecord:
    """Write a small file of text, and return its `FileRecord`."""
    return write_bytes(to, text.encode())
