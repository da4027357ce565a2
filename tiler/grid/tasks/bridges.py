"""Search for the bridges of a run: decks that the filter left in the terrain, which are removed by edits."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np
import scipy
import shapely

from tiler.core.area import Area
from tiler.core.edits import DECK, DeckSurface, DrawnDeck, Edit
from tiler.core.frame import COUNTS_PER_UNIT, CoordFrame
from tiler.core.lattice import Bounds, Cell
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.terrain_results import BridgeResult
from tiler.core.units_text import length_text
from tiler.core.words import counted
from tiler.grid.bridges.deck_cells import DROP_M, REACH_M
from tiler.grid.bridges.examine import (
    CandidateCells,
    examine_decks,
    examined_bounds,
    find_deck_cells,
)
from tiler.grid.coarse import components
from tiler.grid.records import DeckRecord
from tiler.grid.tasks.gridding import GridContext
from tiler.ingest.tasks.assembled import IngestResult
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, calling
from tiler.store import Commits

REMOVE = "remove"
"""Value of ``--bridges`` that searches for bridges and removes them."""
CELLS, DECKS = "deck-cells", "decks"
"""Names of the stages: search for cells that may be part of a deck, and examination of
candidates."""
MAX_EXTENT_M = 600.0
"""Candidates that extend farther than this are left out, in metres.

They are not bridges, and have too many points for one task.
"""
TOUCHING = 1.5
"""Cells touch if their centres are at most this far apart, in cells. Diagonal neighbours touch,
too."""
MAX_REPORTED = 5
"""The log has the sizes and positions of at most this many bridges. The report has all."""
MIN_CELLS = 4
"""A candidate has at least this many cells."""
MAX_ABOVE_M = 0.6
"""Points up to this height above the surface of a deck belong to the deck, in metres."""


def find_bridges(
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
    job.results.bridges = [_result(deck) for deck in decks]
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
    distinct: set[tuple[int, ...]] = set()
    for _, stored in deck_cells.values():
        distinct.update(map(tuple, stored["cells"]))
    cells = sorted(distinct)
    if not cells:
        return
    tree = scipy.spatial.cKDTree([cell[:2] for cell in cells])
    for group in components(range(len(cells)), tree.query_pairs(TOUCHING)):
        candidate = []
        for i in group:
            row, col, direction = cells[i]
            candidate.append((int(row), int(col), int(direction)))
        yield tuple(candidate)


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


def _result(deck: DeckRecord) -> BridgeResult:
    ring = np.array([*deck.ring, deck.ring[0]]) / COUNTS_PER_UNIT
    return BridgeResult(
        deck.length_m, deck.width_m, deck.clearance_m, deck.below, [ring.ravel().tolist()]
    )
