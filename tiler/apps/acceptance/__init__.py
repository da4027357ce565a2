"""Acceptance of clouds: facts that a specification of a survey asks for, measured and compared with it.

`measuring` reads each file once, in child processes. `counts` has the counts of one file, `cells` what follows from the
first returns in cells without `strays`, `separation` the differences of swaths, `difference_raster` their raster,
`repeatability` the spread within a swath, `duplicates` the repeated points, and `scratch` their folder. `rows` is the
table of all rows, with those of `separation_rows`, `measurements` has their classes, and `specification` reads the
limits.
"""

from tiler.apps.acceptance.measuring import check_clouds
from tiler.apps.acceptance.recognition import are_clouds
from tiler.apps.acceptance.specification import (
    Specification,
    read_specification,
    specification_names,
)

__all__ = [
    "Specification",
    "are_clouds",
    "check_clouds",
    "read_specification",
    "specification_names",
]
