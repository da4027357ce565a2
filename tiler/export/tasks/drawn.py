"""Tasks that write vector files: outline of the survey, bridges, bodies of water, contours and spot heights."""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction

from tiler.core.products import CONTOURS, SPOTS
from tiler.export.contours import Heights, write_contours, write_spots
from tiler.export.output_files import OutFile
from tiler.export.polygons import write_bridges, write_outline
from tiler.export.water import write_water
from tiler.io.result_folder import BRIDGES, OUTLINE, WATER
from tiler.plan import water_is_given
from tiler.runs.found import Gridded, final_raster
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
    terrain, smooth = final_raster("dtm", config), config.contour_smooth
    sigma = Fraction(SMOOTH_PIXELS) if smooth is None else smooth / plan.grid.resolution
    spot_reach = min(math.ceil(SPOT_REACH_M / plan.grid.resolution), MAX_REACH)
    vertical, interval = plan.frame.units.vertical, config.contour_interval
    noise = noise_m / float(vertical)
    interval = None if interval is None else interval / vertical
    heights = Heights(terrain, context.spec, plan.inputs.area_key, context.waters.stored_key)
    files = {name: OutFile(out, f"{name}.gpkg") for name in (CONTOURS, SPOTS)}
    calls = {
        CONTOURS: calling(
            write_contours, to=files[CONTOURS], heights=heights, interval=interval, noise=noise, sigma=float(sigma)
        ),
        SPOTS: calling(
            write_spots, to=files[SPOTS], heights=heights, interval=interval, noise=noise, reach=spot_reach
        ),
    }  # fmt: skip
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
    pixels = context.spec.height * context.spec.width
    for name in config.drawn:
        heights_seen = context.checksums(terrain)
        yield Task.of("export", files[name].name, calls[name], heights_seen, pixels=pixels)
