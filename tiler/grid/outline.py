"""Heights of a model as far as the survey reaches."""

from __future__ import annotations

from typing import Any

import numpy as np

from tiler.core.products import BEYOND
from tiler.core.raster import NODATA
from tiler.grid.checksum import checksum
from tiler.grid.survey import coarse_values
from tiler.grid.work import OutlineBlock
from tiler.store import open_store


def outline_block(store_url: str, work: OutlineBlock) -> dict[str, Any]:
    """Write one block of a model without the heights beyond the survey; a `tiler.schedule.task.Work`.

    Facets span a concave border of the survey: land that was never surveyed would get a height from its rim.

    Parameters
    ----------
    store_url : str
    work : OutlineBlock

    Returns
    -------
    dict
        ``pixels``, ``filled`` (pixels with a height), ``cut`` (those that lost it); ``checksum``.
    """
    store, nodata = open_store(store_url), np.float32(NODATA)
    heights = store.read_block(work.heights, work.block)
    before = int(np.count_nonzero(heights != nodata))
    cells = coarse_values(store, work.survey, work.coarse, work.spec, work.block)
    heights = np.where(cells == BEYOND, nodata, heights)
    store.write_block(work.name, work.block, heights)
    after = int(np.count_nonzero(heights != nodata))
    return {"pixels": heights.size, "filled": after, "cut": before - after, "checksum": checksum(heights)}
