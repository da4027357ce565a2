"""Archiving of outdated and changed files of earlier runs in OUT/outdated, so that they do not look current.

A run writes only the requested products. Other products of an earlier run stay valid as long as
the points, the labels and the settings of the rasters are the same. Otherwise they are moved to
``OUT/outdated``, and so are classified files of inputs that the run does not have.

In run.json, ``outputs`` lists the files that a run wrote, and ``made_of`` the basis of its products.
``earlier_outputs`` lists the files of earlier runs until the export has checked them. From then on it lists the files
that this run has yet to write.

Files may be missing, changed by a user, or damaged. Usually size and time show this. If the time differs, or with
``--verify``, all bytes are read. A file that differs is moved and not overwritten, since it may be a user's work.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from tiler.core.words import listed
from tiler.errors import ConfigError, TilerError, is_in_use, write_error
from tiler.export.output_files import FileRecord
from tiler.io.locations import is_url, joined, move_file, sizes_at, states_at
from tiler.io.overwrite_check import check_links
from tiler.io.result_folder import OUTDATED, REVIEW, below, mosaic_file
from tiler.io.vector.opening import validate_closed
from tiler.observe.events import Note
from tiler.runs.file_digests import file_digests
from tiler.runs.job import Job

STAGE = "verify"
WRITING = ("export", "mosaic", "catalogue")
"""Stages whose tasks write files of OUT."""
SIDECARS = (".ovr", ".aux.xml", ".msk", ".msk.ovr")
"""Suffixes, after the name of a raster, of the overviews, statistics and masks that GDAL derives from it.

