"""Numbers of points by class in the classified clouds, and the classes of the input that they keep."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from tiler.core.points import Counts, sum_by_class
from tiler.core.selection import ONLY_GROUND
from tiler.core.words import counted
from tiler.export.output_files import CloudRecord
from tiler.io.result_folder import CLASSIFIED
from tiler.runs.job import Job
from tiler.schedule import Task
from tiler.store import Commits


def report_written_classes(job: Job, tasks: Iterable[Task], made: Commits) -> None:
    """Count the points of the classified clouds by class, and note which classes of the input they keep."""
    records = [CloudRecord.of(made[task.key][1]) for task in tasks if task.key in made]
    kept = sum_by_class(record.kept or {} for record in records)
    written = sum_by_class(record.classes for record in records)
    ground_counts = [record.ground for record in records if record.ground is not None]
    job.results.classes = replace(
        job.results.classes,
        reclass=job.plan.config.reclass,
        kept=kept,
        written=written,
        # Clouds of an earlier version have no count, so that of the filter is the best one.
        ground=sum(ground_counts) if len(ground_counts) == len(records) else None,
    )
    if text := kept_text(kept, job.results.classes.no_part):
        job.note(text)


def report_earlier_classes(job: Job, tasks: Iterable[Task]) -> None:
    """Note that the clouds of an earlier version, which kept no class of the input, are written again."""
    if job.plan.config.reclass != ONLY_GROUND:
        return
    commits = job.store.committed("export")
    records = [CloudRecord.of(commits[task.key][1]) for task in tasks if task.key in commits]
    stored = any(record.kept is None for record in records)
    listed = any(path.startswith(f"{CLASSIFIED}/") for path in job.results.earlier_outputs)
    if stored or (listed and job.earlier_settings and "reclass" not in job.earlier_settings):
        job.note(
            "the classified clouds of an earlier version are written again: points that had class 1 there now keep "
            "their class of the input (--reclass all gives class 1)"
        )


def kept_text(kept: Counts, no_part: Counts) -> str:
    """Return the note about classes of the input that classified clouds keep, or an empty text if they keep none."""
    parts = []
    if kept:
        parts.append(
            f"{_listed(kept)}, which are not ground (--reclass all gives them class 1)"
        )
    if no_part:
        parts.append(f"{_listed(no_part)}, which take no part in the filter (--keep-classes)")
    return f"classes of the input are kept: {'; '.join(parts)}" if parts else ""


def _listed(counts: Counts) -> str:
    """Return a text such as ``12 points of class 3, 5 of class 6``."""
    (code, n_points), *more = counts.items()
    first = f"{counted(n_points, 'point')} of class {code}"
    return ", ".join((first, *(f"{n:,} of class {code}" for code, n in more)))
