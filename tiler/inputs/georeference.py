"""CRS and units of a source, from its WKT or the EPSG codes in its GeoTIFF keys (OGC 19-008r4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache

import numpy as np
from pyproj import CRS
from pyproj.crs import CompoundCRS, is_wkt
from pyproj.database import query_crs_info
from pyproj.enums import PJType
from pyproj.exceptions import CRSError

from tiler.core.crs import crs_in_file, same_vertical_datum, split
from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT, exact_unit, unit_label
from tiler.io.las.headers import LasHeader, read_payload
from tiler.io.las.layout import PROJECTION_USER

_WKT_RECORD = 2112
DIRECTORY = 34735

# Numbers of the keys
_GEODETIC = 2048
_PROJECTED = 3072
_LINEAR_UNIT = 3076
_VERTICAL = 4096
_VERTICAL_UNIT = 4099

_EPSG_CODES = range(1024, 32767)
_USER_DEFINED = 32767
_UNITS = {9001: METRE, 9002: FOOT, 9003: US_SURVEY_FOOT}


@dataclass(frozen=True)
class KeyedCrs:
    """CRS defined by the keys, horizontal and vertical, with metres per unit of heights and notes."""

    horizontal: CRS | None
    vertical: CRS | None
    vertical_unit: Fraction | None
    notes: tuple[str, ...] = ()


def parse_keys(directory: bytes) -> dict[int, int]:
    """Return the keys whose values are stored in the directory itself, or {} if the bytes are not a directory."""
    usable = len(directory) // 8 * 8
    entries = np.frombuffer(directory[:usable], dtype="<u2").reshape(-1, 4)
    if len(entries) == 0:
        return {}
    keys = entries[1 : 1 + int(entries[0, 3])]
    return {int(key): int(value) for key, location, _, value in keys if location == 0}


def crs_of_keys(directory: bytes) -> KeyedCrs:
    """Return the CRS that a directory of GeoTIFF keys defines by EPSG codes."""
    keys = parse_keys(directory)
    notes: list[str] = []
    horizontal = _of_code(keys.get(_PROJECTED), notes)
    if horizontal is None and keys.get(_PROJECTED) is None:
        horizontal = _of_code(keys.get(_GEODETIC), notes)
    if keys.get(_PROJECTED) == _USER_DEFINED:
        notes.append(
            "its GeoTIFF keys describe a user-defined CRS, but only EPSG codes are read"
        )
    unit = _UNITS.get(keys.get(_LINEAR_UNIT, 0))
    if horizontal is not None and horizontal.is_projected and unit is not None:
        metres_per_unit = horizontal.axis_info[0].unit_conversion_factor
        if abs(metres_per_unit / float(unit) - 1) > 1e-9:
            notes.append(
                f"its GeoTIFF keys give {unit_label(unit)} as unit, but their EPSG:{keys[_PROJECTED]} is in "
                f"{unit_label(exact_unit(metres_per_unit))}, which is used; use --units to change it"
            )
    vertical = _of_code(keys.get(_VERTICAL), [])
    if vertical is not None and not vertical.is_vertical:
        vertical = None
    return KeyedCrs(horizontal, vertical, _UNITS.get(keys.get(_VERTICAL_UNIT, 0)), tuple(notes))


def _of_code(code: int | None, notes: list[str]) -> CRS | None:
    if code is None or code not in _EPSG_CODES:
        return None
    try:
        return CRS.from_epsg(code)
    except CRSError:
        notes.append(f"its GeoTIFF keys name EPSG:{code}, which is not known")
        return None


@dataclass(frozen=True)
class Georeference:
    """CRS of a file with its units.

    Attributes
    ----------
    kind : str
        ``projected``, ``local`` (with lengths, but without a position on earth), ``geographic``, ``geocentric``, or
        ``missing``.
    name : str
        Name of the CRS.
    wkt : str or None
        WKT2:2019 of the horizontal CRS, or of both if the vertical CRS is known.
    horizontal, vertical : Fraction or None
        Metres per unit; None if the file does not define the unit.
    notes : tuple of str
        Notes for the user.
    """

    kind: str
    name: str = ""
    wkt: str | None = None
    horizontal: Fraction | None = None
    vertical: Fraction | None = None
    notes: tuple[str, ...] = ()


def georeference(header: LasHeader) -> Georeference:
    """Return the CRS and the units of a file.

    The global encoding of the header decides whether the WKT record or the GeoTIFF keys are
    read first. The other source is used if the first is missing or cannot be read.
    """
    notes: list[str] = []
    readers = [_from_wkt, _from_keys] if header.prefers_wkt else [_from_keys, _from_wkt]
    for read in readers:
        file_crs = read(header, notes)
        if file_crs is not None:
            return file_crs
    return Georeference("missing", notes=tuple(notes))


def describe(
    crs: CRS, notes: Sequence[str] = (), vertical_unit: Fraction | None = None
) -> Georeference:
    """Return the kind and the units of a CRS.

    ``vertical_unit`` is used if the CRS does not define the unit of heights.
    """
    horizontal, vertical = split(crs)
    if horizontal is None:
        return Georeference(
            "missing", crs.name, notes=(*notes, f"its CRS {crs.name} is vertical only")
        )
    kind = _kind(horizontal)
    if kind in ("geographic", "geocentric"):
        return Georeference(kind, horizontal.name, crs.to_wkt(), notes=tuple(notes))
    factors = {exact_unit(a.unit_conversion_factor) for a in horizontal.axis_info[:2]}
    if len(factors) != 1:
        remark = f"its CRS {crs.name} has axes of different units"
        return Georeference("missing", crs.name, notes=(*notes, remark))
    unit = vertical_unit
    if vertical is not None:
        unit = _unit_of(vertical)
    return Georeference(kind, horizontal.name, crs.to_wkt(), factors.pop(), unit, tuple(notes))


def _kind(horizontal: CRS) -> str:
    if horizontal.is_geocentric:
        return "geocentric"
    if horizontal.is_geographic:
        return "geographic"
    return "projected" if horizontal.is_projected else "local"


def _from_wkt(header: LasHeader, notes: list[str]) -> Georeference | None:
    for record in (*header.vlrs, *header.evlrs):
        if record.user_id != PROJECTION_USER or record.record_id != _WKT_RECORD:
            continue
        text = (
            read_payload(header.path, record)
            .split(b"\0")[0]
            .decode("utf-8-sig", "replace")
            .strip()
        )
        if not text:
            notes.append("its WKT record is empty")
            continue
        try:
            file_crs = _described(text)
            return replace(file_crs, notes=(*notes, *file_crs.notes))
        except CRSError as error:
            notes.append(f"its WKT cannot be read ({' '.join(str(error).split())[:120]})")
    return None


@lru_cache(maxsize=64)
def _described(wkt: str) -> Georeference:
    # The files of a delivery share one text, and parsing it takes as long as reading a sample
    # of a file.
    if not is_wkt(wkt):
        raise CRSError(f"Invalid WKT string: {wkt}")
    return describe(crs_in_file(wkt))


def _from_keys(header: LasHeader, notes: list[str]) -> Georeference | None:
    for record in (*header.vlrs, *header.evlrs):
        if record.user_id != PROJECTION_USER or record.record_id != DIRECTORY:
            continue
        keyed = crs_of_keys(read_payload(header.path, record))
        notes.extend(keyed.notes)
        if keyed.horizontal is None:
            continue
        if keyed.vertical is None:
            return describe(keyed.horizontal, notes, keyed.vertical_unit)
        # The key of the unit takes precedence over the EPSG entry: NAVD88 (in metres) with feet is NAVD88 in feet.
        vertical = _in_unit(keyed.vertical, keyed.vertical_unit)
        if vertical is None:
            notes.append(
                f"its GeoTIFF keys give {keyed.vertical.name} in another unit, for which EPSG has no CRS, so "
                "the rasters state no vertical CRS"
            )
            return describe(keyed.horizontal, notes, keyed.vertical_unit)
        name = f"{keyed.horizontal.name} + {vertical.name}"
        return describe(CompoundCRS(name, [keyed.horizontal, vertical]), notes)
    return None


@lru_cache(maxsize=64)
def _in_unit(vertical: CRS, unit: Fraction | None) -> CRS | None:
    """Return the vertical CRS of EPSG with the same datum and a unit, or None if there is none."""
    if unit is None or _unit_of(vertical) == unit:
        return vertical
    for info in query_crs_info("EPSG", PJType.VERTICAL_CRS):
        # EPSG names such a CRS after the one in metres: "NAVD88 height (ftUS)".
        if info.name.startswith(f"{vertical.name} ("):
            found = CRS.from_epsg(info.code)
            if _unit_of(found) == unit and same_vertical_datum(vertical, found):
                return found
    return None


def _unit_of(crs: CRS) -> Fraction:
    return exact_unit(crs.axis_info[-1].unit_conversion_factor)
