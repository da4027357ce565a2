"""Raster of ground points per square metre."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tiler.core.lattice import Cell
from tiler.core.raster import Block, RasterSpec
from tiler.grid.checksum import checksum
from tiler.grid.ground import GroundSelection, read_ground
from tiler.grid.records import DensityRecord
from tiler.grid.work import PointsBlock
from tiler.store import TileStore, open_store


def density_block(store_url: str, work: PointsBlock) -> DensityRecord:
    """Write one block of the density of ground points. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    DensityRecord
        Record of the block. ``filled`` is the number of pixels with a ground point.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    counts = ground_counts(store, work.rule, spec, block)
    area = (spec.lattice.size * store.meta.frame.metres_xy) ** 2
    values = (counts / float(area)).astype(np.float32)
    store.write_block(work.name, block, values)
    return DensityRecord(
        pixels=values.size,
        filled=int(np.count_nonzero(counts)),
        points=int(counts.sum()),
        checksum=checksum(values),
    )


def ground_counts(
    store: TileStore, rule: GroundSelection, spec: RasterSpec, block: Block
) -> npt.NDArray[np.int64]:
    """Count the ground points in each pixel of a block, int64 (height, width)."""
    counts = np.zeros(block.height * block.width, np.int64)
    origin = store.meta.frame.origin

    def count(cell: Cell, points: npt.NDArray[np.int32]) -> npt.NDArray[np.intp]:
        """Count the points of a bucket, and keep none: a block of large cells may hold too many."""
        counts[:] += np.bincount(
            pixel_indices(points, origin, spec, block), minlength=counts.size
        )
        return np.empty(0, np.intp)

    read_ground(store, rule, spec.block_bounds(block), count)
    return counts.reshape(block.height, block.width)


def pixel_indices(
    xyz: npt.NDArray[np.int32], origin: tuple[int, int], spec: RasterSpec, block: Block
) -> npt.NDArray[np.int64]:
    """Return ``row * width + col`` within the block for each point. All points have to lie in the block."""
    x, y = (xyz[axis].astype(np.int64) + origin[axis] for axis in (0, 1))
    col = spec.lattice.index(x) - (spec.west + block.col)
    row = (spec.north - 1 - block.row) - spec.lattice.index(y)
    return row * block.width + col
