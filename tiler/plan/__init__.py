"""The plan of a run: all decisions and checks before the first point is read.

`make` makes the `Plan` of `model`, and adapts it to a store that exists. `inspection` reads the headers and leaves out
files, `area` selects the parts of the inputs that are read, and `drawings` reads features drawn by the user. `sizes`
chooses buckets, tiles and pixels. `method` has the passes and their halos, `memory` the bytes of their windows, and
`estimates` the memory, disk space and time of a run. `validation` refuses plans that would fail, `warnings` warns, and
`plan_text` prints.
"""

from tiler.plan.area import buckets_of, chunks_of
from tiler.plan.estimates import projected_memory, remember, sparse_raster_remedy, stage_seconds
from tiler.plan.make import make_plan, settled, settled_by, settled_by_points
from tiler.plan.method import KEEP, MIN_MATCHED_M2, PlannedPass
from tiler.plan.model import PIECE_POINTS, Plan
from tiler.plan.plan_text import plan_json, plan_lines
from tiler.plan.sizes import bounds_of
from tiler.plan.validation import water_is_given

__all__ = [
    "KEEP",
    "MIN_MATCHED_M2",
    "PIECE_POINTS",
    "Plan",
    "PlannedPass",
    "bounds_of",
    "buckets_of",
    "chunks_of",
    "make_plan",
    "plan_json",
    "plan_lines",
    "projected_memory",
    "remember",
    "settled",
    "settled_by",
    "settled_by_points",
    "sparse_raster_remedy",
    "stage_seconds",
    "water_is_given",
]
