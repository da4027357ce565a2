"""Checks of a DTM against checkpoints, across the edges of tiles, between flight strips, and against an earlier DTM.

`measuring` runs all of these and compares the results with limits, and `figures` draws them. `points` reads checkpoints
and `accuracy` compares them with a DTM. `consistency` needs no checkpoints, `against` an earlier DTM.
`tiler.apps.results` has the types of the results.
"""

from tiler.apps.check.accuracy import check_dtm
from tiler.apps.check.against import CHANGE_M, AgainstOptions
from tiler.apps.check.consistency import TileEdges, seam_steps, strip_differences
from tiler.apps.check.figures import write_figures
from tiler.apps.check.measuring import (
    Requirement,
    judge,
    measure,
    parse_requirements,
    terrain_in,
    with_earlier,
)
from tiler.apps.check.points import Checkpoints, PointOptions, read_checkpoints

__all__ = [
    "CHANGE_M",
    "AgainstOptions",
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
    "with_earlier",
    "write_figures",
]
