"""Acceptance of clouds: facts that a specification of a survey asks for, measured and compared with it.

`measuring` reads each file once, in child processes. `counts` has the counts of one file, and the cells of all without
strays, `cells` what follows from the first returns in them, `separation` the differences of swaths and the spread
within one, `difference_raster` their raster, and `duplicates` the repeated points. `measurements` has the classes of
rows, `rows` is the table of all, and `specification` reads the limits. `page` has the texts and the page.
"""

from tiler.apps.acceptance.measuring import check_clouds
from tiler.apps.acceptance.specification import (
    Specification,
    are_clouds,
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
