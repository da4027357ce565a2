"""Raster of the distance from each pixel's centre to the nearest ground point."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from ptd.gridding.nearest import nearest_points
from tiler.core.raster import Block, RasterSpec
from tiler.grid.block import pixels_of
from tiler.grid.checksum import checksum
from tiler.grid.ground import GroundSelection, read_ground
from tiler.grid.records import BlockRecord
from tiler.grid.work import PointsBlock
from tiler.store import TileStore, open_store

FIRST_SHARE = 4
"""Divisor of the cap for the first search of points, as few blocks need the whole cap."""


@dataclass(frozen=True, kw_only=True)
class DistanceBlock(PointsBlock):
    """Arguments of `distance_block`. Distances are at most ``cap`` counts."""

    cap: Fraction


def distance_block(store_url: str, work: DistanceBlock) -> BlockRecord:
    """Write one block of the plan distance to the nearest ground point. This is a `tiler.schedule.task.Work`.

    The distance is in metres from the pixel's centre (rounded down to a whole count), and at
    most ``cap``.

    Returns
    -------
    BlockRecord
        Record of the block. ``filled`` is the number of pixels nearer than the cap.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    cap, rule = work.cap, work.rule
    distances = ground_distance(store, rule, spec, block, cap / FIRST_SHARE)
    if np.isinf(distances).any():
        distances = ground_distance(store, rule, spec, block, cap)
    metres = float(store.meta.frame.metres_xy)
    values = (np.minimum(distances, float(cap)) * metres).astype(np.float32)
    store.write_block(work.name, block, values)
    return BlockRecord(
        pixels=values.size,
        filled=int(np.isfinite(distances).sum()),
        checksum=checksum(values),
    )


def ground_distance(
    store: TileStore, rule: GroundSelection, spec: RasterSpec, block: Block, reach: Fraction
) -> npt.NDArray[np.float64]:
    """Return plan distances to ground in counts, float64 (height, width), infinite beyond ``reach`` counts."""
    xyz = read_ground(store, rule, spec.block_bounds(block).pad(math.ceil(reach) + 1)).xyz
    return distance_to(xyz, store.meta.frame.origin, spec, block, reach)


def distance_to(
    xyz: npt.NDArray[np.int32],
    origin: tuple[int, int],
    spec: RasterSpec,
    block: Block,
    reach: Fraction,
) -> npt.NDArray[np.float64]:
    """Return plan distances to points in counts, float64 (height, width), infinite beyond ``reach`` counts.

    ``xyz``, int32 (3, n) in local counts, has to include all points within ``reach`` of the block.
    """
    pixels = pixels_of(spec, block, origin)
    nearest = nearest_points(xyz[0], xyz[1], xyz[2], pixels, 1, float(reach))
    squared = nearest.squared[..., 0].astype(np.float64)
    return np.where(nearest.points[..., 0] < 0, np.inf, np.sqrt(squared))
