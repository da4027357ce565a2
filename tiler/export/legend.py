"""Names of the classes of a raster, in the file beside it where GDAL and QGIS look for them."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

from tiler.core.products import PRODUCTS
from tiler.export.mosaic import category_names
from tiler.export.whole_files import write_bytes
from tiler.export.work import WriteLegend


def write_legend(store_url: str, work: WriteLegend) -> dict[str, Any]:
    """Write ``<out>/<product>.tif.aux.xml``; a `tiler.schedule.task.Work`.

    A GeoTIFF itself holds the colours of its classes, but GDAL keeps their names beside it.

    The record is that of `tiler.export.whole_files.new_file`. Raises ProcessingError.
    """
    root = ElementTree.Element("PAMDataset")
    band = ElementTree.SubElement(root, "PAMRasterBand", band="1")
    band.append(category_names(PRODUCTS[work.product].categories))
    ElementTree.indent(root)
    return write_bytes(work.out, work.name, ElementTree.tostring(root, encoding="utf-8"))
