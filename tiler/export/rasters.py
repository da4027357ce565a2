"""Writing of rasters of the store: cloud-optimised GeoTIFFs (COG), VRTs over sheets, and names of classes.

A COG has its overviews before the full resolution, so blocks cannot be written in their order.
They go to a plain tiled GeoTIFF, which GDAL's COG driver then copies with bounded memory. Both
are scratch files next to the target until the COG is complete. The plain file needs up to 4
bytes per pixel, and nothing for blocks without data.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import rasterio
import rasterio.shutil
from affine import Affine
from rasterio.crs import CRS
from rasterio.io import MemoryFile
from rasterio.windows import Window

from ptd.arrays import AnyArray, Bool, Float32
from tiler.core.crs import raster_crs
from tiler.core.drawn_sheets import StoredAreas
from tiler.core.lattice import COUNTS_PER_UNIT, CoordFrame
from tiler.core.products import HEIGHT, PRODUCTS, Product
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec
from tiler.core.units import unit_label
from tiler.errors import ProcessingError
from tiler.export.output_files import (
    FileRecord,
    OutFile,
    ProductInfo,
    RasterFileRecord,
    RasterPart,
    new_file,
    write_bytes,
)
from tiler.io.atomic_files import clear_partial, partial_path, replace_different, sync_folder
from tiler.io.raster_files import CACHE_BYTES, RasterMetadata, plain_geotiff, raster_errors
from tiler.store import TileStore, read_cells

_TYPES = {"float32": "Float32", "uint8": "Byte"}


@dataclass(frozen=True)
class Statistics:
    """Statistics of the valid pixels. Blocks are merged in a fixed order, so the result does not depend on tiles."""

    n: int = 0
    low: float = math.inf
    high: float = -math.inf
    mean: float = 0.0
    squares: float = 0.0

    def merged(self, block: AnyArray, nodata: float | None = NODATA) -> Statistics:
        """Return the statistics with one more block (Chan, Golub and LeVeque 1979, eq. 2.1)."""
        valid = block.ravel()
        if nodata is not None:
            valid = valid[valid != np.float32(nodata)]
        values = valid.astype(np.float64)
        if values.size == 0:
            return self
        n, mean = self.n + values.size, float(values.mean())
        shift = mean - self.mean
        return Statistics(
            n,
            min(self.low, float(values.min())),
            max(self.high, float(values.max())),
            self.mean + shift * values.size / n,
            self.squares
            + float(((values - mean) ** 2).sum())
            + shift**2 * self.n * values.size / n,
        )

    def tags(self, pixels: int) -> dict[str, str]:
        """Return GDAL's metadata items of a band with ``pixels`` pixels."""
        tags = {"STATISTICS_VALID_PERCENT": f"{100 * self.n / pixels:.4g}"}
        if self.n:
            tags |= {
                "STATISTICS_MINIMUM": repr(self.low),
                "STATISTICS_MAXIMUM": repr(self.high),
                "STATISTICS_MEAN": repr(self.mean),
                "STATISTICS_STDDEV": repr(math.sqrt(self.squares / self.n)),
            }
        return tags


def write_cog(
    store: TileStore,
    *,
    to: OutFile,
    info: ProductInfo,
    part: RasterPart,
    compress: str,
    clip: StoredAreas | None = None,
) -> RasterFileRecord:
    """Write a raster of the store, or a sheet of it, as one file, compressed by ``deflate`` or ``zstd``.

    ``clip`` has the area of a drawn sheet and the areas before it, whose pixels belong to other sheets. It is None for
    other files.

    The same content gives the same bytes, since the file does not contain time, path, workers
    or tiles.

    Returns
    -------
    RasterFileRecord
        Record of the file.

    Raises
    ------
    ProcessingError
        The disk is full or the file cannot be written.
    """
    with new_file(to) as file:
        statistics, own = _write(store, info, part, compress, clip, file.path)
    is_empty = statistics.n == 0
    return RasterFileRecord(
        **file.record.to_json(),
        pixels=part.spec.height * part.spec.width,
        valid=statistics.n,
        own=own,
        min=None if is_empty else statistics.low,
        max=None if is_empty else statistics.high,
        mean=None if is_empty else statistics.mean,
    )


