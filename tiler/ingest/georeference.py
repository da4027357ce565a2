"""CRS and units of one source, from its WKT or its GeoTIFF keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache

from pyproj import CRS
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError

from tiler.core.crs import split
from tiler.core.units import exact_unit
from tiler.ingest.geokeys import DIRECTORY, crs_of_keys
from tiler.io.las.headers import LasHeader, read_payload
from tiler.io.las.records import PROJECTION_USER

_WKT_RECORD = 2112


@dataclass(frozen=True)
class Georeference:
    """What a file says of its coordinates.

    Attributes
    ----------
    kind : str
        ``projected``, ``local`` (linear units, nowhere on earth), ``geographic``, ``geocentric``, ``missing``.
    name : str
        Of the CRS.
    wkt : str or None
        WKT2:2019, horizontal and vertical where both are known.
    horizontal, vertical : Fraction or None
        Metres per unit; `vertical` is None where nothing declares it.
    notes : tuple of str
    """

    kind: str
    name: str = ""
    wkt: str | None = None
    horizontal: Fraction | None = None
    vertical: Fraction | None = None
    notes: tuple[str, ...] = ()


def georeference(header: LasHeader) -> Georeference:
    """CRS and units of one file.

    The WKT record counts where the global encoding says so, else the GeoTIFF keys; the other one is taken
    where the first is absent or cannot be read.
    """
    notes: list[str] = []
    readers = [_from_wkt, _from_keys] if header.prefers_wkt else [_from_keys, _from_wkt]
    for read in readers:
        found = read(header, notes)
        if found is not None:
            return found
    return Georeference("missing", notes=tuple(notes))


def describe(crs: CRS, notes: Sequence[str] = (), vertical_unit: Fraction | None = None) -> Georeference:
    """Kind and units of a CRS; ``vertical_unit`` is what heights have where the CRS is silent."""
    horizontal, vertical = split(crs)
    if horizontal is None:
        return Georeference("missing", crs.name, notes=(*notes, f"its CRS {crs.name} is vertical only"))
    kind = _kind(horizontal)
    if kind in ("geographic", "geocentric"):
        return Georeference(kind, horizontal.name, crs.to_wkt(), notes=tuple(notes))
    factors = {exact_unit(a.unit_conversion_factor) for a in horizontal.axis_info[:2]}
    if len(factors) != 1:
        remark = f"its CRS {crs.name} has axes of different units"
        return Georeference("missing", crs.name, notes=(*notes, remark))
    unit = vertical_unit
    if vertical is not None:
        unit = exact_unit(vertical.axis_info[-1].unit_conversion_factor)
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
        text = read_payload(header.path, record).split(b"\0")[0].decode("utf-8-sig", "replace").strip()
        if not text:
            notes.append("its WKT record is empty")
            continue
        try:
            found = _described(text)
            return replace(found, notes=(*notes, *found.notes))
        except CRSError as error:
            notes.append(f"its WKT cannot be read ({' '.join(str(error).split())[:120]})")
    return None


@lru_cache(maxsize=64)
def _described(wkt: str) -> Georeference:
    """The files of a delivery have the same text, and to parse it takes as long as to read some of their points."""
    return describe(CRS.from_wkt(wkt))


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
        both = CompoundCRS(
            f"{keyed.horizontal.name} + {keyed.vertical.name}", [keyed.horizontal, keyed.vertical]
        )
        found = describe(both, notes)
        if keyed.vertical_unit not in (None, found.vertical):
            # Feet above a datum whose EPSG entry is in metres: the key of the unit is about this file.
            return describe(keyed.horizontal, notes, keyed.vertical_unit)
        return found
    return None
