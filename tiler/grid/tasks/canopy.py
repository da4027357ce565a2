"""Closed canopy in a run: its cells for the raster, its facts, and a warning."""

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
from tiler.filter.tasks.passes import elected_name, label_digests, labels_name, tile_records
from tiler.ingest.tasks.assembled import IngestResult
from tiler.observe.events import Warned
from tiler.runs.job import Job
from tiler.store import Commits

TOLD = 0.1
"""Share of the area from which canopy causes a warning."""
PLACES = 3
"""Number of positions in the warning. They have the most canopy."""
HIDES = "a closed canopy (crowns, or tall rough roofs side by side) hides the ground"
MOSTLY = 0.5
"""Share of a block from which canopy is on the report's map."""


@dataclass(frozen=True)
class CanopyCells:
    """Cells of the filter, with their codes.

    Attributes
    ----------
    elected, labels : str
        Names in the store of the cells and of their codes.
    side : Fraction
        Side of the smaller cells in counts.
    digests : mapping of Cell to str
        Digest of the cells and codes of each bucket.
    """

    elected: str
    labels: str
    side: Fraction
    digests: Mapping[Cell, str]


def canopy_cells(job: Job, assembled: IngestResult, labelled: Labelled) -> CanopyCells | None:
    """Return the cells among which the filter found a canopy, or None if it found none or did not search.

    Add the result to the facts as ``canopy`` and warn about it.
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
    """Add the positions of the canopy to the facts, and warn if it covers much of the area."""
    blocks: Counter[tuple[int, int]] = Counter()
    for tile in tile_records(made):
        for column, row, area_m2 in tile.partial["blocks"]:
            blocks[column, row] += area_m2
    unit = float(job.plan.meta.frame.units.horizontal)
    most = sorted(blocks, key=lambda place: (-blocks[place], place))[:PLACES]
    centres = [[round((index + 0.5) * BLOCK_M / unit, 1) for index in place] for place in most]
    job.facts["canopy"] |= {"places": centres, "rings": _rings(blocks, unit)}
    if share < TOLD:
        return
    held = {place: blocks[place] / BLOCK_M**2 for place in most}
    job.facts["canopy_doubts"] = [_doubt(place, held[place], unit) for place in most]
    around = " and ".join(f"x {x:.0f}, y {y:.0f}" for x, y in centres)
    done = (
        "the terrain there is bridged up to --max-edge from the ground around it (mask 6; --voids fill also bridges "
        "wider gaps, --canopy void leaves it without heights)"
    )
    if job.plan.config.canopy == VOID_CANOPY:
        done = "the terrain has no heights there (--canopy fill bridges it from the ground seen around it)"
    hidden = f"{HIDES} in {percent(share)} % of the area, most of all around {around}"
    job.listener(Warned(f"{hidden}: {done}"))


def _doubt(block: tuple[int, int], part: float, unit: float) -> dict[str, Any]:
    """Return a text about the terrain in a block, and its west, south, east and north in units of the CRS."""
    side = BLOCK_M / unit
    west, south = (index * side for index in block)
    text = f"{HIDES} in {percent(part)} % of a square of {length_text(BLOCK_M, unit)}"
    return {"text": text, "place": [west, south, west + side, south + side]}


def _rings(blocks: Mapping[tuple[int, int], int], unit: float) -> list[list[float]]:
    """Return rings in units of the CRS around the blocks that are mostly canopy, for the map."""
    least = min(MOSTLY * BLOCK_M**2, max(blocks.values()))
    held = np.array([block for block, area_m2 in blocks.items() if area_m2 >= least], np.float64)
    side = BLOCK_M / unit
    squares = shapely.box(*(held.T * side), *((held.T + 1) * side))
    return rings_of(shapely.get_parts(shapely.union_all(squares)), side / 4)
