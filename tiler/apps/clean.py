"""Command `tiler clean`, which removes files of earlier runs that later runs do not need."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tiler.errors import ConfigError
from tiler.io.atomic_files import is_scratch
from tiler.io.locations import is_url, local_or_url
from tiler.io.result_folder import earlier_outputs, read_run, store_of
from tiler.store import locked_folder, open_store


@dataclass(frozen=True)
class CleanResult:
    """Number and size of the removed objects, and size of the store.

    ``scratch_files`` is the number of files removed from the folder. ``removed_objects`` and ``removed_bytes`` are the
    number and bytes of the objects removed from folder and store together. ``store_bytes`` are the bytes left in the
    store.
    """

    scratch_files: int
    removed_objects: int
    removed_bytes: int
    store_bytes: int


def clean(out: str | Path, store_url: str | None = None) -> CleanResult:
    """Remove the temporary files and the spool of a finished or broken run.

    The points, the labels of all passes, the rasters and the records of finished tasks stay, so
    the next run does not repeat them. If a later run has to assemble buckets again, for example
    for a further file, it decodes only the pieces that intersect them.

    Parameters
    ----------
    out : path or URL
        Folder of the run.
    store_url : str, optional
        Location of the store. The default is the one in the ``run.json``, or ``store.zarr`` in the folder.

    Raises
    ------
    ConfigError
        The folder does not exist.
    StoreError
        The run has no store, or the store cannot be opened.
    LockedError
        A run uses the folder or its store.
    """
    location = out = local_or_url(out)
    if not is_url(out):
        location = str(Path(out).resolve())
        if not Path(out).is_dir():
            raise ConfigError(f"{out}: no such folder; give the OUT of a run")
    store = open_store(store_of(location, read_run(location) or {}, store_url))
    with locked_folder(location), store.lock():
        before = store.usage()
        store.clean_up()
        after = store.usage()
        # Objects at a URL are never unfinished.
        scratch = [] if is_url(out) else list(_scratch(Path(out)))
        sizes = [path.stat().st_size for path in scratch]
        for path in scratch:
            path.unlink(missing_ok=True)
    return CleanResult(
        scratch_files=len(scratch),
        removed_objects=before.objects - after.objects + len(scratch),
        removed_bytes=before.size_bytes - after.size_bytes + sum(sizes),
        store_bytes=after.size_bytes,
    )


def _scratch(out: Path) -> Iterator[Path]:
    """Yield unfinished files of killed runs, recognised by name, in the folders into which runs write."""
    if read_run(str(out)) is None:
        return
    folders = {out, *((out / path).parent for path in earlier_outputs(out, str(out.resolve())))}
    for folder in sorted(folders):
        if folder.is_dir() and folder.resolve().is_relative_to(out.resolve()):
            yield from sorted(
                path for path in folder.iterdir() if is_scratch(path.name) and path.is_file()
            )
