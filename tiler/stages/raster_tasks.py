"""How the making of each raster is divided into tasks, and what their digests depend on; see `tiler.stages.tasks`."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec, north_west
from tiler.core.water import Waters
from tiler.grid import (
    DeriveBlock,
    DistanceBlock,
    FillBlock,
    GridBlock,
    MakeSurvey,
    MaskBlock,
    OutlineBlock,
    PointsBlock,
    SurfaceBlock,
    Void,
    VoidRasters,
    blocks_of,
    full_halo,
    reach_pixels,
)
from tiler.schedule import Task, digest_of
from tiler.stages.gridding import GAP_M, Gridding, Raster
from tiler.version import __version__

WHOLE = "whole"
"""Key of the one task of a raster that is made at once."""


def terrain_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block that a facet of the terrain could reach."""
    plan, frame, share = g.plan, g.plan.meta.frame, g.plan.surface_share
    widest = full_halo(frame.counts(plan.config.max_edge))
    make = partial(
        GridBlock,
        **_tin(g),
        max_halo=widest,
        interpolation=plan.config.interpolation,
        percent=plan.config.surface_percent,
        thin=None if share is None else Lattice(frame.counts(plan.resolution / share)),
        max_points=plan.block_points,
    )
    return _block_tasks(raster, g, make, widest)


def point_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block with points, of which a pixel sees those within itself."""
    return _block_tasks(raster, g, PointsBlock, 0)


def distance_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block within reach of points; distances are capped."""
    cap = g.plan.meta.frame.counts(g.plan.config.max_edge)
    return _block_tasks(raster, g, partial(DistanceBlock, cap=cap), math.ceil(cap) + 1)


def surface_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block that a facet of the surface could reach; nowhere is it below the terrain."""
    plan, frame, pixels = g.plan, g.plan.meta.frame, reach_pixels(g.plan.resolution)
    (terrain,) = raster.inputs
    spike = plan.config.spike / frame.metres_z
    make = partial(SurfaceBlock, **_tin(g), spike=spike, reach=pixels, terrain=terrain)
    widest = full_halo(frame.counts(plan.config.max_edge))
    return _block_tasks(raster, g, make, widest + math.ceil((pixels + 1) * frame.counts(plan.resolution)))


def _tin(g: Gridding) -> dict[str, Any]:
    """What all blocks on a TIN have in common."""
    counts, plan = g.plan.meta.frame.counts, g.plan
    halo = math.ceil(counts(plan.grid_halo))
    return {"data": g.assembled.bounds, "max_edge": counts(plan.config.max_edge), "halo": halo}


def _block_tasks(raster: Raster, g: Gridding, make: Callable[..., PointsBlock], reach: int) -> Iterator[Task]:
    """One for each block within ``reach`` counts of points; it sees the same block of the raster's inputs.

    ``make`` gets name, spec, block and rule.
    """
    spec, rule = g.spec_of(raster), g.rule
    for block, near in _near(g, spec, reach).items():
        work = make(name=raster.name, spec=spec, block=block, rule=rule)
        under = [g.checksums(name, [block.name]) for name in raster.inputs]
        digest = digest_of(__version__, work, g.seen(near), under)
        yield Task(raster.stage, block.name, digest, raster.work, work, g.points(near))


def _near(g: Gridding, spec: RasterSpec, reach: int = 0) -> dict[Block, list[Cell]]:
    """Blocks within ``reach`` counts of buckets, and as far as objects erode the ground, each with these buckets."""
    reach += math.ceil(g.plan.meta.frame.counts(g.plan.config.erosion))
    return spec.blocks_near(g.plan.meta.bucket, g.labels, BLOCK_PIXELS, reach)


def survey_task(raster: Raster, g: Gridding) -> Iterator[Task]:
    """The one that makes the survey at once."""
    coarse = g.coarse
    (occupancy,) = raster.inputs
    most = float(g.plan.config.max_edge / g.coarse_m)
    work = MakeSurvey(raster.name, coarse, occupancy, float(GAP_M / g.coarse_m), most, g.spec)
    digest = digest_of(__version__, work, g.checksums(occupancy))
    yield Task(raster.stage, WHOLE, digest, raster.work, work, coarse.height * coarse.width)


def voids_task(raster: Raster, g: Gridding) -> Iterator[Task]:
    """The one that numbers the voids of a model."""
    spec = g.spec
    model, survey = raster.inputs
    work = VoidRasters(model, spec, survey, g.coarse, raster.name)
    digest = digest_of(__version__, work, g.checksums(model), g.checksums(survey))
    yield Task(raster.stage, WHOLE, digest, raster.work, work, spec.height * spec.width)


def fill_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block of a model; it depends on all blocks in which the rim of one of its voids can lie."""
    spec = g.spec
    model, survey, voids = raster.inputs
    rasters, found = VoidRasters(model, spec, survey, g.coarse, voids), g.made[voids]
    boxes = found[WHOLE][1]["voids"] if WHOLE in found else []
    voids_of: dict[str, list[int]] = defaultdict(list)
    rims: list[str] = []
    for number, runs in enumerate(found[WHOLE][1]["blocks"] if WHOLE in found else []):
        near = [block.name for block in blocks_of(runs, spec, BLOCK_PIXELS)]
        for key in near:
            voids_of[key].append(number)
        rims.append(digest_of(g.checksums(model, near)))
    surveyed, numbers = g.checksums(survey), g.checksums(voids)
    for key in sorted(voids_of.keys() | g.made[model].keys()):
        mine = voids_of.get(key, [])
        block = spec.block_named(key, BLOCK_PIXELS)
        work = FillBlock(raster.name, block, rasters, tuple(Void(n + 1, Block(*boxes[n])) for n in mine))
        seen = [g.checksums(model, [key]), surveyed, [numbers, *(rims[n] for n in mine)] if mine else []]
        digest = digest_of(__version__, work, seen)
        yield Task(raster.stage, key, digest, raster.work, work, block.height * block.width)


