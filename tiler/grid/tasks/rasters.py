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
    CANOPY_AROUND,
    CanopyBlock,
    DeriveBlock,
    DistanceBlock,
    GridBlock,
    MaskBlock,
    OutlineBlock,
    PointsBlock,
    SigmaBlock,
    SurfaceBlock,
    full_halo,
    reach_of,
    reach_pixels,
)
from tiler.grid.pieces import around
from tiler.grid.tasks.gridding import GridContext, RasterStep
from tiler.grid.tasks.survey import surveyed_blocks
from tiler.schedule import Task

CANOPY = "canopy"
"""Raster of the pixels in which a canopy hides the ground."""


def terrain_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block that a facet of the terrain could reach."""
    plan, frame = g.plan, g.plan.frame
    widest = full_halo(frame.counts(plan.config.max_edge))
    share = plan.surface_cells
    thinning_cells = None if share is None else Lattice(frame.counts(plan.grid.resolution / share))
    make = partial(
        GridBlock,
        **_tin(g),
        max_halo=widest,
        interpolation=plan.config.interpolation,
        percent=plan.config.surface_percent,
        thin=thinning_cells,
        max_points=plan.block_points,
        breaklines=g.corrections.lines_key,
    )
    return _block_tasks(raster, g, make, widest)


def coarse_terrain_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield the tasks of the terrain in coarse cells, which the search for water needs if pixels are larger."""
    return terrain_tasks(raster, g) if g.water_is_sought and g.has_large_pixels else iter(())


def point_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block with points. A pixel depends only on points inside it, and on objects near these."""
    return _block_tasks(raster, g, PointsBlock, 0)


def distance_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block that may have pixels within ``--max-edge`` of points.

    Larger distances are set to ``--max-edge``.
    """
    cap = g.plan.frame.counts(g.plan.config.max_edge)
    return _block_tasks(raster, g, partial(DistanceBlock, cap=cap), math.ceil(cap) + 1)


def surface_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block that a facet of the surface could reach, with the terrain as lower limit."""
    plan, frame = g.plan, g.plan.frame
    reach = reach_pixels(plan.grid.resolution)
    (terrain,) = raster.inputs
    spike = plan.config.spike / frame.metres_z
    make = partial(SurfaceBlock, **_tin(g), spike=spike, reach=reach, terrain=terrain)
    margin = full_halo(frame.counts(plan.config.max_edge))
    margin += math.ceil((reach + 1) * frame.counts(plan.grid.resolution))
    return _block_tasks(raster, g, make, margin)


def _tin(g: GridContext) -> dict[str, Any]:
    """Return the common arguments of all blocks on a TIN."""
    plan, counts = g.plan, g.plan.frame.counts
    halo = math.ceil(counts(plan.grid.halo_m))
    return {"data": g.assembled.bounds, "max_edge": counts(plan.config.max_edge), "halo": halo}


def _block_tasks(
    raster: RasterStep, g: GridContext, make: Callable[..., PointsBlock], margin: int
) -> Iterator[Task]:
    """Yield a task for each block within ``margin`` counts of points.

    A task reads the points near its block, and the same block of the input rasters. The function ``make`` returns the
    arguments of a task for name, spec, block and rule.
    """
    spec, rule = g.spec_of(raster), g.rule
    for block, near in _near(g, spec, margin).items():
        work = make(name=raster.name, spec=spec, block=block, rule=rule)
        inputs = [g.checksums(name, [block.name]) for name in raster.inputs]
        yield g.block_task(raster, work, g.label_digests(near), inputs, points=g.n_points(near))


def _near(g: GridContext, spec: RasterSpec, margin: int = 0) -> dict[Block, list[Cell]]:
    """Return the blocks with buckets within ``margin`` counts (plus ``--erode``), each with these buckets."""
    margin += math.ceil(g.plan.frame.counts(g.plan.config.erosion))
    return spec.blocks_near(g.plan.buckets, g.labels, BLOCK_PIXELS, margin)


def canopy_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block with points, if the filter found a canopy."""
    if g.canopy is None:
        return
    canopy = g.canopy
    for block, near in _near(g, g.spec, math.ceil(CANOPY_AROUND * canopy.side)).items():
        work = CanopyBlock(
            name=raster.name, spec=g.spec, block=block, rule=g.rule, elected=canopy.elected, labels=canopy.labels,
            side=canopy.side,
        )  # fmt: skip
        canopy_digests = [canopy.digests[cell] for cell in near]
        yield g.block_task(raster, work, g.label_digests(near), canopy_digests, points=g.n_points(near))


