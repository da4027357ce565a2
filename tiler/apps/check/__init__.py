"""How good a DTM is: against checkpoints, across the edges of tiles, and between flight strips.

`tiler.apps.check.points` reads checkpoints, `tiler.apps.check.accuracy` compares, `tiler.apps.check.seams` and
`tiler.apps.check.strips` need no checkpoints, `tiler.apps.check.requirements` says what a figure must be,
`tiler.apps.check.figures` draws.
"""

from tiler.apps.check.accuracy import check_dtm
from tiler.apps.check.figures import refuse_figures, write_figures
from tiler.apps.check.measure import measure
from tiler.apps.check.points import Checkpoints, PointOptions, read_checkpoints
from tiler.apps.check.requirements import METRICS, Requirement, judge, parse_requirements
from tiler.apps.check.seams import TileEdges, edges_of_run, seam_steps, seams_of
from tiler.apps.check.strips import strip_differences

__all__ = [
    "METRICS",
    "Checkpoints",
    "PointOptions",
    "Requirement",
    "TileEdges",
    "check_dtm",
    "edges_of_run",
    "judge",
    "measure",
    "parse_requirements",
    "read_checkpoints",
    "refuse_figures",
    "seam_steps",
    "seams_of",
    "strip_differences",
    "write_figures",
]
