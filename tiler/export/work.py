"""Arguments of the tasks that write files: one frozen dataclass per kind of file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from tiler.core.digests import NOT_IN_DIGEST
from tiler.core.edits import DrawnDeck
from tiler.core.lattice import Cell
from tiler.core.raster import Block, RasterSpec
from tiler.core.reclass import ONLY_GROUND
from tiler.store import KeptPiece


@dataclass(frozen=True, kw_only=True)
class NamedFile:
    """File with a name in an existing folder or at a URL."""

    name: str
    out: str


@dataclass(frozen=True, kw_only=True)
class ProductFile:
    """File of a product.

    Attributes
    ----------
    product : str
        Key of `tiler.core.products.PRODUCTS`, which defines data type and colours.
    out : str
        Existing folder, or a URL.
    tags : mapping of str to str
        Tags with the provenance (TILER_VERSION, TILER_METHOD, TILER_PARAMETERS, TILER_INPUTS).
    nodata : float or None
        Nodata value of the file, or None for the nodata value of the product.
    """

    product: str
    out: str
    tags: Mapping[str, str]
    nodata: float | None = None


@dataclass(frozen=True, kw_only=True)
class WriteOutline(NamedFile):
    """Outline of the survey as polygons.

    Attributes
    ----------
    terrain : str
        Raster in the store of the final heights.
    spec : RasterSpec
        Pixels of this raster.
    survey : str
        Raster in the store of the cells of the survey.
    coarse : RasterSpec
        Cells of the survey.
    blocks : tuple of str
        Names of the blocks of the terrain.
    area : str or None
        Key in the store of the requested area.
    """

    terrain: str
    spec: RasterSpec
    survey: str
    coarse: RasterSpec
    blocks: tuple[str, ...]
    area: str | None = None


@dataclass(frozen=True, kw_only=True)
class WriteWater(NamedFile):
    """Bodies of water as polygons, lines and stations of rivers, with their key in the store (``waters``)."""

    waters: str


@dataclass(frozen=True, kw_only=True)
class WriteCog(ProductFile):
    """Raster of the store, or a sheet of it, as one file.

    Attributes
    ----------
    name : str
        Name of the file without its ending.
    raster : str
        Name of the raster in the store.
    spec : RasterSpec
        Pixels of the file.
    compress : str
        Compression, ``deflate`` or ``zstd``.
    fill : float
        Value of pixels beyond the raster and the area.
    whole : RasterSpec or None
        Pixels of the raster in the store if the file is a sheet, else None.
    area : str or None
        Key in the store of the requested area.
    """

    name: str
    raster: str
    spec: RasterSpec
    compress: str
    fill: float
    whole: RasterSpec | None = None
    area: str | None = None


@dataclass(frozen=True, kw_only=True)
class WriteMosaic(ProductFile):
    """VRT of a product over its sheets.

    Attributes
    ----------
    sheets : tuple of (str, RasterSpec)
        Path relative to ``out`` and pixels of each sheet, on one lattice. There is at least one.
    """

    sheets: tuple[tuple[str, RasterSpec], ...]


@dataclass(frozen=True, kw_only=True)
class WriteBridges(NamedFile):
    """Decks of bridges as polygons."""

    decks: tuple[DrawnDeck, ...]


@dataclass(frozen=True, kw_only=True)
class FindSheets:
    """Search of a block of the models for sheets with a height.

    Attributes
    ----------
    rasters : tuple of str
        Rasters of the models in the store.
    spec : RasterSpec
        Pixels of these rasters.
    block : Block
    side : int
        Side of a sheet in pixels. Sheets are anchored at CRS 0, as pixels are.
    area : str or None
        Key in the store of the requested area.
    """

    rasters: tuple[str, ...]
    spec: RasterSpec
    block: Block
    side: int
    area: str | None


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
class WriteSheetIndex(NamedFile):
    """Index of the sheets."""

    sheets: tuple[SheetFile, ...]


@dataclass(frozen=True, kw_only=True)
class WriteLegend(NamedFile):
    """Names of the classes of a product's raster."""

    product: str


@dataclass(frozen=True, kw_only=True)
class VectorFile:
    """Vector product that is made from the terrain.

    Attributes
    ----------
    raster : str
        Raster of heights in the store.
    spec : RasterSpec
        Pixels of this raster.
    out : str
        Existing folder, or a URL.
    interval : Fraction or None
        Interval of contours in vertical units of the CRS, or None for a default by relief and noise.
    noise : float
        Standard deviation of the heights in these units, or 0 if it is not known.
    area, waters : str or None
        Keys in the store of the requested area, and of bodies of water.
    """

    raster: str
    spec: RasterSpec
    out: str
    interval: Fraction | None
    noise: float
    area: str | None
    waters: str | None


@dataclass(frozen=True, kw_only=True)
class WriteContours(VectorFile):
    """Contour lines of heights smoothed by a Gaussian with a standard deviation of ``sigma`` pixels."""

    sigma: float


@dataclass(frozen=True, kw_only=True)
class WriteSpots(VectorFile):
    """Spot heights: pixels that are the highest or lowest within ``reach`` pixels to each side."""

    reach: int


@dataclass(frozen=True, kw_only=True)
class WriteText(NamedFile):
    """Small file of text."""

    text: str


@dataclass(frozen=True, kw_only=True)
class WriteClassified:
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
        Rule that selects the classes that change, see `tiler.core.classes.written_classes`.
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
