"""Bridges of a run: decks that the filter left in the terrain, which are removed by edits."""

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
from tiler.core.units_text import length_text
from tiler.core.words import counted
from tiler.grid import ExamineDecks, FindDeckCells, examine_decks, examined_bounds, find_deck_cells
from tiler.grid.bridges.deck_cells import DROP_M, REACH_M
from tiler.grid.bridges.examine import CandidateCells
from tiler.grid.pieces import components
from tiler.grid.tasks.gridding import GridContext
from tiler.ingest.tasks.assembled import IngestResult
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, digest_of
from tiler.store import Commits
from tiler.version import __version__

REMOVE = "remove"
CELLS, DECKS = "deck-cells", "decks"
"""Names of the stages."""
MAX_WIDTH_M = 600.0
"""Largest extent of a candidate. A larger one is not a bridge, and has too many points for one task."""
TOUCHING = 1.5
"""Largest distance between the centres of touching cells: longer than a diagonal, shorter than two cells."""
MAX_REPORTED = 5
"""Number of bridges whose sizes and positions are in the log. The report lists all."""
MIN_CELLS = 4
"""Least number of cells of a candidate."""
ABOVE_M = 0.6
"""Largest height of a deck's points above its surface. Points below it belong to the nearer of deck and ground."""


def find_bridges(
    job: Job, assembled: IngestResult, labels: Mapping[Cell, str]
) -> tuple[tuple[Edit, ...], tuple[DrawnDeck, ...]]:
    """Find the decks in the terrain. Return edits of their points, and their outlines for output.

    Both are empty if bridges stay in the terrain.
    """
    if job.plan.config.bridges != REMOVE:
        return (), ()
    g = GridContext(job.plan, assembled, labels)
    cells = run_stage(job, CELLS, _cell_tasks(g))
    made = run_stage(job, DECKS, _deck_tasks(g, cells))
    records = _apart([deck for _, (_, record) in sorted(made.items()) for deck in record["decks"]])
    job.facts["bridges"] = [_fact(record) for record in records]
    job.note(_told(records, job.plan.meta.frame))
    metres_z = float(job.plan.meta.frame.metres_z)
    edits = tuple(_edit(-number, record, metres_z) for number, record in enumerate(records, start=1))
    return edits, tuple(_drawn(record) for record in records)


def _told(records: Sequence[Mapping[str, Any]], frame: CoordFrame) -> str:
    """Return a line about the bridges that were found."""
    if not records:
        return "no bridge was found above the ground, so none was removed from the terrain (--bridges remove)"
    texts = []
    for record in records[:MAX_REPORTED]:
        x, y = np.mean(record["ring"], axis=0) / COUNTS_PER_UNIT
        long, wide = (
            length_text(round(record[f"{name}_m"]), frame.units.horizontal) for name in ("length", "width")
        )
        texts.append(f"{long} long and {wide} wide at x {x:.0f}, y {y:.0f}")
    more = f", and {len(records) - MAX_REPORTED} more" if len(records) > MAX_REPORTED else ""
    bridges_text = counted(len(records), "bridge")
    return f"left out of the terrain: {bridges_text} ({'; '.join(texts)}{more}; --bridges keep leaves bridges in)"


def _cell_tasks(g: GridContext) -> Iterator[Task]:
    """Yield a task for each block of coarse cells with points."""
    spec, rule, lattice = g.coarse, g.rule, g.plan.meta.bucket
    margin = math.ceil((REACH_M + float(g.coarse_m)) / float(g.plan.meta.frame.metres_xy))
    for block, buckets in spec.blocks_near(lattice, g.labels, BLOCK_PIXELS).items():
        work = FindDeckCells(name=CELLS, spec=spec, block=block, rule=rule)
        near = lattice.among(spec.block_bounds(block).pad(margin), g.labels)
        digest = digest_of(__version__, work, g.seen(near))
        yield Task(CELLS, block.name, digest, find_deck_cells, work, g.points(buckets))


def _deck_tasks(g: GridContext, found: Commits) -> Iterator[Task]:
    """Yield a task for the candidates of each bucket: groups of touching cells that may be decks."""
    spec, rule, lattice = g.coarse, g.rule, g.plan.meta.bucket
    metres = float(g.plan.meta.frame.metres_xy)
    groups: dict[Cell, list[CandidateCells]] = defaultdict(list)
    for cells in _places(found):
        bounds = examined_bounds(spec, cells, metres)
        if (
            len(cells) >= MIN_CELLS
            and max(bounds.x1 - bounds.x0, bounds.y1 - bounds.y0) * metres <= MAX_WIDTH_M
        ):
            groups[next(lattice.cells(bounds))].append(cells)
    for cell, candidates in sorted(groups.items()):
        work = ExamineDecks(rule, spec, tuple(candidates))
        near = lattice.among(
            reduce(Bounds.union, (examined_bounds(spec, c, metres) for c in candidates)), g.labels
        )
        digest = digest_of(__version__, work, g.seen(near))
        yield Task(DECKS, cell.name, digest, examine_decks, work, g.points(near))


def _places(found: Commits) -> Iterator[CandidateCells]:
    """Yield groups of touching cells, across blocks, in the order of rows and columns."""
    cells = sorted({tuple(cell) for _, record in found.values() for cell in record["cells"]})
    if not cells:
        return
    tree = scipy.spatial.cKDTree([cell[:2] for cell in cells])
    for group in components(range(len(cells)), tree.query_pairs(TOUCHING)):
        yield tuple((int(r), int(c), int(d)) for r, c, d in (cells[i] for i in group))


def _apart(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Drop decks that lie mostly within larger ones, as two candidates may be parts of the same bridge."""
    kept: list[tuple[Any, dict[str, Any]]] = []
    for record in sorted(records, key=lambda r: (-r["length_m"] * r["width_m"], r["ring"])):
        shape = shapely.make_valid(shapely.Polygon(record["ring"]))
        if all(shape.intersection(other).area < shape.area / 2 for other, _ in kept):
            kept.append((shape, record))
    return [record for _, record in kept]


def _edit(number: int, record: Mapping[str, Any], metres_z: float) -> Edit:
    low = min(record["clearance_m"] / 2, DROP_M)
    surface = DeckSurface(*(float(v) for v in (*record["surface"], low / metres_z, ABOVE_M / metres_z)))
    return Edit(number, DECK, Area(((np.array(record["ring"], np.int64),),)), deck=surface)


def _drawn(record: Mapping[str, Any]) -> DrawnDeck:
    coordinates = tuple(int(v) for vertex in record["ring"] for v in vertex)
    return coordinates, record["length_m"], record["width_m"], record["clearance_m"], record["below"]


def _fact(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entry of run.json for a bridge."""
    ring = np.array([*record["ring"], record["ring"][0]]) / COUNTS_PER_UNIT
    sizes = {name: record[name] for name in ("length_m", "width_m", "clearance_m", "below")}
    return {**sizes, "rings": [ring.ravel().tolist()]}
