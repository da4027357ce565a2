"""`tiler clean`: removes what a run left behind and no later one needs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tiler.errors import ConfigError
from tiler.io.locations import is_url, joined
from tiler.io.partial_files import is_scratch
from tiler.io.result_folder import STORE, earlier_outputs, read_run
from tiler.store import locked_folder, open_store


def clean(out: str | Path, store_url: str | None = None) -> dict[str, Any]:
    """Remove scratch and spool of a finished or broken run; the next run finds everything else done.

    Kept are the points, the labels of all passes, the rasters and what is done. A run that later has to assemble
    buckets anew, as for one more file, decodes again the pieces that touch them, and those alone.

    Parameters
    ----------
    out : path or URL
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
        A run is at work on the folder or its store.
    """
    place = str(out) if is_url(out) else str(Path(out).resolve())
    if not (is_url(out) or Path(out).is_dir()):
        raise ConfigError(f"{out}: no such folder; name the OUT of a run")
    configured = (read_run(place) or {}).get("configuration")
    named = configured.get("store") if isinstance(configured, dict) else None
    store = open_store(str(store_url or named or joined(place, STORE)))
    with locked_folder(place), store.lock():
        before = store.usage()
        store.tidy()
        after = store.usage()
        scratch = [] if is_url(out) else list(_scratch(Path(out)))  # objects appear whole
        sizes = [path.stat().st_size for path in scratch]
        for path in scratch:
            path.unlink(missing_ok=True)
    return {
        "scratch_files": len(scratch),
        "removed_objects": before.objects - after.objects + len(scratch),
        "removed_bytes": before.size_bytes - after.size_bytes + sum(sizes),
        "store_bytes": after.size_bytes,
    }


def _scratch(out: Path) -> Iterator[Path]:
    """Files that killed writes left, by the names that tiler gives them, in the folders into which it writes."""
    if read_run(str(out)) is None:
        return
    folders = {out, *((out / path).parent for path in earlier_outputs(out, str(out.resolve())))}
    for folder in sorted(folders):
        if folder.is_dir() and folder.resolve().is_relative_to(out.resolve()):
            yield from sorted(path for path in folder.iterdir() if is_scratch(path.name) and path.is_file())
