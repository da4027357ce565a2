"""Planes of water: level areas with any number of returns, surrounded by rising land.

Water with waves, below weirs and at fords, has as many returns as land, and crowns over its banks hide its shore. But
it is level over tens of metres, unlike land. A plane is a connected area of level ground. It is water if the land
around it rises, as around areas of few returns (`tiler.grid.water_cells`), and if there is further evidence. This is
few returns in much of the plane, or water by the input in some of it. A plane without such evidence is water only next
to a plane with it, perhaps on the other side of a dam.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from tiler.grid.checksum import checksum
from tiler.grid.coarse import Bools, padded
from tiler.grid.pieces import Piece, label_block
from tiler.grid.reach import Floats, distances
from tiler.grid.water_cells import (
    GIVEN_SHARE,
    Rim,
    WaterCells,
    flat_cells,
    rim_of,
    sparse_cells,
)
from tiler.grid.water_extent import shore_area, smoothed, water_heights
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

LEVEL_CELLS = 3
"""Side in cells of the square in which smoothed heights are compared."""
RELIEF_M = 0.08
"""Largest difference of height of water in that square, due to waves and a fall of up to 1 %."""
SHORE_CELLS = 5
"""Largest distance in cells from a plane to its shore. Smoothing and the slope of the bank separate them."""
SPARSE_SHARE = 0.5
"""Least share of cells with few returns for which a plane may be water by itself."""
DAM_M = 40.0
"""Largest distance to evident water of a plane that may be water only next to it. A dam may lie in between."""
BESIDE_M = DAM_M + 20
"""Distance from a plane within which cells are examined."""
AROUND = np.ones((3, 3), np.bool_)


class Plane(NamedTuple):
    """Numbers of cells of a plane, added up over blocks: all, water by the input, and cells with few returns."""

    cells: int = 0
    given: int = 0
    sparse: int = 0

    @property
    def is_evident(self) -> bool:
        """Whether the plane may be water by itself."""
        return self.sparse >= SPARSE_SHARE * self.cells or self.given >= GIVEN_SHARE * self.cells


@dataclass(frozen=True, kw_only=True)
class CountPlaneRims(AreasWork):
    """Arguments of `count_plane_rims`.

    Attributes
    ----------
    evident : tuple of Piece
        Planes that may be water by themselves. They do not count as land around each other.
    others : tuple of Piece
        Planes that may be water next to evident planes. All cells around them count as land, even water. So the crest
        of a dam, which is level, falls to the water on both sides and is not water.
    """

    evident: tuple[Piece, ...]
    others: tuple[Piece, ...]


@dataclass(frozen=True, kw_only=True)
class KeepPlanes(AreasWork):
    """Arguments of `keep_planes`: the planes that are water as ``kept``, with confidences."""

    kept: tuple[tuple[Piece, float], ...]


def plane_cells(ground: Floats, domain: Bools) -> Bools:
    """Return a mask of the cells whose smoothed heights are as level as water, without arms that are one cell wide."""
    unknown = np.isnan(ground)
    high = scipy.ndimage.maximum_filter(np.where(unknown, np.inf, ground), LEVEL_CELLS)
    low = scipy.ndimage.minimum_filter(np.where(unknown, -np.inf, ground), LEVEL_CELLS)
    level = scipy.ndimage.binary_opening((high - low < RELIEF_M) & domain, np.ones((3, 3), np.bool_))
    return np.asarray(level)


def find_planes(store_url: str, work: FindAreas) -> dict[str, Any]:
    """Label the planes in a block. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``sides`` and ``labels`` (number of labels), see `tiler.grid.pieces`; ``sizes``: `Plane` of each label;
        ``boxes``: first row and column, and last row and column plus 1, of each label; ``times``; ``filled``;
        ``checksum``.
    """
    store, block = open_store(store_url), work.block
    cells = read_search_cells(store, work.sources, work.spec, padded(block, MARGIN), 1)
    inner = inner_window(block, MARGIN)
    labels, sides = label_block(plane_cells(smoothed(cells.ground), cells.domain)[inner], corners=False)
    sparse = np.zeros_like(labels, np.bool_)
    if work.usual is not None:
        coarser = read_search_cells(store, work.sources, work.spec, padded(block, MARGIN), work.times)
        coarse_sparse = sparse_cells(coarser, flat_cells(coarser), work.usual)
        sparse = coarse_sparse.repeat(work.times, axis=0).repeat(work.times, axis=1)[inner]
    values = labels.astype(np.float32)
    store.write_block(work.name, block, values)
    count = int(labels.max(initial=0))
    masks = (labels > 0, cells.given[inner], sparse)
    counts = [np.bincount(labels[mask], minlength=count + 1)[1:] for mask in masks]
    boxes = []
    for rows, cols in scipy.ndimage.find_objects(labels):
        boxes.append(
            [block.row + rows.start, block.col + cols.start, block.row + rows.stop, block.col + cols.stop]
        )
    return {
        "sides": sides,
        "labels": count,
        "sizes": np.stack(counts, axis=1).tolist(),
        "boxes": boxes,
        "times": work.times,
        "filled": int(np.count_nonzero(values)),
        "checksum": checksum(values),
    }


def count_plane_rims(store_url: str, work: CountPlaneRims) -> dict[str, Any]:
    """Count the land around planes that lies in a block. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``rims``: name of each plane, and the `tiler.grid.water_cells.Rim` around the plane and its shore. An evident
        plane has a second rim, in which no plane that may be water counts as land. ``beside``: pairs of a plane and an
        evident plane near it.
    """
    evident = set(work.evident)
    planes = {*work.evident, *work.others}
    near = _planes(store_url, work, planes)
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
        water = shore_area(cells, plane_mask, water_heights(cells, plane_mask), SHORE_CELLS)
        evident_water = is_evident[numbers] & ~water
        if name in evident:
            any_water = is_plane[numbers] & ~water
            rims = [_rim(cells, water, others, counted) for others in (evident_water, any_water)]
        else:
            rims = [rim_of(cells, water, np.zeros_like(water), counted, evident_water)]
        if any(map(any, rims)):
            named_rims.append([list(name), *map(list, rims)])
        is_near = distances(plane_mask, DAM_M / cells.size + 1) * cells.size <= DAM_M
        for other in np.unique(numbers[evident_water & counted & is_near]):
            beside.append([list(name), list(near.names[other - 1])])
    return {"rims": named_rims, "beside": beside}


def _rim(cells: WaterCells, water: Bools, others: Bools, counted: Bools) -> Rim:
    """Count the land around a plane and its shore, without other planes and their shores."""
    others_with_shores = scipy.ndimage.binary_dilation(others, AROUND, iterations=SHORE_CELLS) & ~water
    return rim_of(cells, water, others_with_shores, counted)


def keep_planes(store_url: str, work: KeepPlanes) -> dict[str, Any]:
    """Write the confidence that each cell belongs to a plane of water or its shore, 0 elsewhere.

    This is a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``filled`` (cells of water), ``checksum``.
    """
    kept, block = dict(work.kept), work.block
    near = _planes(store_url, work, kept)
    confidence = np.zeros(near.numbers.shape, np.float32)
    for number, window in near.windows(kept):
        cells, mask = near.cells.cut(window), near.numbers[window] == number
        water = shore_area(cells, mask, water_heights(cells, mask), SHORE_CELLS)
        confidence[window][water] = np.maximum(confidence[window][water], kept[near.names[number - 1]])
    values = near.block_values(confidence)
    open_store(store_url).write_block(work.name, block, values)
    return {"filled": int(np.count_nonzero(values)), "checksum": checksum(values)}


def _planes(store_url: str, work: AreasWork, selected: Collection[Piece]) -> AreasAround:
    """Return the planes in and around a block, with smoothed heights in cells near the selected planes."""
    store = open_store(store_url)
    near = areas_around(store, work, selected, BESIDE_M)
    ground = ground_in(store, work.sources.ground, work.spec, near.window)
    return replace(near, cells=near.cells.with_ground(smoothed(ground)))
