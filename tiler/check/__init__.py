"""How good a DTM is: against checkpoints, across the edges of tiles, and between flight strips.

`tiler.check.points` reads checkpoints, `tiler.check.accuracy` compares, `tiler.check.seams` and
`tiler.check.strips` need no checkpoints, `tiler.check.requirements` says what a figure must be,
`tiler.check.figures` draws.
"""

from tiler.check.accuracy import check_dtm
from tiler.check.figures import refuse_figures, write_figures
from tiler.check.measure import measure
from tiler.check.points import Checkpoints, PointOptions, read_checkpoints
from tiler.check.requirements import METRICS, Requirement, judge, parse_requirements
from tiler.check.seams import TileEdges, edges_of_run, seam_steps, seams_of
from tiler.check.strips import strip_differences

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
