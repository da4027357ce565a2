"""Journals of GeoPackages: files of SQLite with changes that are not in the GeoPackage yet.

They lie next to a file while a program has it open, and after a crash. What a user saved may be only in ``-wal``. If
the GeoPackage is replaced or moved, SQLite applies them to the wrong file, or they are lost.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from tiler.core.words import listed
from tiler.errors import ConfigError
from tiler.io.locations import is_url, sizes_at

SUFFIXES = ("-wal", "-journal")
MAX_LISTED = 5


def journals_of(path: Path) -> list[Path]:
    """Return the journals that lie next to a GeoPackage, or next to the file to which a link leads.

    An empty ``-wal`` tells that the file is open. An empty ``-journal`` remains after some programs close the file.
    """
    if path.suffix.lower() != ".gpkg":
        return []
    journals = [f"{os.path.realpath(path)}{suffix}" for suffix in SUFFIXES]
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
