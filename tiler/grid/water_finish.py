"""Final water of a run: extended to its shores and under bridges, without narrow parts and small islands."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tiler.core.raster import Block, RasterSpec
from tiler.grid.centreline import area_of
from tiler.grid.coarse import Bools, Float64, box_around, padded
from tiler.grid.steps import Counts, Position
from tiler.grid.water_cells import WaterCells
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
from tiler.grid.water_search import (
    SMOOTHING_CELLS,
    Float32,
    SearchRead,
    inner_window,
    label_areas,
)

Decks = Sequence[Sequence[int]]

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


def finish_margin(cell_m: float, river_width_m: float, island_m2: float) -> int:
    """Return the width in coarse cells of the margin around a block that can change the water of the block."""
    base_margin = math.ceil(MAX_EXTENSION_M / cell_m) + math.ceil(2 * BRIDGE_M / cell_m)
    narrow = math.ceil(2 * river_width_m / cell_m)
    return base_margin + narrow + 2 + _longest_island(cell_m, island_m2)


def _longest_island(cell_m: float, island_m2: float) -> int:
    """Return the length in cells of the longest island that is certain to lie completely in a window."""
    return min(math.ceil(island_m2 / cell_m**2), MAX_ISLAND_CELLS)


def finish_water(
    sure: Float32,
    planes: Float32,
    crowns: Float32,
    occupancy: Float32,
    ground: Float64,
    domain: Float32,
    place: Position,
    *,
    margin: int,
    river_width_m: float,
    island_m2: float,
    decks: Decks,
) -> tuple[Float64, Counts]:
    """Label the final water of a block.

    Parameters
    ----------
    sure, planes : float32 (height + 2 margin, width + 2 margin)
        Confidences that each cell is water.
    crowns : float32 (height + 2 margin, width + 2 margin)
        Plants near water.
    occupancy, ground, domain, place
        See `SearchRead`, with this margin.
    margin : int
        See `finish_margin`.
    river_width_m : float
        Least width of a river.
    island_m2 : float
        Least area of an island to keep.
    decks : sequence of sequence of int
        Outlines of the bridges near the block that were removed from the terrain: x, y, x, y, ... in absolute counts.

    Returns
    -------
    labels : float64 (height, width)
    counts : dict
        ``labels``, ``sides``: see `label_areas`. ``sizes``: number of cells of each label, number of cells with a
        confidence and sum of the confidences in hundredths. Cells that this step adds have no confidence.
    """
    confidence = np.maximum(sure, planes)
    water, whole = confidence > 0, padded(place.block, margin)
    if water.any():
        rows, cols = box_around(
            water, math.ceil((MAX_EXTENSION_M + BRIDGE_M) / place.pixel_m) + SMOOTHING_CELLS
        )
        near, part = water[rows, cols], (rows, cols)
        window = Block(whole.row + rows.start, whole.col + cols.start, *near.shape)
        cells = SearchRead(occupancy, ground, domain, place).cells(1, part)
        below_deck = _below_decks(decks, place.spec, window, DECK_EDGE_M / place.pixel_m)
        water[part] = _finished(near, cells, crowns[part], below_deck, river_width_m, island_m2)
    inner = inner_window(place.block, margin)
    labels, counts = label_areas(water[inner], confidence[inner] > 0)
    known = confidence[inner].astype(np.float64)
    hundredths = np.bincount(
        labels.ravel(), np.rint(known * 100).ravel(), minlength=counts["labels"] + 1
    )[1:]
    sizes = [[*size, int(n)] for size, n in zip(counts["sizes"], hundredths, strict=True)]
    return labels.astype(np.float64), {**counts, "sizes": sizes}


def _finished(
    water: Bools,
    cells: WaterCells,
    crowns: Float32,
    below_deck: Bools,
    river_width_m: float,
    island_m2: float,
) -> Bools:
    """Extend the water of a window to its shores and under bridges, and remove narrow parts and small islands."""
    smooth, size_m = cells.with_ground(smoothed(cells.ground)), cells.size_m
    level = water_heights(smooth, water)
    if level is not None:
        water = water | beneath_crowns(smooth, crowns, water, level)
        water |= among_reed(smooth, crowns, water, level)
        no_bank = water & has_no_bank(crowns, smooth.ground - level)
        smooth = smooth.with_ground(np.where(no_bank, np.nan, smooth.ground))
        water = extended_to_shore(smooth, water, level, math.ceil(MAX_EXTENSION_M / size_m))
    min_island = DRY_SHARE * island_m2 / size_m**2
    longest_island = _longest_island(size_m, island_m2)
    water = close_bridge_gaps(cells.ground, water, size_m, longest_island, below_deck)
    water = remove_narrow_parts(water, river_width_m / size_m, ~cells.domain)
    water = without_islands(water, min_island)
    return water if level is None else without_border_islands(cells, water, level, min_island)


def _below_decks(decks: Decks, spec: RasterSpec, window: Block, margin: float) -> Bools:
    """Return a mask of the cells of a window below decks, and within ``margin`` cells of decks."""
    import shapely

    is_below = np.zeros((window.height, window.width), np.bool_)
    for ring in decks:
        deck = shapely.Polygon(np.array(ring).reshape(-1, 2))
        is_below |= spec.inside(window, area_of(deck.buffer(margin * float(spec.lattice.size))))
    return is_below
