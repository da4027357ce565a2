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

from tiler.config import AUTO_WATER, VOID_CANOPY, RunConfig
from tiler.core.edits import ACTIONS, OF_PIXELS
from tiler.core.nodata import NODATA
from tiler.core.products import PRODUCTS
from tiler.grid import (
    NO_PIECE,
    above_block,
    below_canopy,
    canopy_block,
    close_block,
    count_plane_rims,
    count_rims,
    crowns_block,
    density_block,
    derive_block,
    distance_block,
    fill_block,
    find_areas,
    find_planes,
    find_voids,
    finish_water,
    grid_block,
    ground_cells,
    keep_areas,
    keep_planes,
    mask_block,
    occupancy_block,
    outline_block,
    sigma_block,
    surface_block,
    survey_block,
)
from tiler.grid.tasks.gridding import Grid, RasterStep
from tiler.grid.tasks.rasters import (
    BELOW_CANOPY,
    CANOPY,
    CANOPY_CELLS,
    CANOPY_TERRAIN,
    above_tasks,
    below_canopy_tasks,
    canopy_tasks,
    canopy_terrain_tasks,
    coarse_terrain_tasks,
    derived_tasks,
    distance_tasks,
    mask_tasks,
    outline_tasks,
    point_tasks,
    sigma_tasks,
    surface_tasks,
    terrain_tasks,
)
from tiler.grid.tasks.survey import (
    domain_gaps,
    fill_tasks,
    survey_gaps,
    survey_tasks,
    voids_tasks,
)
from tiler.grid.tasks.water_search import (
    areas_tasks,
    cells_tasks,
    crowns_tasks,
    ground_tasks,
    plane_rims_tasks,
    plane_sure_tasks,
    rims_tasks,
    sure_tasks,
)

MODELS = ("dtm", "dsm")
"""Products whose voids can be filled."""
ABOVE = "dtm-above"


def final_raster(product: str, config: RunConfig) -> str:
    """Return the name of the raster that is delivered as a product."""
    if product in _outlined(config):
        return f"{product}-outlined"
    return filled_raster(product, config)


def _outlined(config: RunConfig) -> tuple[str, ...]:
    """Return the models from which a raster ``<name>-outlined`` is made.

    With ``--outline survey``, all models end at the outline of the survey. Otherwise only the
    terrain needs this raster, for level water and for canopies.
    """
    return MODELS if config.outline == "survey" else ("dtm",)


def filled_raster(product: str, config: RunConfig) -> str:
    """Return the name of the raster of a product with filled voids, or of the product if no voids are filled."""
    return f"{product}-filled" if product in MODELS and config.voids != "leave" else product


def raster_table(config: RunConfig) -> dict[str, RasterStep]:
    """Return all rasters that these settings allow, by name."""
    dtm, dsm = final_raster("dtm", config), final_raster("dsm", config)
    below = () if config.canopy == VOID_CANOPY else (BELOW_CANOPY,)
    rows = [
        RasterStep(
            "dtm",
            (),
            grid_block,
            Grid.PIXELS,
            terrain_tasks,
            _nodata("dtm"),
            edits=OF_PIXELS,
            follows_lines=True,
        ),
        RasterStep(
            "dsm", (dtm, "survey"), surface_block, Grid.PIXELS, surface_tasks, _nodata("dsm")
        ),
        RasterStep(
            "ndsm", (dsm, dtm), derive_block, Grid.PIXELS, derived_tasks, _nodata("ndsm")
        ),
        RasterStep(
            "hillshade", (dtm,), derive_block, Grid.PIXELS, derived_tasks, _nodata("hillshade")
        ),
        RasterStep("slope", (dtm,), derive_block, Grid.PIXELS, derived_tasks, _nodata("slope")),
        RasterStep("density", (), density_block, Grid.PIXELS, point_tasks, _nodata("density")),
        RasterStep(
            "distance", (), distance_block, Grid.PIXELS, distance_tasks, float(config.max_edge)
        ),
        RasterStep(ABOVE, (dtm,), above_block, Grid.PIXELS, above_tasks, edits=OF_PIXELS),
        RasterStep("occupancy", (), occupancy_block, Grid.COARSE, point_tasks),
        RasterStep(
            "survey-open", ("occupancy",), close_block, Grid.COARSE, survey_gaps, NO_PIECE
        ),
        RasterStep("survey", ("survey-open",), survey_block, Grid.COARSE, survey_tasks),
        RasterStep(CANOPY, (), canopy_block, Grid.PIXELS, canopy_tasks, NODATA),
        RasterStep(CANOPY_CELLS, (), canopy_block, Grid.CANOPY, canopy_tasks, NODATA),
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
        RasterStep(
            BELOW_CANOPY,
            ("dtm", CANOPY, CANOPY_CELLS, CANOPY_TERRAIN),
            below_canopy,
            Grid.PIXELS,
            below_canopy_tasks,
            NODATA,
        ),
        RasterStep(
            "mask",
            ("dtm", dtm, "survey", CANOPY),
            mask_block,
            Grid.PIXELS,
            mask_tasks,
            _nodata("mask"),
        ),
        RasterStep(
            "sigma",
            (dtm, "mask", *below),
            sigma_block,
            Grid.PIXELS,
            sigma_tasks,
            _nodata("sigma"),
        ),
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
                _nodata(model),
                edits=OF_PIXELS if model == "dtm" else (),
            ),
        ]
    finds_water = config.water == AUTO_WATER
    if finds_water:
        rows += _water_rows()
    for model in _outlined(config):
        # The records of the terrain also count the holes inside edits of points, not only of
        # pixels.
        edits = ACTIONS if model == "dtm" else ()
        inputs = [filled_raster(model, config), "survey"]
        if model == "dtm" and finds_water:
            inputs.append("water-cells")
        if model == "dtm":
            inputs += below or (CANOPY,)
        rows.append(
            RasterStep(
                final_raster(model, config),
                tuple(inputs),
                outline_block,
                Grid.PIXELS,
                outline_tasks,
                _nodata(model),
                edits=edits,
            )
        )
    return {row.name: row for row in rows}


