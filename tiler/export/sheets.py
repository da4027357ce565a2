"""Sheets of products: search for sheets with a height, and the index of the sheets as a GeoPackage."""

from __future__ import annotations

import numpy as np
import shapely

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.nodata import NODATA
from tiler.core.raster import RasterSpec
from tiler.export.output_files import new_file
from tiler.export.records import FileRecord, SheetsRecord
from tiler.export.work import FindSheets, WriteSheetIndex
from tiler.io.vector import geopackage
from tiler.store import open_store


def find_sheets(store_url: str, work: FindSheets) -> SheetsRecord:
    """Find the sheets in which one block of the models has a height (a `tiler.schedule.task.Work`).

    Returns
    -------
    SheetsRecord
        Record of the block.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    there = np.zeros((block.height, block.width), np.bool_)
    for raster in work.rasters:
        there |= store.read_block(raster, block) != np.float32(NODATA)
    there &= spec.inside(block, store.area(work.area))
    rows, cols = np.nonzero(there)
    ix = (spec.west + block.col + cols) // work.side
    iy = (spec.north - 1 - block.row - rows) // work.side
    return SheetsRecord(np.unique(np.stack((ix, iy)), axis=1).T.tolist())


COLUMNS = ("west", "south", "east", "north", "void_percent", "min", "max")


def write_sheet_index(store_url: str, work: WriteSheetIndex) -> FileRecord:
    """Write ``<out>/sheets.gpkg``, a layer per product with a polygon per sheet (a `tiler.schedule.task.Work`).

    Columns are ``location`` (path relative to the folder of the file, with the column name of gdaltindex), ``west``,
    ``south``, ``east``, ``north``, ``void_percent`` (share of the pixels without a value), ``min`` and ``max``.

    Return the `FileRecord`. Raise ProcessingError if the file cannot be written.
    """
    crs = open_store(store_url).meta.frame.crs_wkt
    with new_file(work.out, work.name) as new, geopackage(new.path, crs) as file:
        for product in dict.fromkeys(sheet.product for sheet in work.sheets):
            product_sheets = [sheet for sheet in work.sheets if sheet.product == product]
            edges = np.array([_edges(sheet.spec) for sheet in product_sheets])
            # A height of None becomes NaN, which is NULL in the file.
            figures = np.array(
                [(s.void_percent, s.low, s.high) for s in product_sheets], np.float64
            )
            numbers = dict(zip(COLUMNS, np.hstack((edges, figures)).T, strict=True))
            columns = {
                "location": np.array([sheet.path for sheet in product_sheets], object),
                **numbers,
            }
            file.add(product, "Polygon", list(shapely.box(*edges.T)), columns)
    return new.record


def _edges(spec: RasterSpec) -> tuple[float, float, float, float]:
    """Return the west, south, east and north edge of a raster in units of the CRS."""
    size = spec.lattice.size / COUNTS_PER_UNIT
    west, north = spec.west * size, spec.north * size
    return (
        float(west),
        float(north - spec.height * size),
        float(west + spec.width * size),
        float(north),
    )
