"""Tasks that write vector files: outline of the survey, bridges, bodies of water, contours and spot heights."""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction

from tiler.core.digests import digest_of
from tiler.core.products import CONTOURS, SPOTS
from tiler.export import (
    WriteBridges,
    WriteContours,
    WriteOutline,
    WriteSpots,
    WriteWater,
    write_bridges,
    write_contours,
    write_outline,
    write_spots,
    write_water,
)
from tiler.export.work import VectorFile
from tiler.grid.tasks.gridding import GridContext
from tiler.grid.tasks.raster_names import final_raster
from tiler.io.result_folder import BRIDGES, OUTLINE, WATER
from tiler.plan import water_is_given
from tiler.schedule import Task, Work
from tiler.version import RULES

SMOOTH_PIXELS = 2
"""Standard deviation in pixels of the Gaussian that smooths the heights, if the user gives
none."""
SPOT_REACH_M, MAX_REACH = 50, 256
"""Distance from a spot within which no pixel is higher (or lower), in metres, and its largest
value in pixels."""


def vector_tasks(context: GridContext, out: str, noise_m: float) -> Iterator[Task]:
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
    contours = WriteContours(
        raster=terrain, spec=context.spec, out=out, area=plan.inputs.area_key, waters=context.water_key,
        noise=noise, interval=interval, sigma=float(sigma),
    )  # fmt: skip
    spots = WriteSpots(
        raster=terrain, spec=context.spec, out=out, area=plan.inputs.area_key, waters=context.water_key,
        noise=noise, interval=interval, reach=spot_reach,
    )  # fmt: skip
    works: dict[str, tuple[Work, VectorFile]] = {
        CONTOURS: (write_contours, contours),
        SPOTS: (write_spots, spots),
    }
    if config.outline == "survey":
        outline = WriteOutline(
            name=OUTLINE, out=out, terrain=terrain, spec=context.spec, survey="survey", coarse=context.coarse,
            blocks=tuple(sorted(context.made[terrain])), area=plan.inputs.area_key,
        )  # fmt: skip
        digest = digest_of(
            RULES, outline, context.checksums("survey"), context.checksums(terrain)
        )
        yield Task("export", OUTLINE, digest, write_outline, outline)
    if context.corrections.decks:
        bridges = WriteBridges(name=BRIDGES, decks=context.corrections.decks, out=out)
        yield Task("export", BRIDGES, digest_of(RULES, bridges), write_bridges, bridges)
    has_water = bool(context.waters.bodies) or config.water_file is not None
    if has_water and not water_is_given(config, out):
        water = WriteWater(name=WATER, waters=context.waters.key, out=out)
        yield Task("export", WATER, digest_of(RULES, water), write_water, water)
    for name in config.drawn:
        write, work = works[name]
        digest = digest_of(RULES, work, context.checksums(terrain))
        yield Task(
            "export",
            f"{name}.gpkg",
            digest,
            write,
            work,
            pixels=context.spec.height * context.spec.width,
        )
