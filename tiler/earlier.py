"""Files of earlier runs in OUT: what still holds stays, the rest is put aside, so that nothing old looks current.

A run writes the products that it is asked for. Those of an earlier run that it is not asked for hold as long as points,
labels and settings of the rasters are the same; else they go to ``OUT/outdated``, and so do classified files of inputs
that the run has not. run.json lists what a run wrote (``outputs``), what its rasters were made of (``made_of``), and
until the export has dealt with them the files of earlier runs (``earlier_outputs``).
"""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

from tiler.errors import ConfigError, refused_write
from tiler.job import Job
from tiler.places import is_url, joined, move_file, sizes_at
from tiler.results import ASIDE

NAMED = 5
"""Files that the note names; the others are counted."""


def put_aside(job: Job, wanted: Collection[str], basis: str) -> None:
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
        _refuse_foreign(job, [path for path in wanted if path not in earlier])
    there = {p: of for p, of in earlier.items() if p not in wanted and _inside(job.products, p)}
    sizes = dict(zip(there, sizes_at([joined(job.products, p) for p in there]), strict=True))
    stale = sorted(path for path, of in there.items() if of != basis and sizes[path] is not None)
    for path in stale:
        _move(job.products, path)
    kept = {path: size for path, size in sizes.items() if size is not None and path not in stale}
    job.facts["outputs"] = kept
    job.facts["made_of"] = dict.fromkeys(kept, basis)
    job.facts["earlier_outputs"] = dict.fromkeys(wanted)
    if stale:
        more = f" and {len(stale) - NAMED:,} more" if len(stale) > NAMED else ""
        job.note(
            f"{', '.join(stale[:NAMED])}{more}: of an earlier run with other settings or inputs, and not of this one; "
            f"moved to {ASIDE}/"
        )
    job.save("running")


def _refuse_foreign(job: Job, wanted: list[str]) -> None:
    """Raise ConfigError for files that came after the plan, or whose names it could not know."""
    sizes = sizes_at([joined(job.products, path) for path in wanted])
    there = [path for path, size in zip(wanted, sizes, strict=True) if size is not None]
    if there:
        raise ConfigError(
            f"-o {job.products}: {', '.join(there[:NAMED])}: there already, and not known to be of a run of this "
            "folder; move them away, or use --force to replace them"
        )


def _inside(out: str, path: str) -> bool:
    """Whether a path that a file named leads nowhere else, and to a file."""
    if is_url(out):
        return not {"", ".", ".."} & set(path.split("/"))
    whole = Path(out, path)
    return whole.resolve().is_relative_to(Path(out).resolve()) and not whole.is_dir()


def _move(out: str, path: str) -> None:
    source, target = joined(out, path), joined(out, ASIDE, path)
    try:
        move_file(source, target)
    except OSError as error:
        raise refused_write(target, error, None if is_url(out) else Path(out)) from error
    if not is_url(out):
        with suppress(OSError):  # the folder of a product's sheets, unless it still holds any
            Path(source).parent.rmdir()
