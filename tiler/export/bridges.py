"""Decks of bridges that were left out of the terrain, as polygons."""

from __future__ import annotations

import numpy as np
import shapely

from tiler.core.edits import DrawnDeck
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.export.output_files import new_file
from tiler.export.records import FileRecord
from tiler.export.work import OutFile
from tiler.io.vector import geopackage
from tiler.store import TileStore

LAYER = "bridges"


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
    crs = store.meta.frame.crs_wkt
    with new_file(to) as new, geopackage(new.path, crs) as file:
        file.add(
            LAYER, "Polygon", shapes, {**columns, "points_below": sizes[:, 3].astype(np.int32)}
        )
    return new.record
