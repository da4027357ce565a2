"""Lines and rings of drawn and detected features in run.json, for the map of the report."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from tiler.core.area import Area
from tiler.core.breaklines import Counts
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.terrain_results import Rings

MAX_PLACES = 20_000
"""Maximum number of vertices of all edits, all breaklines or all water on a page."""

MAX_VERTICES = 8_000
"""Maximum number of vertices of the outline on the map of the report."""


def drawn(lines: Sequence[Counts]) -> Rings:
    """Return lines as x, y, x, y, ... in units of the CRS, or no lines if they have too many vertices for a page."""
    if sum(map(len, lines)) > MAX_PLACES:
        return []
    return [(line[:, :2] / COUNTS_PER_UNIT).ravel().tolist() for line in lines]


def rings_of_areas(areas: Sequence[Area]) -> list[Rings | None]:
    """Return the closed rings of each area, or None for all areas if the rings have too many vertices for a page."""
    rings_by_area = [list(chain.from_iterable(area.polygons)) for area in areas]
    if sum(map(len, chain.from_iterable(rings_by_area))) > MAX_PLACES:
        return [None] * len(areas)
    return [drawn([np.vstack((ring, ring[:1])) for ring in rings]) for rings in rings_by_area]


def rings_of(parts: npt.NDArray[Any], size: float) -> Rings:
    """Return rings of polygons, simplified with the tolerance ``size``, which doubles until the vertices are few."""
    while True:
        simple = shapely.simplify(parts, size)
        simple = simple[~shapely.is_empty(simple)]
        if (
            shapely.get_num_coordinates(simple).sum() <= MAX_VERTICES
            or len(simple) > MAX_VERTICES / 4
        ):
            break
        size *= 2
    rings = shapely.get_rings(simple)[: MAX_VERTICES // 4]
    return [np.round(shapely.get_coordinates(ring), 3).ravel().tolist() for ring in rings]
