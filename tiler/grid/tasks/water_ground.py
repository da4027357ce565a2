"""Tasks that compute the heights of coarse cells for the search for water."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tiler.core.raster import BLOCK_PIXELS
from tiler.grid import GroundCells
from tiler.grid.pieces import around
from tiler.grid.records import BlockRecord
from tiler.grid.tasks.gridding import GridContext, Place, RasterStep
from tiler.grid.tasks.survey import block_names, near_places
from tiler.grid.tasks.water_search import counts_at
from tiler.grid.water_ground import NEAR_CELLS
from tiler.schedule import Task


def ground_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block of coarse cells that overlaps a block of the terrain with heights."""
    if not context.water_is_sought:
        return
    terrain, coarse_terrain, occupancy = raster.inputs
    coarse, spec = context.coarse, context.spec
    if context.has_large_pixels:
        spec, terrain = coarse, coarse_terrain
    counts = counts_at(context, occupancy)
    places: set[Place] = set()
    for key, (_, stored) in context.made[terrain].items():
        if BlockRecord.of(stored).filled:
            bounds = spec.block_bounds(spec.block_named(key, BLOCK_PIXELS))
            places.update(
                (block.row, block.col) for block in coarse.blocks_within(bounds, BLOCK_PIXELS)
            )
    for place in sorted(places):
        block = coarse.block_at(*place, BLOCK_PIXELS)
        has_water_class = any(
            counts[other]["water"] for other in around(*place) if other in counts
        )
        work = GroundCells(
            name=raster.name, spec=coarse, block=block, heights=terrain, pixels=spec,
            occupancy=occupancy if has_water_class else None, rule=context.rule,
        )  # fmt: skip
        blocks = [
            other.name for other in spec.blocks_within(coarse.block_bounds(block), BLOCK_PIXELS)
        ]
        inputs: list[Any] = [context.checksums(terrain, blocks)]
        if has_water_class:
            margin = int(NEAR_CELLS * coarse.lattice.size) + 1
            near = context.plan.buckets.among(
                coarse.block_bounds(block).pad(margin), context.labels
            )
            inputs.append(
                context.checksums(occupancy, block_names(near_places(coarse, [place])))
            )
            inputs.append(context.label_digests(near))
        yield context.block_task(raster, work, inputs)
