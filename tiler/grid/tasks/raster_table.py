"""Table of all rasters that a run can make. A raster is made after the rasters that are its inputs.

Besides the products there are rasters that are only in the store. Rasters of coarse cells:

- ``occupancy``: the number of points of each cell.
- ``survey-open`` and ``survey``: labels of the open areas that remain after gaps are closed, and the extent of the
  survey (see `tiler.grid.coverage`).
- ``domain-open`` and ``domain``: the same, but wider gaps are closed, because they may be water.
- ``water-...``: the steps of the search for water (`tiler.grid.water_search`, `tiler.grid.water_extent`).
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
from tiler.core.products import PRODUCTS
from tiler.grid.tasks.model_steps import canopy_steps, outline_steps, survey_steps, void_steps
from tiler.grid.tasks.product_steps import product_steps
from tiler.grid.tasks.raster_names import ABOVE, final_raster
from tiler.grid.tasks.steps import Step
from tiler.grid.tasks.terrain import TERRAIN, TERRAIN_OF_CANOPIES, TERRAIN_OF_WATER, OnTin
from tiler.grid.tasks.water_search import water_steps
from tiler.plan import Plan


def raster_table(plan: Plan) -> dict[str, OnTin | Step]:
    """Return all rasters that these settings allow, by name."""
    rows: list[OnTin | Step] = [
        TERRAIN,
        TERRAIN_OF_CANOPIES,
        *survey_steps(plan),
        *void_steps(plan),
        *canopy_steps(plan),
        *outline_steps(plan),
        *product_steps(plan),
    ]
    if plan.config.water == AUTO_WATER:
        rows += [TERRAIN_OF_WATER, *water_steps(plan)]
    return {row.name: row for row in rows}


def required_rasters(plan: Plan) -> list[OnTin | Step]:
    """Return the rasters to make, each after its inputs. The terrain and its inputs come first.

    Every run looks for places where the terrain is above all returns.
    """
    config, table = plan.config, raster_table(plan)
    steps: dict[str, OnTin | Step] = {}

    def add(name: str) -> None:
        for input_name in table[name].inputs:
            add(input_name)
        steps.setdefault(name, table[name])

    for product in ("dtm", *(name for name in PRODUCTS if name in config.exported)):
        add(final_raster(product, config))
    add(ABOVE)
    return list(steps.values())