def _write(
    store: TileStore,
    info: ProductInfo,
    part: RasterPart,
    compress: str,
    clip: StoredAreas | None,
    target: Path,
) -> tuple[Statistics, int]:
    """Write a raster to a file on this machine. Return statistics and number of the pixels that belong to it."""
    plain = partial_path(target, "plain")
    partial = partial_path(target, "cog")
    with raster_errors(target):
        clear_partial(plain)
        clear_partial(partial)
    try:
        statistics, own = _write_plain(store, info, part, clip, plain)
        _copy_as_cog(plain, partial, compress, _product(info))
        _check(partial, part.spec)
        _publish(partial, target)
        return statistics, own
    finally:
        for scratch in (plain, partial, *target.parent.glob(f"{partial.name}.*")):
            with suppress(FileNotFoundError):
                scratch.unlink()


def in_sheet(
    store: TileStore, spec: RasterSpec, clip: StoredAreas | None, block: Block
) -> Bool:
    """Return the mask of the pixels of a block that belong to a drawn sheet, or of all pixels without one."""
    mask = np.ones((block.height, block.width), np.bool_)
    for number, area in enumerate(store.areas(clip) if clip is not None else ()):
        inside = spec.inside(block, area)
        mask &= inside if number == 0 else ~inside
    return mask


def _product(info: ProductInfo) -> Product:
    """Return the product with the nodata value of its file."""
    product = PRODUCTS[info.product]
    if info.nodata is None:
        return product
    return replace(product, nodata=info.nodata)


def _write_plain(
    store: TileStore,
    info: ProductInfo,
    part: RasterPart,
    clip: StoredAreas | None,
    path: Path,
) -> tuple[Statistics, int]:
    """Copy the raster block by block, row by row from the north-west."""
    spec = part.spec
    statistics, of_sheet, own = Statistics(), Statistics(), 0
    nodata = PRODUCTS[info.product].nodata
    look = _raster_metadata(store.meta.frame, info)
    with plain_geotiff(
        path, spec.height, spec.width, spec.transform(COUNTS_PER_UNIT), look
    ) as raster:
        for block in spec.blocks(BLOCK_PIXELS):
            values = _read(store, part, block)
            own_mask = in_sheet(store, spec, clip, block)
            own += int(own_mask.sum())
            if part.area is not None or clip is not None:
                inside = own_mask & spec.inside(block, store.area(part.area))
                values = np.where(inside, values, np.float32(part.fill))
            statistics = statistics.merged(values, nodata)
            if clip is not None:
                of_sheet = of_sheet.merged(values[own_mask], nodata)
            if nodata is None or np.any(values != np.float32(nodata)):
                if look.nodata != nodata:
                    values = np.where(
                        values == np.float32(nodata), np.float32(look.nodata), values
                    )
                raster.write(values, block.row, block.col)
        raster.tag_band({**look.meanings, **statistics.tags(spec.height * spec.width)})
    return statistics if clip is None else of_sheet, own


def _read(store: TileStore, part: RasterPart, block: Block) -> Float32:
    """Return a block of the file. Pixels beyond the raster of the store have the value ``fill``."""
    spec, whole = part.spec, part.whole or part.spec
    row, col = block.row + whole.north - spec.north, block.col + spec.west - whole.west
    window = replace(block, row=row, col=col)
    return read_cells(store, part.raster, whole, window, part.fill)


def _raster_metadata(frame: CoordFrame, info: ProductInfo) -> RasterMetadata:
    product = _product(info)
    unit = product.unit
    if unit == HEIGHT:
        unit = unit_label(frame.units.vertical)
    return RasterMetadata(
        crs=raster_crs(frame.crs_wkt),
        unit=unit,
        description=product.description,
        tags=info.tags,
        dtype=product.dtype,
        nodata=product.nodata,
        colours=product.colours,
        meanings={f"VALUE_{value}": text for value, text in product.values.items()},
        categories=product.categories,
    )


