"""Table of all rasters that a run can make. A raster is made after the rasters that are its inputs.

Besides the products there are rasters that are only in the store. Rasters of coarse cells:

- ``occupancy``: the number of points of each cell.
- ``survey-open`` and ``survey``: labels of the open areas that remain after gaps are closed, and the extent of the
  survey (see `tiler.grid.coverage`).
- ``domain-open`` and ``domain``: the same, but wider gaps are closed, because they may be water.
- ``water-...``: the steps of the search for water (`tiler.grid.water_search`, `tiler.grid.water_finish`).
  ``water-sure`` and ``water-plane-sure`` are confidences. ``water-rims`` and ``water-plane-rims`` have no cells, but a
  record for each block.
- ``<name>-voids``: the voids of a model that are to be filled.

Rasters of cells of canopies: ``canopy-cells`` and ``canopy-terrain``, the crowns where they hide the ground, and the
terrain around, interpolated.

Rasters of pixels:

- ``<name>-filled``: a model with filled voids.
- ``<name>-outlined``: a model that ends at the outline of the survey, with level water.
- ``canopy``: the crowns where they hide the ground, and ``canopy-below``: the terrain there.
- ``dtm-above``: no pixels, but a record for each block of where the terrain lies above all returns.
"""

from __future__ import annotations

from tiler.config import AUTO_WATER
from tiler.core.edits import OF_PIXELS
from tiler.core.nodata import NODATA
from tiler.core.products import PRODUCTS
from tiler.grid import (
    fill_block,
    find_voids,
    grid_block,
)
from tiler.grid.tasks.gridding import Grid, RasterStep
from tiler.grid.tasks.model_steps import canopy_steps, outline_steps, survey_steps
from tiler.grid.tasks.product_steps import product_steps
from tiler.grid.tasks.raster_names import (
    ABOVE,
    CANOPY_CELLS,
    CANOPY_TERRAIN,
    MODELS,
    filled_raster,
    final_raster,
    nodata_of,
)
from tiler.grid.tasks.rasters import (
    canopy_terrain_tasks,
    coarse_terrain_tasks,
    terrain_tasks,
)
from tiler.grid.tasks.steps import Step
from tiler.grid.tasks.survey import (
    fill_tasks,
    voids_tasks,
)
from tiler.grid.tasks.water_search import water_steps
from tiler.plan import Plan


def raster_table(plan: Plan) -> dict[str, RasterStep | Step]:
    """Return all rasters that these settings allow, by name."""
    config = plan.config
    rows: list[RasterStep | Step] = [
        RasterStep(
            "dtm",
            (),
            grid_block,
            Grid.PIXELS,
            terrain_tasks,
            nodata_of("dtm"),
            edits=OF_PIXELS,
            follows_lines=True,
        ),
        *survey_steps(plan),
        *canopy_steps(plan),
        RasterStep(
            CANOPY_TERRAIN,
            (CANOPY_CELLS,),
            grid_block,
            Grid.CANOPY,
            canopy_terrain_tasks,
            NODATA,
            edits=OF_PIXELS,
            follows_lines=True,
        ),
        *outline_steps(plan),
        *product_steps(plan),
    ]
    for model in MODELS if config.voids != "leave" else ():
        voids = f"{model}-voids"
        rows += [
            RasterStep(voids, (model, "survey"), find_voids, Grid.COARSE, voids_tasks),
            RasterStep(
                filled_raster(model, config),
                (model, "survey", voids),
                fill_block,
                Grid.PIXELS,
                fill_tasks,
                nodata_of(model),
                edits=OF_PIXELS if model == "dtm" else (),
            ),
        ]
    if config.water == AUTO_WATER:
        rows += water_steps(plan)
        rows.append(
            RasterStep(
                "water-terrain",
                (),
                grid_block,
                Grid.COARSE,
                coarse_terrain_tasks,
                NODATA,
                edits=OF_PIXELS,
                follows_lines=True,
            )
        )
    return {row.name: row for row in rows}


def required_rasters(plan: Plan) -> list[RasterStep | Step]:
    """Return the rasters to make, each after its inputs. The terrain and its inputs come first.

    Every run looks for places where the terrain is above all returns.
    """
    config, table = plan.config, raster_table(plan)
    steps: dict[str, RasterStep | Step] = {}

    def add(name: str) -> None:
        for input_name in table[name].inputs:
            add(input_name)
        steps.setdefault(name, table[name])

    for product in ("dtm", *(name for name in PRODUCTS if name in config.exported)):
        add(final_raster(product, config))
    add(ABOVE)
    return list(steps.values())
