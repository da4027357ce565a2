"""Disk space that a run needs for its results, its store and its temporary files."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiler.core.products import PRODUCTS
from tiler.core.raster import BLOCK_PIXELS
from tiler.io.las.point_formats import newer_bytes
from tiler.plan.model import Plan

SPOOL_BYTES = 13
"""Bytes per point in the spool (measured on a city)."""
COLUMN_BYTES = 14
"""Bytes per point in its bucket, including its label (measured on a city)."""
LABEL_BYTES = 0.3
"""Bytes per point for each further pass that keeps labels."""
RECORD_BYTES = 12
"""Bytes per point for the records kept until the classified clouds are written (9.5 on
Autzen)."""
STORED_PIXEL_BYTES = 2.2
"""Bytes per pixel of the store's rasters, compressed (measured on a terrain model)."""
EMPTY_PIXEL_BYTES = 0.03
"""Bytes per pixel of a file in an empty block, compressed (measured on 1.6e9 such pixels)."""
DRAWN_PIXEL_BYTES = 5
"""Bytes of contours per pixel of terrain (measured with 90 levels and unsmoothed heights)."""
COPIES = 2
"""Number of copies of a raster while its COG is made: the plain file and the COG. A cloud that
becomes COPC also needs two copies of its records."""
CLASSIFIED_SHARE = 1.2
"""Ratio of the size of a classified file to that of its LAZ input. LAS inputs shrink."""
MAX_PIXELS = 2e10
"""Maximum number of pixels of a mostly empty file. GDAL writes some 5e7 empty pixels per
second."""
MANY_PIXELS = 1e9
"""Number of pixels below which files are written without a warning, however empty they are."""
MOSTLY_EMPTY = 0.99
"""Share of empty pixels above which a warning recommends `--sheets`."""


@dataclass(frozen=True)
class Pixels:
    """Numbers of pixels of a product: in blocks near points, in empty blocks, in the largest file."""

    filled: float
    empty: float
    largest: float


def pixels_of(plan: Plan) -> Pixels:
    """Estimate the numbers of pixels of a product from a sample of the points."""
    resolution, metres = float(plan.grid.resolution), float(plan.frame.metres_xy)
    whole = plan.inputs.extent.area() * metres**2 / resolution**2
    west, south, east, north = (v * metres for v in plan.inputs.extent.to_json())

    def in_squares_with_points(side_m: float) -> float:
        squares = plan.inputs.density_map.squares(side_m, (west, south), (east, north))
        return squares * (side_m / resolution) ** 2

    filled = min(in_squares_with_points(BLOCK_PIXELS * resolution) or whole, whole)
    if plan.config.sheets is None:
        return Pixels(filled, whole - filled, whole)
    side = float(plan.config.sheets)
    in_sheets = in_squares_with_points(side)
    return Pixels(
        min(filled, in_sheets), max(in_sheets - filled, 0.0), (side / resolution) ** 2
    )


def projected_disk(plan: Plan) -> dict[str, int]:
    """Estimate the bytes of the store, of the products and of temporary files.

    The keys are ``store``, ``rasters``, ``drawn`` (vector products), ``classified`` (clouds)
    and ``scratch``. Every pixel of a block near points counts as filled.
    """
    pixels = pixels_of(plan)
    names = {"dtm", *plan.config.exported}
    sizes = [np.dtype(PRODUCTS[name].dtype).itemsize for name in names]
    return {
        "store": int(
            plan.inputs.points * _stored_bytes(plan)
            + STORED_PIXEL_BYTES * pixels.filled * len(names)
        ),
        "rasters": int(
            pixels.filled * sum(sizes) + pixels.empty * EMPTY_PIXEL_BYTES * len(names)
        ),
        "drawn": int(pixels.filled * DRAWN_PIXEL_BYTES * len(plan.config.drawn)),
        "classified": _classified_bytes(plan),
        "scratch": int(COPIES * (_raster_scratch(plan, pixels, sizes) + _copc_scratch(plan))),
    }


def _stored_bytes(plan: Plan) -> float:
    """Return the bytes per point in the store."""
    labels = max(sum(not step.pass_.elected for step in plan.method.steps) - 1, 0)
    size = SPOOL_BYTES + COLUMN_BYTES + LABEL_BYTES * labels
    if plan.writes_clouds:
        size += RECORD_BYTES
    return size


def _classified_bytes(plan: Plan) -> int:
    if not plan.writes_clouds:
        return 0
    if plan.config.classified == "las":
        return sum(source.points * source.record_length for source in plan.inputs.sources)
    return int(CLASSIFIED_SHARE * sum(source.size for source in plan.inputs.sources))


def _raster_scratch(plan: Plan, pixels: Pixels, sizes: list[int]) -> float:
    """Return the bytes of one copy of the largest rasters that are written at the same time.

    ``sizes`` are the bytes per pixel of the rasters.
    """
    if plan.config.sheets is None:
        workers = min(plan.resources.workers, len(sizes))
        largest = sum(sorted(sizes)[-workers:])
    else:
        workers = plan.resources.workers
        largest = workers * max(sizes)
    filled = min(pixels.filled, pixels.largest)
    return filled * largest + (pixels.largest - filled) * EMPTY_PIXEL_BYTES * workers


def _copc_scratch(plan: Plan) -> int:
    """Return the bytes of the records of the largest clouds that become COPC at the same time."""
    if not plan.writes_clouds or plan.config.classified != "copc":
        return 0
    sizes = sorted(
        s.points * newer_bytes(s.point_format, s.record_length) for s in plan.inputs.sources
    )
    return sum(sizes[-plan.resources.workers :])


def needed_bytes(plan: Plan) -> int:
    """Return the bytes that a run needs on the disk of OUT."""
    disk = projected_disk(plan)
    if plan.config.store is not None:
        del disk["store"]
    return sum(disk.values())


def free_bytes(out: Path) -> int:
    """Return the free bytes on the disk of OUT, which need not exist yet."""
    folders = (out, *Path(os.path.realpath(out)).parents)
    existing = next(folder for folder in folders if folder.exists())
    return shutil.disk_usage(existing).free


def sparse_raster_remedy(plan: Plan, out: Path | None) -> str | None:
    """Return a remedy if empty space makes a single raster too large, or None."""
    pixels = pixels_of(plan)
    if plan.config.sheets is not None or pixels.empty <= pixels.filled:
        return None
    empty = pixels.empty * EMPTY_PIXEL_BYTES * (len(plan.config.exported) + COPIES)
    free = None
    if out is not None:
        with suppress(OSError):  # `validate` reports the error of the folder.
            free = free_bytes(out)
    needed = needed_bytes(plan)
    fits_without_empty = free is not None and needed - empty <= free < needed
    if pixels.largest <= MAX_PIXELS and not fits_without_empty:
        return None
    return (
        f"a single raster would have {pixels.largest:.2g} pixels, most of them empty; "
        "use --sheets or --bounds, or check the coordinates"
    )


def sparse_raster_warning(plan: Plan) -> str | None:
    """Return a warning about a large and mostly empty raster, or None."""
    pixels = pixels_of(plan)
    whole = pixels.filled + pixels.empty
    if (
        plan.config.sheets is not None
        or whole < MANY_PIXELS
        or pixels.empty < MOSTLY_EMPTY * whole
    ):
        return None
    return (
        f"the files lie far apart: of the {whole:.2g} pixels of a raster, only {100 * pixels.filled / whole:.2g} % are "
        "near points; use --sheets to write only these"
    )
