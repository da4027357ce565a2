"""Closed canopy in a run: the cells for the raster ``canopy``, the entries in run.json, and a warning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import shapely

from ptd.matched.evidence import percent
from ptd.matched.passes import BLOCK_M, CanopyPass
from tiler.config import VOID_CANOPY
from tiler.core.breaklines import rings_of
from tiler.core.results import CanopyResult, Doubt
from tiler.core.units import length_text
from tiler.observe.events import Warned
from tiler.runs.found import Labelled
from tiler.runs.job import Job

MIN_WARNED_SHARE = 0.1
"""A canopy causes a warning if it covers at least this share of the area."""
MAX_POSITIONS = 3
"""The warning has the positions of at most this many blocks, which are the blocks with the most
canopy."""
HIDES = "a closed canopy (crowns, or tall rough roofs side by side) hides the ground"
MIN_MAPPED_SHARE = 0.5
"""The map of the report shows blocks if canopy covers at least this share of the block."""


def report_canopy(job: Job, labelled: Labelled) -> None:
    """Add the canopy and its positions to run.json, and warn if it covers much of the area."""
    state = labelled.statistics.get(CanopyPass.name)
    if state is None:
        return
    share = state["canopy"]["share"]
    job.results.canopy = CanopyResult(share=share, mode=job.plan.config.canopy)
    if labelled.canopy is None:
        return
    blocks, unit = labelled.canopy.blocks, float(job.plan.frame.units.horizontal)
    fullest = sorted(blocks, key=lambda block: (-blocks[block], block))[:MAX_POSITIONS]
    centres = [
        [round((index + 0.5) * BLOCK_M / unit, 1) for index in block] for block in fullest
    ]
    job.results.canopy = replace(job.results.canopy, places=centres, rings=_rings(blocks, unit))
    if share < MIN_WARNED_SHARE:
        return
    job.results.canopy_doubts = [
        _doubt(block, blocks[block] / BLOCK_M**2, unit) for block in fullest
    ]
    around = " and ".join(f"x {x:.0f}, y {y:.0f}" for x, y in centres)
    effect = (
        "the terrain there is computed from the ground around the canopy and the height of its crowns, and has the "
        "value 6 in the mask; use --canopy void to leave it without heights"
    )
    if job.plan.config.canopy == VOID_CANOPY:
        effect = "the terrain has no heights there (use --canopy fill to compute them from ground around and crowns)"
    hidden = f"{HIDES} in {percent(share)} % of the area, most of all around {around}"
    job.listener(Warned(f"{hidden}: {effect}"))


def _doubt(block: tuple[int, int], share: float, unit: float) -> Doubt:
    """Return a text about the terrain in a block, and its west, south, east and north in units of the CRS."""
    side = BLOCK_M / unit
    west, south = (index * side for index in block)
    text = f"{HIDES} in {percent(share)} % of a square of {length_text(BLOCK_M, unit)}"
    return Doubt(text, [west, south, west + side, south + side])


def _rings(blocks: Mapping[tuple[int, int], int], unit: float) -> list[list[float]]:
    """Return rings in units of the CRS around the blocks that are mostly canopy, for the map.

    If there are no such blocks, the rings surround the blocks with the most canopy.
    """
    min_m2 = min(MIN_MAPPED_SHARE * BLOCK_M**2, max(blocks.values()))
    mapped = np.array(
        [block for block, area_m2 in blocks.items() if area_m2 >= min_m2], np.float64
    )
    side = BLOCK_M / unit
    squares = shapely.box(*(mapped.T * side), *((mapped.T + 1) * side))
    return rings_of(shapely.get_parts(shapely.union_all(squares)), side / 4)
