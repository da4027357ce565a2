"""Values of the calls that write files: where a file goes, and what it is made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tiler.core.lattice import Cell
from tiler.core.raster import RasterSpec
from tiler.core.records import NOT_IN_DIGEST
from tiler.core.selection import ONLY_GROUND
from tiler.io.locations import joined
from tiler.store import KeptPiece


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
    """File of a sheet: product, path in OUT, pixels, percentage without a value, lowest and highest value."""

    product: str
    path: str
    spec: RasterSpec
    void_percent: float
    low: float | None
    high: float | None


@dataclass(frozen=True, kw_only=True)
class CloudCopy:
    """Copy of a source with its new classes.

    Attributes
    ----------
    path : str
        Path or URL of the source.
    source : int
        Number of the source in the store.
    out : str
        Path or URL of the classified cloud.
    labels : str
        Name of the final labels in the store.
    cells : tuple of Cell
        Buckets that contain points of the source.
    salvage : bool
        True if the readable part of a damaged source is used.
    area, edits, waters : str or None
        Keys in the store of the area, of edits, and of bodies of water whose points become water.
    low_is_noise : bool
        True if returns from far below the level of water become low noise.
    reclass : str
        Rule that selects the classes that change, see `tiler.core.points.written_classes`.
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
    labels: str
    cells: tuple[Cell, ...]
    salvage: bool = False
    area: str | None = None
    edits: str | None = field(default=None, metadata=NOT_IN_DIGEST)
    waters: str | None = field(default=None, metadata=NOT_IN_DIGEST)
    low_is_noise: bool = False
    reclass: str = ONLY_GROUND
    stamp: list[Any] | None = field(default=None, metadata=NOT_IN_DIGEST)
    ranges: tuple[tuple[int, int], ...] = ()
    copc: bool = False
    pieces: tuple[KeptPiece, ...] = field(default=(), metadata=NOT_IN_DIGEST)
    threads: int = field(default=1, metadata=NOT_IN_DIGEST)
    wkt: str | None = None
