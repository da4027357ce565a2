"""Polygons as an area in counts, in a separate module so that the child process has few imports."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely

from tiler.core.area import Area, Counts, segmentized
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.units import FARTHEST
from tiler.errors import InputError
from tiler.io.vector.reading import POLYGONS, Feature, read_in_crs


def read_area(path: Path, wkt: str | None) -> tuple[Area, list[str]]:
    """Return the polygons of a file in absolute counts of a CRS, and notes for the user.

    Raise InputError if the file cannot be read or its polygons have no area.
    """
    polygons = read_in_crs(path, POLYGONS, wkt)
    return area_in_counts(str(path), polygons.features), list(polygons.notes)


def area_in_counts(place: str, features: Sequence[Feature]) -> Area:
    """Return the polygons of features in absolute counts.

    Raise InputError, which names the file ``place``, if they have no area or a coordinate is
    too large.
    """
    geometries = [feature.geometry for feature in features]
    if np.abs(shapely.bounds(geometries)).max() >= FARTHEST:
        raise InputError(
            f"{place}: has a coordinate beyond {FARTHEST:g}; use coordinates in its CRS"
        )
    polygons = []
    for polygon in shapely.get_parts(geometries):
        polygons.append(
            tuple(_in_counts(ring) for ring in (polygon.exterior, *polygon.interiors))
        )
    area = Area(tuple(polygons))
    if area.bounds.empty:
        raise InputError(f"{place}: its polygons have no area; draw them wider")
    return area


def _in_counts(ring: shapely.LinearRing) -> Counts:
    corners = shapely.get_coordinates(ring)[:-1]
    return segmentized(np.rint(corners * COUNTS_PER_UNIT).astype(np.int64))
