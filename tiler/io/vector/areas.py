"""Polygons of a file as an area in counts; a module of its own, as a child process that reads one imports no more."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely

from tiler.core.area import Area, shortened
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.units import FARTHEST
from tiler.errors import InputError
from tiler.io.vector.reading import POLYGONS, Feature, read_in_crs


def read_area(path: Path, wkt: str | None) -> tuple[Area, list[str]]:
    """The polygons of a file in absolute counts of a CRS, and what was decided about them; raises InputError."""
    found = read_in_crs(path, POLYGONS, wkt)
    return area_in_counts(str(path), found.features), list(found.notes)


def area_in_counts(place: str, features: Sequence[Feature]) -> Area:
    """The polygons of features in absolute counts; raises InputError, which names the place, where they hold none."""
    rings = [
        [shapely.get_coordinates(ring) for ring in (polygon.exterior, *polygon.interiors)]
        for feature in features
        for polygon in shapely.get_parts(feature.geometry)
    ]
    if any(np.abs(ring).max() >= FARTHEST for rs in rings for ring in rs):
        raise InputError(f"{place}: has a place farther away than {FARTHEST:g}; write coordinates of its CRS")
    counts = tuple(
        tuple(shortened(np.rint(r[:-1] * COUNTS_PER_UNIT).astype(np.int64)) for r in rs) for rs in rings
    )
    area = Area(counts)
    if area.bounds.empty:
        raise InputError(f"{place}: its polygons hold no place; draw them wider")
    return area
