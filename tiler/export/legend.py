"""Names of the classes of a raster, in the file beside it where GDAL and QGIS look for them."""

from __future__ import annotations

import os
from typing import Any
from xml.etree import ElementTree

from tiler.core.products import PRODUCTS
from tiler.export.geotiff import raster_errors
from tiler.export.mosaic import category_names
from tiler.export.work import WriteLegend
from tiler.io.cloud_reading import digest_of_file
from tiler.io.locations import cloud_path, folder_for, joined, state_of
from tiler.io.partial_files import appearing


def write_legend(store_url: str, work: WriteLegend) -> dict[str, Any]:
    """Write ``<out>/<product>.tif.aux.xml``; a `tiler.schedule.task.Work`.

    A GeoTIFF itself holds the colours of its classes, but GDAL keeps their names beside it.

    Parameters
    ----------
    store_url : str
    work : WriteLegend

    Returns
    -------
    dict
        ``path``, ``bytes``, ``digest`` and ``state``, as `write_cog` gives them.
    """
    root = ElementTree.Element("PAMDataset")
    band = ElementTree.SubElement(root, "PAMRasterBand", band="1")
    band.append(category_names(PRODUCTS[work.product].categories))
    ElementTree.indent(root)
    with folder_for(work.out) as folder:
        target = folder / work.name
        with raster_errors(target), appearing(target) as partial, open(partial, "wb") as stream:
            ElementTree.ElementTree(root).write(stream, encoding="utf-8")
            stream.flush()
            os.fsync(stream.fileno())
        record = {"path": target.name, "bytes": target.stat().st_size, "digest": digest_of_file(target)}
    return {**record, "state": state_of(cloud_path(joined(work.out, work.name))).to_json()}