def outline_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block of a model, and for the terrain also each block of the survey."""
    model, survey, *other_inputs = raster.inputs
    canopy = CANOPY if CANOPY in other_inputs and g.made[CANOPY] else None
    waters = g.waters if raster.name.startswith("dtm") else Waters(())
    keys = {*g.made[model]}
    if raster.name.startswith("dtm"):
        # Blocks inside the survey without heights are voids.
        keys |= {block.name for block in surveyed_blocks(g, survey)}
    for key in sorted(keys):
        block = g.spec.block_named(key, BLOCK_PIXELS)
        water_digest = waters.digest(g.spec.block_bounds(block))
        work = OutlineBlock(
            name=raster.name,
            spec=g.spec,
            block=block,
            heights=model,
            survey=survey,
            coarse=g.coarse,
            cut=g.plan.config.outline == "survey",
            canopy=canopy,
            waters=waters.key if water_digest else None,
            edits=g.corrections.edits_key,
            finds_water=g.plan.config.water == AUTO_WATER,
            area=g.plan.inputs.area_key,
        )
        yield g.block_task(
            raster,
            work,
            g.checksums(model, [key]),
            g.coarse_checksums(survey, block),
            water_digest,
            g.checksums(CANOPY, [key]) if canopy else [],
        )


def mask_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block that has points or heights, or that overlaps the survey or a failed tile."""
    spec, coarse, rule = g.spec, g.coarse, g.rule
    dtm, delivered, survey, canopy = raster.inputs
    near = _near(g, spec)
    holes: dict[Block, list[Bounds]] = defaultdict(list)
    for hole in g.holes:
        for block in spec.blocks_within(hole, BLOCK_PIXELS):
            holes[block].append(hole)
    inside = surveyed_blocks(g, survey)
    made = [spec.block_named(key, BLOCK_PIXELS) for key in (*g.made[dtm], *g.made[delivered])]
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
            canopy=canopy if g.made[canopy] else None,
            holes=tuple(holes.get(block, ())),
            area=g.plan.inputs.area_key,
            waters=g.water_key,
        )
        yield g.block_task(
            raster,
            work,
            g.coarse_checksums(survey, block),
            [g.checksums(name, [block.name]) for name in (dtm, delivered, canopy)],
            g.label_digests(near.get(block, [])),
            g.waters.digest(spec.block_bounds(block)),
        )


def derived_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block that all inputs have. A task also reads the pixels next to its block."""
    spec = g.spec
    keys = set.intersection(*(set(g.made[name]) for name in raster.inputs))
    for block in sorted((spec.block_named(key, BLOCK_PIXELS) for key in keys), key=north_west):
        work = DeriveBlock(name=raster.name, spec=spec, block=block, sources=raster.inputs, fill=raster.fill)
        inputs = [g.checksums(name, _around(block)) for name in raster.inputs]
        yield g.block_task(raster, work, inputs)


def sigma_tasks(raster: RasterStep, g: GridContext) -> Iterator[Task]:
    """Yield a task for each block of the terrain. A task also reads points and pixels around its block."""
    spec, frame = g.spec, g.plan.frame
    terrain, mask = raster.inputs
    cap = frame.counts(g.plan.config.max_edge)
    near = _near(g, spec, reach_of(frame, spec.lattice.size, cap))
    for key in sorted(g.made[terrain]):
        block = spec.block_named(key, BLOCK_PIXELS)
        work = SigmaBlock(
            name=raster.name, spec=spec, block=block, rule=g.rule, terrain=terrain, mask=mask, kind=g.kind, cap=cap
        )  # fmt: skip
        inputs = [g.checksums(terrain, _around(block)), g.checksums(mask, [key])]
        buckets = near.get(block, [])
        yield g.block_task(raster, work, g.label_digests(buckets), inputs, points=g.n_points(buckets))


def _around(block: Block) -> list[str]:
    """Return the names of a block and of its eight neighbours, even if some do not exist."""
    return [Block(row, col, 0, 0).name for row, col in around(block.row, block.col)]
