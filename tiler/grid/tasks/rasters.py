"""Division of each raster into tasks, one per block, with digests of the inputs of the tasks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from tiler.config import AUTO_WATER
from tiler.core.lattice import Lattice
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.water import Waters
from tiler.grid import (
    CROWNS_REACH_M,
    BelowCanopy,
    CanopyBlock,
    GridBlock,
    OutlineBlock,
    PointsBlock,
    canopy_reach_cells,
    full_halo,
)
from tiler.grid.coarse import padded
from tiler.grid.records import BlockRecord
from tiler.grid.tasks.gridding import GridContext, RasterStep
from tiler.grid.tasks.raster_names import BELOW_CANOPY, CANOPY
from tiler.grid.tasks.survey import near_places, surveyed_blocks
from tiler.schedule import Task


def terrain_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block that a facet of the terrain could reach."""
    plan, frame = context.plan, context.plan.frame
    widest = full_halo(frame.counts(plan.config.max_edge))
    share = plan.surface_cells
    thinning_cells = (
        None if share is None else Lattice(frame.counts(plan.grid.resolution / share))
    )
    make = _on_tin(
        GridBlock,
        context,
        max_halo=widest,
        interpolation=plan.config.interpolation,
        percent=plan.config.surface_percent,
        thin=thinning_cells,
        max_points=plan.block_points,
        breaklines=context.corrections.lines_key,
    )
    return _block_tasks(raster, context, make, widest)


def coarse_terrain_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield the tasks of the terrain in coarse cells, which the search for water needs if pixels are larger."""
    return (
        terrain_tasks(raster, context)
        if context.water_is_sought and context.has_large_pixels
        else iter(())
    )


def point_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block with points. A pixel depends only on points inside it, and on objects near these."""
    return _block_tasks(raster, context, PointsBlock, 0)


def _on_tin(
    make: Callable[..., PointsBlock], context: GridContext, **more: Any
) -> Callable[..., PointsBlock]:
    """Return a function that makes blocks on a TIN with the arguments common to all of them."""
    facets = context.facets
    return partial(make, data=facets.data, max_edge=facets.max_edge, halo=facets.halo, **more)


def _block_tasks(
    raster: RasterStep, context: GridContext, make: Callable[..., PointsBlock], margin: int
) -> Iterator[Task]:
    """Yield a task for each block within ``margin`` counts of points.

    A task reads the points near its block, and the same block of the input rasters. The
    function ``make`` returns the arguments of a task for name, spec, block and rule.
    """
    spec, rule = context.spec_of(raster.grid), context.rule
    for block, near in context.near(spec, margin).items():
        work = make(name=raster.name, spec=spec, block=block, rule=rule)
        inputs = [context.checksums(name, [block.name]) for name in raster.inputs]
        yield context.block_task(
            raster, work, context.label_digests(near), inputs, points=context.n_points(near)
        )


def canopy_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block with points, in pixels or cells, if the filter found a canopy."""
    if context.canopy is None:
        return
    canopy, spec = context.canopy, context.spec_of(raster.grid)
    reach = canopy_reach_cells(float(canopy.side * context.plan.frame.metres_xy))
    for block, near in context.near(spec, math.ceil(reach * canopy.side)).items():
        work = CanopyBlock(
            name=raster.name,
            spec=spec,
            block=block,
            rule=context.rule,
            elected=canopy.elected,
            labels=canopy.labels,
            side=canopy.side,
        )
        canopy_digests = [canopy.digests[cell] for cell in near]
        yield context.block_task(
            raster,
            work,
            context.label_digests(near),
            canopy_digests,
            points=context.n_points(near),
        )


def canopy_terrain_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block of cells that a facet of the terrain near a canopy could reach."""
    plan, cells = context.plan, context.canopy_cells
    records = context.records(raster.inputs[0], BlockRecord)
    places = set(near_places(cells, [at for at, record in records.items() if record.filled]))
    widest = full_halo(plan.frame.counts(plan.config.max_edge))
    make = _on_tin(
        GridBlock,
        context,
        max_halo=widest,
        percent=plan.config.surface_percent,
        thin=cells.lattice,
        max_points=plan.block_points,
        breaklines=context.corrections.lines_key,
    )
    for block, near in context.near(cells, widest).items() if places else ():
        if (block.row, block.col) in places:
            work = make(name=raster.name, spec=cells, block=block, rule=context.rule)
            yield context.block_task(
                raster, work, context.label_digests(near), points=context.n_points(near)
            )


def below_canopy_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block with a canopy. A task also reads cells around its block."""
    model, canopy, crowns, terrain = raster.inputs
    spec, cells = context.spec, context.canopy_cells
    pixel_m = float(spec.lattice.size * context.plan.frame.metres_xy)
    cell_m = float(cells.lattice.size * context.plan.frame.metres_xy)
    reach = math.ceil((CROWNS_REACH_M + 4 * cell_m) / pixel_m)
    for key, (_, record) in sorted(context.made[canopy].items()):
        if not BlockRecord.of(record).filled:
            continue
        block = spec.block_named(key, BLOCK_PIXELS)
        work = BelowCanopy(
            name=raster.name,
            spec=spec,
            block=block,
            heights=model,
            canopy=canopy,
            cells=cells,
            crowns=crowns,
            terrain=terrain,
        )
        own = [context.checksums(name, [key]) for name in (model, canopy)]
        window = padded(block, reach)
        around_block = [
            context.coarse_checksums(name, window, cells) for name in (crowns, terrain)
        ]
        yield context.block_task(raster, work, own, around_block)


def outline_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block of a model, and for the terrain also each block of the survey."""
    model, survey, *other_inputs = raster.inputs
    canopy, below = (
        name if name in other_inputs and context.made[name] else None
        for name in (CANOPY, BELOW_CANOPY)
    )
    waters = context.waters if raster.name.startswith("dtm") else Waters(())
    keys = {*context.made[model], *context.made.get(BELOW_CANOPY, ())}
    if raster.name.startswith("dtm"):
        # Blocks inside the survey without heights are voids.
        keys |= {block.name for block in surveyed_blocks(context, survey)}
    for key in sorted(keys):
        block = context.spec.block_named(key, BLOCK_PIXELS)
        water_digest = waters.digest(context.spec.block_bounds(block))
        work = OutlineBlock(
            name=raster.name,
            spec=context.spec,
            block=block,
            heights=model,
            survey=survey,
            coarse=context.coarse,
            cut=context.plan.config.outline == "survey",
            canopy=canopy,
            below=below,
            waters=waters.key if water_digest else None,
            edits=context.corrections.edits_key,
            finds_water=context.plan.config.water == AUTO_WATER,
            area=context.plan.inputs.area_key,
        )
        yield context.block_task(
            raster,
            work,
            context.checksums(model, [key]),
            context.coarse_checksums(survey, padded(block, 1)),
            water_digest,
            [context.checksums(name, [key]) for name in (canopy, below) if name],
        )
