"""Division of each raster into tasks, one per block, with digests of the inputs of the tasks."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from tiler.config import AUTO_WATER
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec, north_west
from tiler.core.water import Waters
from tiler.grid import (
    CROWNS_REACH_M,
    AboveBlock,
    BelowCanopy,
    CanopyBlock,
    DeriveBlock,
    DistanceBlock,
    GridBlock,
    MaskBlock,
    OutlineBlock,
    PointsBlock,
    SigmaBlock,
    SurfaceBlock,
    canopy_reach_cells,
    full_halo,
    reach_of,
    reach_pixels,
)
from tiler.grid.coarse import padded
from tiler.grid.pieces import around
from tiler.grid.records import BlockRecord
from tiler.grid.tasks.gridding import GridContext, RasterStep
from tiler.grid.tasks.survey import near_places, surveyed_blocks
from tiler.schedule import Task

CANOPY, BELOW_CANOPY = "canopy", "canopy-below"
"""Rasters of a canopy that hides the ground, and of the terrain below it."""
CANOPY_CELLS, CANOPY_TERRAIN = "canopy-cells", "canopy-terrain"
"""Rasters of cells of canopies: the canopy, and the interpolated terrain around it."""


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


def distance_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block that may have pixels within ``--max-edge`` of points.

    Larger distances are set to ``--max-edge``.
    """
    cap = context.plan.frame.counts(context.plan.config.max_edge)
    return _block_tasks(raster, context, partial(DistanceBlock, cap=cap), math.ceil(cap) + 1)


def surface_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block that a facet of the surface could reach, with the terrain as lower limit."""
    plan, counts = context.plan, context.plan.frame.counts
    terrain, survey = raster.inputs
    choice = _highest(terrain, context)
    margin = full_halo(counts(plan.config.max_edge))
    margin += math.ceil((choice["reach"] + 1) * counts(plan.grid.resolution))
    make = _on_tin(
        SurfaceBlock,
        context,
        survey=survey,
        coarse=context.coarse,
        waters=context.water_key,
        **choice,
    )
    for block, near in _near(context, context.spec, margin).items():
        work = make(name=raster.name, spec=context.spec, block=block, rule=context.rule)
        window = context.spec.block_bounds(block).pad(margin)
        around_block = context.spec.blocks_within(window, BLOCK_PIXELS)
        yield context.block_task(
            raster,
            work,
            context.label_digests(near),
            context.checksums(terrain, [other.name for other in around_block]),
            context.coarse_checksums(survey, block),
            context.waters.digest(context.spec.block_bounds(block)),
            points=context.n_points(near),
        )


def above_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block with points. A task also reads points and pixels just outside the block."""
    spec, choice = context.spec, _highest(raster.inputs[0], context)
    margin = math.ceil(choice["reach"] * spec.lattice.size)
    for block, near in _near(context, spec, margin).items():
        work = AboveBlock(
            name=raster.name,
            spec=spec,
            block=block,
            rule=context.rule,
            waters=context.water_key,
            **choice,
        )
        yield context.block_task(
            raster,
            work,
            context.label_digests(near),
            context.checksums(choice["terrain"], _around(block)),
            context.waters.digest(spec.block_bounds(block)),
            points=context.n_points(near),
        )


def _highest(terrain: str, context: GridContext) -> dict[str, Any]:
    """Return the arguments of `tiler.grid.highest.ReturnsBlock` that are the same for all blocks."""
    return {
        "spike": context.plan.config.spike / context.plan.frame.metres_z,
        "reach": reach_pixels(context.plan.grid.resolution),
        "terrain": terrain,
    }


def _on_tin(
    make: Callable[..., PointsBlock], context: GridContext, **more: Any
) -> Callable[..., PointsBlock]:
    """Return a function that makes blocks on a TIN with the arguments common to all of them."""
    plan, counts = context.plan, context.plan.frame.counts
    halo = math.ceil(counts(plan.grid.halo_m))
    max_edge = counts(plan.config.max_edge)
    return partial(make, data=context.assembled.bounds, max_edge=max_edge, halo=halo, **more)


