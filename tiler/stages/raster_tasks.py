"""How the making of each raster is divided into tasks, and what their digests depend on; see `tiler.stages.tasks`."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator

from tiler.core.lattice import Bounds, Cell
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec, north_west
from tiler.core.water import Waters
from tiler.grid import (
    DeriveBlock,
    DistanceBlock,
    FillBlock,
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
from tiler.stages.tasks import area_key, grid_tasks, ground_rule
from tiler.store import Commits
from tiler.version import __version__

WHOLE = "whole"
"""Key of the one task of a raster that is made at once."""


def _near(g: Gridding, spec: RasterSpec, reach: int = 0) -> dict[Block, list[Cell]]:
    """Blocks within ``reach`` counts of buckets, each with these."""
    return spec.blocks_near(g.plan.meta.bucket, g.labels, BLOCK_PIXELS, reach)


def terrain_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block that a facet of the terrain could reach."""
    return grid_tasks(g.plan, g.assembled, g.labels, raster.name)


def point_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block with points, of which a pixel sees those within itself."""
    spec, rule = g.spec_of(raster), ground_rule(g.plan)

    def work(block: Block) -> PointsBlock:
        return PointsBlock(name=raster.name, spec=spec, block=block, rule=rule)

    return _block_tasks(raster, g, work, 0)


def distance_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block within reach of points; distances are capped."""
    spec, rule, cap = g.spec, ground_rule(g.plan), g.plan.meta.frame.counts(g.plan.config.max_edge)

    def work(block: Block) -> DistanceBlock:
        return DistanceBlock(name=raster.name, spec=spec, block=block, rule=rule, cap=cap)

    return _block_tasks(raster, g, work, math.ceil(cap) + 1)


def surface_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block that a facet of the surface could reach; nowhere is it below the terrain."""
    plan, frame = g.plan, g.plan.meta.frame
    limit, reach = frame.counts(plan.config.max_edge), reach_pixels(plan.resolution)
    (terrain,) = raster.inputs
    spec, rule, data = g.spec, ground_rule(plan), g.assembled.bounds
    halo, spike = math.ceil(frame.counts(plan.grid_halo)), plan.config.spike / frame.metres_z

    def work(block: Block) -> SurfaceBlock:
        return SurfaceBlock(
            name=raster.name,
            spec=spec,
            block=block,
            rule=rule,
            data=data,
            max_edge=limit,
            halo=halo,
            spike=spike,
            reach=reach,
            terrain=terrain,
        )

    return _block_tasks(
        raster, g, work, full_halo(limit) + math.ceil((reach + 1) * frame.counts(plan.resolution))
    )


def _block_tasks(
    raster: Raster, g: Gridding, work_of: Callable[[Block], PointsBlock], reach: int
) -> Iterator[Task]:
    """One for each block within ``reach`` counts of points; it sees the same block of the raster's inputs."""
    reach += math.ceil(g.plan.meta.frame.counts(g.plan.config.erosion))
    for block, near in _near(g, g.spec_of(raster), reach).items():
        work = work_of(block)
        under = [
            g.made[name][block.name][1]["checksum"] for name in raster.inputs if block.name in g.made[name]
        ]
        seen = [[cell.ix, cell.iy, g.labels[cell]] for cell in near]
        points = sum(g.assembled.records[cell]["n"] for cell in near)
        yield Task(
            raster.stage, block.name, digest_of(__version__, work, seen, under), raster.work, work, points
        )


def survey_task(raster: Raster, g: Gridding) -> Iterator[Task]:
    """The one that makes the survey at once."""
    coarse = g.coarse
    (occupancy,) = raster.inputs
    most = float(g.plan.config.max_edge / g.coarse_m)
    work = MakeSurvey(raster.name, coarse, occupancy, float(GAP_M / g.coarse_m), most, g.spec)
    digest = digest_of(__version__, work, checksums(g.made[occupancy]))
    yield Task(raster.stage, WHOLE, digest, raster.work, work, coarse.height * coarse.width)