def _water_rows() -> list[RasterStep]:
    """Return the steps of the search for water."""
    cells = ("occupancy", "water-ground", "domain")
    areas, planes = ("water-areas", *cells), ("water-planes", *cells)
    return [
        RasterStep(
            "domain-open", ("occupancy",), close_block, Grid.COARSE, domain_gaps, NO_PIECE
        ),
        RasterStep("domain", ("domain-open",), survey_block, Grid.COARSE, survey_tasks),
        RasterStep(
            "water-terrain",
            (),
            grid_block,
            Grid.COARSE,
            coarse_terrain_tasks,
            NODATA,
            edits=OF_PIXELS,
            follows_lines=True,
        ),
        RasterStep(
            "water-ground",
            ("dtm", "water-terrain", "occupancy"),
            ground_cells,
            Grid.COARSE,
            ground_tasks,
            NODATA,
        ),
        RasterStep("water-areas", cells, find_areas, Grid.COARSE, areas_tasks),
        RasterStep("water-rims", areas, count_rims, Grid.COARSE, rims_tasks),
        RasterStep("water-sure", ("water-rims", *areas), keep_areas, Grid.COARSE, sure_tasks),
        RasterStep("water-planes", cells, find_planes, Grid.COARSE, areas_tasks),
        RasterStep("water-plane-rims", planes, count_plane_rims, Grid.COARSE, plane_rims_tasks),
        RasterStep(
            "water-plane-sure",
            ("water-plane-rims", *planes),
            keep_planes,
            Grid.COARSE,
            plane_sure_tasks,
        ),
        RasterStep(
            "water-crowns",
            ("water-sure", "water-plane-sure", "occupancy", "water-ground"),
            crowns_block,
            Grid.COARSE,
            crowns_tasks,
        ),
        RasterStep(
            "water-cells",
            ("water-sure", "water-plane-sure", "water-crowns", *cells),
            finish_water,
            Grid.COARSE,
            cells_tasks,
        ),
    ]


def _nodata(product: str) -> float:
    """Return the nodata value of a product, or 0 if all pixels of the product have a value."""
    nodata = PRODUCTS[product].nodata
    return 0.0 if nodata is None else nodata


def required_rasters(config: RunConfig) -> list[RasterStep]:
    """Return the rasters to make, each after its inputs. The terrain and its inputs come first.

    Every run looks for places where the terrain is above all returns.
    """
    table = raster_table(config)
    steps: dict[str, RasterStep] = {}

    def add(name: str) -> None:
        for input_name in table[name].inputs:
            add(input_name)
        steps.setdefault(name, table[name])

    for product in ("dtm", *(name for name in PRODUCTS if name in config.exported)):
        add(final_raster(product, config))
    add(ABOVE)
    return list(steps.values())
