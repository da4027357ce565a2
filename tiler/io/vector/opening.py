"""Checks of vector files before GDAL opens them, since it ignores suffixes, follows links in a file, writes journals.

Journals are files of SQLite with changes that are not in a GeoPackage yet. They lie next to it while a program has it
open, and after a crash. What a user saved may be only in ``-wal``. If the GeoPackage is replaced or moved, SQLite
applies them to the wrong file, or they are lost.
"""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pyproj.exceptions import ProjError
from shapely.errors import ShapelyError

from tiler.core.crs import crs_in_file
from tiler.core.words import listed
from tiler.errors import ConfigError, InputError
from tiler.io.atomic_files import SCRATCH_PREFIX
from tiler.io.foreign_content import excerpt, member, packing_of, parse_json_object
from tiler.io.locations import is_url, no_such_file, sizes_at, states_at
from tiler.redaction import printable

_SQL = re.compile(r"sqlite3_\w+\(.*?\) failed: ", re.DOTALL)
"""Call of SQLite in a message of GDAL, which precedes the reason."""
_DAMAGED = re.compile("malformed|file is not a database")
IN_USE = "is in use by another program"
"""Fault of a file that another program has locked. Such a file is not damaged."""
_JOURNAL_SUFFIXES = ("-wal", "-journal")
MAX_LISTED = 5


def journals_of(path: Path) -> list[Path]:
    """Return the journals that lie next to a GeoPackage, or next to the file to which a link leads.

    An empty ``-wal`` tells that the file is open. An empty ``-journal`` remains after some programs close the file.
    """
    if path.suffix.lower() != ".gpkg":
        return []
    journals = [f"{os.path.realpath(path)}{suffix}" for suffix in _JOURNAL_SUFFIXES]
    sizes = dict(zip(journals, sizes_at(journals), strict=True))
    return [
        Path(journal)
        for journal, size in sizes.items()
        if size or (size == 0 and journal.endswith("-wal"))
    ]


def open_text(journals: Sequence[Path]) -> str:
    """Return the error and the remedy for outputs with journals."""
    names = listed([journal.name for journal in journals], MAX_LISTED)
    return (
        f"{names}: its GeoPackage is open in another program, or was when that program crashed, so this journal may "
        "contain saved edits; close the GeoPackage there (after a crash, open and close it), then run again"
    )


def validate_closed(out: str, paths: Iterable[str]) -> None:
    """Raise ConfigError if a GeoPackage of OUT has a journal. Objects at a URL have none."""
    if is_url(out):
        return
    journals = [journal for path in sorted(paths) for journal in journals_of(Path(out, path))]
    if journals:
        raise ConfigError(f"-o {out}: {open_text(journals)}")


SIGNATURES = {
    ".gpkg": b"SQLite format 3\0",
    ".geojson": b"",
    ".json": b"",
    ".shp": b"\0\0\x27\x0a",
    ".fgb": b"fgb\x03fgb",
}
"""Suffixes of the formats that are read, and the first bytes of their files. GeoJSON is checked
as a whole."""
CUT = "cut it to the survey with `ogr2ogr -spat X0 Y0 X1 Y1 part.gpkg FILE`"
"""Remedy for a file that is too large."""
MAX_COPIES = 10
"""Number of attempts to copy a file that another program is changing."""


def check_file(path: Path, wanted: str) -> list[bool] | None:
    """Raise InputError for a file that GDAL must not open.

    GDAL recognises a format by the content and not by the name: it would follow the links to
    other files or hosts in a VRT or WFS with the name ``area.gpkg``. Therefore the first bytes
    of a file must match its suffix.

    Returns
    -------
    list of bool or None
        Whether each feature of a GeoJSON file has a geometry, or None for other formats.
    """
    signature = SIGNATURES.get(path.suffix.lower())
    if not os.path.exists(path) or (signature is not None and not path.is_file()):
        raise no_such_file(path, f"give a GeoPackage, GeoJSON or Shapefile with {wanted}")
    start = _first_bytes(path)
    if packing := packing_of(start):
        raise InputError(f"{path}: is packed with {packing}; unpack it and give the file in it")
    if signature is None:
        *most, last = SIGNATURES
        raise InputError(
            f"{path}: {wanted} are read from {', '.join(most)} and {last} files; "
            f"convert it, for example with `ogr2ogr new.gpkg FILE`"
        )
    if "!" in str(path.resolve()) or str(path.resolve()).startswith("/vsi"):
        raise InputError(
            f"{path}: GDAL would read it as an archive because of its name; rename it"
        )
    if not start.startswith(signature):
        raise InputError(
            f"{path}: does not begin as a {path.suffix.lower()} file does; get the file again, "
            f"or convert it with `ogr2ogr new.gpkg FILE`"
        )
    return _check_geojson(path, wanted) if not signature else None


