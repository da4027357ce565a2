"""Decks of bridges that were left out of the terrain, as polygons."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.export.work import WriteBridges
from tiler.io.cloud_reading import digest_of_file
from tiler.io.locations import cloud_path, folder_for, joined, state_of
from tiler.io.vector import geopackage
from tiler.store import open_store

LAYER = "bridges"


def write_bridges(store_url: str, work: WriteBridges) -> dict[str, Any]:
    """Write ``<out>/bridges.gpkg``; a `tiler.schedule.task.Work`.

    A polygon for the free part of each deck: ``length_m``, ``width_m``, ``clearance_m`` (height above what lies beside
    it), ``points_below`` (seen beneath it, which is more than likely only where the scanner looked from the side).

    Parameters
    ----------
    store_url : str
    work : WriteBridges

    Returns
    -------
    dict
        ``path``, ``bytes``, ``digest``, ``state``: as those of `write_cog`.

    Raises
    ------
    ProcessingError
        The disk is full or the file cannot be written.
    """
    shapes = [shapely.Polygon(np.array(ring).reshape(-1, 2) / COUNTS_PER_UNIT) for ring, *_ in work.decks]
    sizes = np.array([deck[1:] for deck in work.decks], np.float64).reshape(-1, 4)
    columns = dict(zip(("length_m", "width_m", "clearance_m"), sizes.T, strict=False))
    with folder_for(work.out) as folder:
        target = folder / work.name
        with geopackage(target, open_store(store_url).meta.frame.crs_wkt) as file:
            file.add(LAYER, "Polygon", shapes, {**columns, "points_below": sizes[:, 3].astype(np.int32)})
        record = {"path": target.name, "bytes": target.stat().st_size, "digest": digest_of_file(target)}
    return {**record, "state": state_of(cloud_path(joined(work.out, work.name))).to_json()}