def _copy_as_cog(plain: Path, partial: Path, compress: str, product: Product) -> None:
    """Copy a GeoTIFF as COG: GDAL orders, compresses and builds overviews in one thread and bounded memory."""
    options = {
        "COMPRESS": compress.upper(),
        "PREDICTOR": product.predictor,
        "OVERVIEW_PREDICTOR": product.predictor,
        "BLOCKSIZE": BLOCK_PIXELS,
        "OVERVIEW_RESAMPLING": product.resampling,
        "OVERVIEWS": "AUTO",
        "BIGTIFF": "IF_SAFER",
        "NUM_THREADS": 1,
        "STATISTICS": "AUTO",  # The statistics of the plain file are kept.
    }
    with rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES, GDAL_NUM_THREADS=1), raster_errors(partial):
        partial.unlink(missing_ok=True)
        rasterio.shutil.copy(plain, partial, driver="COG", **options)


def _check(partial: Path, spec: RasterSpec) -> None:
    """Read the last block and raise ProcessingError if it is damaged.

    GDAL may notice a full disk only when it closes the file, and may not report it.
    """
    row = (spec.height - 1) // BLOCK_PIXELS * BLOCK_PIXELS
    col = (spec.width - 1) // BLOCK_PIXELS * BLOCK_PIXELS
    last = spec.block_at(row, col, BLOCK_PIXELS)
    with raster_errors(partial), rasterio.open(partial) as raster:
        if raster.shape != (spec.height, spec.width):
            raise ProcessingError(
                f"{partial}: {raster.shape} pixels instead of {(spec.height, spec.width)}"
            )
        raster.read(1, window=Window(last.col, last.row, last.width, last.height))


def _publish(partial: Path, target: Path) -> None:
    """Give a complete file its final name, and sync it to the disk."""
    with raster_errors(target):
        # Windows cannot sync a file that is open only for reading.
        with open(partial, "rb+") as stream:
            os.fsync(stream.fileno())
        replace_different(partial, target)
        sync_folder(target.parent)


def write_mosaic(
    store: TileStore,
    *,
    to: OutFile,
    info: ProductInfo,
    sheets: tuple[tuple[str, RasterSpec], ...],
    outside: float | None = None,
) -> FileRecord:
    """Write the VRT of a product over its sheets.

    ``sheets`` are at least one path relative to the folder of the file, and the pixels of each, on one lattice.
    ``outside`` is the value of pixels that belong to other sheets, if the bounds of sheets overlap.
    Return the `FileRecord`. Raise ProcessingError if the file cannot be written.
    """
    frame, product = store.meta.frame, PRODUCTS[info.product]
    whole = _hull([spec for _, spec in sheets])
    root = ElementTree.Element(
        "VRTDataset", rasterXSize=str(whole.width), rasterYSize=str(whole.height)
    )
    crs = raster_crs(frame.crs_wkt)
    if crs is not None:
        root.append(_srs(crs))
    a, b, c, d, e, f = whole.transform(COUNTS_PER_UNIT)
    ElementTree.SubElement(root, "GeoTransform").text = ", ".join(
        repr(v) for v in (c, a, b, f, d, e)
    )
    _add_metadata(root, {"AREA_OR_POINT": "Area", **info.tags})
    band = ElementTree.SubElement(
        root, "VRTRasterBand", dataType=_TYPES[product.dtype], band="1"
    )
    _describe_band(band, _raster_metadata(frame, info))
    for path, spec in sheets:
        source = _add_sheet(band, path, spec, whole, _TYPES[product.dtype])
        if outside is not None:
            source.tag = "ComplexSource"
            ElementTree.SubElement(source, "NODATA").text = f"{outside:.17g}"
    ElementTree.indent(root)
    return write_bytes(to, ElementTree.tostring(root, encoding="utf-8"))


