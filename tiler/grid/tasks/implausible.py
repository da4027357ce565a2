"""Warnings about results that cannot be true, whatever their cause, with the likely cause and a setting to try."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator

from tiler.config import VOID_CANOPY
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec
from tiler.core.terrain_results import Implausible
from tiler.core.units_text import length_text
from tiler.grid.flaws import BELOW_M, CELLS_PER_BLOCK
from tiler.grid.steps import Counts
from tiler.observe.events import Warned
from tiler.plan import KEEP
from tiler.runs.job import Job

MIN_GROUND = 0.01
"""Minimum share of ground among the points, and of pixels with a return near the terrain."""
ENOUGH_NEAR = 0.1
"""Share of pixels with a return near the terrain from which few ground points are right, as in
dense scans of forests."""
MAX_VOID = 0.5
"""Share of the survey from which voids are implausible."""
MAX_BELOW = 0.98
"""Share of the pixels of a square in which the terrain may lie below all returns."""
SQUARE_M = 256.0
"""Least side of a square. The widest roof that is removed by default is 200 m wide."""
MIN_SEEN = 1 / 3
"""Least share of pixels with returns in a square, so that a roof at the border of the survey is not a square."""

Square = tuple[int, int]


def report_implausible(job: Job, spec: RasterSpec, above: Iterable[Counts]) -> None:
    """Warn about results that cannot be true, and add them to run.json."""
    if vars(job.results).get("implausible"):  # An empty terrain explains all else.
        return
    job.results.implausible = []
    # A canopy or a failed tile explains them, and has its own warning.
    if job.record.failed or "canopy_doubts" in vars(job.results):
        return
    pixel_m = float(job.plan.grid.resolution)
    job.results.implausible = [*_low_terrain(job, spec, above, pixel_m), *_void(job)]
    for result in job.results.implausible:
        job.listener(Warned(f"{result.why}: {result.remedy}"))


def _low_terrain(
    job: Job, spec: RasterSpec, above: Iterable[Counts], pixel_m: float
) -> Iterator[Implausible]:
    """Yield terrain far below the returns: of the whole survey, or of the squares in which it is."""
    cell_pixels = BLOCK_PIXELS // CELLS_PER_BLOCK
    side = max(math.ceil(SQUARE_M / (cell_pixels * pixel_m)), 1) * cell_pixels
    seen, below = Counter[Square](), Counter[Square]()
    for counts in above:
        for row, col, n_seen, n_below in counts["cells"]:
            seen[row // side, col // side] += n_seen
            below[row // side, col // side] += n_below
    near, share = 1 - below.total() / max(seen.total(), 1), _ground_share(job)
    height = length_text(BELOW_M, job.plan.frame.units.vertical)
    if seen and (near < MIN_GROUND or (share < MIN_GROUND and near < ENOUGH_NEAR)):
        why = (
            f"{share:.2%} of the points are ground, and all returns lie more than {height} above the terrain in "
            f"{1 - near:.1%} of the pixels"
        )
        yield Implausible("too little ground", why, _remedy(job), None)
        return
    wrong = [
        square
        for square, n in seen.items()
        if n >= MIN_SEEN * side**2 and below[square] >= MAX_BELOW * n
    ]
    if wrong:
        row, col = min(wrong, key=lambda square: (-below[square], square))
        bounds = spec.block_bounds(Block(row * side, col * side, side, side))
        length = length_text(side * pixel_m, job.plan.frame.units.horizontal)
        why = (
            f"nearly all returns lie more than {height} above the terrain, in {len(wrong)} of {len(seen)} squares of "
            f"{length}"
        )
        edges = [edge / COUNTS_PER_UNIT for edge in bounds.to_json()]
        yield Implausible("terrain below all returns", why, _remedy(job), edges)


def _ground_share(job: Job) -> float:
    """Return the share of ground among the points that a filter or the input classified."""
    config, results = job.plan.config, job.results
    if config.method != KEEP:
        return results.filter.ground / max(results.filter.points - results.filter.kept, 1)
    counts = results.classes.input
    ground = sum(counts.get(str(code), 0) for code in config.ground_classes)
    return ground / max(sum(counts.values()), 1)


def _remedy(job: Job) -> str:
    method = job.plan.config.method
    if method == KEEP:
        return "the ground classes of the input are incomplete or wrong; use --method auto"
    if method != "auto":
        return f"method {method} took low points for ground, or hills for objects; use --method auto"
    return f"if hills are cut off there, use {_smaller_objects(job)}, or --edits with the action ground"


def _smaller_objects(job: Job) -> str:
    parameters = job.plan.method.parameters
    sizes = (
        f"{n} (it is {parameters[f'{n}_m']:g} m)" for n in ("roof_size", "max_building_size")
    )
    return f"a lower --set {' or '.join(sizes)}"


def _void(job: Job) -> Iterator[Implausible]:
    """Yield voids in half of the survey, unless the user asked for voids under canopy."""
    config, voids = job.plan.config, vars(job.results).get("voids")
    if voids is None or config.canopy == VOID_CANOPY:
        return
    # A terrain without any height has its own warning.
    share = voids.pixels / max(voids.surveyed_pixels, 1)
    if MAX_VOID <= share < 1:
        edge = length_text(config.max_edge, job.plan.frame.units.horizontal)
        why = (
            f"{share:.0%} of the survey has no height, because its ground points are farther apart than --max-edge "
            f"{edge}"
        )
        remedy = "use --voids fill, or a larger --max-edge"
        if config.method == "auto":
            remedy += f"; if hills are void, use {_smaller_objects(job)}"
        yield Implausible("mostly void survey", why, remedy, None)
