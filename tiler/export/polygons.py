"""Polygons as GeoPackages: outline of the survey, decks of bridges, and index of the sheets of a product."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import rasterio.features
import rasterio.transform
import shapely
from affine import Affine

from ptd.arrays import AnyArray, Bool
from tiler.core.area import Area
from tiler.core.breaklines import rings_of
from tiler.core.drawn_sheets import StoredAreas
from tiler.core.edits import DrawnDeck
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.products import BARE, SURVEYED, VOID
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec
from tiler.export.output_files import (
    FileRecord,
    OutFile,
    OutlineFileRecord,
    SheetFile,
    new_file,
)
from tiler.io.vector import geopackage
from tiler.store import TileStore, coarse_values

POLYGON = 3
"""Number of the geometry type Polygon in shapely."""
COLUMNS = ("west", "south", "east", "north", "void_percent", "min", "max")


def write_outline(
    store: TileStore,
    *,
    to: OutFile,
    terrain: str,
    spec: RasterSpec,
    survey: str,
    coarse: RasterSpec,
    blocks: tuple[str, ...],
    area: str | None,
) -> OutlineFileRecord:
    """Write the outline of the survey as polygons.

    The outline is the edge of the terrain, pixel by pixel. The file has one polygon for each
    part of the survey, with its voids as holes, and with ``area_m2`` (without the voids),
    ``void_m2`` and ``void_percent`` (of both together).

    Parameters
    ----------
    store : TileStore
    to : OutFile
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

    Returns
    -------
    OutlineFileRecord
        Record of the file. Its rings are simplified for the map (`rings_of`).

    Raises
    ------
    ProcessingError
        The disk is full or the file cannot be written.
    """
    requested, pieces = store.area(area), []
    for block in (spec.block_named(name, BLOCK_PIXELS) for name in blocks):
        cells = coarse_values(store, survey, coarse, spec, block)
        # Pixels inside the survey that should have a height count, too, but no pixels in a void, even if facets
        # span it.
        covered = (cells == SURVEYED) | (cells == BARE)
        if not covered.all():
            heights = store.read_block(terrain, block)
            covered |= (heights != np.float32(NODATA)) & (cells != VOID)
        pieces.append(polygons_of(covered & spec.inside(block, requested), spec, block))
    parts = _joined(np.concatenate([np.empty(0, object), *pieces]))
    square = float(store.meta.frame.units.horizontal) ** 2
    land = shapely.area(parts) * square
    void = (
        np.array([sum(shapely.Polygon(ring).area for ring in part.interiors) for part in parts])
        * square
    )
    columns = {
        "area_m2": land,
        "void_m2": void,
        "void_percent": 100 * void / np.maximum(land + void, 1e-9),
    }
    with new_file(to) as new, geopackage(new.path, store.meta.frame.crs_wkt) as file:
        file.add("outline", "Polygon", list(parts), columns)
    size = float(spec.lattice.size / COUNTS_PER_UNIT)
    return OutlineFileRecord(
        **new.record.to_json(), polygons=len(parts), rings=rings_of(parts, size)
    )


def polygons_of(inside: Bool, spec: RasterSpec, block: Block) -> AnyArray:
    """Return polygons around the chosen pixels of a block, in units of the CRS.

    Parameters
    ----------
    inside : bool, shape (height, width)
        Mask of the chosen pixels.
    spec : RasterSpec
        Raster that contains the block.
    block : Block
    """
    to_units = Affine(*spec.window(block).transform(COUNTS_PER_UNIT))
    if inside.all():
        west, south, east, north = rasterio.transform.array_bounds(*inside.shape, to_units)
        return np.array([shapely.box(west, south, east, north)], object)
    shapes = rasterio.features.shapes(inside.astype(np.uint8), inside, transform=to_units)
    return np.array([shapely.geometry.shape(shape) for shape, _ in shapes], object)


def sheet_shape(store: TileStore, spec: RasterSpec, clip: StoredAreas | None) -> Any:
    """Return the polygons of a sheet in units of the CRS, without those of the sheets before it."""
    if clip is None:
        return shapely.box(*spec.edges)
    own, *earlier = (_shape(area) for area in store.areas(clip))
    parts = shapely.get_parts(shapely.difference(own, shapely.union_all(earlier)))
    return shapely.multipolygons(parts[shapely.get_type_id(parts) == POLYGON])


def _shape(area: Area) -> Any:
    rings = ([ring / COUNTS_PER_UNIT for ring in polygon] for polygon in area.polygons)
    polygons = [shapely.Polygon(outer, holes) for outer, *holes in rings]
    return shapely.union_all(shapely.make_valid(polygons))


def _joined(pieces: AnyArray) -> AnyArray:
    """Join the polygons of all blocks that share a side, and return the results from the north-west."""
    # Corners of blocks would stay as vertices on straight sides, so the polygons are
    # simplified.
    parts = shapely.normalize(
        shapely.simplify(shapely.get_parts(shapely.union_all(pieces)), 0.0)
    )
    parts = parts[(shapely.get_type_id(parts) == POLYGON) & ~shapely.is_empty(parts)]
    west, _, _, north = shapely.bounds(parts).T if len(parts) else np.empty((4, 0))
    polygons: AnyArray = parts[np.lexsort((west, -north))]
    return polygons


def write_bridges(store: TileStore, *, to: OutFile, decks: tuple[DrawnDeck, ...]) -> FileRecord:
    """Write the decks of bridges.

    The file has one polygon for the free part of each deck. Columns are ``length_m``,
    ``width_m``, ``clearance_m`` (height above the surface next to it) and ``points_below``.
    There are more than a few points below a deck only where the scanner looked from the side.

    Return the `FileRecord`. Raise ProcessingError if the file cannot be written.
    """
    shapes = [
        shapely.Polygon(np.array(ring).reshape(-1, 2) / COUNTS_PER_UNIT) for ring, *_ in decks
    ]
    sizes = np.array([deck[1:] for deck in decks], np.float64).reshape(-1, 4)
    columns = dict(zip(("length_m", "width_m", "clearance_m"), sizes.T, strict=False))
    with new_file(to) as new, geopackage(new.path, store.meta.frame.crs_wkt) as file:
        file.add(
            "bridges",
            "Polygon",
            shapes,
            {**columns, "points_below": sizes[:, 3].astype(np.int32)},
        )
    return new.record


def find_sheets(
    store: TileStore,
    *,
    rasters: tuple[str, ...],
    spec: RasterSpec,
    block: Block,
    width: int,
    height: int,
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
    width, height : int
        Pixels of a sheet. Sheets are anchored at CRS 0, as pixels are.
    area : str or None
        Key in the store of the requested area.

    Returns
    -------
    dict
        ``sheets``: column and row on the lattice of sheets, ascending.
    """
    there = _with_height(store, rasters, spec, block, area)
    rows, cols = np.nonzero(there)
    ix = (spec.west + block.col + cols) // width
    iy = (spec.north - 1 - block.row - rows) // height
    return {"sheets": np.unique(np.stack((ix, iy)), axis=1).T.tolist()}


