"""Sheets of products: search for sheets with a height, and the index of the sheets as a GeoPackage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely

from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.products import NODATA
from tiler.core.raster import Block, RasterSpec
from tiler.export.output_files import new_file
from tiler.export.records import FileRecord
from tiler.export.work import OutFile, SheetFile
from tiler.io.vector import geopackage
from tiler.store import TileStore


def find_sheets(
    store: TileStore,
    *,
    rasters: tuple[str, ...],
    spec: RasterSpec,
    block: Block,
    side: int,
    area: str | None,
) -> Mapping[str, Any]:
    """Find the sheets in which one block of the models has a height.

    Parameters
    ----------
    store : TileStore
    rasters : tuple of str
        Rasters of the models in the store.
    spec : RasterSpec
        Pixels of these rasters.
    block : Block
    side : int
        Side of a sheet in pixels. Sheets are anchored at CRS 0, as pixels are.
    area : str or None
        Key in the store of the requested area.

    Returns
    -------
    dict
        ``sheets``: column and row on the lattice of sheets, ascending.
    """
    there = np.zeros((block.height, block.width), np.bool_)
    for raster in rasters:
        there |= store.read_block(raster, block) != np.float32(NODATA)
    there &= spec.inside(block, store.area(area))
    rows, cols = np.nonzero(there)
    ix = (spec.west + block.col + cols) // side
    iy = (spec.north - 1 - block.row - rows) // side
    return {"sheets": np.unique(np.stack((ix, iy)), axis=1).T.tolist()}


COLUMNS = ("west", "south", "east", "north", "void_percent", "min", "max")


def write_sheet_index(
    store: TileStore, *, to: OutFile, sheets: tuple[SheetFile, ...]
) -> FileRecord:
    """Write the index of the sheets, a layer per product with a polygon per sheet.

    Columns are ``location`` (path relative to the folder of the file, with the column name of gdaltindex), ``west``,
    ``south``, ``east``, ``north``, ``void_percent`` (share of the pixels without a value), ``min`` and ``max``.

    Return the `FileRecord`. Raise ProcessingError if the file cannot be written.
    """
    crs = store.meta.frame.crs_wkt
    with new_file(to) as new, geopackage(new.path, crs) as file:
        for product in dict.fromkeys(sheet.product for sheet in sheets):
            product_sheets = [sheet for sheet in sheets if sheet.product == product]
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
