"""GeoPackage (OGC 12-128r19)."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tiler.errors import InputError
from tiler.io.json_text import excerpt
from tiler.redaction import printable

_ENVELOPE_BYTES = (0, 32, 48, 48, 64)
_EMPTY = 0x10


@dataclass(frozen=True)
class Layer:
    """Features of a layer.

    Attributes
    ----------
    name : str
    records : list of (geometry, properties)
        The geometry as it is stored, see `geometry_of`.
    crs : str or None
        Authority code or WKT.
    """

    name: str
    records: list[tuple[Any, dict[str, Any]]]
    crs: str | None


def read_layer(path: Path, kinds: Collection[str], wanted: str) -> Layer:
    """The one layer of a file whose geometries are of these kinds; raises InputError.

    Parameters
    ----------
    path : Path
    kinds : collection of str
        Names of geometry types, upper case.
    wanted : str
        What they are called in messages.
    """
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
            base.row_factory = sqlite3.Row
            base.text_factory = lambda text: text.decode("utf-8", "replace")
            return _layer(path, base, kinds, wanted)
    except (sqlite3.Error, UnicodeDecodeError) as error:  # damaged text is in messages of sqlite as well
        raise InputError(f"{path}: not a GeoPackage that can be read ({printable(str(error))})") from error


def _layer(path: Path, base: sqlite3.Connection, kinds: Collection[str], wanted: str) -> Layer:
    layers = base.execute(
        "SELECT table_name, column_name, srs_id FROM gpkg_geometry_columns "
        f"WHERE upper(geometry_type_name) IN ({', '.join('?' * len(kinds))})",
        tuple(kinds),
    ).fetchall()
    if len(layers) != 1:
        names = ", ".join(printable(str(layer["table_name"])) for layer in layers) or "none"
        raise InputError(
            f"{path}: needs one layer of {wanted}, has {len(layers)} ({names}); "
            f"write one with `ogr2ogr {wanted}.gpkg FILE LAYER`"
        )
    table, column, srs = layers[0]
    rows = base.execute(f'SELECT * FROM "{_quoted(str(table))}"')
    columns = [name for name, *_ in rows.description]
    geometry = next((i for i, name in enumerate(columns) if name.lower() == str(column).lower()), None)
    if geometry is None:
        raise InputError(
            f"{path}: layer {printable(str(table))} has no column {excerpt(column)}, which should hold its {wanted}"
        )
    records = [
        (row[geometry], {name: row[i] for i, name in enumerate(columns) if i != geometry}) for row in rows
    ]
    found = base.execute(
        "SELECT organization, organization_coordsys_id, definition FROM gpkg_spatial_ref_sys WHERE srs_id = ?",
        (srs,),
    ).fetchone()
    if found is None or srs in (-1, 0):
        return Layer(printable(str(table)), records, None)
    if str(found["organization"]).upper() in ("NONE", ""):
        return Layer(printable(str(table)), records, str(found["definition"]))
    return Layer(
        printable(str(table)), records, f"{found['organization']}:{found['organization_coordsys_id']}"
    )


def _quoted(name: str) -> str:
    return name.replace('"', '""')


def geometry_of(blob: Any, place: str) -> bytes:
    """The well-known binary of a geometry (2.1.3: a header stands before it), empty for an empty one."""
    if not isinstance(blob, bytes) or blob[:2] != b"GP":
        raise InputError(f"{place}: has no GeoPackage geometry")
    try:
        start = 8 + _ENVELOPE_BYTES[(blob[3] >> 1) & 7]
    except IndexError as error:
        raise InputError(f"{place}: its geometry is damaged ({error})") from error
    return b"" if blob[3] & _EMPTY else blob[start:]
