"""Table of all rasters that a run can make, with the rows of the products.

A raster is made after the rasters that are its inputs.

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

import math
from collections.abc import Mapping

import numpy as np

from tiler.config import AUTO_WATER, VOID_CANOPY
from tiler.core.mask_values import MASK_VALUES, OUTSIDE
from tiler.core.products import PRODUCTS
from tiler.core.raster import Block
from tiler.core.records import records_of
from tiler.core.terrain_results import SurfaceResult
from tiler.grid.block import full_halo
from tiler.grid.block_surroundings import reach_pixels
from tiler.grid.derived import (
    density,
    distance,
    height_above_ground,
    hillshade,
    mask,
    slope,
    surface,
)
from tiler.grid.flaws import above, min_pixels
from tiler.grid.records import BlockRecord
from tiler.grid.sigma import land_margin, reach_of, sigma, sigma_result
from tiler.grid.steps import Counts, Read
from tiler.grid.tasks.findings import report_above, report_implausible
from tiler.grid.tasks.gridding import (
    ABOVE,
    BELOW_CANOPY,
    CANOPY,
    GridContext,
    final_raster,
)
from tiler.grid.tasks.model_steps import canopy_steps, outline_steps, survey_steps, void_steps
from tiler.grid.tasks.steps import Step, all_of, any_of
from tiler.grid.tasks.terrain import TERRAIN, TERRAIN_OF_CANOPIES, TERRAIN_OF_WATER, OnTin
from tiler.grid.tasks.water_search import water_steps
from tiler.plan import Plan
from tiler.runs.job import Job

OfBlocks = Mapping[Block, Counts]


def raster_table(plan: Plan) -> dict[str, OnTin | Step]:
    """Return all rasters that these settings allow, by name."""
    rows: list[OnTin | Step] = [
        TERRAIN,
        TERRAIN_OF_CANOPIES,
        *survey_steps(plan),
        *void_steps(plan),
        *canopy_steps(plan),
        *outline_steps(plan),
        *_product_steps(plan),
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


def _product_steps(plan: Plan) -> list[Step]:
    """Return the steps of all products but the terrain, and of the check of the terrain."""
    config, frame, pixel_m = plan.config, plan.frame, plan.grid.resolution
    dtm, dsm = final_raster("dtm", config), final_raster("dsm", config)
    terrain, rim, survey = Read(f"raster:{dtm}"), Read(f"raster:{dtm}", 1), Read("cells:survey")
    points, waters = Read("points"), Read("waters")
    # Plan and heights may have different units.
    pixel = {"pixel": float(pixel_m / frame.units.vertical)}
    reach, land = reach_pixels(pixel_m), land_margin(float(pixel_m))
    support = {"reach": reach, "spike": config.spike / frame.metres_z}
    size, cap = frame.counts(pixel_m), frame.counts(config.max_edge)
    facets_near = full_halo(cap) + math.ceil((reach + 1) * size)
    below = {} if config.canopy == VOID_CANOPY else {"below": Read(f"raster:{BELOW_CANOPY}")}
    return [
        Step(
            "dsm",
            surface,
            {
                "points": Read(f"points:{dtm}", facets_near),
                "terrain": terrain,
                "survey": survey,
                "waters": waters,
                "facets": Read("facets"),
            },
            all_of("points"),
            support,
            _surface_found,
        ),
        Step(
            "ndsm",
            height_above_ground,
            {"surface": Read(f"raster:{dsm}"), "terrain": terrain},
            all_of("surface", "terrain"),
        ),
        Step("hillshade", hillshade, {"terrain": rim}, all_of("terrain"), pixel, fill=0.0),
        Step("slope", slope, {"terrain": rim}, all_of("terrain"), pixel),
        Step(
            "density",
            density,
            {"points": points},
            all_of("points"),
            {"pixel_m2": float(pixel_m**2)},
            fill=0.0,
        ),
        Step(
            "distance",
            distance,
            {"points": Read("points", math.ceil(cap) + 1)},
            all_of("points"),
            {"cap": cap},
            fill=float(config.max_edge),
        ),
        Step(
            ABOVE,
            above,
            {
                "points": Read(f"points:{dtm}", math.ceil(reach * size)),
                "terrain": rim,
                "waters": waters,
                "edits": Read("edits"),
            },
            all_of("points"),
            {"least": min_pixels(pixel_m**2), **support},
            _above_found,
        ),
        Step(
            "mask",
            mask,
            {
                "terrain": Read("raster:dtm"),
                "delivered": terrain,
                "canopy": Read(f"raster:{CANOPY}"),
                "survey": survey,
                "points": points,
                "waters": waters,
                "failed": Read("failed"),
                "area": Read("area"),
            },
            any_of("points", "terrain", "delivered", "survey", "failed"),
            finish=_mask_found,
            fill=OUTSIDE,
        ),
        Step(
            "sigma",
            sigma,
            {
                "points": Read("points", reach_of(frame, size, cap)),
                "terrain": Read(f"raster:{dtm}", land),
                "mask": Read("raster:mask"),
                "kind": Read("kind"),
                **below,
            },
            all_of("terrain"),
            {"margin": land, "cap": cap},
            _sigma_found,
        ),
    ]


def _surface_found(job: Job, context: GridContext, of_blocks: OfBlocks) -> None:
    delivered = context.made[final_raster("dsm", job.plan.config)]
    job.results.dsm = SurfaceResult(
        filled=sum(record.filled for record in records_of(BlockRecord, delivered)),
        measured=sum(counts["measured"] for counts in of_blocks.values()),
    )


def _above_found(job: Job, context: GridContext, of_blocks: OfBlocks) -> None:
    report_above(job, context.spec, of_blocks)
    report_implausible(job, context.spec, of_blocks.values())


def _mask_found(job: Job, context: GridContext, of_blocks: OfBlocks) -> None:
    totals = np.sum([counts["values"] for counts in of_blocks.values()], axis=0).tolist()
    totals[OUTSIDE] += context.spec.height * context.spec.width - sum(totals)
    job.results.mask = {
        text.split(":")[0]: totals[value] for value, text in MASK_VALUES.items()
    }


def _sigma_found(job: Job, context: GridContext, of_blocks: OfBlocks) -> None:
    job.results.sigma = sigma_result(context.kind, list(of_blocks.values()))
