"""Tasks that write vector files: outline of the survey, bridges, bodies of water, contours and spot heights."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from tiler.core.drawn_sheets import StoredAreas
from tiler.core.file_names import validate_distinct_names
from tiler.core.lattice import Bounds
from tiler.core.products import CONTOURS
from tiler.core.raster import BLOCK_PIXELS
from tiler.export.contours import (
    Heights,
    SheetPart,
    contours_reach,
    spots_reach,
    write_contours,
    write_spots,
)
from tiler.export.output_files import OutFile
from tiler.export.polygons import write_bridges, write_outline
from tiler.export.tasks.sheets import key_of, name_of
from tiler.export.water import write_water
from tiler.io.locations import joined
from tiler.io.result_folder import BRIDGES, OUTLINE, WATER, sheet_file
from tiler.plan import Plan, water_is_given
from tiler.runs.found import Gridded, Sheet, final_raster
from tiler.schedule import Task, calling

SMOOTH_PIXELS = 2
"""Standard deviation in pixels of the Gaussian that smooths the heights, if the user gives
none."""
SPOT_REACH_M, MAX_REACH = 50, 256
"""Distance from a spot within which no pixel is higher (or lower), in metres, and its largest
value in pixels."""


def vector_tasks(context: Gridded, out: str, noise_m: float) -> Iterator[Task]:
    """Yield one task per vector file.

    ``noise_m`` is the standard deviation of the heights of ground in metres, or 0 if it is not known.
    """
    plan, config = context.plan, context.plan.config
    terrain = final_raster("dtm", config)
    if config.outline == "survey":
        outline = calling(
            write_outline, to=OutFile(out, OUTLINE), terrain=terrain, spec=context.spec, survey="survey",
            coarse=context.coarse, blocks=tuple(sorted(context.made[terrain])), area=plan.inputs.area_key,
        )  # fmt: skip
        seen = [context.checksums("survey"), context.checksums(terrain)]
        yield Task.of("export", OUTLINE, outline, seen)
    if context.decks:
        bridges = calling(write_bridges, to=OutFile(out, BRIDGES), decks=context.decks)
        yield Task.of("export", BRIDGES, bridges)
    has_water = bool(context.waters.bodies) or config.water_file is not None
    if has_water and not water_is_given(config, out):
        water = calling(write_water, to=OutFile(out, WATER), waters=context.waters.key)
        yield Task.of("export", WATER, water)
    bounds, interval = context.spec.bounds, _interval(plan)
    for name in config.drawn:
        file = OutFile(out, f"{name}.gpkg")
        yield _task("export", file.name, context, _Part(file, bounds), name, noise_m, interval)


def sheet_tasks(
    context: Gridded, out: str, noise_m: float, found: Mapping[str, float]
) -> Iterator[Task]:
    """Yield one task per vector product and sheet.

    ``found`` has the intervals of the files of all sheets, in vertical units of the CRS, by product.
    """
    for name in found:
        interval = _interval(context.plan) or Fraction(str(found[name]))
        for key, (file, sheet) in sheet_files(context, name, out).items():
            clip = None
            if sheet.drawn is not None:
                keys = (sheet.drawn.area.key, *sheet.drawn.earlier)
                clip = StoredAreas(keys, context.drawn)
            part = _Part(file, sheet.spec.bounds, SheetPart(sheet.spec, clip))
            yield _task("mosaic", key, context, part, name, noise_m, interval)


def sheet_files(context: Gridded, product: str, out: str) -> dict[str, tuple[OutFile, Sheet]]:
    """Return the file of a vector product for each sheet, and the sheet, by the key of the task."""
    files = {}
    for sheet in context.sheets:
        path = sheet_file(product, name_of(context, product, sheet)).partition("/")[2]
        file = OutFile(joined(out, product), path)
        files[f"{key_of(product, sheet)}.gpkg"] = file, sheet
    names = (file.name for file, _ in files.values())
    validate_distinct_names(context.plan.config.sheet_template, names)
    return files


@dataclass(frozen=True)
class _Part:
    """File of a vector product, its bounds, and its sheet if it has not all of the terrain."""

    file: OutFile
    bounds: Bounds
    sheet: SheetPart | None = None


def _task(
    stage: str,
    key: str,
    context: Gridded,
    part: _Part,
    name: str,
    noise_m: float,
    interval: Fraction | None,
) -> Task:
    """Return the task of a vector product. It depends on the heights and the water in and near its bounds."""
    plan, config, spec = context.plan, context.plan.config, context.spec
    terrain, smooth = final_raster("dtm", config), config.contour_smooth
    sigma = float(Fraction(SMOOTH_PIXELS) if smooth is None else smooth / plan.grid.resolution)
    reach = min(math.ceil(SPOT_REACH_M / plan.grid.resolution), MAX_REACH)
    noise = noise_m / float(plan.frame.units.vertical)
    values: dict[str, Any] = {
        "to": part.file,
        "heights": Heights(terrain, spec, plan.inputs.area_key, context.waters.stored_key),
        "interval": interval,
        # It only serves to choose an interval.
        "noise": noise if interval is None else 0.0,
        **({} if part.sheet is None else {"sheet": part.sheet}),
    }
    if name == CONTOURS:
        call = calling(write_contours, sigma=sigma, **values)
    else:
        call = calling(write_spots, reach=reach, **values)
    margin = contours_reach(sigma) if name == CONTOURS else spots_reach(reach)
    near = part.bounds.pad(math.ceil(margin * spec.lattice.size))
    blocks = (block.name for block in spec.blocks_within(near, BLOCK_PIXELS))
    seen = [context.checksums(terrain, blocks), context.waters.digest(near)]
    shape = spec if part.sheet is None else part.sheet.spec
    return Task.of(stage, key, call, seen, pixels=shape.height * shape.width)


def _interval(plan: Plan) -> Fraction | None:
    """Return the interval that the user gave, in vertical units of the CRS."""
    given = plan.config.contour_interval
    return None if given is None else given / plan.frame.units.vertical