def _first_bytes(path: Path) -> bytes:
    """Return the first bytes of a file, none of a path that is not a file."""
    if not path.is_file():
        return b""
    try:
        with path.open("rb") as stream:
            return stream.read(max(map(len, SIGNATURES.values())))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); give a readable file"
        ) from error


def _check_geojson(path: Path, wanted: str) -> list[bool]:
    """Check a GeoJSON file, in which GDAL would silently misread an unknown CRS or a damaged geometry."""
    try:
        content = parse_json_object(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: not valid GeoJSON ({printable(str(error))}); write {wanted} as features"
        ) from error
    features = content.get("features")
    if content.get("type") != "FeatureCollection" or not isinstance(features, list):
        raise InputError(f"{path}: not a GeoJSON FeatureCollection; write {wanted} as features")
    for number, feature in enumerate(features, start=1):
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise InputError(
                f"{path}: feature {number} is not a GeoJSON Feature; write {wanted} as features"
            )
    # Most programs still write the member with the CRS, although RFC 7946 removed it.
    named = member(member(content, "crs"), "properties").get("name")
    if (
        named is None and content.get("crs") is not None
    ):  # GDAL would take such coordinates for degrees.
        raise InputError(
            f"{path}: its CRS has no name ({excerpt(content['crs'], 80)}), and links are not followed; name it with "
            f"`ogr2ogr -a_srs EPSG:... new.gpkg FILE`"
        )
    try:
        if named is not None:
            crs_in_file(str(named))
    except (ProjError, UnicodeError, RecursionError) as error:
        raise InputError(
            f"{path}: its CRS {excerpt(named)} is not known; write it with another CRS"
        ) from error
    return [feature.get("geometry") is not None for feature in features]


@contextmanager
def unchanged(path: Path) -> Iterator[Path]:
    """Yield the path at which GDAL can read a file without changing it: its own, or that of a copy.

    SQLite writes the journal of a crashed program into a GeoPackage that is only read. An open as ``immutable`` would
    ignore what is committed in ``-wal``. So a GeoPackage with journals is copied with them.
    """
    if not journals_of(path):
        yield path
        return
    with TemporaryDirectory(prefix=SCRATCH_PREFIX) as folder:
        copy = Path(folder, path.name)
        try:
            _copy_with_journals(path, copy)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be copied to {folder} ({error.strerror}); close it in the program that has it open"
            ) from error
        with reading(path), closing(sqlite3.connect(copy)) as database:
            # This writes committed changes into the copy, and removes those of an unfinished transaction.
            database.execute("PRAGMA journal_mode = delete")
        yield copy


def _copy_with_journals(path: Path, copy: Path) -> None:
    """Copy a GeoPackage and its journals as they were at one moment.

    Raise InputError if a program keeps writing to them.
    """
    source = os.path.realpath(path)
    suffixes = ("", *_JOURNAL_SUFFIXES)
    states = None
    for _ in range(MAX_COPIES):
        before, states = states, states_at([f"{source}{suffix}" for suffix in suffixes])
        if states == before:
            return
        for suffix, state in zip(suffixes, states, strict=True):
            Path(f"{copy}{suffix}").unlink(missing_ok=True)
            if state is not None:
                # If the program removes its journal now, the states will differ.
                with suppress(FileNotFoundError):
                    shutil.copyfile(f"{source}{suffix}", f"{copy}{suffix}")
    raise InputError(f"{path}: a program keeps writing to it; close it there, then run again")


@contextmanager
def reading(path: Path) -> Iterator[list[str]]:
    """Convert errors of libraries to an InputError, and yield a list that receives their warnings."""
    reported: list[str] = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield reported
    # pyogrio raises RuntimeErrors. Names and texts that are not UTF-8 raise
    # UnicodeDecodeErrors.
    except (RuntimeError, ValueError, OverflowError, ShapelyError, sqlite3.Error) as error:
        if "database is locked" in str(error):
            raise InputError(f"{path}: {IN_USE}; close it there, then run again") from error
        raise InputError(
            f"{path}: cannot be read ({_short(error)}); get the file again"
        ) from error
    reported += sorted({_short(warning.message) for warning in caught})


def _short(problem: Any) -> str:
    """Return the message of a library, in one line and without SQL and the advice after a semicolon."""
    text = " ".join(_SQL.sub("", str(problem)).split(";")[0].split())
    return "its database is damaged" if _DAMAGED.search(text) else printable(text)[:150]
