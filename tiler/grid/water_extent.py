"""Final water of a run: extended to its shores and under bridges, without narrow parts and small islands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy
import shapely

from ptd.arrays import AnyArray, Bool, Float32, Float64
from tiler.core.raster import Block, RasterSpec
from tiler.grid.coarse import box_around, opened, padded, within
from tiler.grid.river import area_of
from tiler.grid.steps import Counts, Position
from tiler.grid.water_cells import WaterCells
from tiler.grid.water_plants import among_reed, beneath_crowns, has_no_bank
from tiler.grid.water_search import SMOOTHING_CELLS, SearchRead, inner_window, label_areas

LEVEL_M = 0.15
"""Water extends over ground that is at most this high above the water, in metres."""
BELOW_M = 0.4
"""Water does not extend over ground that is deeper than this below the water, in metres.

Such ground is the foot of a dam, or other water.
"""
DEEP_CELLS = 5
"""Ground counts as deeper than `BELOW_M` only in squares of this side, in cells. Smaller pits
come from low returns."""
LEVEL_CELLS = 5
"""The level of water is the mean height in a square of this side, in cells."""
LEVEL_STEP_M = 0.001
"""Heights are rounded to multiples of this before they are added up, in metres."""
OUTER_CELLS = 2
"""The outermost cells of water may be bank: a border of this width, in cells."""
NEAR_CELLS = 10
"""Outermost cells do not contribute to the level if there are inner cells within this distance,
in cells."""
BRIDGE_M = 14.0
"""Water extends under bridges up to this width, in metres."""
UNDER_BRIDGE_M = 0.5
"""Terrain under a bridge is at most this high above the shores next to it, in metres."""
TIDE_M = 0.7
"""Land at the border of the survey may be water if it is at most this high above the water, in
metres."""
SPREAD_M = 0.2
"""Land at the border of the survey may be water if the standard deviation of its heights is at
most this, in metres."""
SPECK_CELLS = 4
"""A speck has at most this many cells."""


def smoothed(ground: Float64) -> Float64:
    """Remove pits and peaks of one or two cells: take the median of three cells along rows and columns, twice."""
    known = ~np.isnan(ground)
    box = box_around(known, 0)
    part = ground[box]
    for axis in (0, 1, 0, 1):
        before, after = np.roll(part, 1, axis), np.roll(part, -1, axis)
        part = np.fmax(np.fmin(before, after), np.fmin(np.fmax(before, after), part))
    smooth_ground = np.full_like(ground, np.nan)
    smooth_ground[box] = part
    smooth_ground[~known] = np.nan
    return smooth_ground


def water_heights(cells: WaterCells, wet: Bool) -> Float64 | None:
    """Return the water level near each cell in metres, or None if the water has no returns.

    The level comes from the nearest cells of water with returns. The outermost cells of the
    water may be bank, so they count only if there are no inner cells near. Cells without
    returns do not count, as their heights come from the banks.
    """
    ground = np.rint(cells.ground / LEVEL_STEP_M)  # Sums of whole numbers are exact.
    known = wet & (cells.returns > 0) & ~np.isnan(ground)
    if not known.any():
        return None
    inner = known & scipy.ndimage.binary_erosion(wet, iterations=OUTER_CELLS, border_value=1)
    known &= inner | ~within(inner, NEAR_CELLS)
    number = scipy.ndimage.uniform_filter(known.astype(np.float64), LEVEL_CELLS)
    total = scipy.ndimage.uniform_filter(np.where(known, ground, 0.0), LEVEL_CELLS)
    nearest = scipy.ndimage.distance_transform_edt(
        ~known, return_distances=False, return_indices=True
    )
    levels: Float64 = (total / np.where(known, number, 1.0))[tuple(nearest)] * LEVEL_STEP_M
    return levels


def extended_to_shore(
    cells: WaterCells, water: Bool, level: Float64 | None, max_steps: int
) -> Bool:
    """Extend water by up to ``max_steps`` cells over connected low cells of the domain.

    Cells are low if they have no height, or if they are at most `LEVEL_M` above the water and
    not in a deep square (`DEEP_CELLS`). Low parts narrower than three cells are left out.
    ``level`` is the level near each cell. If it is None, water is not extended.
    """
    extended_water = water.copy()
    if level is None:
        return extended_water
    box = box_around(water, max_steps)
    near, wet = cells.cut(box), water[box]
    above = near.ground - level[box]
    deep = scipy.ndimage.binary_opening(
        above < -BELOW_M, np.ones((DEEP_CELLS, DEEP_CELLS), np.bool_)
    )
    low = near.domain & ~deep & ((above <= LEVEL_M) | np.isnan(above))
    low = opened(low | wet, math.sqrt(2)) | wet
    extended_water[box] = scipy.ndimage.binary_dilation(wet, iterations=max_steps, mask=low)
    return extended_water


def close_bridge_gaps(
    ground: Float64, water: Bool, size_m: float, longest_island: int, below_deck: Bool
) -> Bool:
    """Close gaps in water under bridges: below known decks, and where the terrain is about as low as the shores.

    Land that water encloses is not a bridge, because bridges are connected with the bank. Such
    land is an island and stays, if it has at most ``longest_island`` rows and columns. Longer
    land may extend beyond the window of another block, where it would not look enclosed. Blocks
    have to agree, so no block treats longer land as an island.
    """
    pad = math.ceil(BRIDGE_M / size_m)
    padded = np.pad(water, pad)
    radius = BRIDGE_M / 2 / size_m
    closed = ~within(~within(padded, radius), radius)[pad:-pad, pad:-pad]
    shore = scipy.ndimage.binary_dilation(water, np.ones((3, 3), np.bool_)) & ~np.isnan(ground)
    around = 2 * pad + 1
    low = scipy.ndimage.minimum_filter(np.where(shore, ground, np.inf), around)
    with np.errstate(invalid="ignore"):
        gaps = closed & (below_deck | (ground - low <= UNDER_BRIDGE_M))
    labels, _, enclosed = _land(water)
    is_short = [False]
    for rows, cols in scipy.ndimage.find_objects(labels):
        is_short.append(max(rows.stop - rows.start, cols.stop - cols.start) <= longest_island)
    island = enclosed & np.array(is_short)
    return np.asarray(water | (gaps & ~island[labels]))


def remove_narrow_parts(water: Bool, width: float, beyond: Bool) -> Bool:
    """Remove the parts of water narrower than ``width`` cells. The other parts keep their shore.

    Cells ``beyond`` the survey count as water, because water may continue there.
    """
    radius = max(width / 2 - 0.5, 1.0)
    # Water at exactly this radius from land is wide enough.
    inner = ~within(~np.pad(water | beyond, 1), math.nextafter(radius, 0.0))[1:-1, 1:-1]
    return water & within(inner, width / 2 + 1)


def without_islands(water: Bool, min_cells: float) -> Bool:
    """Fill enclosed land of fewer than ``min_cells`` cells. Land that touches the border of the array stays."""
    labels, sizes, enclosed = _land(water)
    return np.asarray(water | (enclosed & (sizes < min_cells))[labels])


def without_border_islands(
    cells: WaterCells, water: Bool, level: Float64, min_cells: float
) -> Bool:
    """Fill flat land of fewer than ``min_cells`` cells between water and the border of the survey.

    Flat land is at most `TIDE_M` above the water, and its heights differ little (`SPREAD_M`).
    It is filled if it is a speck, or if at least as many sides of its cells face the water as
    face the border. Such land is mostly water with returns, for example from a flight at a
    higher tide. Land that touches the border of the array stays.
    """
    labels, _, inside = _land(water | ~cells.domain)

    def total(weights: AnyArray, mask: Any = ...) -> AnyArray:
        """Return the sum of weights for each piece of land."""
        return np.bincount(labels[mask].ravel(), weights[mask].ravel(), len(inside))

    sizes = total(labels > 0)
    to_water = total(_sides(water))
    to_border = total(_sides(~cells.domain & ~water))
    above = np.rint((cells.ground - level) / LEVEL_STEP_M)
    known = ~np.isnan(above)
    number = np.maximum(np.bincount(labels[known], minlength=len(inside)), 1)
    mean = total(above, known) / number
    spread = np.sqrt(total(above**2, known) / number - mean**2)
    highest = np.zeros(len(inside))
    np.maximum.at(highest, labels[known], above[known])
    flat = (spread * LEVEL_STEP_M <= SPREAD_M) & (highest * LEVEL_STEP_M <= TIDE_M)
    lies_in_water = (to_water >= to_border) | (sizes <= SPECK_CELLS)
    filled: Bool = inside & flat & (sizes < min_cells) & (to_border > 0) & lies_in_water
    return np.asarray(water | filled[labels])


def _sides(cells: Bool) -> Float64:
    """Return for each cell how many of its four neighbours are in the mask ``cells``."""
    cross = [[0, 1, 0], [1, 0, 1], [0, 1, 0]]
    return scipy.ndimage.correlate(cells.astype(np.float64), cross, mode="constant")


def _land(water: Bool) -> tuple[AnyArray, AnyArray, Bool]:
    """Label the pieces of land.

    Return the label of each cell, and for each label its number of cells and whether water
    encloses it.
    """
    labels, number = scipy.ndimage.label(~water)
    sizes = np.bincount(labels.ravel(), minlength=number + 1)
    enclosed: Bool = np.ones(number + 1, np.bool_)
    for side in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        enclosed[side] = False
    enclosed[0] = False
    return labels, sizes, enclosed


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
    water: Bool,
    cells: WaterCells,
    crowns: Float32,
    below_deck: Bool,
    river_width_m: float,
    island_m2: float,
) -> Bool:
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


def _below_decks(decks: Decks, spec: RasterSpec, window: Block, margin: float) -> Bool:
    """Return a mask of the cells of a window below decks, and within ``margin`` cells of decks."""
    is_below = np.zeros((window.height, window.width), np.bool_)
    for ring in decks:
        deck = shapely.Polygon(np.array(ring).reshape(-1, 2))
        is_below |= spec.inside(window, area_of(deck.buffer(margin * float(spec.lattice.size))))
    return is_below
