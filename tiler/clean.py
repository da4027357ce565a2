"""`tiler clean`: what a run left behind and no later one needs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tiler.errors import ConfigError
from tiler.store import open_store

SCRATCH = ("*.partial", "*.partial.*")


def clean(out: Path, store_url: str | None = None) -> dict[str, Any]:
    """Remove scratch and spool of a finished or broken run; the next run finds everything else done.

    Kept are the points, the labels of all passes, the rasters and what is done. A run that later has to assemble
    buckets anew, as for one more file, decodes again the pieces that touch them, and those alone.

    Parameters
    ----------
    out : Path
        The run's folder.
    store_url : str, optional
        Where its store lies; default: as its ``run.json`` says, else ``store.zarr`` in the folder.

    Returns
    -------
    dict
        ``scratch_files`` removed from the folder, ``removed_objects`` and ``removed_bytes`` of store and folder,
        ``store_bytes`` left.

    Raises
    ------
    ConfigError
        No such folder.
    StoreError
        It has no store.
    LockedError
        A run is at work on it.
    """
    if not out.is_dir():
        raise ConfigError(f"{out}: no such folder; name the OUT of a run")
    store = open_store(store_url or _store_of(out))
    with store.lock():
        before = store.usage()
        store.tidy()
        after = store.usage()
        scratch = [
            path
            for pattern in SCRATCH
            for path in sorted(out.rglob(pattern))
            if path.is_file() and out / "store.zarr" not in path.parents
        ]
        sizes = [path.stat().st_size for path in scratch]
        for path in scratch:
            path.unlink(missing_ok=True)
    return {
        "scratch_files": len(scratch),
        "removed_objects": before.objects - after.objects + len(scratch),
        "removed_bytes": before.size_bytes - after.size_bytes + sum(sizes),
        "store_bytes": after.size_bytes,
    }


def _store_of(out: Path) -> str:
    """The store that the run of a folder used."""
    try:
        named = json.loads((out / "run.json").read_text())["configuration"]["store"]
    except (OSError, ValueError, KeyError, TypeError):
        named = None
    return str(named or out.resolve() / "store.zarr")
