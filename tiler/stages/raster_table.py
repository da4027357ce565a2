"""All rasters that a run can make, one row each; the order in which they are made follows from their inputs.

Besides the products there are rasters that only the store holds: ``occupancy`` and ``survey`` (coarse cells, see
`tiler.grid.survey`); for a model whose voids are filled ``<name>-voids`` (coarse cells: the number of the void)
and ``<name>-filled``; and ``<name>-outlined``, the model as far as the survey reaches, with level water.
"""

from __future__ import annotations

from tiler.config import NO_WATER, RunConfig
from tiler.core.products import PRODUCTS
from tiler.grid import (
    density_block,
    derive_block,
    distance_block,
    fill_block,
    find_voids,
    grid_block,
    mask_block,
    occupancy_block,
    outline_block,
    surface_block,
    survey_raster,
)
from tiler.stages.gridding import Grid, Raster
from tiler.stages.raster_tasks import (
    derived_tasks,
    distance_tasks,
    fill_tasks,
    mask_tasks,
    outline_tasks,
    point_tasks,
    surface_tasks,
    survey_task,
    terrain_tasks,
    voids_task,
)

MODELS = ("dtm", "dsm")
"""Products whose voids can be filled."""


def final(product: str, config: RunConfig) -> str:
    """The raster of the store that holds a product as people get it."""
    if product in _outlined(config):
        return f"{product}-outlined"
    return filled(product, config)


def _outlined(config: RunConfig) -> tuple[str, ...]:
    """Models that end at the outline, or hold water: only the terrain is level there."""
    if config.outline == "survey":
        return MODELS
    return () if config.water == NO_WATER else ("dtm",)


def filled(product: str, config: RunConfig) -> str:
    """The raster of the store that holds a product with its voids filled, if they are."""
    return f"{product}-filled" if product in MODELS and config.voids != "leave" else product


def raster_table(config: RunConfig) -> dict[str, Raster]:
    """All rasters that these settings allow, by name."""
    dtm, dsm = final("dtm", config), final("dsm", config)
    rows = [
        Raster("dtm", (), grid_block, Grid.PIXELS, terrain_tasks, _fill("dtm")),
        Raster("dsm", (dtm,), surface_block, Grid.PIXELS, surface_tasks, _fill("dsm")),
        Raster("ndsm", (dsm, dtm), derive_block, Grid.PIXELS, derived_tasks, _fill("ndsm")),
        Raster("hillshade", (dtm,), derive_block, Grid.PIXELS, derived_tasks, _fill("hillshade")),
        Raster("slope", (dtm,), derive_block, Grid.PIXELS, derived_tasks, _fill("slope")),
        Raster("density", (), density_block, Grid.PIXELS, point_tasks, _fill("density")),
        Raster("distance", (), distance_block, Grid.PIXELS, distance_tasks, float(config.max_edge)),
        Raster("occupancy", (), occupancy_block, Grid.COARSE, point_tasks),
        Raster("survey", ("occupancy",), survey_raster, Grid.COARSE, survey_task),
        Raster("mask", ("dtm", dtm, "survey"), mask_block, Grid.PIXELS, mask_tasks, _fill("mask")),
    ]
    for model in MODELS if config.voids != "leave" else ():
        voids = f"{model}-voids"
        rows += [
            Raster(voids, (model, "survey"), find_voids, Grid.COARSE, voids_task),
            Raster(
                filled(model, config),
                (model, "survey", voids),
                fill_block,
                Grid.PIXELS,
                fill_tasks,
                _fill(model),
            ),
        ]
    for model in _outlined(config):
        cut, whole = final(model, config), filled(model, config)
        rows.append(Raster(cut, (whole, "survey"), outline_block, Grid.PIXELS, outline_tasks, _fill(model)))
    return {row.name: row for row in rows}


def _fill(product: str) -> float:
    """The nodata value of a product; 0 where all its pixels have a value."""
    nodata = PRODUCTS[product].nodata
    return 0.0 if nodata is None else nodata


def wanted(config: RunConfig) -> list[Raster]:
    """The rasters to make, each after its inputs; the terrain is always made, and first."""
    table, found = raster_table(config), dict[str, Raster]()

    def add(name: str) -> None:
        for source in table[name].inputs:
            add(source)
        found.setdefault(name, table[name])

    for product in ("dtm", *(name for name in PRODUCTS if name in config.exported)):
        add(final(product, config))
    return list(found.values())
