"""Transformation of geometries to the CRS of a run. Edges that become curved get more vertices."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from pyproj import CRS, Transformer
from pyproj.enums import TransformDirection
from pyproj.exceptions import ProjError
from shapely.geometry.base import BaseGeometry

from ptd.arrays import Float64
from tiler.core.crs import crs_in_file, same_horizontal, split
from tiler.errors import InputError
from tiler.io.foreign_content import excerpt

MAX_HALVINGS = 12
"""Maximum number of times that an edge is halved."""
BEND = 0.005
"""Largest distance between a straight edge and the curve, in units of the CRS."""

# A position is outside the area of use of a CRS if the inverse transformation misses it by more
# than this tolerance.
RETURN = 1e-2
"""Tolerance of the inverse transformation in units of the CRS."""
RETURN_DEG = 1e-6
"""Tolerance of the inverse transformation in degrees."""

Places = Float64


def in_crs(
    path: Path,
    geometries: Sequence[BaseGeometry],
    text: str | None,
    wkt: str | None,
    notes: list[str],
) -> list[BaseGeometry]:
    """Transform geometries to the horizontal CRS of a run. Heights do not change.

    Parameters
    ----------
    path : Path
        File of the geometries, for messages.
    geometries : sequence of shapely geometries
    text : str or None
        CRS of the geometries in the file, or None if it has none.
    wkt : str or None
        CRS of the run, or None if it is unknown.
    notes : list of str
        List that receives notes for the user.

    Raises
    ------
    InputError
        The CRS is missing, unknown, or cannot be transformed to the CRS of the run, or a position is outside the area
        of use of the CRS of the run.
    """
    if text is None and wkt is None:
        notes.append(f"{path}: has no CRS: the CRS of the clouds is assumed")
        return list(geometries)
    if text is None:
        raise InputError(
            f"{path}: has no CRS; write it with one, `ogr2ogr -a_srs EPSG:... new.gpkg {path}`"
        )
    try:
        named = split(crs_in_file(text))[0]
    except (ProjError, UnicodeError, RecursionError) as error:
        raise InputError(
            f"{path}: its CRS {excerpt(text)} is not known; write it with another CRS"
        ) from error
    if named is None:
        raise InputError(
            f"{path}: its CRS {excerpt(text)} has no horizontal part; write it with another CRS"
        )
    run_crs = None if wkt is None else split(CRS.from_wkt(wkt))[0]
    if run_crs is None:
        raise InputError(
            f"{path} is in {named.name}, the CRS of the clouds is unknown; give it with --crs, or use --bounds"
        )
    if same_horizontal(named, run_crs):
        return list(geometries)
    notes.append(f"{path}: was transformed from {named.name} to {run_crs.name}")
    try:
        transformer = Transformer.from_crs(named, run_crs, always_xy=True)
    except ProjError as error:
        raise InputError(
            f"{path} is in {named.name}, which cannot be transformed to {run_crs.name}; write it with another CRS"
        ) from error
    moved = partial(_moved, transformer, RETURN_DEG if named.is_geographic else RETURN)
    try:
        return [_rebuilt(geometry, moved) for geometry in geometries]
    except _Beyond as error:
        raise InputError(
            f"{path}: read in {named.name}, it extends beyond the area of use of {run_crs.name}; write it with its own "
            "CRS (GeoJSON without one is in WGS 84), or clip it to the survey"
        ) from error


class _Beyond(Exception):
    """Position outside the area of use of the CRS of the run."""


def _rebuilt(geometry: BaseGeometry, moved: Any) -> BaseGeometry:
    """Return a geometry with all its lines, rings or points transformed by ``moved``."""
    if geometry.geom_type == "Polygon":
        rings = [
            moved(_places(ring), True) for ring in (geometry.exterior, *geometry.interiors)
        ]
        return shapely.Polygon(rings[0], rings[1:])
    if geometry.geom_type == "LineString":
        return shapely.LineString(moved(_places(geometry), False))
    if geometry.geom_type == "Point":
        return shapely.Point(moved(_places(geometry), False)[0])
    parts: BaseGeometry = type(geometry)([_rebuilt(part, moved) for part in geometry.geoms])
    return parts


def _places(geometry: BaseGeometry) -> Places:
    places: Places = shapely.get_coordinates(geometry, include_z=bool(geometry.has_z))
    return places


def _moved(transformer: Transformer, near: float, places: Places, closed: bool) -> Places:
    """Transform a line or ring, with more vertices on the edges that become curved.

    The division of an edge does not depend on its direction, so neighbours keep a common
    border.
    """
    start = places[:-1] if closed else places
    there = _transformed(transformer, start)
    for _ in range(MAX_HALVINGS):
        x, y = transformer.transform(
            there[:, 0], there[:, 1], direction=TransformDirection.INVERSE
        )
        back = np.stack([x, y], axis=1)
        if not (
            np.isfinite(there[:, :2]).all()
            and np.allclose(back, start[:, :2], rtol=0, atol=near)
        ):
            raise _Beyond
        ahead, ahead_there = np.roll(start, -1, axis=0), np.roll(there, -1, axis=0)
        middle = (start + ahead) / 2
        moved = _transformed(transformer, middle)
        leaves = np.hypot(*(moved - (there + ahead_there) / 2)[:, :2].T) > BEND
        bent = np.flatnonzero(
            leaves if closed else leaves & (np.arange(len(leaves)) < len(leaves) - 1)
        )
        if not bent.size:
            break
        start = np.insert(start, bent + 1, middle[bent], axis=0)
        there = np.insert(there, bent + 1, moved[bent], axis=0)
    if not np.isfinite(there[:, :2]).all():
        raise _Beyond
    return np.concatenate([there, there[:1]]) if closed else there


def _transformed(transformer: Transformer, places: Places) -> Places:
    moved = places.copy()
    moved[:, 0], moved[:, 1] = transformer.transform(places[:, 0], places[:, 1])
    return moved