def _block_tasks(
    raster: RasterStep, context: GridContext, make: Callable[..., PointsBlock], margin: int
) -> Iterator[Task]:
    """Yield a task for each block within ``margin`` counts of points.

    A task reads the points near its block, and the same block of the input rasters. The
    function ``make`` returns the arguments of a task for name, spec, block and rule.
    """
    spec, rule = context.spec_of(raster), context.rule
    for block, near in _near(context, spec, margin).items():
        work = make(name=raster.name, spec=spec, block=block, rule=rule)
        inputs = [context.checksums(name, [block.name]) for name in raster.inputs]
        yield context.block_task(
            raster, work, context.label_digests(near), inputs, points=context.n_points(near)
        )


def _near(context: GridContext, spec: RasterSpec, margin: int = 0) -> dict[Block, list[Cell]]:
    """Return the blocks with buckets within ``margin`` counts (plus ``--erode``), each with these buckets."""
    margin += math.ceil(context.plan.frame.counts(context.plan.config.erosion))
    return spec.blocks_near(context.plan.buckets, context.labels, BLOCK_PIXELS, margin)


def canopy_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block with points, in pixels or cells, if the filter found a canopy."""
    if context.canopy is None:
        return
    canopy, spec = context.canopy, context.spec_of(raster)
    reach = canopy_reach_cells(float(canopy.side * context.plan.frame.metres_xy))
    for block, near in _near(context, spec, math.ceil(reach * canopy.side)).items():
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
    for block, near in _near(context, cells, widest).items() if places else ():
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


def mask_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block that has points or heights, or that overlaps the survey or a failed tile."""
    spec, coarse, rule = context.spec, context.coarse, context.rule
    dtm, delivered, survey, canopy = raster.inputs
    near = _near(context, spec)
    holes: dict[Block, list[Bounds]] = defaultdict(list)
    for hole in context.holes:
        for block in spec.blocks_within(hole, BLOCK_PIXELS):
            holes[block].append(hole)
    inside = surveyed_blocks(context, survey)
    made = [
        spec.block_named(key, BLOCK_PIXELS)
        for key in (*context.made[dtm], *context.made[delivered])
    ]
    for block in sorted({*near, *holes, *inside, *made}, key=north_west):
        work = MaskBlock(
            name=raster.name,
            spec=spec,
            block=block,
            rule=rule,
            dtm=dtm,
            filled=delivered,
            survey=survey,
            coarse=coarse,
            canopy=canopy if context.made[canopy] else None,
            holes=tuple(holes.get(block, ())),
            area=context.plan.inputs.area_key,
            waters=context.water_key,
        )
        yield context.block_task(
            raster,
            work,
            context.coarse_checksums(survey, block),
            [context.checksums(name, [block.name]) for name in (dtm, delivered, canopy)],
            context.label_digests(near.get(block, [])),
            context.waters.digest(spec.block_bounds(block)),
        )


def derived_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block that all inputs have. A task also reads the pixels next to its block."""
    spec = context.spec
    keys = set.intersection(*(set(context.made[name]) for name in raster.inputs))
    for block in sorted((spec.block_named(key, BLOCK_PIXELS) for key in keys), key=north_west):
        work = DeriveBlock(
            name=raster.name, spec=spec, block=block, sources=raster.inputs, fill=raster.fill
        )
        inputs = [context.checksums(name, _around(block)) for name in raster.inputs]
        yield context.block_task(raster, work, inputs)


def sigma_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block of the terrain. A task also reads points and pixels around its block."""
    spec, frame = context.spec, context.plan.frame
    terrain, mask, *below = raster.inputs
    cap = frame.counts(context.plan.config.max_edge)
    near = _near(context, spec, reach_of(frame, spec.lattice.size, cap))
    for key in sorted(context.made[terrain]):
        block = spec.block_named(key, BLOCK_PIXELS)
        work = SigmaBlock(
            name=raster.name,
            spec=spec,
            block=block,
            rule=context.rule,
            terrain=terrain,
            mask=mask,
            below=below[0] if below and context.made[below[0]] else None,
            kind=context.kind,
            cap=cap,
        )
        inputs = [context.checksums(terrain, _around(block)), context.checksums(mask, [key])]
        inputs += [context.checksums(name, [key]) for name in below]
        buckets = near.get(block, [])
        yield context.block_task(
            raster,
            work,
            context.label_digests(buckets),
            inputs,
            points=context.n_points(buckets),
        )


def _around(block: Block) -> list[str]:
    """Return the names of a block and of its eight neighbours, even if some do not exist."""
    return [Block(row, col, 0, 0).name for row, col in around(block.row, block.col)]
