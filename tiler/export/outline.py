"""Outline of the survey as polygons."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import rasterio.features
import rasterio.transform
import shapely
from affine import Affine

from tiler.core.breaklines import rings_of
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.products import BARE, SURVEYED, VOID
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec
from tiler.export.output_files import new_file
from tiler.export.records import OutlineFileRecord
from tiler.export.work import OutFile
from tiler.io.vector import geopackage
from tiler.store import TileStore, coarse_values

LAYER = "outline"
POLYGON = 3
"""Number of the geometry type Polygon in shapely."""


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
    parts = joined(np.concatenate([np.empty(0, object), *pieces]))
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
    crs = store.meta.frame.crs_wkt
    with new_file(to) as new, geopackage(new.path, crs) as file:
        file.add(
            LAYER,
            "Polygon",
            list(parts),
            {k: np.asarray(v, np.float64) for k, v in columns.items()},
        )
    size = float(spec.lattice.size / COUNTS_PER_UNIT)
    return OutlineFileRecord(
        **new.record.to_json(), polygons=len(parts), rings=rings_of(parts, size)
    )


def polygons_of(
    inside: npt.NDArray[np.bool_], spec: RasterSpec, block: Block
) -> npt.NDArray[Any]:
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


def joined(pieces: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Join the polygons of all blocks that share a side, and return the results from the north-west."""
    # Corners of blocks would stay as vertices on straight sides, so the polygons are
    # simplified.
    parts = shapely.normalize(
        shapely.simplify(shapely.get_parts(shapely.union_all(pieces)), 0.0)
    )
    parts = parts[(shapely.get_type_id(parts) == POLYGON) & ~shapely.is_empty(parts)]
    west, _, _, north = shapely.bounds(parts).T if len(parts) else np.empty((4, 0))
    polygons: npt.NDArray[Any] = parts[np.lexsort((west, -north))]
    return polygons
