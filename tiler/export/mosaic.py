"""Writing of XML files next to rasters: a VRT (GDAL's virtual raster) over the sheets of a product, and class names."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

import rasterio.shutil
from affine import Affine
from rasterio.crs import CRS
from rasterio.io import MemoryFile

from tiler.core.crs import raster_crs
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.products import PRODUCTS
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.errors import ProcessingError
from tiler.export.cog import raster_metadata
from tiler.export.output_files import write_bytes
from tiler.export.records import FileRecord
from tiler.export.work import OutFile, ProductInfo
from tiler.io.raster_files import RasterMetadata
from tiler.store import TileStore

_TYPES = {"float32": "Float32", "uint8": "Byte"}


def write_mosaic(
    store: TileStore,
    *,
    to: OutFile,
    info: ProductInfo,
    sheets: tuple[tuple[str, RasterSpec], ...],
) -> FileRecord:
    """Write the VRT of a product over its sheets.

    ``sheets`` are at least one path relative to the folder of the file, and the pixels of each, on one lattice.
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
    _describe_band(band, raster_metadata(frame, info))
    for path, spec in sheets:
        _add_sheet(band, path, spec, whole, _TYPES[product.dtype])
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
        band.append(category_names(look.categories))
    if look.colours:
        table = ElementTree.SubElement(band, "ColorTable")
        for value in range(max(look.colours) + 1):
            red, green, blue = (str(c) for c in look.colours.get(value, (0, 0, 0)))
            ElementTree.SubElement(table, "Entry", c1=red, c2=green, c3=blue, c4="255")


def category_names(names: Sequence[str]) -> ElementTree.Element:
    """Return the element that names the values 0, 1, 2, ... of a raster of classes for GDAL."""
    element = ElementTree.Element("CategoryNames")
    for name in names:
        ElementTree.SubElement(element, "Category").text = name
    return element


def _add_sheet(
    band: ElementTree.Element, path: str, spec: RasterSpec, whole: RasterSpec, kind: str
) -> None:
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


def write_legend(_: TileStore, *, to: OutFile, product: str) -> FileRecord:
    """Write the names of the classes of a product's raster.

    A GeoTIFF contains the colours of its classes, but GDAL keeps their names in a file next to
    it.

    Return the `FileRecord`. Raise ProcessingError if the file cannot be written.
    """
    root = ElementTree.Element("PAMDataset")
    band = ElementTree.SubElement(root, "PAMRasterBand", band="1")
    band.append(category_names(PRODUCTS[product].categories))
    ElementTree.indent(root)
    return write_bytes(to, ElementTree.tostring(root, encoding="utf-8"))
