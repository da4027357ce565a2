"""Horizontal and vertical parts of a CRS, their names, and the scale of a projection."""

from __future__ import annotations

import math

from pyproj import CRS, Proj
from pyproj.exceptions import ProjError


def split(crs: CRS) -> tuple[CRS | None, CRS | None]:
    """The horizontal CRS and the one that defines heights (vertical, or with three axes), or None in place of each."""
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
    """Name of the height reference of a CRS, like ``NAVD88 height (EPSG:5703)``; None if the CRS defines none."""
    if wkt is None:
        return None
    vertical = split(CRS.from_wkt(wkt))[1]
    if vertical is None:
        return None
    authority = vertical.to_authority()
    return vertical.name if authority is None else f"{vertical.name} ({':'.join(authority)})"


def same_horizontal(one: CRS, other: CRS) -> bool:
    """Whether the definitions are equal except for names and the order of axes, or the EPSG codes and units are."""
    if one == other or one.equals(other, ignore_axis_order=True):
        return True
    code = one.to_epsg()
    factors = [c.axis_info[0].unit_conversion_factor for c in (one, other) if c.axis_info]
    return code is not None and code == other.to_epsg() and len(set(factors)) == 1


def crs_name(wkt: str | None) -> str:
    """The name of a CRS, with its code if it has one; ``none`` for no CRS."""
    if wkt is None:
        return "none"
    crs = CRS.from_user_input(wkt)
    code = crs.to_authority(min_confidence=100)
    return f"{crs.name} ({':'.join(code)})" if code else crs.name


def length_scale(wkt: str, x: float, y: float) -> float | None:
    """Length in the plane of the CRS over length on the ground at a place: 1.5 in Web Mercator at 48 degrees.

    The scale in the direction in which it differs most from 1; None if PROJ does not know it.
    """
    horizontal = split(CRS.from_wkt(wkt))[0]
    if horizontal is None or not horizontal.is_projected:
        return None
    projection = Proj(horizontal)
    try:
        found = projection.get_factors(*projection(x, y, inverse=True, errcheck=True), errcheck=True)
    except ProjError:
        return None
    scales = [s for s in (found.tissot_semimajor, found.tissot_semiminor) if math.isfinite(s) and s > 0]
    return max(scales, key=lambda scale: abs(math.log(scale)), default=None)
