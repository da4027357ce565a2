"""Making of the corrections of a run: edits and breaklines of the user, and edits that remove bridges."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tiler.core.breaklines import MIN_LENGTH_M, Breaklines
from tiler.core.edits import OF_PIXELS, OF_POINTS, TO_GROUND, Edit, Edits
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Cell, Lattice
from tiler.core.map_lines import add_rings, drawn
from tiler.errors import ProcessingError
from tiler.filter.tasks.labelled import Labelled
from tiler.grid import SurveyEdits, survey_edits
from tiler.grid.tasks.bridges import find_bridges
from tiler.grid.tasks.corrections import Corrections
from tiler.grid.tasks.gridding import ground_rule
from tiler.ingest.tasks.assembled import IngestResult
from tiler.plan import Plan
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, digest_of
from tiler.store import Commits
from tiler.version import __version__


def correct(job: Job, assembled: IngestResult, labelled: Labelled) -> tuple[Labelled, Corrections]:
    """Find bridges, and put the edits and breaklines of the run into the store.

    Return the labels with digests that include the edits, and the `Corrections`.
    """
    plan, labels, corrections = job.plan, labelled.digests, Corrections()
    pixels = Lattice(plan.grid.meta.frame.counts(plan.grid.resolution))
    deck_edits, decks = find_bridges(job, assembled, labels)
    if deck_edits or plan.inputs.edits:
        edits = Edits((*deck_edits, *_user_edits(job, assembled, labels, pixels)), pixels)
        job.store.put_edits(edits)
        corrections = replace(corrections, edits=edits, decks=decks)
        labelled = replace(labelled, digests=_label_digests(plan, edits, labels))
    if plan.inputs.lines:
        min_length = plan.grid.meta.frame.counts(MIN_LENGTH_M)
        lines = Breaklines.of(plan.inputs.lines, pixels.size, min_length, assembled.bounds)
        job.store.put_breaklines(lines)
        job.facts["breaklines"] = {
            "lines": len(plan.inputs.lines),
            "vertices": len(lines.vertices),
            "drawn": drawn(plan.inputs.lines),
        }
        corrections = replace(corrections, lines=lines, line_digests=lines.digests(plan.grid.meta.bucket))
    return labelled, corrections


def _label_digests(plan: Plan, edits: Edits, labels: Mapping[Cell, str]) -> dict[Cell, str]:
    """Return the digests of labels. If an edit intersects a bucket, its digest includes the edit."""
    digests = dict(labels)
    for cell, near in edits.by_cell(plan.grid.meta.bucket, labels).items():
        digests[cell] = digest_of(digests[cell], [edit.digest for edit in near], str(plan.grid.resolution))
    return digests


def _user_edits(
    job: Job, assembled: IngestResult, labels: Mapping[Cell, str], pixels: Lattice
) -> tuple[Edit, ...]:
    """Count the points inside the user's edits for run.json. Return the edits.

    An edit with the action `ground` applies to points with a class of ground in the input. It applies to the lowest
    points instead (`Edit.lowest`) if there are none, or if the terrain is made from the classes of the input anyway.
    """
    if not job.plan.inputs.edits:
        return ()
    user_edits = Edits(job.plan.inputs.edits, pixels)
    job.store.put_edits(user_edits)
    tasks = list(_count_tasks(job.plan, user_edits, assembled, labels))
    made = run_stage(job, "edits", tasks)
    if len(made) < len(tasks):
        raise ProcessingError(f"--edits: could not be applied: {job.record.first_error('edits')}")
    counts = {edit.number: np.zeros(5, np.int64) for edit in job.plan.inputs.edits}
    for _, record in made.values():
        for number, *bucket_counts in record["edits"]:
            counts[number] += bucket_counts
    has_no_labels = ground_rule(job.plan).labels is None
    edits = []
    for edit in job.plan.inputs.edits:
        has_no_ground = has_no_labels or not counts[edit.number][-1]
        edits.append(replace(edit, lowest=edit.action == TO_GROUND and has_no_ground))
    job.facts["edits"] = [_fact(edit, counts[edit.number].tolist()) for edit in edits]
    add_rings(job.facts["edits"], [edit.area for edit in edits])
    return tuple(edits)


def _count_tasks(
    plan: Plan, edits: Edits, assembled: IngestResult, labels: Mapping[Cell, str]
) -> Iterator[Task]:
    """Yield a task for each bucket that an edit of points intersects."""
    rule = ground_rule(plan)
    for cell, near in edits.by_cell(plan.grid.meta.bucket, labels).items():
        edit_digests = [[edit.number, *edit.digest] for edit in near]
        digest = digest_of(__version__, rule, edits.cell, cell, labels[cell], edit_digests)
        work = SurveyEdits(rule, edits.key, cell)
        yield Task("edits", cell.name, digest, survey_edits, work, assembled.records[cell].n)


def _fact(edit: Edit, counts: Sequence[int]) -> dict[str, Any]:
    """Return the entry of run.json for an edit. ``counts`` are the sums of the five counts of `survey_edits`.

    `report_edited_pixels` adds the number of pixels.
    """
    bounds = [v / COUNTS_PER_UNIT for v in edit.area.bounds.to_json()]
    fact: dict[str, Any] = {"number": edit.number, "action": edit.action, "bounds": bounds}
    if edit.action in OF_POINTS:
        points, ground_before, by_classes, by_lowest, _ = counts
        fact |= {"points": points, "ground_before": ground_before}
        fact["ground_after"] = by_lowest if edit.lowest else by_classes
        fact["by"] = "lowest points" if edit.lowest else "classes"
    return fact


def report_edited_pixels(job: Job, terrain: Commits) -> None:
    """Add to run.json the number of pixels of the terrain that each edit set."""
    counts: dict[int, int] = {}
    for _, record in terrain.values():
        for number, pixels in record.get("edited", ()):
            counts[number] = counts.get(number, 0) + pixels
    for fact in job.facts.get("edits", ()):
        if fact["action"] in OF_PIXELS:
            fact["pixels"] = counts.get(fact["number"], 0)
        fact["changed"] = _changed(fact)
    unchanged = [fact for fact in job.facts.get("edits", ()) if not fact["changed"]]
    if unchanged:
        names = ", ".join(f"feature {fact['number']} ({fact['action']})" for fact in unchanged[:5])
        more = f" and {len(unchanged) - 5} more" if len(unchanged) > 5 else ""
        job.note(f"--edits: {names}{more}: changed nothing")


def _changed(fact: Mapping[str, Any]) -> bool:
    if fact["action"] in OF_PIXELS:
        return bool(fact["pixels"])
    return bool(fact["ground_before"] != fact["ground_after"])
