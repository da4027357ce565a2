"""`tiler clean`: remove files of earlier runs that no later run needs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tiler.errors import ConfigError
from tiler.io.atomic_files import is_scratch
from tiler.io.locations import is_url, joined
from tiler.io.result_folder import STORE, earlier_outputs, read_run
from tiler.store import locked_folder, open_store


def clean(out: str | Path, store_url: str | None = None) -> dict[str, Any]:
    """Remove scratch and spool of a finished or broken run; the next run finds all other work done.

    The points, the labels of all passes, the rasters and the records of finished tasks stay. If a later run has to
    assemble buckets again, for example for a further file, it decodes only the pieces that touch them.

    Parameters
    ----------
    out : path or URL
        Folder of the run.
    store_url : str, optional
        Location of its store; by default the one in its ``run.json``, or ``store.zarr`` in the folder.

    Returns
    -------
    dict
        ``scratch_files`` removed from the folder, ``removed_objects`` and ``removed_bytes`` of store and folder,
        ``store_bytes`` left.

    Raises
    ------
    ConfigError
        If there is no such folder.
    StoreError
        If it has no store.
    LockedError
        If a run is at work on the folder or its store.
    """
    place = str(out)
    if not is_url(out):
        place = str(Path(out).resolve())
        if not Path(out).is_dir():
            raise ConfigError(f"{out}: no such folder; give the OUT of a run")
    if not store_url:
        configured = (read_run(place) or {}).get("configuration")
        if isinstance(configured, dict):
            store_url = configured.get("store")
    store = open_store(str(store_url or joined(place, STORE)))
    with locked_folder(place), store.lock():
        before = store.usage()
        store.tidy()
        after = store.usage()
        scratch = []
        if not is_url(out):  # objects at a URL appear whole
            scratch = list(_scratch(Path(out)))
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
    """Unfinished files of killed runs, recognised by their names, in the folders into which runs write."""
    if read_run(str(out)) is None:
        return
    folders = {out, *((out / path).parent for path in earlier_outputs(out, str(out.resolve())))}
    for folder in sorted(folders):
        if folder.is_dir() and folder.resolve().is_relative_to(out.resolve()):
            yield from sorted(path for path in folder.iterdir() if is_scratch(path.name) and path.is_file())
