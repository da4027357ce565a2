"""Lines and rings of drawn and detected features in run.json, for the map of the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from tiler.core.area import Area
from tiler.core.breaklines import Counts
from tiler.core.frame import COUNTS_PER_UNIT

MAX_PLACES = 20_000
"""Maximum number of vertices of all edits, all breaklines or all water on a page."""

MAX_VERTICES = 8_000
"""Maximum number of vertices of the outline on the map of the report."""


def drawn(lines: Sequence[Counts]) -> list[list[float]]:
    """Return lines as x, y, x, y, ... in units of the CRS, or no lines if they have too many vertices for a page."""
    if sum(map(len, lines)) > MAX_PLACES:
        return []
    return [(line[:, :2] / COUNTS_PER_UNIT).ravel().tolist() for line in lines]


def add_rings(facts: Sequence[dict[str, Any]], areas: Sequence[Area]) -> None:
    """Add to each fact the closed rings of its area, unless all rings together have too many vertices for a page."""
    rings = [[ring for rings in area.polygons for ring in rings] for area in areas]
    if sum(len(ring) for of_area in rings for ring in of_area) <= MAX_PLACES:
        for fact, of_area in zip(facts, rings, strict=True):
            fact["rings"] = drawn([np.vstack((ring, ring[:1])) for ring in of_area])


def rings_of(parts: npt.NDArray[Any], size: float) -> list[list[float]]:
    """Return rings of polygons, simplified with the tolerance ``size``, which doubles until the vertices are few."""
    while True:
        simple = shapely.simplify(parts, size)
        simple = simple[~shapely.is_empty(simple)]
        if shapely.get_num_coordinates(simple).sum() <= MAX_VERTICES or len(simple) > MAX_VERTICES / 4:
            break
        size *= 2
    rings = shapely.get_rings(simple)[: MAX_VERTICES // 4]
    return [np.round(shapely.get_coordinates(ring), 3).ravel().tolist() for ring in rings]
