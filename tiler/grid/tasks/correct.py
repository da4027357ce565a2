"""Corrections of a run: edits and breaklines of the user, and edits that remove the bridges that were found."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
import shapely

from tiler.core.area import Area
from tiler.core.breaklines import MIN_LENGTH_M, Breaklines, drawn, rings_of_areas
from tiler.core.edits import (
    DECK,
    OF_PIXELS,
    OF_POINTS,
    TO_GROUND,
    VOID,
    DeckSurface,
    DrawnDeck,
    Edit,
    Edits,
)
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds, Cell, CoordFrame, Lattice
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.records import digest_of
from tiler.core.results import BreaklineCounts, BridgeResult, EditResult
from tiler.core.units import length_text
from tiler.core.words import counted, listed
from tiler.errors import ProcessingError
from tiler.grid.bridges.deck_cells import DROP_M, REACH_M
from tiler.grid.bridges.examine import (
    CandidateCells,
    examine_decks,
    examined_bounds,
    find_deck_cells,
)
from tiler.grid.coarse import touching_cells
from tiler.grid.ground import count_edited_points
from tiler.grid.records import DeckRecord
from tiler.grid.tasks.gridding import Corrections, GridContext, ground_rule
from tiler.plan import Plan
from tiler.runs.found import IngestResult, Labelled
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
    pixels = Lattice(plan.frame.counts(plan.grid.surface_pixel))
    deck_edits, decks = _find_bridges(job, assembled, labels)
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
            digests[cell], [edit.digest for edit in near], str(plan.grid.surface_pixel)
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
    has_ground = {number: not has_no_labels and n[-1] > 0 for number, n in counts.items()}
    edits = [
        replace(edit, lowest=edit.action == TO_GROUND and not has_ground[edit.number])
        for edit in job.plan.inputs.edits
    ]
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


def report_edited_pixels(job: Job, outlined: Commits) -> None:
    """Add to run.json the number of pixels of the delivered terrain that each edit set."""
    counts = Counter[str]()
    for _, stored in outlined.values():
        for key, pixels in stored["edited"]:
            counts[key] += pixels
    if not job.results.edits:
        return
    keys = {edit.number: edit.key for edit in job.plan.inputs.edits}
    job.results.edits = [
        _with_pixels(edit, counts[keys[edit.number]]) for edit in job.results.edits
    ]


def report_edit_holes(job: Job, counts: Mapping[str, int]) -> None:
    """Add to run.json the number of pixels without a height in each edit, by its key, and note edits without effect.

    An edit that accepts a void has an effect, although it sets no pixel.
    """
    if not job.results.edits:
        return
    keys = {edit.number: edit.key for edit in job.plan.inputs.edits}
    job.results.edits = [
        _with_holes(edit, counts.get(keys[edit.number], 0)) for edit in job.results.edits
    ]
    unchanged = [edit for edit in job.results.edits if not edit.changed]
    if unchanged:
        names = [f"feature {edit.number} ({edit.action})" for edit in unchanged]
        job.note(f"--edits: {listed(names, 5)}: changed nothing")


def _with_holes(edit: EditResult, holes: int) -> EditResult:
    """Return the changes by an edit with the number of pixels inside it that have no height."""
    accepts = edit.action == VOID and holes > 0
    return replace(edit, holes=holes, changed=edit.changed or accepts)


def _with_pixels(edit: EditResult, pixels: int) -> EditResult:
    """Return the changes by an edit with the number of pixels that it set."""
    if edit.action in OF_PIXELS:
        return replace(edit, pixels=pixels, changed=pixels > 0)
    return replace(edit, changed=edit.ground_before != edit.ground_after)


REMOVE = "remove"
"""Value of ``--bridges`` that searches for bridges and removes them."""
CELLS, DECKS = "deck-cells", "decks"
"""Names of the stages: search for cells that may be part of a deck, and examination of
candidates."""
MAX_EXTENT_M = 600.0
"""Candidates that extend farther than this are left out, in metres.

