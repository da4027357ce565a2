"""Numbers and heights of ground points and of objects in the cells of a window."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tiler.core.raster import Block, RasterSpec
from tiler.core.raster import within as within_window
from tiler.grid.coarse import Bools
from tiler.grid.density import pixel_indices
from tiler.grid.ground import GroundSelection, read_ground_and_objects
from tiler.grid.reach import Floats
from tiler.grid.water_masonry import ObjectCells
from tiler.grid.water_search import Slices
from tiler.store import TileStore


class FineCells(NamedTuple):
    """Points in the fine cells of a window.

    Attributes
    ----------
    ground : float64
        Mean height of the ground points of each cell in metres, NaN if there are none.
    n_ground : float64
        Number of ground points of each cell.
    objects : ObjectCells
    """

    ground: Floats
    n_ground: Floats
    objects: ObjectCells

    @property
    def has_points(self) -> Bools:
        """Mask of the cells with points."""
        return np.asarray(self.n_ground + self.objects.number > 0)


class _Heights:
    """Sums and extremes of the heights of points in the cells of a window, in counts."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.total, self.number = np.zeros(shape), np.zeros(shape)
        self.lowest, self.highest = np.full(shape, np.inf), np.full(shape, -np.inf)

    def add(self, cells: npt.NDArray[np.int64], heights: npt.NDArray[np.int32], part: Slices) -> None:
        """Add points of a part of the window, given the number of each point's cell in the part."""
        shape, z = self.total[part].shape, heights.astype(np.float64)
        size = shape[0] * shape[1]
        self.total[part] += np.bincount(cells, z, size).reshape(shape)
        self.number[part] += np.bincount(cells, minlength=size).reshape(shape)

    def add_extremes(
        self, cells: npt.NDArray[np.int64], heights: npt.NDArray[np.int32], part: Slices
    ) -> None:
        """Add the lowest and highest points of each cell, see `add`."""
        for extreme, extremes in ((np.minimum, self.lowest), (np.maximum, self.highest)):
            flat = extremes[part].ravel()
            extreme.at(flat, cells, heights.astype(np.float64))
            extremes[part] = flat.reshape(extremes[part].shape)

    def mean(self) -> Floats:
        """Return the mean height of each cell, NaN if it has no points."""
        mean = np.full(self.total.shape, np.nan)
        np.divide(self.total, self.number, out=mean, where=self.number > 0)
        return mean


def fine_cells(
    store: TileStore, rule: GroundSelection, fine: RasterSpec, window: Block, selected: Bools
) -> FineCells:
    """Return the points of the ``selected`` cells. Other cells have none."""
    frame, bounds = store.meta.frame, fine.block_bounds(window)
    ground, objects = _Heights(selected.shape), _Heights(selected.shape)
    for bucket in store.buckets_within(bounds):
        inside = store.meta.bucket.bounds(bucket).intersection(bounds)
        part = fine.part(window, inside)
        in_window = within_window(part, window)
        if not selected[in_window].any():
            continue
        is_selected = selected[in_window].ravel()
        points = read_ground_and_objects(store, rule, inside)
        for heights, xyz in zip((ground, objects), points, strict=True):
            cells = pixel_indices(xyz, frame.origin, fine, part)
            chosen = is_selected[cells]
            cells, z = cells[chosen], xyz[2, chosen]
            heights.add(cells, z, in_window)
            if heights is objects:
                heights.add_extremes(cells, z, in_window)
    scale = float(frame.metres_z)
    tops = ObjectCells(
        objects.number, objects.lowest * scale, objects.mean() * scale, objects.highest * scale
    )
    return FineCells(ground.mean() * scale, ground.number, tops)
