"""Moves files that no longer hold, or are not as a run wrote them, to OUT/outdated, so that nothing old looks current.

A run writes the products that it is asked for. Those of an earlier run that it is not asked for hold as long as points,
labels and settings of the rasters are the same; else they go to ``OUT/outdated``, and so do classified files of inputs
that the run has not. run.json lists what a run wrote (``outputs``), what its rasters were made of (``made_of``), and
until the export has dealt with them the files of earlier runs (``earlier_outputs``).

Files may be gone, changed by a user, or damaged. Size and time tell as a rule; where the time is another one, and with
``--verify``, all bytes are read. What differs is put aside, not overwritten: it may be a user's work.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from tiler.errors import ConfigError, write_error
from tiler.ingest.tasks.fingerprints import contents
from tiler.io.locations import is_url, joined, move_file, sizes_at, states_at
from tiler.io.result_folder import OUTDATED, below
from tiler.runs.job import Job

STAGE = "verify"
NAMED = 5
"""Files that the note names; the others are counted."""


def archive_outdated(job: Job, wanted: Collection[str], basis: str) -> None:
    """Move what no longer holds; what does is listed in ``outputs``, as are no files yet of this run.

    Parameters
    ----------
    job : Job
    wanted : collection of str
        Files that this run writes, as paths in OUT. They are known from now on, but not what they are made of, so
        that a run that is killed while it writes leaves nothing that later runs take for theirs.
    basis : str
        What the rasters of this run are made of.

    Raises
    ------
    ConfigError
        A file that this run writes is there, and no earlier run made it.
    ProcessingError
        A file cannot be moved.
    """
    # What was dealt with already is this run's own: after a repair of the store all of this is done again.
    earlier = {**job.facts["earlier_outputs"], **dict.fromkeys(job.facts.get("outputs", {}), basis)}
    if not job.plan.config.force:
        _validate_own_files(job, [path for path in wanted if path not in earlier])
    there = {p: of for p, of in earlier.items() if p not in wanted and _inside(job.products, p)}
    sizes = dict(zip(there, sizes_at([joined(job.products, p) for p in there]), strict=True))
    stale = sorted(path for path, of in there.items() if of != basis and sizes[path] is not None)
    kept = {path: size for path, size in sizes.items() if size is not None and path not in stale}
    aside = move_aside(job.products, stale)
    for path in _damaged(job, kept) if job.plan.config.verify else ():
        del kept[path]
        text = f"{path}: changed since a run wrote it; moved to {move_aside(job.products, [path])}/"
        job.note(f"{text}, and not made again, as --products does not list it")
    job.facts["outputs"] = kept
    job.facts["digests"] = {p: d for p, d in job.facts.get("digests", {}).items() if p in kept}
    job.facts["made_of"] = dict.fromkeys(kept, basis)
    job.facts["earlier_outputs"] = dict.fromkeys(wanted)
    if stale:
        job.note(
            f"{named(stale)}: of an earlier run with other settings or inputs, and not of this one; "
            f"moved to {aside}/"
        )
    job.save("running")


def _damaged(job: Job, paths: Collection[str]) -> list[str]:
    """Files that differ from what the run that wrote them noted in run.json."""
    known = {p: d for p, d in job.facts.get("digests", {}).items() if p in paths}
    places = {joined(job.products, path): path for path in sorted(known)}
    states = zip(places, states_at(list(places)), strict=True)
    found = contents(job, "verify", [(place, s, 0) for place, s in states if s is not None], writes_out=True)
    return [places[place] for place, result in found if result.get("content") != known[places[place]]]


def _validate_own_files(job: Job, wanted: list[str]) -> None:
    """Raise ConfigError for files that came after the plan, or whose names it could not know."""
    sizes = sizes_at([joined(job.products, path) for path in wanted])
    there = [path for path, size in zip(wanted, sizes, strict=True) if size is not None]
    if there:
        raise ConfigError(
            f"-o {job.products}: {', '.join(there[:NAMED])}: already exists and was not written by a run in this "
            "folder; move them away, or use --force to replace them"
        )


def _inside(out: str, path: str) -> bool:
    """Whether a path that a file named leads nowhere else, and to a file."""
    if is_url(out):
        return not {"", ".", ".."} & set(path.split("/"))
    whole = Path(out, path)
    return whole.resolve().is_relative_to(Path(out).resolve()) and not whole.is_dir()


def move_aside(out: str, paths: Sequence[str]) -> str:
    """Move files of OUT together into a folder in which none of their names is taken; its path in OUT."""
    folder, number = OUTDATED, 1
    while _taken(out, [joined(out, folder, path) for path in paths]):
        number += 1
        folder = f"{OUTDATED}/{number}"
    for path in paths:
        _move(out, path, joined(out, folder, path))
    return folder


def named(paths: Sequence[str]) -> str:
    """The first of some files by name, and how many more there are."""
    more = f" and {len(paths) - NAMED:,} more" if len(paths) > NAMED else ""
    return ", ".join(paths[:NAMED]) + more


def _taken(out: str, places: list[str]) -> bool:
    if is_url(out):
        return any(size is not None for size in sizes_at(places))
    return any(os.path.lexists(place) for place in places)


def _move(out: str, path: str, target: str) -> None:
    source = joined(out, path)
    try:
        move_file(source, target)
    except OSError as error:
        raise write_error(target, error, None if is_url(out) else Path(out)) from error
    if not is_url(out):
        with suppress(OSError):  # the folder of a product's sheets, unless it still holds any
            Path(source).parent.rmdir()


def invalidate_changed_outputs(job: Job, stage: str, files: Mapping[str, str]) -> None:
    """Let the tasks of a stage be done again whose files are not what they wrote.

    Parameters
    ----------
    job : Job
    stage : str
        Its records have ``bytes``, and ``digest`` and ``state`` unless an older version made them.
    files : mapping of str to str
        Key of a task to the path or URL of its file.

    Raises
    ------
    ProcessingError
        A file that differs cannot be moved aside.
    """
    commits = {key: commit for key, commit in job.store.committed(stage).items() if key in files}
    states = dict(zip(commits, states_at([files[key] for key in commits]), strict=True))
    gone = [key for key, state in states.items() if state is None]
    there = {key: state for key, state in states.items() if state is not None}
    changed = [key for key, state in there.items() if state.size != commits[key][1]["bytes"]]
    doubtful = {}
    for key in there.keys() - set(changed):
        record = commits[key][1]
        if job.plan.config.verify or there[key].to_json() != record.get("state", there[key].to_json()):
            doubtful[files[key]] = key
    files_of = [(place, there[key], 0) for place, key in sorted(doubtful.items())]
    for place, result in contents(job, STAGE, files_of, writes_out=True):
        key = doubtful[place]
        digest, record = commits[key]
        if result.get("content") != record.get("digest", ""):
            changed.append(key)
        else:  # the same bytes: this time is as good as the one before
            job.store.commit(stage, key, digest, {**record, "state": there[key].to_json()})
    job.invalidate(stage, [*gone, *changed])
    if changed:
        paths = sorted(below(job.products, files[key]) for key in changed)
        place = move_aside(job.products, paths)
        job.note(f"{named(paths)}: changed since a run wrote them; moved to {place}/ and made again")
