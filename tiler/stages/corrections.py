"""What people drew, applied to a run: corrections of points and heights, and breaklines.

They change the digests of the buckets and blocks that they touch and of no others, so only these are made again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from tiler.core.breaklines import SHORTEST_M, Breaklines
from tiler.core.edits import OF_PIXELS, OF_POINTS, Edit, Edits
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.errors import ProcessingError
from tiler.export import WriteClassified
from tiler.export.work import DrawnDeck
from tiler.grid import FillBlock, OutlineBlock, PointsBlock, SurveyEdit, full_halo, survey_edit
from tiler.plan import Plan
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Placed, Task, digest_of
from tiler.stages.bridges import find_bridges
from tiler.stages.map_lines import add_rings, drawn
from tiler.stages.tasks import Assembled, ground_rule
from tiler.store import Commits
from tiler.version import __version__

EDITED = ("dtm", "dtm-filled", "dtm-outlined")
"""Rasters whose heights edits can set."""
FOLLOWS_LINES = "dtm"
"""The raster that is made of breaklines as well."""


@dataclass(frozen=True)
class Corrections:
    """Corrections and breaklines of a run, applied on top of the labels.

    Attributes
    ----------
    edits : Edits or None
    lines : Breaklines or None
    line_digests : mapping of Cell to str
        Of the breaklines in each bucket of the lattice, whether or not it has points.
    decks : tuple of DrawnDeck
        Of bridges that are left out; the edits say of what points they are.
    """

    edits: Edits | None = None
    lines: Breaklines | None = None
    line_digests: Mapping[Cell, str] | None = None
    decks: tuple[DrawnDeck, ...] = ()

    def of_clouds(self, tasks: Iterable[Task]) -> Iterator[Task]:
        """The tasks of classified clouds; what edits change of labels is in their digests already."""
        for task in tasks:
            yield task if self.edits is None else _with_edits(task, self.edits.key)

    def of_raster(self, plan: Plan, name: str, task: Task) -> Task:
        """A task of a raster, with corrections, and with digests of those that touch its block."""
        bounds = task.arguments.place(plan.meta.bucket) if isinstance(task.arguments, Placed) else None
        if bounds is None:
            return task
        seen: list[Any] = []
        if self.edits is not None:
            task = _with_edits(task, self.edits.key)
            seen += self.edits.digest(bounds, OF_PIXELS) if name in EDITED else []
        if self.lines is not None and name == FOLLOWS_LINES:
            task = replace(task, arguments=replace(task.arguments, breaklines=self.lines.key))
            seen += self._lines_near(plan, bounds)
        return replace(task, digest=digest_of(task.digest, seen)) if seen else task

    def _lines_near(self, plan: Plan, bounds: Bounds) -> list[Any]:
        """Cells with breaklines that can reach a block, as far as any facet does."""
        found = self.line_digests or {}
        reach = full_halo(plan.meta.frame.counts(plan.config.max_edge))
        reach += math.ceil(3 * plan.meta.frame.counts(plan.resolution))
        near = plan.meta.bucket.among(bounds.pad(reach), found)
        return [[cell.ix, cell.iy, found[cell]] for cell in near]


def _with_edits(task: Task, key: str) -> Task:
    """A task that knows of the corrections; those that touch it are in its digest, the key of all is not."""
    work = task.arguments
    if isinstance(work, PointsBlock):
        return replace(task, arguments=replace(work, rule=replace(work.rule, edits=key)))
    if isinstance(work, FillBlock | OutlineBlock | WriteClassified):
        return replace(task, arguments=replace(work, edits=key))
    return task


def correct(
    job: Job, assembled: Assembled, labels: Mapping[Cell, str]
) -> tuple[dict[Cell, str], Corrections]:
    """Apply the drawn features that the plan read; returns digests of the corrected labels, and the `Corrections`."""
    plan, found = job.plan, Corrections()
    corrected = dict(labels)
    decks, shapes = find_bridges(job, assembled, labels)
    if decks or plan.edits:
        cell = Lattice(plan.meta.frame.counts(plan.resolution))
        edits = Edits((*decks, *_surveyed(job, assembled, labels, cell)), cell)
        job.store.put_edits(edits)
        found = replace(found, edits=edits, decks=shapes)
        corrected = _labels(plan, edits, labels)
    if plan.lines:
        pixel = plan.meta.frame.counts(plan.resolution)
        lines = Breaklines.of(plan.lines, pixel, plan.meta.frame.counts(SHORTEST_M), assembled.bounds)
        job.store.put_breaklines(lines)
        vertices, on_map = len(lines.vertices), drawn(plan.lines)
        job.facts["breaklines"] = {"lines": len(plan.lines), "vertices": vertices, "drawn": on_map}
        found = replace(found, lines=lines, line_digests=lines.digests(plan.meta.bucket))
    return corrected, found


def _labels(plan: Plan, edits: Edits, labels: Mapping[Cell, str]) -> dict[Cell, str]:
    """Digests of labels, others where an edit touches a bucket."""
    found = dict(labels)
    for edit in edits.edits:
        for cell in _touched(plan.meta.bucket, edit, labels) if edit.action in OF_POINTS else ():
            found[cell] = digest_of(found[cell], edit.digest, str(plan.resolution))
    return found


def _touched(lattice: Lattice, edit: Edit, cells: Mapping[Cell, Any]) -> list[Cell]:
    near = lattice.among(edit.area.bounds, cells)
    return [cell for cell in near if edit.area.touches(lattice.bounds(cell))]


def _surveyed(job: Job, assembled: Assembled, labels: Mapping[Cell, str], cell: Lattice) -> tuple[Edit, ...]:
    """The edits that people drew, after their points were counted."""
    plan = job.plan
    if not plan.edits:
        return ()
    tasks = {edit.number: _survey_task(plan, edit, cell, assembled, labels) for edit in plan.edits}
    made = run_stage(job, "edits", tasks.values())
    missing = [task for task in tasks.values() if task.key not in made]
    if missing:
        raise ProcessingError(
            f"--edits: {missing[0].key} could not be applied: {job.record.failed[-1]['error']}"
        )
    records = {number: made[task.key][1] for number, task in tasks.items()}
    edits = tuple(replace(e, lowest=records[e.number]["lowest"]) for e in plan.edits)
    job.facts["edits"] = [_fact(edit, records[edit.number]) for edit in edits]
    add_rings(job.facts["edits"], [edit.area for edit in edits])
    return edits


def _survey_task(
    plan: Plan, edit: Edit, cell: Lattice, assembled: Assembled, labels: Mapping[Cell, str]
) -> Task:
    cells = _touched(plan.meta.bucket, edit, labels) if edit.action in OF_POINTS else []
    rule = ground_rule(plan)
    work = SurveyEdit(rule, edit, cell, tuple(cells))
    digest = digest_of(__version__, rule, edit.number, edit.digest, cell, cells, [labels[c] for c in cells])
    points = sum(assembled.records[c]["n"] for c in cells)
    return Task("edits", f"e{edit.number:06d}", digest, survey_edit, work, points)


def _fact(edit: Edit, record: Mapping[str, Any]) -> dict[str, Any]:
    """What run.json says of an edit; pixels follow when the terrain is made."""
    bounds = [v / COUNTS_PER_UNIT for v in edit.area.bounds.to_json()]
    fact: dict[str, Any] = {"number": edit.number, "action": edit.action, "bounds": bounds}
    if edit.action in OF_POINTS:
        fact |= {name: record[name] for name in ("points", "ground_before", "ground_after")}
        fact["by"] = "lowest points" if record["lowest"] else "classes"
    return fact


def tell_of_pixels(job: Job, terrain: Commits) -> None:
    """Add to run.json how many pixels of the terrain each edit set."""
    counts: dict[int, int] = {}
    for _, record in terrain.values():
        for number, pixels in record.get("edited", ()):
            counts[number] = counts.get(number, 0) + pixels
    for fact in job.facts.get("edits", ()):
        if fact["action"] in OF_PIXELS:
            fact["pixels"] = counts.get(fact["number"], 0)
    nothing = [fact for fact in job.facts.get("edits", ()) if not _changed(fact)]
    if nothing:
        names = ", ".join(f"feature {fact['number']} ({fact['action']})" for fact in nothing[:5])
        more = f" and {len(nothing) - 5} more" if len(nothing) > 5 else ""
        job.note(f"--edits: {names}{more}: changed nothing")


def _changed(fact: Mapping[str, Any]) -> bool:
    return bool(
        fact["pixels"] if fact["action"] in OF_PIXELS else fact["ground_before"] != fact["ground_after"]
    )
