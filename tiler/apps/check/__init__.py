"""Checks of a DTM against checkpoints, across the edges of tiles, and between flight strips.

`measure` runs all of these. `points` reads checkpoints and `accuracy` compares them with a DTM. `seams` and `strips` do
not need checkpoints. `requirements` compares the results with limits, and `figures` draws them. `results` has the
types of the results.
"""

from tiler.apps.check.accuracy import check_dtm
from tiler.apps.check.figures import write_figures
from tiler.apps.check.measuring import measure, terrain_in
from tiler.apps.check.points import Checkpoints, PointOptions, read_checkpoints
from tiler.apps.check.requirements import METRICS, Requirement, judge, parse_requirements
from tiler.apps.check.seams import TileEdges, seam_steps
from tiler.apps.check.strips import strip_differences

__all__ = [
    "METRICS",
    "Checkpoints",
    "PointOptions",
    "Requirement",
    "TileEdges",
    "check_dtm",
    "judge",
    "measure",
    "parse_requirements",
    "read_checkpoints",
    "seam_steps",
    "strip_differences",
    "terrain_in",
    "write_figures",
]
