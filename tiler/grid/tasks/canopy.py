"""What a run does about closed canopy: where its cells are, and what is told of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import shapely

from ptd.matched.canopy_pass import BLOCK_M, CanopyPass
from ptd.matched.cells import CELL_M
from ptd.matched.evidence import percent
from ptd.methods import METHODS
from tiler.config import VOID_CANOPY
from tiler.core.lattice import Cell
from tiler.core.map_lines import rings_of
from tiler.core.units_text import length_text
from tiler.filter.tasks.labelled import Labelled
from tiler.filter.tasks.passes import elected_name, label_digests, labels_name
from tiler.ingest.tasks.assembled import IngestResult
from tiler.runs.job import Job
from tiler.store import Commits

TOLD = 0.1
"""Share of the area from which on a warning tells of the canopy."""
PLACES = 3
"""Places that the warning names, those with most canopy."""
HIDES = "a closed canopy (crowns, or tall rough roofs side by side) hides the ground"
MOSTLY = 0.5
"""Share of a block from which on the report's map shows it."""


@dataclass(frozen=True)
class CanopyCells:
    """The cells that the filter worked on, with their codes.

    Attributes
    ----------
    elected, labels : str
        Names in the store.
    side : Fraction
        Of the smaller cells, counts.
    digests : mapping of Cell to str
        Of the cells of a bucket and their codes.
    """

    elected: str
    labels: str
    side: Fraction
    digests: Mapping[Cell, str]


def canopy_cells(job: Job, assembled: IngestResult, labelled: Labelled) -> CanopyCells | None:
    """The cells among which the filter found a canopy; None where it found none, and where nobody looked for one.

    Tells of what was found, as ``canopy`` of run.json, and warns of it.
    """
    state = labelled.statistics.get(CanopyPass.name)
    if state is None:
        return None
    share = state["canopy"]["share"]
    job.facts["canopy"] = {"share": share, "mode": job.plan.config.canopy}
    if not share:
        return None
    passes = METHODS[job.plan.config.method].params(**job.plan.parameters).passes
    number = next(n for n, step in enumerate(passes) if step.name == CanopyPass.name)
    elects = max(n for n, step in enumerate(passes[:number]) if step.elects and step.applies(state))
    made = job.store.committed(f"filter{number}")
    _tell(job, share, made)
    side = job.plan.meta.frame.counts(Fraction(repr(CELL_M)))
    return CanopyCells(elected_name(elects), labels_name(number), side, label_digests(assembled, made))


def _tell(job: Job, share: float, made: Commits) -> None:
    """Add to the facts where the canopy is, and warn where it covers much."""
    blocks: Counter[tuple[int, int]] = Counter()
    for _, record in made.values():
        for column, row, area_m2 in record["partial"]["blocks"]:
            blocks[column, row] += area_m2
    unit = float(job.plan.meta.frame.units.horizontal)
    most = sorted(blocks, key=lambda place: (-blocks[place], place))[:PLACES]
    places = [[round((index + 0.5) * BLOCK_M / unit, 1) for index in place] for place in most]
    job.facts["canopy"] |= {"places": places, "rings": _rings(blocks, unit)}
    if share < TOLD:
        return
    held = {place: blocks[place] / BLOCK_M**2 for place in most}
    job.facts["canopy_doubts"] = [_doubt(place, held[place], unit) for place in most]
    around = " and ".join(f"x {x:.0f}, y {y:.0f}" for x, y in places)
    done = (
        "up to --max-edge the terrain is bridged there from the ground seen around (mask 6; --voids fill goes on "
        "beyond, --canopy void leaves it without heights)"
    )
    if job.plan.config.canopy == VOID_CANOPY:
        done = "the terrain has no heights there (--canopy fill bridges it from the ground seen around it)"
    hidden = f"{HIDES} in {percent(share)} % of the area, most of all around {around}"
    job.listener("warning", {"text": f"{hidden}: {done}"})


def _doubt(block: tuple[int, int], part: float, unit: float) -> dict[str, Any]:
    """Doubt about the terrain in a block: a text, and its west, south, east and north in units of the CRS."""
    side = BLOCK_M / unit
    west, south = (index * side for index in block)
    text = f"{HIDES} in {percent(part)} % of a square of {length_text(BLOCK_M, unit)}"
    return {"text": text, "place": [west, south, west + side, south + side]}


def _rings(blocks: Mapping[tuple[int, int], int], unit: float) -> list[list[float]]:
    """Rings around the blocks that a canopy covers mostly, for the map; all coordinates in units of the CRS."""
    least = min(MOSTLY * BLOCK_M**2, max(blocks.values()))
    held = np.array([place for place, area_m2 in blocks.items() if area_m2 >= least], np.float64)
    side = BLOCK_M / unit
    squares = shapely.box(*(held.T * side), *((held.T + 1) * side))
    return rings_of(shapely.get_parts(shapely.union_all(squares)), side / 4)
