"""CRS records of a classified cloud, for sources whose CRS records do not suffice."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

from pyproj import CRS
from pyproj.exceptions import CRSError

from tiler.core.crs import split, vertical_name
from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT, exact_unit
from tiler.export.work import CloudCopy
from tiler.inputs.sources import SourceInfo
from tiler.io.las.headers import LasHeader
from tiler.io.las.layout import PROJECTION_USER, Vlr, packed_record

WKT_BIT = 0x10
"""Bit of the global encoding that makes the WKT record the source of the CRS."""
_WKT, _KEYS, _NUMBERS, _TEXTS = 2112, 34735, 34736, 34737
_MODEL, _PROJECTED, _LINEAR_UNIT, _VERTICAL, _VERTICAL_UNIT = 1024, 3072, 3076, 4096, 4099
_IS_PROJECTED = 1
_UNITS = {METRE: 9001, FOOT: 9002, US_SURVEY_FOOT: 9003}
_CODES = range(1024, 32767)
"""EPSG codes that a key can hold (OGC 19-008r4)."""


@dataclass(frozen=True)
class NewCrs:
    """CRS that replaces the CRS records of the source.

    Attributes
    ----------
    record : bytes
        Whole VLR.
    is_wkt : bool
        True for WKT, False for GeoTIFF keys.
    note : str
        Note for the user, or empty.
    """

    record: bytes
    is_wkt: bool
    note: str = ""


def new_crs(header: LasHeader, cloud: CloudCopy, run_wkt: str | None) -> NewCrs | None:
    """Return the CRS to write into a classified cloud, or None if the records of the source stay.

    LAS 1.4 and COPC get WKT. Earlier versions of LAS get GeoTIFF keys if the CRS parts have
    EPSG codes, else WKT.

    Parameters
    ----------
    header : LasHeader
        Header of the source.
    cloud : CloudCopy
    run_wkt : str or None
        CRS of the run.
    """
    records = (*header.vlrs, *header.evlrs)
    if cloud.copc and run_wkt is not None:
        has = any(r.user_id == PROJECTION_USER and r.record_id == _WKT for r in records)
        if cloud.wkt is not None or not (has and header.prefers_wkt):
            return NewCrs(_wkt_record(run_wkt), True, "CRS written as WKT, which COPC requires")
    if cloud.wkt is None or cloud.copc:
        return None
    note = ""
    if any(map(_is_crs, records)):
        note = "CRS of the run written in place of CRS records that cannot be read or have no vertical CRS"
    if header.version >= (1, 4):
        return NewCrs(_wkt_record(cloud.wkt), True, note)
    keys = geotiff_keys(CRS.from_wkt(cloud.wkt))
    if keys is not None:
        return NewCrs(packed_record(PROJECTION_USER, _KEYS, "", keys), False, note)
    told = "CRS written as WKT, although the LAS version is before 1.4: GeoTIFF keys have no code for this CRS"
    return NewCrs(_wkt_record(cloud.wkt), True, told)


def crs_to_write(info: SourceInfo, run_wkt: str | None, given: str | None) -> str | None:
    """Return the CRS that a classified cloud gets, or None if the CRS records of its source stay.

    ``given`` is the text of ``--crs``, which may add a vertical CRS to that of the source.
    """
    if not info.has_crs:
        return run_wkt
    if given is None or not _gives_heights(given) or vertical_name(run_wkt) is None:
        return None
    return run_wkt if vertical_name(info.georeference.wkt) is None else None


@lru_cache(maxsize=4)
def _gives_heights(crs: str) -> bool:
    """Return whether a text of ``--crs`` names a CRS with heights."""
    return crs.strip().lower() != "none" and split(CRS.from_user_input(crs))[1] is not None


def without_crs(records: Sequence[Vlr]) -> list[Vlr]:
    """Return all records except those of a CRS."""
    return [record for record in records if not _is_crs(record)]


def _is_crs(record: Vlr) -> bool:
    return record.user_id == PROJECTION_USER and record.record_id in (
        _WKT,
        _KEYS,
        _NUMBERS,
        _TEXTS,
    )


def geotiff_keys(crs: CRS) -> bytes | None:
    """Return GeoTIFF keys with the EPSG codes of a projected CRS, or None if it lacks such codes.

    A vertical CRS is included. laspy omits units and the vertical CRS, and rasterio writes keys
    only into images.
    """
    horizontal, vertical = split(crs)
    if horizontal is None or not horizontal.is_projected:
        return None
    keys = [(_MODEL, _IS_PROJECTED), *_named(horizontal, _PROJECTED, _LINEAR_UNIT)]
    if vertical is not None and vertical.is_vertical:
        keys += _named(vertical, _VERTICAL, _VERTICAL_UNIT)
    elif vertical is not None:
        keys.append((_VERTICAL, 0))
    if not all(code in _CODES or key == _MODEL for key, code in keys):
        return None
    entries = [struct.pack("<4H", key, 0, 1, code) for key, code in keys]
    return struct.pack("<4H", 1, 1, 0, len(keys)) + b"".join(entries)


def _named(crs: CRS, code_key: int, unit_key: int) -> list[tuple[int, int]]:
    """Return keys with the EPSG codes of a CRS and of its unit. A code is 0 if there is none."""
    unit = exact_unit(crs.axis_info[-1].unit_conversion_factor)
    return [(code_key, crs.to_epsg(min_confidence=100) or 0), (unit_key, _UNITS.get(unit, 0))]


def _wkt_record(wkt: str) -> bytes:
    """Return the record of a CRS in WKT 1, as LAS requires, or in the given WKT if WKT 1 cannot express the CRS."""
    text = wkt
    with suppress(CRSError):
        text = CRS.from_wkt(wkt).to_wkt("WKT1_GDAL", output_axis_rule=False) or wkt
    return packed_record(PROJECTION_USER, _WKT, "", text.encode() + b"\0")
