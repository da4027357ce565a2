"""CRS and units of a run, from its sources and settings.

Files without a CRS whose coordinates look like degrees are refused, since coordinates are otherwise lengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from pyproj import CRS
from pyproj.exceptions import CRSError

from tiler.config import RunConfig
from tiler.core.crs import (
    at_degrees,
    same_horizontal,
    same_vertical_datum,
    split,
    vertical_name,
)
from tiler.core.units import METRE, Units, unit_named, unit_plural
from tiler.core.words import name_in_wkt
from tiler.errors import ConfigError, InputError
from tiler.inputs.georeference import Georeference, describe
from tiler.inputs.sources import SourceInfo

_MAX_DEGREES = 180.0
"""Largest absolute coordinate. It is the same for x and y, since some writers swap them."""
_MAX_SIDE = 2.0
"""Longest extent of a file in degrees, about 200 km."""
_MIN_SIDE = 1e-5
"""Shortest extent for the density, 1 m in degrees: points at almost one position have any density."""
_MAX_DENSITY = 1e8
"""Number of points per square unit above which the unit cannot be a length: points that are 0.1 mm
apart have 1e8 per m2. In degrees, 0.1 point per m2 gives 1e9."""


class CommonCrs(NamedTuple):
    """CRS of a run (None if it is unknown), its units, notes for the user, and what declared the CRS."""

    wkt: str | None
    units: Units
    notes: list[str]
    origin: str

    def note_at(self, x: float, y: float) -> list[str]:
        """Return the note that names the CRS and the place of a position, or none if there is no CRS."""
        if self.wkt is None:
            return []
        where, unit = at_degrees(self.wkt, x, y), unit_plural(self.units.horizontal)
        return [
            f"the CRS is {name_in_wkt(self.wkt)}, from {self.origin}{where}; x and y are in {unit}"
        ]


def resolve_common_crs(infos: Sequence[SourceInfo], config: RunConfig) -> CommonCrs:
    """Find the CRS and the units that all sources share. Files without points are ignored.

    Raises
    ------
    InputError
        The CRS of a file is missing (and there is no ``--crs``), geographic, geocentric, or not that of the others,
        coordinates without a CRS are degrees, or heights have different datums or units.
    ConfigError
        ``--crs`` or ``--units`` cannot be used.
    """
    notes: list[str] = []
    given = _given(config.crs)
    for info in infos:
        if info.points and info.georeference.kind == "missing" and config.units is None:
            validate_lengths(info)
    members = [
        (i.path, _settled(i.path, i.georeference, given, config.crs)) for i in infos if i.points
    ]
    _check_horizontal(members)
    _check_vertical(members)
    _note_ignored_crs(members, config.crs, given, notes)
    units = _units(members, config.units, notes)
    texts = {text for _, g in members if (text := _wkt_with(units.vertical, g)) is not None}
    # Equal definitions may have different texts. The choice does not depend on the order of the
    # files.
    wkt = min(
        texts,
        key=lambda text: (_parts(text)[1] is None, -text.count("ID["), text),
        default=None,
    )
    origin = "the files" if any(g is not given for _, g in members) else "--crs"
    return CommonCrs(wkt, units, notes, origin)


def validate_lengths(info: SourceInfo, if_metres: str = "give --units m") -> None:
    """Raise InputError if the coordinates of a file without a CRS are so dense that they must be degrees.

    ``if_metres`` is the remedy if they are metres.
    """
    if info.bounds is None:
        return
    x0, y0, _, x1, y1, _ = info.bounds
    sides = x1 - x0, y1 - y0
    if max(map(abs, (x0, y0, x1, y1))) > _MAX_DEGREES or max(sides) > _MAX_SIDE:
        return
    if min(sides) >= _MIN_SIDE and info.points > _MAX_DENSITY * sides[0] * sides[1]:
        raise InputError(
            f"{info.path}: has no CRS, and its coordinates look like degrees (x {x0:.7g}, y {y0:.7g}); reproject it "
            f"to a projected CRS, or {if_metres} if they are metres"
        )


def _wkt_with(vertical_unit: Fraction, crs: Georeference) -> str | None:
    """Return the text of a CRS, without its vertical part if that has another unit."""
    horizontal, vertical = _parts(crs.wkt)
    if vertical is None or horizontal is None or crs.vertical == vertical_unit:
        return crs.wkt
    return horizontal.to_wkt()


def _given(text: str | None) -> Georeference | None:
    """Return the CRS of ``--crs``.

    Raise ConfigError if it is unknown, or neither projected nor local.
    """
    if text is None or text.strip().lower() == "none":
        return None
    try:
        crs = describe(CRS.from_user_input(text))
    except CRSError as error:
        raise ConfigError(
            f"--crs {text}: {' '.join(str(error).split())[:150]}; write EPSG:25832, a WKT, or none"
        ) from error
    if crs.kind not in ("projected", "local"):
        kind = "; ".join(crs.notes) if crs.kind == "missing" else f"{crs.name} is {crs.kind}"
        raise ConfigError(f"--crs {text}: {kind}; give a projected CRS")
    return crs


def _note_ignored_crs(
    members: Sequence[tuple[Path, Georeference]],
    text: str | None,
    given: Georeference | None,
    notes: list[str],
) -> None:
    """Add a note if files have a CRS other than ``--crs``, which is then not used for them."""
    declared = [g for _, g in members if g.wkt is not None and g is not given]
    if text is None:
        return
    differing = next((g for g in dict.fromkeys(declared) if _differs(g, given)), None)
    if differing is not None and differing.wkt is not None:
        notes.append(
            f"--crs {text} is only for files without a CRS: {len(declared)} of {len(members)} files have their own, "
            f"{CRS.from_wkt(differing.wkt).name}, which is used; if it is wrong, write the right one into the files "
            "first (`pdal translate IN OUT --writers.las.a_srs=EPSG:...`)"
        )


def _differs(own: Georeference, given: Georeference | None) -> bool:
    """Return whether a file's CRS is not that of ``--crs``, or has other heights."""
    if given is None:
        return True
    own_crs, vertical = _parts(own.wkt)
    given_crs, heights = _parts(given.wkt)
    if own_crs is None or given_crs is None or not same_horizontal(given_crs, own_crs):
        return True
    if heights is None:
        return False
    same_datum = vertical is not None and same_vertical_datum(vertical, heights)
    return not same_datum or own.vertical != given.vertical


