"""The plan of a run: all decisions and checks before the first point is read.

`inspection` reads the headers, and `make` makes the `Plan` of `model`, whose parts are also in `inputs` and `method`.
`sizes` chooses buckets, tiles and pixels, `density_map` finds the densest place, and `distant_files` finds files that
lie too far away. `memory`, `projection`, `disk` and `rates` estimate the memory, disk space and time of a run.
`validation` checks the plan, `settled` adapts it to a store that exists, and `plan_text` prints it.
"""

from tiler.plan.area import buckets_of, chunks_of
from tiler.plan.disk import sparse_raster_remedy
from tiler.plan.inspection import output_names
from tiler.plan.make import make_plan
from tiler.plan.memory import PlannedPass
from tiler.plan.method import KEEP, MIN_MATCHED_M2
from tiler.plan.model import PIECE_POINTS, Plan
from tiler.plan.plan_text import plan_json, plan_lines
from tiler.plan.projection import projected_memory
from tiler.plan.rates import remember, stage_seconds
from tiler.plan.settled import settled, settled_by, settled_by_points
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
    "output_names",
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
