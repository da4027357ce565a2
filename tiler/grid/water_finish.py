"""Final water of a run: extended to its shores and under bridges, without narrow parts and small islands."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tiler.core.raster import Block
from tiler.grid.centreline import area_of
from tiler.grid.checksum import checksum
from tiler.grid.coarse import Bools, padded
from tiler.grid.pieces import label_block
from tiler.grid.reach import box_around
from tiler.grid.records import SizesRecord
from tiler.grid.water_crowns import beneath_crowns
from tiler.grid.water_extent import (
    BRIDGE_M,
    close_bridge_gaps,
    extended_to_shore,
    remove_narrow_parts,
    smoothed,
    water_heights,
    without_border_islands,
    without_islands,
)
from tiler.grid.water_reed import among_reed, has_no_bank
from tiler.grid.water_search import SMOOTHING_CELLS, Sources, inner_window, read_search_cells
from tiler.grid.work import BlockWork
from tiler.store import TileStore, open_store, read_cells

MAX_EXTENSION_M = 20.0
"""Water extends over low ground up to this distance, in metres."""
MAX_ISLAND_CELLS = 128
"""Windows have a margin for islands up to this length, in coarse cells."""

DECK_EDGE_M = 4.0
"""The terrain may have remains of a deck up to this distance from the deck, in metres."""
DRY_SHARE = 0.25
"""An island stays if the part of it clearly above the water has at least this share of ``island_m2``.

Flat parts of an island become water in this step. The whole area of an island is known only
after its shore is drawn (`tiler.grid.water_find`).
"""


@dataclass(frozen=True, kw_only=True)
class FinishWater(BlockWork):
    """Arguments of `finish_water`.

    Attributes
    ----------
    confidences : tuple of str
        Rasters of the confidence that each cell is water.
    crowns : str
        Raster of the plants near water.
    sources : Sources
    river_width_m : float
        Least width of a river.
    island_m2 : float
        Least area of an island to keep.
    decks : tuple of tuple of int
        Outlines of the bridges near the block that were removed from the terrain: x, y, x, y, ... in absolute counts.
    """

    confidences: tuple[str, ...]
    crowns: str
    sources: Sources
    river_width_m: float
    island_m2: float
    decks: tuple[tuple[int, ...], ...] = ()


def finish_margin(work: FinishWater, size_m: float) -> int:
    """Return the width in coarse cells of the margin around a block that can change the water of the block."""
    base_margin = math.ceil(MAX_EXTENSION_M / size_m) + math.ceil(2 * BRIDGE_M / size_m)
    return (
        base_margin
        + math.ceil(2 * work.river_width_m / size_m)
        + 2
        + _longest_island(work, size_m)
    )


def _longest_island(work: FinishWater, size_m: float) -> int:
    """Return the length in cells of the longest island that is certain to lie completely in a window."""
    return min(math.ceil(work.island_m2 / size_m**2), MAX_ISLAND_CELLS)


def finish_water(store_url: str, work: FinishWater) -> SizesRecord:
    """Label the final water of a block. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    SizesRecord
        Record of the block. Cells that this step adds have no confidence.
    """
    store, block, spec = open_store(store_url), work.block, work.spec
    size_m = float(spec.lattice.size * store.meta.frame.metres_xy)
    margin = finish_margin(work, size_m)
    confidence = np.max(
        [read_cells(store, name, spec, padded(block, margin)) for name in work.confidences],
        axis=0,
    )
    water = confidence > 0
    if water.any():
        rows, cols = box_around(
            water, math.ceil((MAX_EXTENSION_M + BRIDGE_M) / size_m) + SMOOTHING_CELLS
        )
        near = water[rows, cols]
        window = Block(
            block.row - margin + rows.start, block.col - margin + cols.start, *near.shape
        )
        water[rows, cols] = _finished(store, work, near, window, size_m)
    inner = inner_window(block, margin)
    labels, sides = label_block(water[inner], corners=False)
    values = labels.astype(np.float32)
    store.write_block(work.name, block, values)
    count = int(labels.max(initial=0))
    known = confidence[inner] > 0
    hundredths = np.rint(confidence[inner][known].astype(np.float64) * 100)
    counts = [
        np.bincount(labels.ravel(), minlength=count + 1)[1:],
        np.bincount(labels[known], minlength=count + 1)[1:],
        np.bincount(labels[known], hundredths, minlength=count + 1)[1:],
    ]
    return SizesRecord(
        sides=sides,
        labels=count,
        sizes=np.stack(counts, axis=1).astype(np.int64).tolist(),
        filled=int(np.count_nonzero(values)),
        checksum=checksum(values),
    )


def _finished(
    store: TileStore, work: FinishWater, water: Bools, window: Block, size_m: float
) -> Bools:
    """Extend the water of a window to its shores and under bridges, and remove narrow parts and small islands."""
    cells = read_search_cells(store, work.sources, work.spec, window, 1)
    smooth = cells.with_ground(smoothed(cells.ground))
    level = water_heights(smooth, water)
    if level is not None:
        crowns = read_cells(store, work.crowns, work.spec, window)
        water = water | beneath_crowns(smooth, crowns, water, level)
        water |= among_reed(smooth, crowns, water, level)
        no_bank = water & has_no_bank(crowns, smooth.ground - level)
        smooth = smooth.with_ground(np.where(no_bank, np.nan, smooth.ground))
        water = extended_to_shore(smooth, water, level, math.ceil(MAX_EXTENSION_M / size_m))
    min_island = DRY_SHARE * work.island_m2 / size_m**2
    below_deck = _below_decks(work, window, DECK_EDGE_M / size_m)
    longest_island = _longest_island(work, size_m)
    water = close_bridge_gaps(cells.ground, water, size_m, longest_island, below_deck)
    water = remove_narrow_parts(water, work.river_width_m / size_m, ~cells.domain)
    water = without_islands(water, min_island)
    return water if level is None else without_border_islands(cells, water, level, min_island)


def _below_decks(work: FinishWater, window: Block, margin: float) -> Bools:
    """Return a mask of the cells of a window below decks, and within ``margin`` cells of decks."""
    import shapely

    is_below = np.zeros((window.height, window.width), np.bool_)
    for ring in work.decks:
        deck = shapely.Polygon(np.array(ring).reshape(-1, 2))
        area = area_of(deck.buffer(margin * float(work.spec.lattice.size)))
        is_below |= work.spec.inside(window, area)
    return is_below
