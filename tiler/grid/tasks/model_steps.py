"""Steps between the terrain and its delivered model: the survey, voids, canopies, and the outline."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction

from ptd.matched.cells import CELL_M
from tiler.config import AUTO_WATER, VOID_CANOPY
from tiler.core.digests import digest_of
from tiler.core.raster import BLOCK_PIXELS, Block
from tiler.grid.canopy import below_canopy, canopy, canopy_reach, crowns_margin
from tiler.grid.coarse import Runs, blocks_of
from tiler.grid.coverage import NO_PIECE, margin_of, occupancy, open_areas, survey
from tiler.grid.derived import outline
from tiler.grid.steps import Read
from tiler.grid.tasks.gridding import (
    BELOW_CANOPY,
    CANOPY,
    CANOPY_CELLS,
    CANOPY_TERRAIN,
    GAP_M,
    MODELS,
    Grid,
    GridContext,
    canopy_cell_m,
    coarse_cell_m,
    filled_raster,
    final_raster,
    nodata_of,
    outlined_models,
)
from tiler.grid.tasks.steps import (
    NONE,
    Near,
    Step,
    Values,
    all_of,
    any_of,
    block_names,
    enclosed_by,
    near_points,
)
from tiler.grid.voids import Void, fill_voids, find_voids
from tiler.plan import Plan

SEARCHED = "domain"
"""Name of the survey with gaps as wide as ``--max-edge``, which may be water."""


def survey_steps(plan: Plan) -> list[Step]:
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
                _enclosed,
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
    return dict.fromkeys(near_points(context, "occupancy", reach_blocks), NONE)


def _enclosed(step: Step, context: GridContext, _: Near) -> Mapping[Block, Values]:
    return enclosed_by(context, step.inputs[0])


def void_steps(plan: Plan) -> list[Step]:
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
                _inside_survey,
                fill=0.0,
                grid=Grid.COARSE,
            ),
            Step(
                filled_raster(model, config),
                fill_voids,
                {
                    "heights": heights,
                    "cells": Read(f"coarse:{voids}"),
                    "edits": Read("edits"),
                    "place": Read("place"),
                },
                _with_voids,
                fill=nodata_of(model),
            ),
        ]
    return steps


def _inside_survey(_: Step, context: GridContext, __: Near) -> Mapping[Block, Values]:
    found = context.counts("survey").items()
    return {block: NONE for block, counts in found if counts["inside"]}


def _with_voids(step: Step, context: GridContext, _: Near) -> Mapping[Block, Values]:
    """Return the blocks of a model and those near its voids, each with the voids near it."""
    spec, (model, voids) = context.spec, step.inputs
    found = {(block.row, block.col): counts for block, counts in context.counts(voids).items()}
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


def canopy_steps(plan: Plan) -> list[Step]:
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
            _with_canopy,
        ),
    ]


def _with_canopy(_: Step, context: GridContext, __: Near) -> Mapping[Block, Values]:
    """Return the blocks with a canopy."""
    found = context.counts(CANOPY, Grid.PIXELS).items()
    return {block: NONE for block, counts in found if counts["filled"]}


def outline_steps(plan: Plan) -> list[Step]:
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