Styles and metadata of QGIS (``.qml``, ``.qmd``) are a user's work, and stay.
"""
ERDAS_OVERVIEWS = ".aux"
"""Suffix, in place of that of a raster, of its overviews in the format of Erdas Imagine, which QGIS offers."""
NAMED = 5
"""Number of files that a note lists. Further files are counted."""


def archive_outdated(job: Job, written: Mapping[str, str], basis: str) -> None:
    """Move outdated files of earlier runs, and list the files that stay valid in ``outputs``.

    Parameters
    ----------
    job : Job
    written : mapping of str to str
        Files that this run writes, as paths in OUT, by the key of the task. From now on run.json lists them as
        ``earlier_outputs`` without a basis. So if a run is killed while it writes, later runs do not treat its files as
        valid.
    basis : str
        Digest of the data and settings from which the products of this run are made.

    Raises
    ------
    ConfigError
        A file that this run writes already exists, and was not written by an earlier run. Or a GeoPackage is open.
    ProcessingError
        A file cannot be moved.
    """
    wanted = set(written.values())
    # After a repair of the store the export runs again, and ``outputs`` lists files that this
    # run has checked already.
    earlier = {**job.results.earlier_outputs, **dict.fromkeys(job.results.outputs, basis)}
    # The plan checked this as well, but the run may have taken hours since.
    validate_closed(job.products, wanted | earlier.keys())
    if not job.plan.config.force:
        _validate_own_files(job, [path for path in wanted if path not in earlier])
    there = {p: of for p, of in earlier.items() if p not in wanted and _inside(job.products, p)}
    sizes = dict(zip(there, sizes_at([joined(job.products, p) for p in there]), strict=True))
    stale = sorted(
        path for path, of in there.items() if of != basis and sizes[path] is not None
    )
    kept = {
        path: size for path, size in sizes.items() if size is not None and path not in stale
    }
    aside = archive(job, stale)
    for path in _damaged(job, kept) if job.plan.config.verify else ():
        del kept[path]
        text = f"{path}: changed since a run wrote it; moved to {archive(job, [path])}/"
        job.note(f"{text}, and not made again, as --products does not list it", Note)
    _archive_changed(job, written)
    job.results.outputs = kept
    job.results.digests = {p: d for p, d in job.results.digests.items() if p in kept}
    job.results.made_of = dict.fromkeys(kept, basis)
    job.results.earlier_outputs = dict.fromkeys(wanted)
    if stale:
        job.note(
            f"{listed(stale, NAMED)}: written by an earlier run with other settings or inputs, and not made by this "
            f"run; moved to {aside}/",
            Note,
        )
    job.save("running")


def _archive_changed(job: Job, written: Mapping[str, str]) -> None:
    """Move changed files that this run replaces, if the store is new and has no record of them.

    `invalidate_changed_outputs` moves those that the store knows.
    """
    known = {REVIEW, *(key for stage in WRITING for key in job.store.committed(stage))}
    changed = sorted(_damaged(job, {path for key, path in written.items() if key not in known}))
    if changed:
        job.note(_changed_text(changed, archive(job, changed)), Note)


def _changed_text(paths: Sequence[str], location: str) -> str:
    return f"{listed(paths, NAMED)}: changed since a run wrote them; moved to {location}/ and made again"


def _damaged(job: Job, paths: Collection[str]) -> list[str]:
    """Return the files whose bytes do not match their digest in run.json."""
    known = {p: d for p, d in job.results.digests.items() if p in paths}
    path_of = {joined(job.products, path): path for path in sorted(known)}
    states = zip(path_of, states_at(list(path_of)), strict=True)
    results = file_digests(
        job,
        "verify",
        [(location, s, 0) for location, s in states if s is not None],
        in_out=True,
    )
    return [
        path_of[location]
        for location, result in results
        if result.digest != known[path_of[location]]
    ]


def _validate_own_files(job: Job, wanted: list[str]) -> None:
    """Raise ConfigError if files to write already exist: they appeared after the plan, or are not in the plan."""
    sizes = sizes_at([joined(job.products, path) for path in wanted])
    there = [path for path, size in zip(wanted, sizes, strict=True) if size is not None]
    if there:
        raise ConfigError(
            f"-o {job.products}: {', '.join(there[:NAMED])}: already exists and was not written by a run in this "
            "folder; move them away, or use --force to replace them"
        )


def _inside(out: str, path: str) -> bool:
    """Return whether a path from run.json lies in OUT and is not a folder."""
    if is_url(out):
        return not {"", ".", ".."} & set(path.split("/"))
    whole = Path(out, path)
    return whole.resolve().is_relative_to(Path(out).resolve()) and not whole.is_dir()


def archive(job: Job, paths: Sequence[str], copies: bool = False) -> str:
    """Move or copy files of OUT and their sidecars into one folder in which none of their names exists.

    Return the path of the folder in OUT. Raise ConfigError if one of them is an open GeoPackage, or a folder is a link.
    """
    out, folder, number = job.products, OUTDATED, 1
    validate_closed(out, paths)
    paths = list(dict.fromkeys([*paths, *_sidecars(job, paths)]))
    while _taken(out, [joined(out, folder, path) for path in paths]):
        number += 1
        folder = f"{OUTDATED}/{number}"
    check_links("-o", out, [*paths, *(f"{folder}/{path}" for path in paths)])
    for path in paths:
        if copies:
            _copy(out, path, joined(out, folder, path))
        else:
            _move(out, path, joined(out, folder, path))
    return folder


def archive_unwritten(job: Job, path: str) -> None:
    """Move the file of an earlier run that this run could not replace, so that it does not look current."""
    told = f"{path}: written by an earlier run, and this run could not replace it"
    try:
        if sizes_at([joined(job.products, path)]) != [None]:
            job.note(f"{told}; moved to {archive(job, [path])}/", Note)
    except (TilerError, OSError) as error:  # Such as a file that another program has open.
        job.note(f"{told}, nor move it ({error}); do not use it", Note)


def archive_sidecars(job: Job, replaced: Collection[str]) -> None:
    """Move the sidecars of files that now have other bytes, since a GIS would show the earlier data."""
    # The VRT of a product keeps its bytes if only the pixels of the sheets change.
    mosaics = {mosaic_file(os.path.dirname(path)) for path in replaced if "/" in path}
    sidecars = _sidecars(job, sorted({*replaced, *mosaics}))
    if sidecars:
        job.note(
            f"{listed(sidecars, NAMED)}: made by another program from files that this run replaced; moved to "
            f"{archive(job, sidecars)}/",
            Note,
        )


def _sidecars(job: Job, paths: Collection[str]) -> list[str]:
    """Return the files next to outputs that other programs derived from them. Objects at a URL have none."""
    if is_url(job.products):
        return []
    outputs = {*job.results.outputs, *job.results.earlier_outputs}
    sidecars = [f"{path}{suffix}" for path in paths for suffix in SIDECARS]
    sidecars += [f"{os.path.splitext(path)[0]}{ERDAS_OVERVIEWS}" for path in paths]
    return [
        s for s in sidecars if s not in outputs and os.path.lexists(joined(job.products, s))
    ]


def _taken(out: str, places: list[str]) -> bool:
    if is_url(out):
        return any(size is not None for size in sizes_at(places))
    return any(os.path.lexists(place) for place in places)


def _move(out: str, path: str, target: str) -> None:
    source = joined(out, path)
    try:
        move_file(source, target)
    except OSError as error:
        # Windows moves no file that is open, so the file to close is the source.
        refused = source if is_in_use(error) else target
        raise write_error(refused, error, None if is_url(out) else Path(out)) from error
    if not is_url(out):
        with suppress(OSError):  # The folder of a product's sheets is removed once it is empty.
            Path(source).parent.rmdir()


def _copy(out: str, path: str, target: str) -> None:
    try:
        Path(target).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(joined(out, path), target)
    except OSError as error:
        raise write_error(target, error, Path(out)) from error


def invalidate_changed_outputs(job: Job, stage: str, files: Mapping[str, str]) -> None:
    """Invalidate the tasks of a stage whose files are missing or were changed, and archive the changed files.

    Parameters
    ----------
    job : Job
    stage : str
        Stage whose records have ``bytes``, and ``digest`` and ``state`` unless an older version made them.
    files : mapping of str to str
        Path or URL of the file of each task, by the key of the task.

    Raises
    ------
    ProcessingError
        A changed file cannot be moved.
    """
    commits = {
        key: commit for key, commit in job.store.committed(stage).items() if key in files
    }
    states = dict(zip(commits, states_at([files[key] for key in commits]), strict=True))
    gone = [key for key, state in states.items() if state is None]
    there = {key: state for key, state in states.items() if state is not None}
    records = {key: FileRecord.of(stored) for key, (_, stored) in commits.items()}
    changed = [key for key, state in there.items() if state.size != records[key].bytes]
    doubtful = {}
    for key in there.keys() - set(changed):
        state = records[key].state
        if job.plan.config.verify or (state is not None and state != there[key].to_json()):
            doubtful[files[key]] = key
    files_of = [(location, there[key], 0) for location, key in sorted(doubtful.items())]
    for location, result in file_digests(job, STAGE, files_of, in_out=True):
        key = doubtful[location]
        digest, stored = commits[key]
        if result.digest != (records[key].digest or ""):
            changed.append(key)
        else:  # The bytes are the same, so the new time replaces the earlier one.
            job.store.commit(stage, key, digest, {**stored, "state": there[key].to_json()})
    job.invalidate(stage, [*gone, *changed])
    # The new file of places to review has what the user decided, and replaces the earlier one at once.
    paths = sorted(below(job.products, files[key]) for key in changed if key != REVIEW)
    if paths:
        job.note(_changed_text(paths, archive(job, paths)), Note)
