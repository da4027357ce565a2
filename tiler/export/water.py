"""Bodies of water as a file that a person can edit and give back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.water import Water
from tiler.export.work import WriteWater
from tiler.io.cloud_reading import digest_of_file
from tiler.io.locations import cloud_path, folder_for, joined, state_of
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
        ``path``, ``bytes``, ``digest``, ``state``: as those of `write_cog`; ``bodies``.
    """
    import shapely

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
    with folder_for(work.out) as folder:
        target = folder / work.name
        with geopackage(target, store.meta.frame.crs_wkt) as file:
            file.add(POLYGONS, "MultiPolygon", shapes, columns)
            lines = [shapely.LineString(flow / COUNTS_PER_UNIT) for _, flow in rivers]
            numbers = np.array([number for number, _ in rivers], np.int64)
            file.add(FLOW, "LineString Z", lines, {"number": numbers})
        record = {"path": target.name, "bytes": target.stat().st_size, "digest": digest_of_file(target)}
    state = state_of(cloud_path(joined(work.out, work.name))).to_json()
    return {**record, "state": state, "bodies": len(bodies)}


def _shape(body: Water) -> Any:
    """The polygons of a body, in units of the CRS."""
    import shapely

    return shapely.MultiPolygon([_rings(rings) for rings in body.area.polygons])


def _rings(rings: Sequence[npt.NDArray[np.int64]]) -> Any:
    import shapely

    return shapely.Polygon(rings[0] / COUNTS_PER_UNIT, [ring / COUNTS_PER_UNIT for ring in rings[1:]])
