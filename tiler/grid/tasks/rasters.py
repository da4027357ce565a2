"""Tasks of the rasters that are interpolated on the TIN of the ground, one per block."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

from tiler.core.lattice import Lattice
from tiler.grid import GridBlock, full_halo
from tiler.grid.records import BlockRecord
from tiler.grid.tasks.gridding import GridContext, Place, RasterStep
from tiler.grid.tasks.survey import near_places
from tiler.schedule import Task


def terrain_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block that a facet of the terrain could reach."""
    plan, share = context.plan, context.plan.surface_cells
    thin = None if share is None else Lattice(plan.frame.counts(plan.grid.resolution / share))
    return _on_tin(raster, context, None, thin=thin, interpolation=plan.config.interpolation)


def coarse_terrain_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield the tasks of the terrain in coarse cells, which the search for water needs if pixels are larger."""
    return terrain_tasks(raster, context) if context.water_is_sought else iter(())


def canopy_terrain_tasks(raster: RasterStep, context: GridContext) -> Iterator[Task]:
    """Yield a task for each block of cells that a facet of the terrain near a canopy could reach."""
    cells, records = context.canopy_cells, context.records(raster.inputs[0], BlockRecord)
    places = near_places(cells, [at for at, record in records.items() if record.filled])
    return _on_tin(raster, context, set(places), thin=cells.lattice)


def _on_tin(
    raster: RasterStep, context: GridContext, places: Collection[Place] | None, **values: Any
) -> Iterator[Task]:
    """Yield a task for each block within the reach of a facet, or only for those at some places."""
    plan, facets, spec, rule = (
        context.plan, context.facets, context.spec_of(raster.grid), context.rule
    )  # fmt: skip
    widest = full_halo(facets.max_edge)
    for block, near in context.near(spec, widest).items() if places != set() else ():
        if places is not None and (block.row, block.col) not in places:
            continue
        work = GridBlock(
            name=raster.name,
            spec=spec,
            block=block,
            rule=rule,
            data=facets.data,
            max_edge=facets.max_edge,
            halo=facets.halo,
            max_halo=widest,
            percent=plan.config.surface_percent,
            max_points=plan.block_points,
            breaklines=context.corrections.lines_key,
            **values,
        )
        yield context.block_task(
            raster, work, context.label_digests(near), points=context.n_points(near)
        )