def _srs(crs: str) -> ElementTree.Element:
    """Return the SRS element that GDAL writes for a file in this CRS.

    It contains the mapping of columns and rows to the axes of the CRS.
    """
    profile = {"driver": "GTiff", "width": 1, "height": 1, "count": 1, "dtype": "uint8"}
    with MemoryFile() as memory, MemoryFile(ext=".vrt") as copy:
        with memory.open(**profile, crs=CRS.from_user_input(crs), transform=Affine.scale(2.0)):
            pass
        with memory.open() as pixel:
            rasterio.shutil.copy(pixel, copy.name, driver="VRT")
        srs = ElementTree.fromstring(copy.read()).find("SRS")
    if srs is None:
        raise ProcessingError(
            f"GDAL cannot write the CRS {crs[:60]} into a VRT; export without --sheets"
        )
    return srs


def _hull(specs: list[RasterSpec]) -> RasterSpec:
    west, north = min(s.west for s in specs), max(s.north for s in specs)
    south, east = min(s.north - s.height for s in specs), max(s.west + s.width for s in specs)
    return RasterSpec(specs[0].lattice, west, north, north - south, east - west)


def _add_metadata(parent: ElementTree.Element, tags: dict[str, str]) -> None:
    metadata = ElementTree.SubElement(parent, "Metadata")
    for key, value in tags.items():
        ElementTree.SubElement(metadata, "MDI", key=key).text = value


def _describe_band(band: ElementTree.Element, look: RasterMetadata) -> None:
    """Add the metadata of the bands of the sheets' files, in the order that GDAL's schema requires."""
    _add_metadata(band, dict(look.meanings))
    ElementTree.SubElement(band, "Description").text = look.description
    if look.unit:
        ElementTree.SubElement(band, "UnitType").text = look.unit
    if look.nodata is not None:
        ElementTree.SubElement(band, "NoDataValue").text = f"{look.nodata:.17g}"
    ElementTree.SubElement(band, "ColorInterp").text = "Palette" if look.colours else "Gray"
    if look.categories:
        band.append(_category_names(look.categories))
    if look.colours:
        table = ElementTree.SubElement(band, "ColorTable")
        for value in range(max(look.colours) + 1):
            red, green, blue = (str(c) for c in look.colours.get(value, (0, 0, 0)))
            ElementTree.SubElement(table, "Entry", c1=red, c2=green, c3=blue, c4="255")


def _category_names(names: Sequence[str]) -> ElementTree.Element:
    """Return the element that names the values 0, 1, 2, ... of a raster of classes for GDAL."""
    element = ElementTree.Element("CategoryNames")
    for name in names:
        ElementTree.SubElement(element, "Category").text = name
    return element


def _add_sheet(
    band: ElementTree.Element, path: str, spec: RasterSpec, whole: RasterSpec, kind: str
) -> ElementTree.Element:
    source = ElementTree.SubElement(band, "SimpleSource")
    ElementTree.SubElement(source, "SourceFilename", relativeToVRT="1").text = path
    ElementTree.SubElement(source, "SourceBand").text = "1"
    size = (str(spec.width), str(spec.height))
    block = dict(zip(("RasterXSize", "RasterYSize"), size, strict=True))
    block |= {
        "DataType": kind,
        "BlockXSize": str(BLOCK_PIXELS),
        "BlockYSize": str(BLOCK_PIXELS),
    }
    ElementTree.SubElement(source, "SourceProperties", block)
    offset = (str(spec.west - whole.west), str(whole.north - spec.north))
    for name, (x, y) in (("SrcRect", ("0", "0")), ("DstRect", offset)):
        ElementTree.SubElement(source, name, xOff=x, yOff=y, xSize=size[0], ySize=size[1])
    return source


def write_legend(_: TileStore, *, to: OutFile, product: str) -> FileRecord:
    """Write the names of the classes of a product's raster.

    A GeoTIFF contains the colours of its classes, but GDAL keeps their names in a file next to
    it.

    Return the `FileRecord`. Raise ProcessingError if the file cannot be written.
    """
    root = ElementTree.Element("PAMDataset")
    band = ElementTree.SubElement(root, "PAMRasterBand", band="1")
    band.append(_category_names(PRODUCTS[product].categories))
    ElementTree.indent(root)
    return write_bytes(to, ElementTree.tostring(root, encoding="utf-8"))
