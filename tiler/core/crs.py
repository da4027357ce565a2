"""Horizontal and vertical parts of a CRS, their names, the scale of a projection, and the area of use."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

from pyproj import CRS, Proj
from pyproj.crs import is_wkt
from pyproj.exceptions import CRSError, ProjError

USED_BEYOND, MIN_USED_BEYOND_DEG = 0.1, 0.1
"""Distance beyond its area of use to which a CRS is used: this share of the shorter side of the area, and at least so
many degrees (11 km). This is 33 km for the Dutch grid, and 0.6 degrees for a UTM zone of WGS 84: a cloud of Peru that
is right lies 0.43 degrees outside its zone, a Dutch one in coordinates of the national grid 0.74."""


_FOR_PROJ = re.compile(
    r'\b(?:EXTENSION|PARAMETERFILE)\s*[\[(]((?:"(?:[^"]|"")*"|[^"\])])*)', re.I
)
"""Elements of a WKT with parameters of PROJ and names of grids."""
_FILE = re.compile(r"\binit\s*=|(?<!\d)[\\/]|[\\/](?!\d)", re.I)
"""Signs of a path or URL in parameters of PROJ, in which ``1/3`` is a number."""
_OGC = "http://www.opengis.net/def/crs/"
"""Start of the URLs that stand for codes. PROJ knows them without a network."""


def crs_in_file(text: str) -> CRS:
    """Return the CRS that a file of unknown origin names, as WKT or by a code.

    Raise CRSError if it is unknown, or if PROJ would open a file at a path or URL in it.
    """
    parts = [text]
    if is_wkt(text):
        parts = _FOR_PROJ.findall(text)
    elif text.startswith(_OGC):
        parts = []
    if any(map(_FILE.search, parts)):
        raise CRSError("names a file or a URL, which a CRS in a file may not")
    return CRS.from_user_input(text)


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


def raster_crs(wkt: str | None) -> str | None:
    """Return the WKT of the CRS to write into a raster, or None.

    GeoTIFF has no projected CRS with three axes, and GDAL writes none at all. So a raster gets the horizontal part.
    """
    if wkt is None:
        return None
    horizontal, vertical = split(CRS.from_wkt(wkt))
    if horizontal is None or vertical is None or vertical.is_vertical:
        return wkt
    code = horizontal.to_epsg(min_confidence=100)
    return (horizontal if code is None else CRS.from_epsg(code)).to_wkt()


@lru_cache(maxsize=64)
def split_wkt(wkt: str | None) -> tuple[CRS | None, CRS | None]:
    """Return the parts of a CRS as `split` does. Both are None if there is no CRS."""
    return (None, None) if wkt is None else split(CRS.from_wkt(wkt))


def vertical_name(wkt: str | None) -> str | None:
    """Return the name of the height reference of a CRS, like ``NAVD88 height (EPSG:5703)``.

    A CRS with three axes has heights above an ellipsoid: ``ellipsoidal height (WGS 84)``. The result is None if the CRS
    does not define heights.
    """
    vertical = split_wkt(wkt)[1]
    if vertical is None:
        return None
    if not vertical.is_vertical and vertical.geodetic_crs is not None:
        return f"ellipsoidal height ({vertical.geodetic_crs.name})"
    authority = code_of(vertical)
    return vertical.name if authority is None else f"{vertical.name} ({':'.join(authority)})"


@lru_cache(maxsize=64)
def code_of(crs: CRS) -> tuple[str, str] | None:
    """Return the authority and the code that match a CRS best, or None if it has no code.

    PROJ searches a tenth of a second for a CRS without a code.
    """
    code: tuple[str, str] | None = crs.to_authority()
    return code


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


AreaOfUse = tuple[float, float, float, float]
"""West, south, east and north edge of an area of use in degrees. West is larger than east across the antimeridian."""


class Placement(NamedTuple):
    """Position on Earth by a CRS, and the area of use of the CRS.

    Attributes
    ----------
    longitude, latitude : float
        Degrees, from Greenwich. NaN if the coordinates have no position.
    area : AreaOfUse
    outside_deg : float
        Distance from the area in degrees: 0 inside it, infinite if the coordinates have no position.
    """

    longitude: float
    latitude: float
    area: AreaOfUse
    outside_deg: float


def placement(wkt: str, x: float, y: float) -> Placement | None:
    """Return the position of coordinates, or None if the CRS is not projected or its area of use is unknown."""
    crs = CRS.from_wkt(wkt)
    horizontal = split(crs)[0]
    if horizontal is None or not horizontal.is_projected:
        return None
    projection = Proj(horizontal)
    area = _projected_area(crs, horizontal, projection)
    if area is None:
        return None
    position = _on_earth(projection, x, y)
    if position is None:
        return Placement(math.nan, math.nan, area, math.inf)
    longitude, latitude = position
    west, south, _, north = area
    # Longitudes are compared modulo 360, because an area of use may contain the antimeridian.
    from_west = (longitude - west) % 360
    beyond = max(min(from_west - _sides(area)[0], 360 - from_west), 0.0)
    outside_deg = max(beyond, south - latitude, latitude - north)
    return Placement(longitude, latitude, area, outside_deg)


def _on_earth(projection: Proj, x: float, y: float) -> tuple[float, float] | None:
    """Return longitude and latitude of coordinates, or None if they have no position."""
    try:
        longitude, latitude = projection(x, y, inverse=True, errcheck=True)
        back = projection(longitude, latitude, errcheck=True)
    except ProjError:
        return None
    if not all(map(math.isfinite, (longitude, latitude, *back))) or math.dist(back, (x, y)) > 1:
        return None
    return longitude, latitude


def at_degrees(wkt: str | None, x: float, y: float) -> str:
    """Return where coordinates lie, such as ``, data at 4.07° N, 0.11° E``, or an empty text if that is unknown."""
    horizontal = None if wkt is None else split(CRS.from_wkt(wkt))[0]
    if horizontal is None or not horizontal.is_projected:
        return ""
    position = _on_earth(Proj(horizontal), x, y)
    return "" if position is None else f", data at {_place(*position)}"


def _projected_area(crs: CRS, horizontal: CRS, projection: Proj) -> AreaOfUse | None:
    """Return the area of use of a projected CRS, or that of its datum if it has none or is a zone of UTM.

    Countries use one UTM zone for all of their area, such as zone 33 in western Norway. So the
    area of a zone is that of the datum, unless the datum is used in the whole world.
    """
    own = _area_of_use(horizontal) or _area_of_use(crs)
    geodetic = horizontal.geodetic_crs
    of_datum = None if geodetic is None else _area_of_use(geodetic)
    is_utm = "proj=utm" in projection.definition_string()
    if own is None or (is_utm and of_datum is not None and _sides(of_datum)[0] < 360):
        return of_datum
    return own


def _area_of_use(crs: CRS) -> AreaOfUse | None:
    """Return the area of use of a CRS, by its code if the text does not contain the area, as in WKT 1."""
    if crs.area_of_use is None and (code := code_of(crs)) is not None:
        crs = CRS.from_authority(*code)
    return None if crs.area_of_use is None else crs.area_of_use.bounds


def _sides(area: AreaOfUse) -> tuple[float, float]:
    """Return width and height of an area of use in degrees."""
    west, south, east, north = area
    return (east - west) % 360 or 360.0, north - south


def misplaced(wkt: str | None, x: float, y: float) -> str | None:
    """Return a warning if a position lies outside the area of use of a CRS, farther than the CRS is used."""
    found = None if wkt is None else placement(wkt, x, y)
    if found is None:
        return None
    if found.outside_deg <= max(USED_BEYOND * min(_sides(found.area)), MIN_USED_BEYOND_DEG):
        return None
    west, south, east, north = found.area
    place = "no place on Earth"
    if math.isfinite(found.outside_deg):
        place = _place(found.longitude, found.latitude)
    return (
        f"the data lie at {place}, outside the area of use of their CRS {crs_name(wkt)}, {_degrees(south, 'NS')} to "
        f"{_degrees(north, 'NS')} and {_degrees(west, 'EW')} to {_degrees(east, 'EW')}; if the place is wrong, so is "
        "the CRS: give the right one with --crs, or write it into files that have a CRS "
        "(`pdal translate IN OUT --writers.las.a_srs=EPSG:...`)"
    )


def _place(longitude: float, latitude: float) -> str:
    return f"{_degrees(latitude, 'NS')}, {_degrees(longitude, 'EW')}"


def _degrees(angle: float, signs: str) -> str:
    """Return an angle such as ``4.04° N``; ``signs`` are the letters of positive and negative angles."""
    return f"{abs(angle):.2f}° {signs[angle < 0]}"


def crs_warnings(wkt: str | None, bounds: Sequence[float] | None) -> list[str]:
    """Return the warning of `misplaced` for the middle of bounds, if there is one.

    The first half of ``bounds`` are the lowest coordinates, the second half the highest.
    """
    if not bounds:
        return []
    half = len(bounds) // 2
    text = misplaced(wkt, (bounds[0] + bounds[half]) / 2, (bounds[1] + bounds[half + 1]) / 2)
    return [] if text is None else [text]
