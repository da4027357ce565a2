"""What a run leaves on the disk, and what it needs there on the way."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tiler.core.products import PRODUCTS
from tiler.core.raster import BLOCK_PIXELS
from tiler.io.las.newer_formats import newer_bytes
from tiler.plan.model import Plan

SPOOL_BYTES, COLUMN_BYTES = 13, 14
"""Per point on disk, in the spool, and in its bucket with its label; measured on a city."""
RECORD_BYTES = 12
"""Per point, of the records that are kept until the classified clouds are written: 9.5 on Autzen, rounded up."""
STORED_PIXEL_BYTES = 2.2
"""Per pixel of the store's rasters, compressed; measured on a terrain model."""
EMPTY_PIXEL_BYTES = 0.03
"""Per pixel of a file where there is nothing far around, compressed; measured on a file of 1.6e9 such pixels."""
DRAWN_PIXEL_BYTES = 5
"""Per pixel that contours are drawn of; measured on a terrain model, 90 levels, heights not smoothed."""
COPIES = 2
"""Copies of a raster while its COG is made: the plain one, and what GDAL writes. Of records that become COPC too."""
CLASSIFIED_SHARE = 1.2
"""Bytes of a classified file over those of its LAZ input; LAS inputs shrink."""
MOST_PIXELS = 2e10
"""Most pixels of one file that is mostly empty: GDAL writes some 5e7 empty ones a second."""
MANY_PIXELS, MOSTLY_EMPTY = 1e9, 0.99
"""A file of more pixels of which a larger share is empty is warned of."""


@dataclass(frozen=True)
class Pixels:
    """Pixels of one product: in blocks near points, in empty blocks of its files, and in its largest file."""

    filled: float
    empty: float
    largest: float


def pixels_of(plan: Plan) -> Pixels:
    """Pixels of a product, as far as a sample of the points tells where these are."""
    resolution, metres = float(plan.resolution), float(plan.meta.frame.metres_xy)
    whole = plan.extent.area() * metres**2 / resolution**2
    corners = [v * metres for v in plan.extent.to_json()]

    def near(side_m: float) -> float:
        west, south, east, north = corners
        return plan.density_map.squares(side_m, (west, south), (east, north)) * (side_m / resolution) ** 2

    filled = min(near(BLOCK_PIXELS * resolution) or whole, whole)
    if plan.config.sheets is None:
        return Pixels(filled, whole - filled, whole)
    side = float(plan.config.sheets)
    cut = near(side)
    return Pixels(min(filled, cut), max(cut - filled, 0.0), (side / resolution) ** 2)


def projected_disk(plan: Plan) -> dict[str, int]:
    """Bytes of ``store``, ``rasters``, ``drawn`` products, ``classified`` clouds, and ``scratch`` on the way to these.

    Rasters are reckoned as if every pixel of a block near points held a value.
    """
    pixels = pixels_of(plan)
    names = {"dtm", *plan.config.exported}
    sizes = [4 if PRODUCTS[name].dtype == "float32" else 1 for name in names]
    labels = max(sum(not step.work.elected for step in plan.steps) - 1, 0)
    workers = min(plan.workers, len(names)) if plan.config.sheets is None else plan.workers
    largest = sum(sorted(sizes)[-workers:]) if plan.config.sheets is None else workers * max(sizes)
    held = min(pixels.filled, pixels.largest)
    raster_scratch = held * largest + (pixels.largest - held) * EMPTY_PIXEL_BYTES * workers
    return {
        "store": int(
            plan.points * (SPOOL_BYTES + COLUMN_BYTES + 0.3 * labels + plan.writes_clouds * RECORD_BYTES)
            + STORED_PIXEL_BYTES * pixels.filled * len(names)
        ),
        "rasters": int(pixels.filled * sum(sizes) + pixels.empty * EMPTY_PIXEL_BYTES * len(names)),
        "drawn": int(pixels.filled * DRAWN_PIXEL_BYTES * len(plan.config.drawn)),
        "classified": 0
        if not plan.writes_clouds
        else sum(s.points * s.record_length for s in plan.sources)
        if plan.config.classified == "las"
        else int(CLASSIFIED_SHARE * sum(s.size for s in plan.sources)),
        "scratch": int(COPIES * (raster_scratch + _copc_scratch(plan))),
    }


def _copc_scratch(plan: Plan) -> int:
    """Bytes of the records of the largest clouds that become COPC at the same time."""
    if not plan.writes_clouds or plan.config.classified != "copc":
        return 0
    sizes = sorted(s.points * newer_bytes(s.point_format, s.record_length) for s in plan.sources)
    return sum(sizes[-plan.workers :])


def needed_bytes(plan: Plan) -> int:
    """Bytes that a run needs where OUT lies."""
    disk = projected_disk(plan)
    return sum(disk.values()) - (disk["store"] if plan.config.store is not None else 0)


def free_bytes(out: Path) -> int:
    """Bytes free where OUT lies, or will lie."""
    return shutil.disk_usage(next(p for p in (out, *Path(os.path.realpath(out)).parents) if p.exists())).free


def too_much_between(plan: Plan, out: Path | None) -> str | None:
    """What to do where the emptiness between the points is what one raster cannot hold; None where it can."""
    pixels = pixels_of(plan)
    if plan.config.sheets is not None or pixels.empty <= pixels.filled:
        return None
    empty = pixels.empty * EMPTY_PIXEL_BYTES * (len(plan.config.exported) + COPIES)
    free = None
    with suppress(OSError):  # `refuse` tells what is wrong with the folder
        free = None if out is None else free_bytes(out)
    full = free is not None and needed_bytes(plan) > free >= needed_bytes(plan) - empty
    if pixels.largest <= MOST_PIXELS and not full:
        return None
    return (
        f"one raster over all would have {pixels.largest:.2g} pixels, nearly all of them empty; "
        "use --sheets or --bounds, or see to the coordinates"
    )


def emptiness_warning(plan: Plan) -> str | None:
    """Tells of a file that is mostly empty and takes long to write."""
    pixels = pixels_of(plan)
    whole = pixels.filled + pixels.empty
    if plan.config.sheets is not None or whole < MANY_PIXELS or pixels.empty < MOSTLY_EMPTY * whole:
        return None
    return (
        f"the files lie far apart: of {whole:.2g} pixels of a raster {100 * pixels.filled / whole:.2g} % are near "
        "points; --sheets writes these alone"
    )
