"""Table of all rasters that a run can make, with the rows that are steps, but those of water.

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
- ``dtm-left``: no pixels, but the objects that are probably left in the terrain, and the places where it is unsure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction

import numpy as np

from ptd.matched.cells import CELL_M
from tiler.config import AUTO_WATER, VOID_CANOPY
from tiler.core.products import MASK_VALUES, MODELS, OUTSIDE, PRODUCTS, Read
from tiler.core.raster import BLOCK_PIXELS, Block
from tiler.core.records import digest_of
from tiler.core.results import SurfaceResult
from tiler.grid import derived
from tiler.grid.block import full_halo
from tiler.grid.block_surroundings import reach_pixels
from tiler.grid.canopy import below_canopy, canopy, canopy_reach, crowns_margin
from tiler.grid.coarse import Runs, blocks_of
from tiler.grid.coverage import NO_PIECE, margin_of, occupancy, open_areas, survey
from tiler.grid.derived import (
    distance,
    mask,
    outline,
    surface,
)
from tiler.grid.flaws import ABOVE_M, above, min_pixels
from tiler.grid.left_objects import left_margin, left_objects
from tiler.grid.sigma import land_margin, reach_of, sigma, sigma_result
from tiler.grid.steps import Counts
from tiler.grid.tasks.findings import report_above, report_implausible
from tiler.grid.tasks.gridding import (
    ABOVE,
    BELOW_CANOPY,
    CANOPY,
    CANOPY_CELLS,
    CANOPY_TERRAIN,
    GAP_M,
    LEFT,
    Grid,
    GridContext,
    canopy_cell_m,
    coarse_cell_m,
    nodata_of,
)
from tiler.grid.tasks.left_objects import report_left_objects, report_unsure
from tiler.grid.tasks.steps import (
    NONE,
    Near,
    Step,
    Values,
    all_of,
    any_of,
    block_names,
    blocks_with,
    enclosed_by_survey,
    near_blocks,
)
from tiler.grid.tasks.terrain import TERRAIN, TERRAIN_OF_CANOPIES, TERRAIN_OF_WATER, OnTin
from tiler.grid.tasks.water_search import water_steps
from tiler.grid.unsure_terrain import SEARCHES
from tiler.grid.voids import Void, fill_voids, find_voids
from tiler.plan import Plan
from tiler.runs.found import filled_raster, final_raster, outlined_models
from tiler.runs.job import Job

OfBlocks = Mapping[Block, Counts]


def raster_table(plan: Plan) -> dict[str, OnTin | Step]:
    """Return all rasters that these settings allow, by name."""
    rows: list[OnTin | Step] = [
        TERRAIN,
        TERRAIN_OF_CANOPIES,
        *_survey_steps(plan),
        *_void_steps(plan),
        *_canopy_steps(plan),
        *_outline_steps(plan),
        *_product_steps(plan),
        *(_step_of(name, plan) for name in PRODUCTS if PRODUCTS[name].reads),
    ]
    if plan.config.water == AUTO_WATER:
        rows += [TERRAIN_OF_WATER, *water_steps(plan)]
    return {row.name: row for row in rows}


def required_rasters(plan: Plan) -> list[OnTin | Step]:
    """Return the rasters to make, each after its inputs. The terrain and its inputs come first.

    Every run looks for places where the terrain is above all returns, for objects that are left in it, and for
    places where it is unsure.
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
    add(LEFT)
    return list(steps.values())


def _step_of(name: str, plan: Plan) -> Step:
    """Return the step of a product whose row (`tiler.core.products`) says what it reads."""
    reads = {
        argument: Read(f"raster:{final_raster(read.raster, plan.config)}", read.margin)
        if read.kind == "delivered"
        else read
        for argument, read in PRODUCTS[name].reads.items()
    }
    held = [argument for argument, read in reads.items() if read.kind in ("raster", "points")]
    return Step(name, getattr(derived, name), reads, all_of(*held), fill=nodata_of(name))


