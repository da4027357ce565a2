"""Making of the corrections of a run: edits and breaklines of the user, and edits that remove bridges."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from tiler.core.breaklines import MIN_LENGTH_M, Breaklines
from tiler.core.digests import digest_of
from tiler.core.edits import OF_PIXELS, OF_POINTS, TO_GROUND, Edit, Edits
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Cell, Lattice
from tiler.core.map_lines import drawn, rings_of_areas
from tiler.core.records import records_of
from tiler.core.terrain_results import BreaklineCounts, EditResult
from tiler.core.words import listed
from tiler.errors import ProcessingError
from tiler.filter.tasks.labelled import Labelled
from tiler.grid.edits import count_edited_points
from tiler.grid.records import TerrainRecord
from tiler.grid.tasks.bridges import find_bridges
from tiler.grid.tasks.corrections import Corrections
from tiler.grid.tasks.gridding import ground_rule
from tiler.ingest.tasks.assembled import IngestResult
from tiler.plan import Plan
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, calling
from tiler.store import Commits


def correct(
    job: Job, assembled: IngestResult, labelled: Labelled
) -> tuple[Labelled, Corrections]:
    """Find bridges, and put the edits and breaklines of the run into the store.

    Return the labels with digests that include the edits, and the `Corrections`.
    """
    plan, labels, corrections = job.plan, labelled.digests, Corrections()
    pixels = Lattice(plan.frame.counts(plan.grid.resolution))
    deck_edits, decks = find_bridges(job, assembled, labels)
    if deck_edits or plan.inputs.edits:
        edits = Edits((*deck_edits, *_user_edits(job, assembled, labels, pixels)), pixels)
        job.store.put_edits(edits)
        corrections = replace(corrections, edits=edits, decks=decks)
        labelled = replace(labelled, digests=_label_digests(plan, edits, labels))
    if plan.inputs.lines:
        min_length = plan.frame.counts(MIN_LENGTH_M)
        lines = Breaklines.of(plan.inputs.lines, pixels.size, min_length, assembled.bounds)
        job.store.put_breaklines(lines)
        job.results.breaklines = BreaklineCounts(
            len(plan.inputs.lines), len(lines.vertices), drawn(plan.inputs.lines)
        )
        corrections = replace(
            corrections, lines=lines, line_digests=lines.digests(plan.buckets)
        )
    return labelled, corrections


def _label_digests(plan: Plan, edits: Edits, labels: Mapping[Cell, str]) -> dict[Cell, str]:
    """Return the digests of labels. If an edit intersects a bucket, its digest includes the edit."""
    digests = dict(labels)
    for cell, near in edits.by_cell(plan.buckets, labels).items():
        digests[cell] = digest_of(
            digests[cell], [edit.digest for edit in near], str(plan.grid.resolution)
        )
    return digests


def _user_edits(
    job: Job, assembled: IngestResult, labels: Mapping[Cell, str], pixels: Lattice
) -> tuple[Edit, ...]:
    """Count the points inside the user's edits for run.json. Return the edits.

    An edit with the action `ground` applies to points with a class of ground in the input. It
    applies to the lowest points instead (`Edit.lowest`) if there are none, or if the terrain is
    made from the classes of the input anyway.
    """
    if not job.plan.inputs.edits:
        return ()
    user_edits = Edits(job.plan.inputs.edits, pixels)
    job.store.put_edits(user_edits)
    tasks = list(_count_tasks(job.plan, user_edits, assembled, labels))
    made = run_stage(job, "edits", tasks)
    if len(made) < len(tasks):
        raise ProcessingError(
            f"--edits: could not be applied: {job.record.first_error('edits')}"
        )
    counts = {edit.number: np.zeros(5, np.int64) for edit in job.plan.inputs.edits}
    for _, stored in made.values():
        for number, *bucket_counts in stored["edits"]:
            counts[number] += bucket_counts
    has_no_labels = ground_rule(job.plan).labels is None
    edits = []
    for edit in job.plan.inputs.edits:
        has_no_ground = has_no_labels or not counts[edit.number][-1]
        edits.append(replace(edit, lowest=edit.action == TO_GROUND and has_no_ground))
    rings = rings_of_areas([edit.area for edit in edits])
    job.results.edits = [
        replace(_result(edit, counts[edit.number].tolist()), rings=rings_of_edit)
        for edit, rings_of_edit in zip(edits, rings, strict=True)
    ]
    return tuple(edits)


def _count_tasks(
    plan: Plan, edits: Edits, assembled: IngestResult, labels: Mapping[Cell, str]
) -> Iterator[Task]:
    """Yield a task for each bucket that an edit of points intersects."""
    rule = ground_rule(plan)
    for cell, near in edits.by_cell(plan.buckets, labels).items():
        call = calling(count_edited_points, rule=rule, edits_key=edits.key, cell=cell)
        yield Task.of(
            "edits",
            cell.name,
            call.without("edits_key"),
            edits.cell,
            labels[cell],
            [[edit.number, *edit.digest] for edit in near],
            points=assembled.records[cell].n,
            bounds=plan.buckets.bounds(cell),
        )


def _result(edit: Edit, counts: Sequence[int]) -> EditResult:
    """Return the changes by an edit. ``counts`` are the sums of the five counts of `count_edited_points`.

    `report_edited_pixels` adds the number of pixels.
    """
    bounds = [v / COUNTS_PER_UNIT for v in edit.area.bounds.to_json()]
    result = EditResult(number=edit.number, action=edit.action, bounds=bounds)
    if edit.action not in OF_POINTS:
        return result
    points, ground_before, by_classes, by_lowest, _ = counts
    return replace(
        result,
        points=points,
        ground_before=ground_before,
        ground_after=by_lowest if edit.lowest else by_classes,
        by="lowest points" if edit.lowest else "classes",
    )


def report_edited_pixels(job: Job, terrain: Commits) -> None:
    """Add to run.json the number of pixels of the terrain that each edit set."""
    counts: dict[int, int] = {}
    for record in records_of(TerrainRecord, terrain):
        for number, pixels in record.edited or ():
            counts[number] = counts.get(number, 0) + pixels
    if not job.results.edits:
        return
    job.results.edits = [
        _with_pixels(edit, counts.get(edit.number, 0)) for edit in job.results.edits
    ]
    unchanged = [edit for edit in job.results.edits if not edit.changed]
    if unchanged:
        names = [f"feature {edit.number} ({edit.action})" for edit in unchanged]
        job.note(f"--edits: {listed(names, 5)}: changed nothing")


def _with_pixels(edit: EditResult, pixels: int) -> EditResult:
    """Return the changes by an edit with the number of pixels that it set."""
    if edit.action in OF_PIXELS:
        return replace(edit, pixels=pixels, changed=pixels > 0)
    return replace(edit, changed=edit.ground_before != edit.ground_after)
