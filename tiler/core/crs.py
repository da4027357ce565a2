"""Horizontal and vertical parts of a CRS, their names, and the scale of a projection."""

from __future__ import annotations

import math
from typing import Any

from pyproj import CRS, Proj
from pyproj.exceptions import ProjError


def split(crs: CRS) -> tuple[CRS | None, CRS | None]:
    """Return the horizontal CRS and the CRS that defines heights (vertical or with three axes). Each may be None."""
    if crs.is_bound and crs.source_crs is not None:
        return split(crs.source_crs)
    if crs.is_compound:
        parts = [split(part) for part in crs.sub_crs_list]
        horizontal = next((h for h, _ in parts if h is not None), None)
        vertical = next((v for _, v in parts if v is not None), None)
        return horizontal, vertical
    if crs.is_vertical:
        return None, crs
    if len(crs.axis_info) == 3 and not crs.is_geocentric:
        return crs.to_2d(), crs
    return crs, None


def vertical_name(wkt: str | None) -> str | None:
    """Return the name of the height reference of a CRS, like ``NAVD88 height (EPSG:5703)``.

    The result is None if the CRS does not define heights.
    """
    if wkt is None:
        return None
    vertical = split(CRS.from_wkt(wkt))[1]
    if vertical is None:
        return None
    authority = vertical.to_authority()
    return vertical.name if authority is None else f"{vertical.name} ({':'.join(authority)})"


def same_horizontal(one: CRS, other: CRS) -> bool:
    """Return whether two CRS are the same horizontally.

    Either their definitions are equal except for names and the order of axes, or their EPSG
    codes and units are equal.
    """
    if one == other or one.equals(other, ignore_axis_order=True):
        return True
    code = one.to_epsg()
    factors = [c.axis_info[0].unit_conversion_factor for c in (one, other) if c.axis_info]
    return code is not None and code == other.to_epsg() and len(set(factors)) == 1


def same_vertical_datum(one: CRS, other: CRS) -> bool:
    """Return whether heights of two CRS refer to the same datum. Their units may differ."""
    datum = _vertical_datum(one)
    return one.name == other.name or (datum is not None and datum == _vertical_datum(other))


def _vertical_datum(crs: CRS) -> Any:
    """Return the datum of a vertical CRS, or the name of its ensemble of datums, which has no datum in PROJ."""
    return crs.datum or crs.to_json_dict().get("datum_ensemble", {}).get("name")


def crs_name(wkt: str | None) -> str:
    """Return the name of a CRS, with its code if it has one, or ``none`` if there is no CRS."""
    if wkt is None:
        return "none"
    crs = CRS.from_user_input(wkt)
    code = crs.to_authority(min_confidence=100)
    return f"{crs.name} ({':'.join(code)})" if code else crs.name


def point_scale_factor(wkt: str, x: float, y: float) -> float | None:
    """Return the point scale factor of a CRS at a position, for example 1.5 in Web Mercator at 48 degrees.

    The factor is the length in the plane of the CRS divided by the length on the ground, in the
    direction in which it differs most from 1. It is None if the CRS is not projected or PROJ
    cannot compute it.
    """
    horizontal = split(CRS.from_wkt(wkt))[0]
    if horizontal is None or not horizontal.is_projected:
        return None
    projection = Proj(horizontal)
    try:
        factors = projection.get_factors(
            *projection(x, y, inverse=True, errcheck=True), errcheck=True
        )
    except ProjError:
        return None
    scales = [
        s
        for s in (factors.tissot_semimajor, factors.tissot_semiminor)
        if math.isfinite(s) and s > 0
    ]
    return max(scales, key=lambda scale: abs(math.log(scale)), default=None)