def _settled(
    path: Path, own: Georeference, given: Georeference | None, text: str | None
) -> Georeference:
    """Return the CRS of a file, or that of ``--crs`` if the file does not have one.

    Raise InputError if the CRS is missing or has angles instead of lengths.
    """
    if own.kind in ("geographic", "geocentric"):
        raise InputError(
            f"{path}: CRS {own.name} is {own.kind}, not projected; reproject the file to a projected CRS"
        )
    if own.kind != "missing":
        return _with_heights(own, given)
    if given is not None:
        return given
    if text is not None:
        return Georeference("missing", "unknown")
    why = f" ({'; '.join(own.notes)})" if own.notes else ""
    raise InputError(
        f"{path}: has no CRS{why}; give it with --crs EPSG:..., or --crs none to assume metres "
        "(feet: --crs none --units ft)"
    )


@lru_cache(maxsize=64)
def _with_heights(own: Georeference, given: Georeference | None) -> Georeference:
    """Return a file's CRS, or that of ``--crs`` if it adds a vertical CRS to the same horizontal one."""
    if given is None or given.wkt is None or own.wkt is None:
        return own
    own_crs, vertical = _parts(own.wkt)
    given_crs, heights = _parts(given.wkt)
    if vertical is not None or heights is None or own.vertical not in (None, given.vertical):
        return own
    if own_crs is None or given_crs is None or not same_horizontal(given_crs, own_crs):
        return own
    return given