def find_drawn_sheets(
    store: TileStore,
    *,
    rasters: tuple[str, ...],
    spec: RasterSpec,
    block: Block,
    sheets: StoredAreas,
    area: str | None,
) -> Mapping[str, Any]:
    """Find the sheets that the user drew in which one block of the models has a height.

    Parameters
    ----------
    store, rasters, spec, block, area
        See `find_sheets`.
    sheets : StoredAreas
        Areas of the sheets near the block, in the order of their file.

    Returns
    -------
    dict
        ``sheets``: keys of those with a height. ``outside``: number of pixels with a height in no sheet.
    """
    there = _with_height(store, rasters, spec, block, area)
    found = []
    for key, shape in zip(sheets.keys, store.areas(sheets), strict=True):
        inside = there & spec.inside(block, shape)
        if inside.any():
            found.append(key)
            there &= ~inside
    return {"sheets": found, "outside": int(np.count_nonzero(there))}


def _with_height(
    store: TileStore, rasters: tuple[str, ...], spec: RasterSpec, block: Block, area: str | None
) -> Bool:
    """Return the mask of the pixels of a block in the area in which one of the rasters has a height."""
    there = np.zeros((block.height, block.width), np.bool_)
    for raster in rasters:
        there |= store.read_block(raster, block) != np.float32(NODATA)
    return there & spec.inside(block, store.area(area))


def write_sheet_index(
    store: TileStore, *, to: OutFile, sheets: tuple[SheetFile, ...]
) -> FileRecord:
    """Write the index of the sheets, a layer per product with a polygon per sheet: its bounds, or what the user drew.

    Columns are ``location`` (path relative to the folder of the file, with the column name of gdaltindex), ``west``,
    ``south``, ``east``, ``north``, ``void_percent`` (share of the pixels without a value), ``min`` and ``max``.

    Return the `FileRecord`. Raise ProcessingError if the file cannot be written.
    """
    with new_file(to) as new, geopackage(new.path, store.meta.frame.crs_wkt) as file:
        for product in dict.fromkeys(sheet.product for sheet in sheets):
            product_sheets = [sheet for sheet in sheets if sheet.product == product]
            edges = np.array([sheet.spec.edges for sheet in product_sheets])
            # A height of None becomes NaN, which is NULL in the file.
            figures = np.array(
                [(s.void_percent, s.low, s.high) for s in product_sheets], np.float64
            )
            numbers = dict(zip(COLUMNS, np.hstack((edges, figures)).T, strict=True))
            columns = {
                "location": np.array([sheet.path for sheet in product_sheets], object),
                **numbers,
            }
            shapes = [sheet_shape(store, sheet.spec, sheet.clip) for sheet in product_sheets]
            is_drawn = any(sheet.clip for sheet in product_sheets)
            file.add(product, "MultiPolygon" if is_drawn else "Polygon", shapes, columns)
    return new.record
