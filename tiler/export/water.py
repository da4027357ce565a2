"""Bodies of water as a file that a person can edit and give back."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.water import Water
from tiler.export.whole_files import new_file
from tiler.export.work import WriteWater
from tiler.io.vector import geopackage
from tiler.store import open_store

POLYGONS, FLOW = "water", "flow"
"""Layers of the file."""


def write_water(store_url: str, work: WriteWater) -> dict[str, Any]:
    """Write bodies of water as ``<out>/water.gpkg``; a `tiler.schedule.task.Work`.

    Layer ``water``: polygons with ``number``, ``kind``, ``level`` (of a river the upper one), ``level_end``,
    ``area_m2`` and ``sure`` (0 to 1, empty where a person said so). Layer ``flow``: the line of each
    river, with the height of the water at each vertex.

    Returns
    -------
    dict
        As of `new_file`; ``bodies``.
    """
    store = open_store(store_url)
    bodies = store.all_waters(work.waters).bodies
    square = float(store.meta.frame.units.horizontal) ** 2
    shapes = [_shape(body) for body in bodies]
    columns = {
        "number": np.array([b.number for b in bodies], np.int64),
        "kind": np.array([b.kind for b in bodies], object),
        "level": np.array([b.range[0] for b in bodies], np.float64),
        "level_end": np.array([b.range[1] for b in bodies], np.float64),
        "area_m2": np.array([shape.area * square for shape in shapes], np.float64),
        "sure": np.array([np.nan if b.sure is None else b.sure for b in bodies], np.float64),
    }
    rivers = [(b.number, b.flow) for b in bodies if b.flow is not None]
    crs = store.meta.frame.crs_wkt
    with new_file(work.out, work.name) as (target, record), geopackage(target, crs) as file:
        file.add(POLYGONS, "MultiPolygon", shapes, columns)
        lines = [shapely.LineString(flow / COUNTS_PER_UNIT) for _, flow in rivers]
        file.add(FLOW, "LineString Z", lines, {"number": np.array([n for n, _ in rivers], np.int64)})
    return {**record, "bodies": len(bodies)}


def _shape(body: Water) -> Any:
    """The polygons of a body, in units of the CRS."""
    polygons = [[ring / COUNTS_PER_UNIT for ring in rings] for rings in body.area.polygons]
    return shapely.MultiPolygon([shapely.Polygon(outer, holes) for outer, *holes in polygons])
