"""GeoPackages with journals, as a GIS leaves them while it edits and after a crash."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

FUNCTIONS = ("ST_IsEmpty", "ST_MinX", "ST_MaxX", "ST_MinY", "ST_MaxY")
"""Functions that a program has to provide, since triggers of the spatial index call them."""


def connected(path: Path) -> sqlite3.Connection:
    """A connection that can write features."""
    database = sqlite3.connect(path)
    for name in FUNCTIONS:
        database.create_function(name, 1, lambda _: 0)
    return database


def opened_in_gis(path: Path) -> sqlite3.Connection:
    """Commit a copy of the first feature, and keep the file open: the feature is only in ``-wal``."""
    database = connected(path)
    database.execute("PRAGMA journal_mode = wal")
    table, _ = layer_of(database)
    names = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
    columns = ", ".join(f'"{name}"' for name in names if name != "fid")
    database.execute(f"INSERT INTO {table} ({columns}) SELECT {columns} FROM {table} LIMIT 1")
    database.commit()
    return database


def crashed(path: Path, folder: Path) -> Path:
    """Copy a GeoPackage with its journals, as they remain if the program that has it open is killed."""
    folder.mkdir()
    for file in path.parent.glob(f"{path.name}*"):
        if not file.name.endswith("-shm"):
            shutil.copy2(file, folder)
    return folder / path.name


def in_transaction(path: Path) -> sqlite3.Connection:
    """Begin a transaction without WAL that is too large for memory, so that the file has unfinished changes."""
    database = connected(path)
    database.execute("PRAGMA cache_size = 1")
    table, _ = layer_of(database)
    database.execute(f"DELETE FROM {table}")
    database.execute("CREATE TABLE large (x)")
    database.executemany("INSERT INTO large VALUES (?)", [("x" * 1000,)] * 300)
    return database


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Another process has begun an exclusive transaction, in which it has not changed anything yet."""
    code = (
        "import sqlite3, sys; base = sqlite3.connect(sys.argv[1], isolation_level=None);"
        "base.execute('BEGIN EXCLUSIVE'); print('locked', flush=True); sys.stdin.read()"
    )
    # Locks of a file do not exclude the process that has them.
    with subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        try:
            yield
        finally:
            process.communicate()


def layer_of(database: sqlite3.Connection) -> tuple[str, int]:
    """Name and number of features of the first layer."""
    (table,) = database.execute("SELECT table_name FROM gpkg_geometry_columns").fetchone()
    return table, database.execute(f"SELECT count(*) FROM {table}").fetchone()[0]


def n_features(path: Path) -> int:
    """Number of features of the first layer. The file must be intact."""
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        return layer_of(database)[1]
