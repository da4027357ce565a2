"""Arguments of the tasks that write files: one frozen dataclass for each kind of file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from tiler.core.edits import DrawnDeck
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.core.reclass import ONLY_GROUND
from tiler.schedule import NOT_IN_DIGEST
from tiler.store import KeptPiece


@dataclass(frozen=True, kw_only=True)
class NamedFile:
    """A file, by its name in a folder that exists, or at a URL."""

    name: str
    out: str


@dataclass(frozen=True, kw_only=True)
class ProductFile:
    """A file of a product.

    Attributes
    ----------
    product : str
        Key of `tiler.core.products.PRODUCTS`, for the type and looks.
    out : str
        Folder that exists, or a URL.
    tags : mapping of str to str
        The provenance (TILER_VERSION, TILER_METHOD, TILER_PARAMETERS, TILER_INPUTS).
    nodata : float or None
        Of the file; None: that of the store.
    """

    product: str
    out: str
    tags: Mapping[str, str]
    nodata: float | None = None


@dataclass(frozen=True, kw_only=True)
class WriteOutline(NamedFile):
    """The outline of the survey as polygons.

    Attributes
    ----------
    terrain : str
        Raster of the heights that are delivered.
    spec : RasterSpec
        Of its pixels.
    survey : str
    coarse : RasterSpec
        Of the cells of the survey.
    blocks : tuple of str
        Names of the blocks of the terrain.
    area : str or None
        Key in the store of the area that is wanted.
    """

    terrain: str
    spec: RasterSpec
    survey: str
    coarse: RasterSpec
    blocks: tuple[str, ...]
    area: str | None = None


@dataclass(frozen=True, kw_only=True)
class WriteWater(NamedFile):
    """Bodies of water as polygons, and the lines along which rivers flow; ``waters``: key in the store."""

    waters: str


@dataclass(frozen=True, kw_only=True)
class WriteCog(ProductFile):
    """A raster of the store, or a sheet of it, as one file.

    Attributes
    ----------
    name : str
        Of the file, without its ending.
    raster : str
        In the store.
    spec : RasterSpec
        Of the file.
    compress : str
        ``deflate`` or ``zstd``.
    fill : float
        Value beyond raster and area.
    whole : RasterSpec or None
        Of the raster in the store, where ``spec`` is that of a sheet.
    area : str or None
        Key in the store of the area that is wanted.
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
    """A VRT of a product; ``sheets``: paths relative to ``out`` and their pixels on one lattice, at least one."""

    sheets: tuple[tuple[str, RasterSpec], ...]


@dataclass(frozen=True, kw_only=True)
class WriteBridges(NamedFile):
    """The decks of bridges."""

    decks: tuple[DrawnDeck, ...]


@dataclass(frozen=True, kw_only=True)
class FindSheets:
    """A block of the models, in which sheets with a height are looked for.

    Attributes
    ----------
    rasters : tuple of str
        Of the models in the store.
    spec : RasterSpec
        Of these.
    block : Block
    side : int
        Pixels of a sheet's side; sheets are anchored at CRS 0, as pixels are.
    area : str or None
        Key in the store of the area that is wanted.
    """

    rasters: tuple[str, ...]
    spec: RasterSpec
    block: Block
    side: int
    area: str | None

    def place(self, buckets: Lattice) -> Bounds | None:
        """Bounds of the block."""
        return self.spec.block_bounds(self.block)


@dataclass(frozen=True)
class SheetFile:
    """A sheet that was written: its product, path in OUT, pixels, percentage without a value, lowest and highest."""

    product: str
    path: str
    spec: RasterSpec
    void_percent: float
    low: float | None
    high: float | None


@dataclass(frozen=True, kw_only=True)
class WriteSheetIndex(NamedFile):
    """The tile index of the sheets."""

    sheets: tuple[SheetFile, ...]


@dataclass(frozen=True, kw_only=True)
class WriteLegend(NamedFile):
    """Names of the classes of a product's raster."""

    product: str


@dataclass(frozen=True, kw_only=True)
class VectorFile:
    """A file of vectors that follows from the terrain.

    Attributes
    ----------
    raster : str
        Of heights in the store.
    spec : RasterSpec
    out : str
        Folder that exists, or a URL.
    interval : Fraction or None
        Of contours, in vertical units of the CRS; None: by the relief.
    noise : float
        Standard deviation of the heights in these units; 0 where it is not known.
    area, waters : str or None
        Keys in the store of the area that is wanted, and of bodies of water.
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
    """Contour lines; ``sigma``: pixels, of the Gaussian that smooths the heights beforehand."""

    sigma: float


@dataclass(frozen=True, kw_only=True)
class WriteSpots(VectorFile):
    """Spot heights; ``reach``: pixels around a spot in which nothing is higher, or lower."""

    reach: int


@dataclass(frozen=True, kw_only=True)
class WriteText(NamedFile):
    """A small file of text."""

    text: str


@dataclass(frozen=True, kw_only=True)
class WriteClassified:
    """A source again, with its new classes.

    Attributes
    ----------
    path : str
        Of the source, or its URL.
    source : int
        Its number in the store.
    out : str
        The final name, a path or a URL.
    labels : str
        Name of the final labels in the store.
    cells : tuple of Cell
        The buckets that hold points of it.
    salvage : bool
    area, edits, waters : str or None
        Keys in the store of the area, of corrections and of bodies of water in which points are water.
    low_is_noise : bool
        Whether returns from far below the level of water are low noise.
    reclass : str
        Which classes change, see `tiler.core.classes.written_classes`.
    stamp : list or None
        Of the source, as the plan found it: tells a file that was only touched from one that was changed.
    ranges : tuple of (int, int)
        First record and number of those that are looked at, whole chunks; of them only points inside the area are
        written. Empty: all points of the source are.
    copc : bool
        As COPC; else LAZ or LAS, by the name of ``out``.
    pieces : tuple of KeptPiece
        Of which the store may keep the records: the source is decoded where it does not.
    threads : int
        Number of threads that compress: more than one where there are fewer clouds than workers.
    wkt : str or None
        The CRS to write, where the source has none that can be read.
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

    def place(self, buckets: Lattice) -> Bounds | None:
        """Bounds of the buckets."""
        return buckets.hull(self.cells) if self.cells else None
