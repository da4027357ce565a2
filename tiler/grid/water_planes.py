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
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from tiler.grid.checksum import checksum
from tiler.grid.coarse import Bools, padded
from tiler.grid.pieces import Piece, label_block
from tiler.grid.reach import Floats, distances, opened
from tiler.grid.records import BlockRecord, RimsRecord, SizesRecord
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
    AreasWork,
    FindAreas,
    areas_around,
    ground_in,
    inner_window,
    read_search_cells,
)
from tiler.store import open_store

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
AROUND = np.ones((3, 3), np.bool_)


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


@dataclass(frozen=True, kw_only=True)
class CountPlaneRims(AreasWork):
    """Arguments of `count_plane_rims`.

    Attributes
    ----------
    evident : tuple of Piece
        Evident planes. They do not count as land around each other.
    others : tuple of Piece
        Planes that may be water only near evident planes. All cells around them count as land, even water. So the crest
        of a dam is not water: it is level, but its ring falls to the water on both sides.
    """

    evident: tuple[Piece, ...]
    others: tuple[Piece, ...]


@dataclass(frozen=True, kw_only=True)
class KeepPlanes(AreasWork):
    """Arguments of `keep_planes`.

    Attributes
    ----------
    kept : tuple of (Piece, float)
        Planes that are water, with confidences.
    """

    kept: tuple[tuple[Piece, float], ...]


def plane_cells(ground: Floats, domain: Bools) -> Bools:
    """Return a mask of the cells whose smoothed heights are as level as water, without parts narrower than 3 cells."""
    return opened((relief(ground) < RELIEF_M) & domain, math.sqrt(2))


def find_planes(store_url: str, work: FindAreas) -> SizesRecord:
    """Label the planes in a block. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    SizesRecord
        Record of the block, with sizes as in `Plane`, ``n_merged`` and ``boxes``.
    """
    store, block = open_store(store_url), work.block
    cells = read_search_cells(store, work.sources, work.spec, padded(block, MARGIN), 1)
    inner = inner_window(block, MARGIN)
    labels, sides = label_block(
        plane_cells(smoothed(cells.ground), cells.domain)[inner], corners=False
    )
    sparse = np.zeros_like(labels, np.bool_)
    if work.usual is not None:
        coarser = cells.merged(work.n_merged)
        coarse_sparse = sparse_cells(coarser, flat_cells(coarser), work.usual)
        sparse = coarse_sparse.repeat(work.n_merged, axis=0).repeat(work.n_merged, axis=1)[
            inner
        ]
    values = labels.astype(np.float32)
    store.write_block(work.name, block, values)
    count = int(labels.max(initial=0))
    masks = (labels > 0, cells.given[inner], sparse)
    counts = [np.bincount(labels[mask], minlength=count + 1)[1:] for mask in masks]
    boxes = []
    for rows, cols in scipy.ndimage.find_objects(labels):
        boxes.append(
            [
                block.row + rows.start,
                block.col + cols.start,
                block.row + rows.stop,
                block.col + cols.stop,
            ]
        )
    return SizesRecord(
        sides=sides,
        labels=count,
        sizes=np.stack(counts, axis=1).tolist(),
        boxes=boxes,
        n_merged=work.n_merged,
        filled=int(np.count_nonzero(values)),
        checksum=checksum(values),
    )


def count_plane_rims(store_url: str, work: CountPlaneRims) -> RimsRecord:
    """Count the land of a block around planes. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    RimsRecord
        Record of the block.
    """
    evident = set(work.evident)
    planes = {*work.evident, *work.others}
    areas = _planes(store_url, work, planes)
    is_evident = np.array([False, *(name in evident for name in areas.names)])
    is_plane = np.array([False, *(name in planes for name in areas.names)])
    named_rims: list[list[Any]] = []
    beside: list[list[Any]] = []
    for number, window in areas.windows(planes):
        name = areas.names[number - 1]
        cells = areas.cells.cut(window)
        numbers = areas.numbers[window]
        counted = areas.counted[window]
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
        for other in np.unique(numbers[evident_water & counted & is_near]):
            beside.append([list(name), list(areas.names[other - 1])])
    return RimsRecord(rims=named_rims, beside=beside)


def _rim(cells: WaterCells, water: Bools, not_land: Bools, counted: Bools) -> Rim:
    """Count the land around a plane and its shore. Cells of ``not_land`` and their shores do not count as land."""
    with_shores = (
        scipy.ndimage.binary_dilation(not_land, AROUND, iterations=SHORE_CELLS) & ~water
    )
    return rim_of(cells, water, with_shores, counted)


def keep_planes(store_url: str, work: KeepPlanes) -> BlockRecord:
    """Write for each cell the confidence of the plane of water that covers it, shore included; otherwise 0.

    This is a `tiler.schedule.task.Work`.

    Returns
    -------
    BlockRecord
        Record of the block. ``filled`` is the number of cells of water.
    """
    kept, block = dict(work.kept), work.block
    areas = _planes(store_url, work, kept)
    confidence = np.zeros(areas.numbers.shape, np.float32)
    for number, window in areas.windows(kept):
        cells, mask = areas.cells.cut(window), areas.numbers[window] == number
        water = extended_to_shore(cells, mask, water_heights(cells, mask), SHORE_CELLS)
        confidence[window][water] = np.maximum(
            confidence[window][water], kept[areas.names[number - 1]]
        )
    values = areas.block_values(confidence)
    open_store(store_url).write_block(work.name, block, values)
    return BlockRecord(filled=int(np.count_nonzero(values)), checksum=checksum(values))


def _planes(store_url: str, work: AreasWork, selected: Collection[Piece]) -> AreasAround:
    """Return the planes in and around a block, with smoothed heights of the cells near the selected planes."""
    store = open_store(store_url)
    areas = areas_around(store, work, selected, BESIDE_M)
    ground = ground_in(store, work.sources.ground, work.spec, areas.window)
    return replace(areas, cells=areas.cells.with_ground(smoothed(ground)))