They are not bridges, and have too many points for one task.
"""
MAX_REPORTED = 5
"""The log has the sizes and positions of at most this many bridges. The report has all."""
MIN_CELLS = 4
"""A candidate has at least this many cells."""
MAX_ABOVE_M = 0.6
"""Points up to this height above the surface of a deck belong to the deck, in metres."""


def _find_bridges(
    job: Job, assembled: IngestResult, labels: Mapping[Cell, str]
) -> tuple[tuple[Edit, ...], tuple[DrawnDeck, ...]]:
    """Find the decks in the terrain. Return edits that remove the decks, and the outlines of the decks for output.

    Edits and outlines are empty unless ``--bridges`` is `REMOVE`.
    """
    if job.plan.config.bridges != REMOVE:
        return (), ()
    context = GridContext(job.plan, assembled, labels)
    cells = run_stage(job, CELLS, _cell_tasks(context))
    made = run_stage(job, DECKS, _deck_tasks(context, cells))
    decks: list[DeckRecord] = []
    for name in sorted(made):
        decks += [DeckRecord.of(deck) for deck in made[name][1]["decks"]]
    decks = _without_parts(decks)
    job.results.bridges = [_bridges_result(deck) for deck in decks]
    job.note(_note(decks, job.plan.frame))
    metres_z = float(job.plan.frame.metres_z)
    edits = tuple(_edit(-number, deck, metres_z) for number, deck in enumerate(decks, start=1))
    return edits, tuple(_outline(deck) for deck in decks)


def _note(decks: Sequence[DeckRecord], frame: CoordFrame) -> str:
    """Return a line for the log about the bridges that were found."""
    if not decks:
        return "no bridge was found above the ground, so none was removed from the terrain (--bridges remove)"
    texts = []
    for deck in decks[:MAX_REPORTED]:
        x, y = np.mean(deck.ring, axis=0) / COUNTS_PER_UNIT
        long = length_text(round(deck.length_m), frame.units.horizontal)
        wide = length_text(round(deck.width_m), frame.units.horizontal)
        texts.append(f"{long} long and {wide} wide at x {x:.0f}, y {y:.0f}")
    more = f", and {len(decks) - MAX_REPORTED} more" if len(decks) > MAX_REPORTED else ""
    bridges_text = counted(len(decks), "bridge")
    return f"left out of the terrain: {bridges_text} ({'; '.join(texts)}{more}; --bridges keep leaves bridges in)"


def _cell_tasks(context: GridContext) -> Iterator[Task]:
    """Yield a task for each block of coarse cells that has points."""
    spec, rule, lattice = context.coarse, context.rule, context.plan.buckets
    margin = math.ceil(
        (REACH_M + float(context.coarse_m)) / float(context.plan.frame.metres_xy)
    )
    for block, buckets in spec.blocks_near(lattice, context.labels, BLOCK_PIXELS).items():
        call = calling(find_deck_cells, spec=spec, block=block, rule=rule)
        bounds = spec.block_bounds(block)
        near = context.label_digests(lattice.among(bounds.pad(margin), context.labels))
        n_points = context.n_points(buckets)
        yield Task.of(
            CELLS,
            block.name,
            call,
            near,
            points=n_points,
            makes=block.height * block.width,
            bounds=bounds,
        )


def _deck_tasks(context: GridContext, deck_cells: Commits) -> Iterator[Task]:
    """Yield a task for each bucket with candidates.

    A candidate belongs to the bucket at the south-west corner of the area that is examined for
    it.
    """
    spec, rule, lattice = context.coarse, context.rule, context.plan.buckets
    metres = float(context.plan.frame.metres_xy)
    groups: dict[Cell, list[CandidateCells]] = defaultdict(list)
    for cells in _candidates(deck_cells):
        bounds = examined_bounds(spec, cells, metres)
        extent_m = max(bounds.x1 - bounds.x0, bounds.y1 - bounds.y0) * metres
        if len(cells) >= MIN_CELLS and extent_m <= MAX_EXTENT_M:
            groups[next(lattice.cells(bounds))].append(cells)
    for cell, candidates in sorted(groups.items()):
        call = calling(examine_decks, rule=rule, spec=spec, candidates=tuple(candidates))
        examined = [examined_bounds(spec, cells, metres) for cells in candidates]
        bounds = reduce(Bounds.union, examined)
        near = lattice.among(bounds, context.labels)
        digests, n_points = context.label_digests(near), context.n_points(near)
        yield Task.of(DECKS, cell.name, call, digests, points=n_points, bounds=bounds)


def _candidates(deck_cells: Commits) -> Iterator[CandidateCells]:
    """Yield groups of touching cells in the order of rows and columns. Cells of different blocks can form a group."""
    directions: dict[tuple[int, int], set[int]] = defaultdict(set)
    for _, stored in deck_cells.values():
        for row, col, direction in stored["cells"]:
            directions[row, col].add(direction)
    for group in touching_cells(sorted(directions)):
        yield tuple(
            (*place, direction) for place in group for direction in sorted(directions[place])
        )


def _without_parts(decks: Sequence[DeckRecord]) -> list[DeckRecord]:
    """Return the decks, without decks that lie mostly within a larger deck and are probably a part of it."""
    kept: list[tuple[Any, DeckRecord]] = []
    for deck in sorted(decks, key=lambda deck: (-deck.length_m * deck.width_m, deck.ring)):
        shape = shapely.make_valid(shapely.Polygon(deck.ring))
        if all(shape.intersection(other).area < shape.area / 2 for other, _ in kept):
            kept.append((shape, deck))
    return [deck for _, deck in kept]


def _edit(number: int, deck: DeckRecord, metres_z: float) -> Edit:
    """Return the edit that removes a deck: the points inside its outline and near its surface."""
    # Points more than ``low`` below the surface may be ground under the bridge.
    low = min(deck.clearance_m / 2, DROP_M)
    values = (*deck.surface, low / metres_z, MAX_ABOVE_M / metres_z)
    surface = DeckSurface(*(float(value) for value in values))
    outline = np.array(deck.ring, np.int64)
    return Edit(number, DECK, Area(((outline,),)), deck=surface)


def _outline(deck: DeckRecord) -> DrawnDeck:
    coordinates = tuple(np.array(deck.ring).ravel().tolist())
    return coordinates, deck.length_m, deck.width_m, deck.clearance_m, deck.below


def _bridges_result(deck: DeckRecord) -> BridgeResult:
    ring = np.array([*deck.ring, deck.ring[0]]) / COUNTS_PER_UNIT
    return BridgeResult(
        deck.length_m, deck.width_m, deck.clearance_m, deck.below, [ring.ravel().tolist()]
    )
