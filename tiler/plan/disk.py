"""What a run leaves on the disk, and what it needs there on the way."""

from __future__ import annotations

from tiler.core.products import PRODUCTS
from tiler.plan.model import KEEP, Plan

SPOOL_BYTES, COLUMN_BYTES = 12, 12
"""Per point on disk, in the spool, and in its bucket with its label; measured on a city."""
STORED_PIXEL_BYTES = 2.2
"""Per pixel of the store's rasters, compressed; measured on a terrain model."""
COPIES = 2
"""Copies of a raster while its COG is made: the plain one, and what GDAL writes."""
CLASSIFIED_SHARE = 1.2
"""Bytes of a classified file over those of its LAZ input; LAS inputs shrink."""


def projected_disk(plan: Plan) -> dict[str, int]:
    """Bytes of the ``store``, of the ``rasters``, of the ``classified`` clouds, and of ``scratch`` of the largest COG.

    Rasters are reckoned as if every pixel of the extent held a value.
    """
    metres = float(plan.meta.frame.metres_xy)
    pixels = plan.extent.area() * metres**2 / float(plan.resolution) ** 2
    names = {"dtm", *plan.config.products}
    sizes = [4 if PRODUCTS[name].dtype == "float32" else 1 for name in names]
    labels = max(len(plan.passes) - 1, 0)
    workers = min(plan.workers, len(names))
    return {
        "store": int(
            plan.points * (SPOOL_BYTES + COLUMN_BYTES + 0.3 * labels)
            + STORED_PIXEL_BYTES * pixels * len(names)
        ),
        "rasters": int(pixels * sum(sizes)),
        "classified": 0
        if plan.config.method == KEEP
        else int(CLASSIFIED_SHARE * sum(s.size for s in plan.sources)),
        "scratch": int(COPIES * pixels * sum(sorted(sizes)[-workers:])),
    }
