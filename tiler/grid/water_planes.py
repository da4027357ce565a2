"""Planes of water: level areas with any number of returns, surrounded by rising land.

Water with waves, below weirs and at fords, has as many returns as land, and crowns over its
banks hide its shore. But such water is level over tens of metres, unlike land. A plane is a
connected area of level ground. A plane is water if the land around it rises (as around
candidates, `tiler.grid.water_cells`) and if it is evident. In an evident plane, many cells have
few returns, or some cells are water by the input. A plane that is not evident is water only
near an evident plane of water, for example on the other side of a dam.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Float32, Float64
from tiler.grid.coarse import AROUND, Piece, distances, opened
from tiler.grid.steps import Counts, Position
from tiler.grid.water_cells import (
    GIVEN_SHARE,
    Rim,
    WaterCells,
    flat_cells,
    relief,
    rim_of,
    sparse_cells,
)
from tiler.grid.water_extent import extended_to_shore, smoothed, water_heights
from tiler.grid.water_search import (
    MARGIN,
    AreasAround,
    Joins,
    Kept,
    SearchRead,
    areas_around,
    inner_window,
    label_areas,
)

RELIEF_M = 0.08
"""Three by three cells are level if their smoothed heights differ by less than this, in metres.

Waves and a fall of up to 1 % cause such differences on water.
"""
SHORE_CELLS = 5
"""The shore is at most this far from the plane, in cells.

The plane ends before the shore because of smoothing and the slope of the bank.
"""
SPARSE_SHARE = 0.5
"""A plane is evident if at least this share of its cells has few returns."""
DAM_M = 40.0
"""A plane that is not evident may be water up to this distance from evident planes, in metres.

