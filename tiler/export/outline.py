"""The outline of the survey as polygons."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import rasterio.features
import shapely
from affine import Affine

from tiler.core.area import Area
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.products import BEYOND, VOID
from tiler.core.raster import Block, RasterSpec
from tiler.export.whole_files import new_file
from tiler.export.work import WriteOutline
from tiler.io.vector import geopackage
from tiler.store import open_store

LAYER = "outline"
MOST_VERTICES = 8_000
"""Most vertices of the outline on the map of the report."""


def write_outline(store_url: str, work: WriteOutline) -> dict[str, Any]:
    """Write the outline of the survey as ``<out>/outline.gpkg``; a `tiler.schedule.task.Work`.

    A polygon for each part of the survey, with its voids as holes: ``area_m2`` (without them), ``void_m2``,
    ``void_percent`` (of both together).

    Returns
    -------
    dict
        As of `new_file`; ``polygons``; ``rings``: for a map, each as
        x, y, x, y, ... in units of the CRS, with no more detail than `MOST_VERTICES` allow.

    Raises
    ------
    ProcessingError
        The disk is full or the file cannot be written.
    """
    store, spec = open_store(store_url), work.coarse
    cells = store.read_block(work.survey, Block(0, 0, spec.height, spec.width))
    parts = polygons_of(cells, spec, store.area(work.area))
    square = float(store.meta.frame.units.horizontal) ** 2
    area = shapely.area(parts) * square
    void = np.array([sum(shapely.Polygon(ring).area for ring in part.interiors) for part in parts]) * square
    columns = {"area_m2": area, "void_m2": void, "void_percent": 100 * void / np.maximum(area + void, 1e-9)}
    crs = store.meta.frame.crs_wkt
    with new_file(work.out, work.name) as (target, record), geopackage(target, crs) as file:
        file.add(LAYER, "Polygon", list(parts), {k: np.asarray(v, np.float64) for k, v in columns.items()})
    size = float(spec.lattice.size / COUNTS_PER_UNIT)
    return {**record, "polygons": len(parts), "rings": rings_of(parts, size)}


def rings_of(parts: npt.NDArray[Any], size: float) -> list[list[float]]:
    """Rings of polygons, without steps of ``size`` and, if they are too many for a page, with steps twice as wide."""
    while True:
        simple = shapely.simplify(parts, size)
        simple = simple[~shapely.is_empty(simple)]
        if shapely.get_num_coordinates(simple).sum() <= MOST_VERTICES or len(simple) > MOST_VERTICES / 4:
            break
        size *= 2
    rings = shapely.get_rings(simple)[: MOST_VERTICES // 4]
    return [np.round(shapely.get_coordinates(ring), 3).ravel().tolist() for ring in rings]


def polygons_of(cells: npt.NDArray[np.float32], spec: RasterSpec, area: Area | None) -> npt.NDArray[Any]:
    """Polygons around the cells of a survey, in units of the CRS, from the north-west; voids are holes.

    Parameters
    ----------
    cells : float32, shape (height, width)
        See `tiler.core.products.BEYOND`.
    spec : RasterSpec
        Of the cells.
    area : Area or None
        What lies outside of it is left out.
    """
    inside = (cells != BEYOND) & (cells != VOID)
    shapes = rasterio.features.shapes(
        inside.astype(np.uint8), inside, transform=Affine(*spec.transform(COUNTS_PER_UNIT))
    )
    found = [shapely.geometry.shape(shape) for shape, _ in shapes]
    if area is not None:
        wanted = shapely.union_all([_polygon(rings) for rings in area.polygons])
        parts = shapely.get_parts(shapely.intersection(np.array(found, object), wanted))
        found = [part for part in parts if part.geom_type == "Polygon" and not part.is_empty]
    return np.array(found, object)


def _polygon(rings: tuple[npt.NDArray[np.int64], ...]) -> Any:
    """A polygon of an area, by an odd number of crossings."""
    shape = shapely.Polygon()
    for ring in rings:
        shape = shapely.symmetric_difference(
            shape, shapely.make_valid(shapely.Polygon(ring / COUNTS_PER_UNIT))
        )
    return shape
