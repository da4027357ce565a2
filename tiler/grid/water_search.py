"""Search for water in three steps: find candidates, count the land around them, keep the candidates that are water.

A task of a step reads the rasters of earlier steps in a block and its margin, and writes the
block. Between two steps, the areas of all blocks are joined (`tiler.grid.tasks.water_search`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.products import BEYOND
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.grid.checksum import checksum
from tiler.grid.coarse import Bools, padded
from tiler.grid.pieces import Labels, Piece, areas_within, label_block
from tiler.grid.reach import Floats, box_around
from tiler.grid.records import BlockRecord, RimsRecord, SizesRecord
from tiler.grid.water_cells import (
    RING_M,
    WaterCells,
    rim_of,
    water_candidates,
)
from tiler.grid.work import BlockWork
from tiler.store import TileStore, open_store, read_cells

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


@dataclass(frozen=True)
class Sources:
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


@dataclass(frozen=True, kw_only=True)
class FindAreas(BlockWork):
    """Arguments of `find_areas` and `find_planes`.

    Attributes
    ----------
    sources : Sources
    n_merged : int
        Number of cells that are merged along a side, a power of two. A merged cell is so large that it is not
        empty by chance.
    usual : float or None
        Usual number of returns, see `tiler.grid.water_cells.water_candidates`.
    """

    sources: Sources
    n_merged: int
    usual: float | None


@dataclass(frozen=True, kw_only=True)
class AreasWork(BlockWork):
    """Arguments of tasks on the candidates in and around a block.

    Attributes
    ----------
    sources : Sources
    n_merged : int
        See `FindAreas`.
    areas : str
        Raster of the labels of candidates.
    joins : tuple of (Piece, Piece)
        Result of `tiler.grid.pieces.Joined.joins`.
    """

    sources: Sources
    n_merged: int
    areas: str
    joins: tuple[tuple[Piece, Piece], ...]


@dataclass(frozen=True, kw_only=True)
class CountRims(AreasWork):
    """Arguments of `count_rims`."""


@dataclass(frozen=True, kw_only=True)
class KeepAreas(AreasWork):
    """Arguments of `keep_areas`.

    Attributes
    ----------
    kept : tuple of (Piece, float)
        Areas that are water, with confidences.
    """

    kept: tuple[tuple[Piece, float], ...]


def find_areas(store_url: str, work: FindAreas) -> SizesRecord:
    """Label the candidates for water in a block. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    SizesRecord
        Record of the block, with sizes as in `CellCounts`, and ``n_merged``.
    """
    store, block = open_store(store_url), work.block
    cells = read_search_cells(
        store, work.sources, work.spec, padded(block, MARGIN), work.n_merged
    )
    candidate_mask = (
        water_candidates(cells, work.usual)
        .repeat(work.n_merged, axis=0)
        .repeat(work.n_merged, axis=1)
    )
    fine = cells.finer(work.n_merged).cut(inner_window(block, MARGIN))
    labels, sides = label_block(candidate_mask[inner_window(block, MARGIN)], corners=False)
    values = labels.astype(np.float32)
    store.write_block(work.name, block, values)
    count = int(labels.max(initial=0))
    counts = [
        np.bincount(labels[mask], minlength=count + 1)[1:] for mask in (labels > 0, fine.given)
    ]
    return SizesRecord(
        sides=sides,
        labels=count,
        sizes=np.stack(counts, axis=1).tolist(),
        n_merged=work.n_merged,
        filled=int(np.count_nonzero(values)),
        checksum=checksum(values),
    )


def count_rims(store_url: str, work: CountRims) -> RimsRecord:
    """Count the land of a block around candidates. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    RimsRecord
        Record of the block.
    """
    near = areas_around(open_store(store_url), work, None, BESIDE_M)
    named_rims = []
    for number, window in near.windows(None):
        area_mask = near.numbers[window] == number
        other_areas_mask = (near.numbers[window] > 0) & ~area_mask
        rim = rim_of(near.cells.cut(window), area_mask, other_areas_mask, near.counted[window])
        if any(rim):
            named_rims.append([list(near.names[number - 1]), list(rim)])
    return RimsRecord(rims=named_rims)


def keep_areas(store_url: str, work: KeepAreas) -> BlockRecord:
    """Write the confidence that each cell of a block is water, 0 for land. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    BlockRecord
        Record of the block. ``filled`` is the number of cells of water.
    """
    store, kept = open_store(store_url), dict(work.kept)
    numbers, names = areas_within(store, work.areas, work.spec, work.block, work.joins)
    values = np.array([0.0, *(kept.get(name, 0.0) for name in names)], np.float32)[numbers]
    store.write_block(work.name, work.block, values)
    return BlockRecord(filled=int(np.count_nonzero(values)), checksum=checksum(values))


def inner_window(block: Block, margin: int) -> Slices:
    """Return the rows and columns of a block in an array of the block and a margin."""
    return slice(margin, margin + block.height), slice(margin, margin + block.width)


def ground_in(store: TileStore, name: str, spec: RasterSpec, window: Block) -> Floats:
    """Read the heights of the terrain in a window in metres, NaN for cells without a height."""
    heights = read_cells(store, name, spec, window, NODATA).astype(np.float64)
    heights[heights == NODATA] = np.nan
    heights *= float(store.meta.frame.units.vertical)
    return heights


def read_search_cells(
    store: TileStore, sources: Sources, spec: RasterSpec, window: Block, n_merged: int
) -> WaterCells:
    """Read returns, classes and ground in a window, and merge squares of ``n_merged`` by ``n_merged`` cells.

    ``n_merged`` is a power of two.
    """
    points = read_cells(store, sources.occupancy, spec, window)
    domain: Bools = read_cells(store, sources.domain, spec, window, float(BEYOND)) != BEYOND
    size_m = float(spec.lattice.size * store.meta.frame.metres_xy)
    ground = ground_in(store, sources.ground, spec, window)
    return WaterCells(np.abs(points), points < 0, ground, domain, size_m).merged(n_merged)


@dataclass(frozen=True)
class AreasAround:
    """Areas in and around a block. The window includes the cells that are needed to count the land around the areas.

    Attributes
    ----------
    cells : WaterCells
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
    numbers: Labels
    names: list[Piece]
    window: Block
    block: Block
    pad: int

    @cached_property
    def counted(self) -> Bools:
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

    def block_values(self, values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
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
    store: TileStore, work: AreasWork, selected: Collection[Piece] | None, margin_m: float
) -> AreasAround:
    """Find the areas in and around a block, and read the cells within ``margin_m`` of selected areas.

    None selects all areas.
    """
    whole = padded(work.block, MARGIN)
    numbers, names = areas_within(store, work.areas, work.spec, whole, work.joins)
    selected_names = names if selected is None else selected
    area_mask = np.array([False, *(name in selected_names for name in names)])[numbers]
    pad = math.ceil(margin_m / float(work.spec.lattice.size * store.meta.frame.metres_xy)) + 1
    # Windows are aligned, so that squares of cells that are merged are the same in all windows.
    rows, cols = (
        slice(s.start // ALIGNED * ALIGNED, -(-s.stop // ALIGNED) * ALIGNED)
        for s in box_around(area_mask, pad + SMOOTHING_CELLS)
    )
    numbers = numbers[rows, cols]
    window = Block(whole.row + rows.start, whole.col + cols.start, *numbers.shape)
    cells = read_search_cells(store, work.sources, work.spec, window, work.n_merged).finer(
        work.n_merged
    )
    return AreasAround(cells, numbers, names, window, work.block, pad)