def voids_task(raster: Raster, g: Gridding) -> Iterator[Task]:
    """The one that numbers the voids of a model."""
    spec = g.spec
    model, survey = raster.inputs
    work = VoidRasters(model, spec, survey, g.coarse, raster.name)
    digest = digest_of(__version__, work, checksums(g.made[model]), checksums(g.made[survey]))
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
        rims.append(
            digest_of([[key, g.made[model][key][1]["checksum"]] for key in near if key in g.made[model]])
        )
    surveyed, numbers = checksums(g.made[survey]), checksums(found)
    for key in sorted(voids_of.keys() | g.made[model].keys()):
        mine = voids_of.get(key, [])
        own = g.made[model][key][1]["checksum"] if key in g.made[model] else None
        block = spec.block_named(key, BLOCK_PIXELS)
        work = FillBlock(raster.name, block, rasters, tuple(Void(n + 1, Block(*boxes[n])) for n in mine))
        seen = [own, surveyed, [numbers, *(rims[n] for n in mine)] if mine else []]
        digest = digest_of(__version__, work, seen)
        yield Task(raster.stage, key, digest, raster.work, work, block.height * block.width)


def outline_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block of a model, and for those of the survey that hold water."""
    model, survey = raster.inputs
    made, surveyed = g.made[model], checksums(g.made[survey])
    waters = g.waters if raster.name.startswith("dtm") else Waters(())
    keys = {*made}
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
        own = made[key][1]["checksum"] if key in made else None
        digest = digest_of(__version__, work, own, surveyed, wet)
        yield Task(raster.stage, key, digest, raster.work, work, block.height * block.width)


def mask_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block that has a height, or could have one: within the survey, or where a tile failed."""
    spec, coarse, rule, area = g.spec, g.coarse, ground_rule(g.plan), area_key(g.plan)
    dtm, heights, survey = raster.inputs
    surveyed = checksums(g.made[survey])
    near = _near(g, spec, math.ceil(g.plan.meta.frame.counts(g.plan.config.erosion)))
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
            area=area,
            waters=g.waters.key if g.waters.bodies else None,
        )
        wet = g.waters.digest(spec.block_bounds(block))
        rasters = [
            g.made[name][block.name][1]["checksum"] for name in (dtm, heights) if block.name in g.made[name]
        ]
        seen = [[cell.ix, cell.iy, g.labels[cell]] for cell in near.get(block, [])]
        digest = digest_of(__version__, work, surveyed, rasters, seen, wet)
        yield Task(raster.stage, block.name, digest, raster.work, work, block.height * block.width)


def derived_tasks(raster: Raster, g: Gridding) -> Iterator[Task]:
    """One for each block that all inputs have; its pixels see one pixel of the blocks around."""
    spec = g.spec
    keys = set.intersection(*(set(g.made[source]) for source in raster.inputs))
    for block in sorted((spec.block_named(key, BLOCK_PIXELS) for key in keys), key=north_west):
        work = DeriveBlock(name=raster.name, spec=spec, block=block, sources=raster.inputs, fill=raster.fill)
        digest = digest_of(__version__, work, [_around(g.made[source], block) for source in raster.inputs])
        yield Task(raster.stage, block.name, digest, raster.work, work, block.height * block.width)


def checksums(commits: Commits) -> list[list[str]]:
    """Name and checksum of each block of a raster."""
    return [[key, record["checksum"]] for key, (_, record) in sorted(commits.items())]


def _around(commits: Commits, block: Block) -> list[list[str]]:
    """Checksums of a block and of its eight neighbours."""
    near = [
        Block(block.row + down, block.col + right, 0, 0).name
        for down in (-BLOCK_PIXELS, 0, BLOCK_PIXELS)
        for right in (-BLOCK_PIXELS, 0, BLOCK_PIXELS)
    ]
    return [[key, commits[key][1]["checksum"]] for key in near if key in commits]