def _check_horizontal(members: Sequence[tuple[Path, Georeference]]) -> None:
    """Raise InputError if the horizontal CRSs of two files differ."""
    if not members:
        return
    first_path, first = members[0]
    reference = _parts(first.wkt)[0]
    for path, member in members[1:]:
        other = _parts(member.wkt)[0]
        if other is reference:
            continue
        if other is None or reference is None or not same_horizontal(reference, other):
            raise InputError(
                f"{path}: its CRS is {member.name}, that of {first_path} is {first.name}; "
                "run them apart, reproject, or give --crs for files without one"
            )


def _check_vertical(members: Sequence[tuple[Path, Georeference]]) -> None:
    """Raise InputError if the vertical datums of two files differ. Files without one suit any."""
    known = [(path, g.wkt, v) for path, g in members if (v := _parts(g.wkt)[1]) is not None]
    for path, wkt, vertical in known[1:]:
        first_path, first_wkt, first = known[0]
        if vertical is not first and not same_vertical_datum(first, vertical):
            raise InputError(
                f"{path}: its heights refer to {vertical_name(wkt)}, those of {first_path} to "
                f"{vertical_name(first_wkt)}; run them apart, convert the heights, or correct the CRS in a file"
            )


@lru_cache(maxsize=64)
def _parts(wkt: str | None) -> tuple[CRS | None, CRS | None]:
    return (None, None) if wkt is None else split(CRS.from_wkt(wkt))


def _units(
    members: Sequence[tuple[Path, Georeference]], text: str | None, notes: list[str]
) -> Units:
    """Return the horizontal and the vertical unit.

    Raise InputError if heights of files have different units, or ConfigError if ``--units``
    cannot be used.
    """
    declared = next((g.horizontal for _, g in members if g.horizontal is not None), None)
    if text is None:
        if members and declared is None:
            notes.append(
                "the files have no CRS: coordinates are assumed to be in metres (--crs, --units)"
            )
        horizontal = declared or METRE
        return Units(horizontal, _common_vertical(members, horizontal, notes))
    parts = [unit_named(part) for part in text.split(",")]
    if len(parts) > 2:
        raise ConfigError(f"--units {text}; give h or h,v, like ft or m,ft")
    horizontal = parts[0]
    vertical = parts[1] if len(parts) == 2 else _common_vertical(members, horizontal, [])
    notes.append(
        f"--units: x and y are in {unit_plural(horizontal)}, heights in {unit_plural(vertical)}"
    )
    if declared not in (None, horizontal):
        notes.append(
            f"--units {text}: x and y are read in {unit_plural(horizontal)} although their CRS has "
            f"{unit_plural(declared)}; if this is the unit of the heights alone, write --units h,v"
        )
    for path, own in members:
        if own.vertical not in (None, vertical):
            notes.append(
                f"--units {text}: heights are read in {unit_plural(vertical)} although the CRS of {path} has "
                f"{unit_plural(own.vertical)}; rasters do not get its vertical CRS"
            )
            break
    return Units(horizontal, vertical)


def _common_vertical(
    members: Sequence[tuple[Path, Georeference]], horizontal: Fraction, notes: list[str]
) -> Fraction:
    """Return the unit of all heights, which is the horizontal unit in files that do not define it.

    Raise InputError if heights of files have different units.
    """
    units = [(path, g.vertical or horizontal) for path, g in members]
    for path, unit in units[1:]:
        if unit != units[0][1]:
            raise InputError(
                f"{path}: its heights are in {unit_plural(unit)}, those of {units[0][0]} in "
                f"{unit_plural(units[0][1])}; convert them, or give the units of all with --units h,v"
            )
    silent = sum(g.vertical is None for _, g in members)
    if silent and any(g.wkt for _, g in members):
        notes.append(
            f"heights are assumed to be in {unit_plural(horizontal)}, like x and y, because there is no vertical "
            f"CRS in {silent} of {len(members)} files (--units h,v)"
        )
    return units[0][1] if units else horizontal