def _product_steps(plan: Plan) -> list[Step]:
    """Return the steps of the products whose reads depend on the settings, and of the check of the terrain."""
    config, frame, pixel_m = plan.config, plan.frame, plan.grid.resolution
    dtm = final_raster("dtm", config)
    terrain, rim, survey = Read(f"raster:{dtm}"), Read(f"raster:{dtm}", 1), Read("cells:survey")
    points, waters = Read("points"), Read("waters")
    reach, land = reach_pixels(pixel_m), land_margin(float(pixel_m))
    left = left_margin(float(pixel_m))
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
            {"least": min_pixels(pixel_m**2), "above_m": ABOVE_M, **support},
            _above_found,
        ),
        Step(
            LEFT,
            left_objects,
            {
                "points": Read("points", math.ceil(left * size)),
                "terrain": Read(f"raster:{dtm}", left),
                "kind": Read("kind"),
            },
            _of_searched_kinds,
            {"margin": left},
            _left_found,
            # Of small pixels, the land around is wider than a block.
            side=2 * BLOCK_PIXELS if 2 * left > BLOCK_PIXELS else BLOCK_PIXELS,
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
    job.results.dsm = SurfaceResult(
        filled=context.delivered_heights("dsm"),
        measured=sum(counts["measured"] for counts in of_blocks.values()),
    )


def _above_found(job: Job, context: GridContext, of_blocks: OfBlocks) -> None:
    report_above(job, context.spec, of_blocks)
    report_implausible(job, context.spec, of_blocks.values())


def _of_searched_kinds(step: Step, context: GridContext, near: Near) -> Mapping[Block, Values]:
    """Return the blocks with a terrain if the kind of the cloud is known."""
    return all_of("terrain")(step, context, near) if context.kind in SEARCHES else {}


def _left_found(job: Job, context: GridContext, of_blocks: OfBlocks) -> None:
    objects = report_left_objects(job, context.spec, of_blocks)
    report_unsure(job, context.spec, of_blocks, objects)


def _mask_found(job: Job, context: GridContext, of_blocks: OfBlocks) -> None:
    totals = np.sum([counts["values"] for counts in of_blocks.values()], axis=0).tolist()
    totals[OUTSIDE] += context.spec.height * context.spec.width - sum(totals)
    job.results.mask = {
        text.split(":")[0]: totals[value] for value, text in MASK_VALUES.items()
    }


def _sigma_found(job: Job, context: GridContext, of_blocks: OfBlocks) -> None:
    job.results.sigma = sigma_result(context.kind, list(of_blocks.values()))


SEARCHED = "domain"
"""Name of the survey with gaps as wide as ``--max-edge``, which may be water."""


def _survey_steps(plan: Plan) -> list[Step]:
    """Return the steps that find the extent of the survey, and of the domain in which water is searched."""
    max_gap = float(plan.config.max_edge / coarse_cell_m(plan))
    usual = min(float(GAP_M / coarse_cell_m(plan)), max_gap)
    steps = [
        Step(
            "occupancy",
            occupancy,
            {"points": Read("points")},
            all_of("points"),
            fill=0.0,
            grid=Grid.COARSE,
        )
    ]
    names = ("survey", SEARCHED) if plan.config.water == AUTO_WATER else ("survey",)
    for name in names:
        gap = usual if name == "survey" else max_gap
        steps += [
            Step(
                f"{name}-open",
                open_areas,
                {"occupancy": Read("numbers:occupancy", margin_of(max_gap))},
                _near_points,
                {"gap": gap, "max_gap": max_gap, "marks_bare": name == "survey"},
                fill=NO_PIECE,
                grid=Grid.COARSE,
            ),
            Step(
                name,
                survey,
                {
                    "opened": Read(f"raster:{name}-open", 1),
                    "place": Read("place"),
                    "products": Read("products"),
                },
                enclosed_by_survey,
                fill=0.0,
                grid=Grid.COARSE,
            ),
        ]
    return steps


def _near_points(step: Step, context: GridContext, _: Near) -> Mapping[Block, Values]:
    """Return the blocks that gaps can extend into. Without a search for water the domain has none."""
    if step.name.startswith(SEARCHED) and not context.water_is_sought:
        return {}
    reach_blocks = math.ceil((step.values["max_gap"] + 2) / BLOCK_PIXELS)
    with_points = context.places_with("occupancy", "filled")
    return dict.fromkeys(near_blocks(context.coarse, with_points, reach_blocks), NONE)


def _void_steps(plan: Plan) -> list[Step]:
    """Return the steps that find and fill the voids of models inside the survey."""
    config, steps = plan.config, list[Step]()
    # Half a pixel is less: the centre of a pixel that touches a block lies in the margin.
    margin = math.floor(plan.grid.resolution / coarse_cell_m(plan))
    for model in MODELS if config.voids != "leave" else ():
        voids, heights = f"{model}-voids", Read(f"pixels:{model}")
        steps += [
            Step(
                voids,
                find_voids,
                {
                    "heights": heights,
                    "survey": Read("numbers:survey", margin),
                    "place": Read("place"),
                },
                blocks_with("survey", "inside"),
                fill=0.0,
                grid=Grid.COARSE,
            ),
            Step(
                filled_raster(model, config),
                fill_voids,
                {
                    "heights": heights,
                    "cells": Read(f"coarse:{voids}"),
                    "place": Read("place"),
                },
                _with_voids,
                fill=nodata_of(model),
            ),
        ]
    return steps


def _with_voids(step: Step, context: GridContext, _: Near) -> Mapping[Block, Values]:
    """Return the blocks of a model and those near its voids, each with the voids near it."""
    spec, (model, voids) = context.spec, step.inputs
    found = context.counts_at(voids)
    near: dict[str, list[Void]] = {key: [] for key in context.made[model]}
    for pieces in context.areas(voids, corners=True).areas.values():
        runs: Runs = []
        for piece in pieces:
            runs += found[piece.row, piece.col]["blocks"][piece.label - 1]
        keys = sorted({block.name for block in blocks_of(runs, spec, BLOCK_PIXELS)})
        places = block_names(sorted({(piece.row, piece.col) for piece in pieces}))
        around = digest_of(context.checksums(model, keys), context.checksums(voids, places))
        for key in keys:
            near.setdefault(key, []).append(Void(pieces, around))
    return {
        spec.block_named(key, BLOCK_PIXELS): {"voids": tuple(of_block)}
        for key, of_block in near.items()
    }


def _canopy_steps(plan: Plan) -> list[Step]:
    """Return the steps that find crowns that hide the ground, and the terrain below them."""
    frame, side = plan.frame, plan.frame.counts(Fraction(repr(CELL_M)))
    reads = {
        "cells": Read("canopy", canopy_reach(side, frame.metres_xy)),
        "points": Read("points"),
        "place": Read("place"),
    }
    margin = crowns_margin(float(canopy_cell_m(plan)))
    return [
        Step(CANOPY, canopy, reads, all_of("cells"), {"side": side}),
        Step(CANOPY_CELLS, canopy, reads, all_of("cells"), {"side": side}, grid=Grid.CANOPY),
        Step(
            BELOW_CANOPY,
            below_canopy,
            {
                "terrain": Read("raster:dtm"),
                "canopy": Read(f"raster:{CANOPY}"),
                "crowns": Read(f"canopy-grid:{CANOPY_CELLS}", margin),
                "bridge": Read(f"canopy-grid:{CANOPY_TERRAIN}", margin),
                "place": Read("place"),
            },
            blocks_with(CANOPY, "filled", Grid.PIXELS),
        ),
    ]


def _outline_steps(plan: Plan) -> list[Step]:
    """Return the steps that end models at the outline of the survey. The terrain gets level water and canopies."""
    config, steps = plan.config, []
    values = {"cut": config.outline == "survey", "finds_water": config.water == AUTO_WATER}
    usual = {"survey": Read("cells:survey", 1), "area": Read("area", 1), "edits": Read("edits")}
    for model in outlined_models(config):
        reads = {"heights": Read(f"raster:{filled_raster(model, config)}"), **usual}
        over = all_of("heights")
        if model == "dtm":
            cells = ":water-cells" if config.water == AUTO_WATER else ""
            reads["waters"] = Read(f"waters{cells}")
            if config.canopy == VOID_CANOPY:
                reads["canopy"] = Read(f"raster:{CANOPY}")
            else:
                reads["below"] = Read(f"raster:{BELOW_CANOPY}")
            # Blocks inside the survey without heights are voids.
            over = any_of("heights", "survey", *reads.keys() & {"below"})
        steps.append(Step(final_raster(model, config), outline, reads, over, values))
    return steps