def outline_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block of a model, and for those of the survey that hold water."""
    model, survey = raster.inputs
    surveyed = g.checksums(survey)
    waters = g.waters if raster.name.startswith("dtm") else Waters(())
    keys = {*g.made[model]}
    if waters.bodies:
        inside = blocks_of(g.made[survey][WHOLE][1]["blocks"], g.spec, BLOCK_PIXELS)
        keys |= {block.name for block in inside if waters.near(g.spec.block_bounds(block)).bodies}
    for key in sorted(keys):
        block = g.spec.block_named(key, BLOCK_PIXELS)
        wet = waters.digest(g.spec.block_bounds(block))
        work = OutlineBlock(
            name=raster.name,
            spec=g.spec,
            block=block,
            heights=model,
            survey=survey,
            coarse=g.coarse,
            cut=g.plan.config.outline == "survey",
            waters=waters.key if wet else None,
        )
        digest = digest_of(__version__, work, g.checksums(model, [key]), surveyed, wet)
        yield Task(raster.stage, key, digest, raster.work, work, block.height * block.width)


def mask_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block that has a height, or could have one: within the survey, or where a tile failed."""
    spec, coarse, rule = g.spec, g.coarse, g.rule
    dtm, heights, survey = raster.inputs
    surveyed, near = g.checksums(survey), _near(g, spec)
    holes: dict[Block, list[Bounds]] = defaultdict(list)
    for hole in g.holes:
        for block in spec.blocks_within(hole, BLOCK_PIXELS):
            holes[block].append(hole)
    inside = blocks_of(g.made[survey][WHOLE][1]["blocks"], spec, BLOCK_PIXELS)
    made = (spec.block_named(key, BLOCK_PIXELS) for name in (dtm, heights) for key in g.made[name])
    for block in sorted({*near, *holes, *inside, *made}, key=north_west):
        work = MaskBlock(
            name=raster.name,
            spec=spec,
            block=block,
            rule=rule,
            dtm=dtm,
            filled=heights,
            survey=survey,
            coarse=coarse,
            holes=tuple(holes.get(block, ())),
            area=g.plan.area_key,
            waters=g.water_key,
        )
        wet = g.waters.digest(spec.block_bounds(block))
        rasters = [g.checksums(name, [block.name]) for name in (dtm, heights)]
        digest = digest_of(__version__, work, surveyed, rasters, g.seen(near.get(block, [])), wet)
        yield Task(raster.stage, block.name, digest, raster.work, work, block.height * block.width)


def derived_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block that all inputs have; its pixels see one pixel of the blocks around."""
    spec = g.spec
    keys = set.intersection(*(set(g.made[source]) for source in raster.inputs))
    for block in sorted((spec.block_named(key, BLOCK_PIXELS) for key in keys), key=north_west):
        work = DeriveBlock(name=raster.name, spec=spec, block=block, sources=raster.inputs, fill=raster.fill)
        digest = digest_of(
            __version__, work, [g.checksums(source, _around(block)) for source in raster.inputs]
        )
        yield Task(raster.stage, block.name, digest, raster.work, work, block.height * block.width)


def _around(block: Block) -> list[str]:
    """Names of a block and of its eight neighbours, whether or not there are such."""
    steps = (-BLOCK_PIXELS, 0, BLOCK_PIXELS)
    return [Block(block.row + down, block.col + right, 0, 0).name for down in steps for right in steps]
