"""Search for water in three steps: find candidates, count the land around them, keep the candidates that are water.

A task of a step reads the rasters of earlier steps in a block and its margin, and writes the
block. Between two steps, the areas of all blocks are joined (`tiler.grid.tasks.water_search`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Float32, Float64, Int32
from tiler.core.products import BEYOND
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.grid.coarse import Piece, areas_within, box_around, label_block, padded
from tiler.grid.steps import Counts, Position
from tiler.grid.water_cells import (
    RING_M,
    WaterCells,
    rim_of,
    water_candidates,
)
from tiler.store import TileStore, read_cells

MARGIN = 64
"""Width of the margin around a block, in coarse cells."""
ALIGNED = 16
"""Windows begin and end at multiples of this, in coarse cells.

At most this many cells are merged along a side.
"""
BESIDE_M = RING_M[1] + 2
"""Cells up to this distance from an area are read to count the land around the area, in
metres."""
SMOOTHING_CELLS = 8
"""Cells farther away than this, in cells, do not change the smoothed height of a cell."""
Slices = tuple[slice, slice]
WHOLE: Slices = (slice(None), slice(None))
Joins = Sequence[tuple[Piece, Piece]]
Kept = Sequence[tuple[Piece, float]]


@dataclass(frozen=True)
class SearchRasters:
    """Rasters of coarse cells for the search for water.

    Attributes
    ----------
    occupancy : str
        Number of points in each cell, negative in cells that are water by the input.
    ground : str
        Heights of the terrain.
    domain : str
        Cells of the survey, and of the gaps that may be water.
    """

    occupancy: str
    ground: str
    domain: str


class SearchRead(NamedTuple):
    """What the steps of the search read at a block and `MARGIN` cells around it, each (height, width).

    Attributes
    ----------
    occupancy : float32
        Number of points in each cell, negative in cells that are water by the input.
    ground : float64
        Heights of the terrain in units of the CRS, NaN for cells without a height.
    domain : float32
        Cells of the survey, and of the gaps that may be water.
    place : Position
    """

    occupancy: Float32
    ground: Float64
    domain: Float32
    place: Position

    def cells(self, n_merged: int, part: Slices = WHOLE) -> WaterCells:
        """Return the cells of a part, with squares of ``n_merged`` by ``n_merged`` cells merged (a power of two)."""
        points, ground = self.occupancy[part], self.ground[part] * self.place.unit_m
        domain = self.domain[part] != BEYOND
        cells = WaterCells(np.abs(points), points < 0, ground, domain, self.place.pixel_m)
        return cells.merged(n_merged)


def find_areas(
    occupancy: Float32,
    ground: Float64,
    domain: Float32,
    place: Position,
    *,
    n_merged: int,
    usual: float | None,
) -> tuple[Float64, Counts]:
    """Label the candidates for water in a block.

    Parameters
    ----------
    occupancy, ground, domain, place
        See `SearchRead`.
    n_merged : int
        Number of cells that are merged along a side, a power of two. A merged cell is so large that it is not
        empty by chance.
    usual : float or None
        Usual number of returns, see `tiler.grid.water_cells.water_candidates`.

    Returns
    -------
    labels : float64 (height, width)
    counts : dict
        Counts of `label_areas` with sizes as in `CellCounts`, and ``n_merged``.
    """
    cells = SearchRead(occupancy, ground, domain, place).cells(n_merged)
    candidate_mask = (
        water_candidates(cells, usual).repeat(n_merged, axis=0).repeat(n_merged, axis=1)
    )
    inner = inner_window(place.block, MARGIN)
    given = cells.finer(n_merged).given[inner]
    labels, counts = label_areas(candidate_mask[inner], given)
    return labels.astype(np.float64), {**counts, "n_merged": n_merged}


def label_areas(cells: Bool, *masks: Bool) -> tuple[Int32, dict[str, Any]]:
    """Label the connected areas of a block.

    Returns
    -------
    labels : int32 (height, width)
    counts : dict
        ``labels``, ``sides``: number of labels, and the labels along the sides of the block (`tiler.grid.coarse`).
        ``sizes``: for each label, its number of cells, and the number of those in each mask.
    """
    labels, sides = label_block(cells, corners=False)
    count = int(labels.max(initial=0))
    sizes = [
        np.bincount(labels[mask], minlength=count + 1)[1:] for mask in (labels > 0, *masks)
    ]
    return labels, {"labels": count, "sides": sides, "sizes": np.stack(sizes, axis=1).tolist()}


def count_rims(
    areas: Float32,
    occupancy: Float32,
    ground: Float64,
    domain: Float32,
    place: Position,
    *,
    n_merged: int,
    joins: Joins,
) -> tuple[None, Counts]:
    """Count the land of a block around candidates.

    Parameters
    ----------
    areas : float32 (height, width)
        Labels of candidates.
    occupancy, ground, domain, place
        See `SearchRead`.
    n_merged : int
        See `find_areas`.
    joins : sequence of (Piece, Piece)
        Result of `tiler.grid.coarse.Joined.joins`.

    Returns
    -------
    None
    counts : dict
        ``rims``: name (`Piece`) and `tiler.grid.water_cells.Rim` of each area.
    """
    read = SearchRead(occupancy, ground, domain, place)
    near = areas_around(read, areas, joins, n_merged, None, BESIDE_M)
    named_rims = []
    for number, window in near.windows(None):
        area_mask = near.numbers[window] == number
        other_areas_mask = (near.numbers[window] > 0) & ~area_mask
        rim = rim_of(near.cells.cut(window), area_mask, other_areas_mask, near.counted[window])
        if any(rim):
            named_rims.append([list(near.names[number - 1]), list(rim)])
    return None, {"rims": named_rims}


def keep_areas(
    areas: Float32, place: Position, *, joins: Joins, kept: Kept
) -> tuple[Float32, Counts]:
    """Return the confidence that each cell of a block is water, 0 for land.

    Parameters
    ----------
    areas : float32 (height, width)
        Labels of candidates.
    place : Position
    joins : sequence of (Piece, Piece)
    kept : sequence of (Piece, float)
        Areas that are water, with confidences.
    """
    confidences = dict(kept)
    numbers, names = areas_within(areas.astype(np.int32), place.block, joins)
    values = np.array([0.0, *(confidences.get(name, 0.0) for name in names)], np.float32)
    return values[numbers], {}


def inner_window(block: Block, margin: int) -> Slices:
    """Return the rows and columns of a block in an array of the block and a margin."""
    return slice(margin, margin + block.height), slice(margin, margin + block.width)


def read_search_cells(
    store: TileStore, sources: SearchRasters, spec: RasterSpec, window: Block
) -> WaterCells:
    """Read returns, classes and ground in a window."""
    frame = store.meta.frame
    points = read_cells(store, sources.occupancy, spec, window)
    heights = read_cells(store, sources.ground, spec, window, NODATA).astype(np.float64)
    ground = np.where(heights == NODATA, np.nan, heights) * float(frame.units.vertical)
    domain: Bool = read_cells(store, sources.domain, spec, window, float(BEYOND)) != BEYOND
    size_m = float(spec.lattice.size * frame.metres_xy)
    return WaterCells(np.abs(points), points < 0, ground, domain, size_m)


@dataclass(frozen=True)
class AreasAround:
    """Areas in and around a block. The window includes the cells that are needed to count the land around the areas.

    Attributes
    ----------
    cells : WaterCells
    ground : float64
        Heights of the cells before any are merged.
    numbers : int32, shape of the cells
        Number of the area in each cell, 0 for none.
    names : list of Piece
        Names of the areas with the numbers 1, 2, ...
    window : Block
        Position of the cells in the raster.
    block : Block
    pad : int
        Margin of an area's window, in cells.
    """

    cells: WaterCells
    ground: Float64
    numbers: Int32
    names: list[Piece]
    window: Block
    block: Block
    pad: int

    @cached_property
    def counted(self) -> Bool:
        """Mask of the cells of the block itself."""
        block_mask = np.zeros(self.numbers.shape, np.bool_)
        block_mask[self._common_part(self.window)] = True
        return block_mask

    def _common_part(self, origin: Block) -> Slices:
        """Return the rows and columns that window and block have in common.

        They are relative to the first row and column of ``origin``, which is the window or the
        block.
        """
        top = max(self.window.row, self.block.row)
        left = max(self.window.col, self.block.col)
        bottom = min(self.window.row + self.window.height, self.block.row + self.block.height)
        right = min(self.window.col + self.window.width, self.block.col + self.block.width)
        bottom, right = max(bottom, top), max(right, left)
        return (
            slice(top - origin.row, bottom - origin.row),
            slice(left - origin.col, right - origin.col),
        )

    def block_values(self, values: Float32) -> Float32:
        """Return the values of the cells of the block from values of the window. Cells beyond the window are 0."""
        block_values = np.zeros((self.block.height, self.block.width), np.float32)
        block_values[self._common_part(self.block)] = values[self._common_part(self.window)]
        return block_values

    def windows(self, selected: Collection[Piece] | None) -> Iterator[tuple[int, Slices]]:
        """Yield the number of each selected area, and the window of the area padded by `pad`.

        Areas are left out if that window does not overlap the block. None selects all areas.
        """
        names = self.names if selected is None else selected
        for number, window in enumerate(scipy.ndimage.find_objects(self.numbers), start=1):
            if self.names[number - 1] not in names:
                continue
            if window is not None:
                rows, cols = (
                    slice(max(s.start - self.pad, 0), s.stop + self.pad) for s in window
                )
                if self.counted[rows, cols].any():
                    yield number, (rows, cols)


def areas_around(
    read: SearchRead,
    areas: Float32,
    joins: Joins,
    n_merged: int,
    selected: Collection[Piece] | None,
    margin_m: float,
) -> AreasAround:
    """Find the areas in and around a block, and the cells within ``margin_m`` of selected areas.

    None selects all areas.
    """
    place, whole = read.place, padded(read.place.block, MARGIN)
    numbers, names = areas_within(areas.astype(np.int32), whole, joins)
    selected_names = names if selected is None else selected
    area_mask = np.array([False, *(name in selected_names for name in names)])[numbers]
    pad = math.ceil(margin_m / place.pixel_m) + 1
    # Windows are aligned, so that squares of cells that are merged are the same in all windows.
    rows, cols = (
        slice(s.start // ALIGNED * ALIGNED, -(-s.stop // ALIGNED) * ALIGNED)
        for s in box_around(area_mask, pad + SMOOTHING_CELLS)
    )
    numbers = numbers[rows, cols]
    window = Block(whole.row + rows.start, whole.col + cols.start, *numbers.shape)
    cells = read.cells(n_merged, (rows, cols)).finer(n_merged)
    return AreasAround(
        cells, read.cells(1, (rows, cols)).ground, numbers, names, window, place.block, pad
    )