A dam may lie in between.
"""
BESIDE_M = DAM_M + 20
"""Cells up to this distance from a plane are read, in metres."""


class Plane(NamedTuple):
    """Numbers of cells of a plane, added up over blocks.

    Attributes
    ----------
    cells : int
    given : int
        Cells that are water by the input.
    sparse : int
        Cells with few returns.
    """

    cells: int = 0
    given: int = 0
    sparse: int = 0

    @property
    def is_evident(self) -> bool:
        """Whether the plane may be water without evident planes near it."""
        return (
            self.sparse >= SPARSE_SHARE * self.cells or self.given >= GIVEN_SHARE * self.cells
        )


def plane_cells(ground: Float64, domain: Bool) -> Bool:
    """Return a mask of the cells whose smoothed heights are as level as water, without parts narrower than 3 cells."""
    return opened((relief(ground) < RELIEF_M) & domain, math.sqrt(2))


def find_planes(
    occupancy: Float32,
    ground: Float64,
    domain: Float32,
    place: Position,
    *,
    n_merged: int,
    usual: float | None,
) -> tuple[Float64, Counts]:
    """Label the planes in a block. Parameters are those of `find_areas`.

    Returns
    -------
    labels : float64 (height, width)
    counts : dict
        Counts of `label_areas` with sizes as in `Plane`, ``n_merged``, and ``boxes``: [row, col, last_row + 1,
        last_col + 1] of each label.
    """
    block, inner = place.block, inner_window(place.block, MARGIN)
    cells = SearchRead(occupancy, ground, domain, place).cells(1)
    planes = plane_cells(smoothed(cells.ground), cells.domain)[inner]
    sparse = np.zeros_like(planes)
    if usual is not None:
        coarser = cells.merged(n_merged)
        coarse_sparse = sparse_cells(coarser, flat_cells(coarser), usual)
        sparse = coarse_sparse.repeat(n_merged, axis=0).repeat(n_merged, axis=1)[inner]
    labels, counts = label_areas(planes, cells.given[inner], sparse)
    boxes = [
        [
            block.row + rows.start,
            block.col + cols.start,
            block.row + rows.stop,
            block.col + cols.stop,
        ]
        for rows, cols in scipy.ndimage.find_objects(labels)
    ]
    return labels.astype(np.float64), {**counts, "n_merged": n_merged, "boxes": boxes}


def count_plane_rims(
    areas: Float32,
    occupancy: Float32,
    ground: Float64,
    domain: Float32,
    place: Position,
    *,
    n_merged: int,
    joins: Joins,
    evident: Sequence[Piece],
    others: Sequence[Piece],
) -> tuple[None, Counts]:
    """Count the land of a block around planes.

    Parameters
    ----------
    areas, occupancy, ground, domain, place, n_merged, joins
        See `count_rims`.
    evident : sequence of Piece
        Evident planes. They do not count as land around each other.
    others : sequence of Piece
        Planes that may be water only near evident planes. All cells around them count as land, even water. So the crest
        of a dam is not water: it is level, but its ring falls to the water on both sides.

    Returns
    -------
    None
    counts : dict
        ``rims``: name (`Piece`) and rims of each plane. In the rim of an evident plane, other evident planes do not
        count as land. An evident plane also has a second rim, in which no other plane counts as land. ``beside``: pairs
        of a plane and an evident plane near it.
    """
    planes = {*evident, *others}
    near = _planes(SearchRead(occupancy, ground, domain, place), areas, joins, n_merged, planes)
    is_evident = np.array([False, *(name in evident for name in near.names)])
    is_plane = np.array([False, *(name in planes for name in near.names)])
    named_rims: list[list[Any]] = []
    beside: list[list[Any]] = []
    for number, window in near.windows(planes):
        name = near.names[number - 1]
        cells = near.cells.cut(window)
        numbers = near.numbers[window]
        counted = near.counted[window]
        plane_mask = numbers == number
        water = extended_to_shore(
            cells, plane_mask, water_heights(cells, plane_mask), SHORE_CELLS
        )
        evident_water = is_evident[numbers] & ~water
        if name in evident:
            any_water = is_plane[numbers] & ~water
            rims = [
                _rim(cells, water, not_land, counted) for not_land in (evident_water, any_water)
            ]
        else:
            rims = [rim_of(cells, water, np.zeros_like(water), counted, evident_water)]
        if any(any(rim) for rim in rims):
            named_rims.append([list(name), *(list(rim) for rim in rims)])
        is_near = distances(plane_mask, DAM_M / cells.size_m + 1) * cells.size_m <= DAM_M
        others_near = np.unique(numbers[evident_water & counted & is_near])
        beside += [[list(name), list(near.names[other - 1])] for other in others_near]
    return None, {"rims": named_rims, "beside": beside}


def _rim(cells: WaterCells, water: Bool, not_land: Bool, counted: Bool) -> Rim:
    """Count the land around a plane and its shore. Cells of ``not_land`` and their shores do not count as land."""
    with_shores = (
        scipy.ndimage.binary_dilation(not_land, AROUND, iterations=SHORE_CELLS) & ~water
    )
    return rim_of(cells, water, with_shores, counted)


def keep_planes(
    areas: Float32,
    occupancy: Float32,
    ground: Float64,
    domain: Float32,
    place: Position,
    *,
    n_merged: int,
    joins: Joins,
    kept: Kept,
) -> tuple[Float32, Counts]:
    """Return for each cell the confidence of the plane of water that covers it, shore included; otherwise 0.

    Parameters are those of `count_rims` and `keep_areas`.
    """
    confidences = dict(kept)
    read = SearchRead(occupancy, ground, domain, place)
    near = _planes(read, areas, joins, n_merged, confidences)
    confidence = np.zeros(near.numbers.shape, np.float32)
    for number, window in near.windows(confidences):
        cells, mask = near.cells.cut(window), near.numbers[window] == number
        water = extended_to_shore(cells, mask, water_heights(cells, mask), SHORE_CELLS)
        confidence[window][water] = np.maximum(
            confidence[window][water], confidences[near.names[number - 1]]
        )
    return near.block_values(confidence), {}


def _planes(
    read: SearchRead, areas: Float32, joins: Joins, n_merged: int, selected: Collection[Piece]
) -> AreasAround:
    """Return the planes in and around a block, with smoothed heights of the cells near the selected planes."""
    near = areas_around(read, areas, joins, n_merged, selected, BESIDE_M)
    return replace(near, cells=near.cells.with_ground(smoothed(near.ground)))
