"""Estimates, before any point is read, of the memory of a worker, of disk space and of time.

The rates of earlier runs are in the user's cache folder.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from tiler.core.products import PRODUCTS
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.results import StageResult
from tiler.core.units import Sides
from tiler.io.atomic_files import replace_file
from tiler.io.foreign_content import parse_json_object
from tiler.io.las.point_formats import is_legacy, newer_bytes
from tiler.io.locations import is_url
from tiler.plan.memory import (
    ASSEMBLY_POINT_BYTES,
    BASE_BYTES,
    EXPORT_BYTES,
    EXPORT_POINTS,
    GROUND_BYTES,
    SPOOL_POINT_BYTES,
    elected_peak,
    filter_bytes,
    tile_peak,
)
from tiler.plan.method import MAX_HALF, PlannedPass, expected_passes, widest_halo
from tiler.plan.model import PIECE_POINTS, Plan
from tiler.version import __version__

SPOOL_BYTES = 13
"""Bytes per point in the spool (measured on a city)."""
COLUMN_BYTES = 14
"""Bytes per point in its bucket, including its label (measured on a city)."""
LABEL_BYTES = 0.3
"""Bytes per point for each further pass that keeps labels."""
RECORD_BYTES = 12
"""Bytes per point for the records kept until the classified clouds are written (9.5 on
Autzen)."""
CLASS_BYTES = 1
"""The same if only classes, returns and flags are kept."""
STORED_PIXEL_BYTES = 2.2
"""Bytes per pixel of the store's rasters, compressed (measured on a terrain model)."""
EMPTY_PIXEL_BYTES = 0.03
"""Bytes per pixel of a file in an empty block, compressed (measured on 1.6e9 such pixels)."""
DRAWN_PIXEL_BYTES = 5
"""Bytes of contours per pixel of terrain (measured with 90 levels and unsmoothed heights)."""
GEOPACKAGE_BYTES = 98_304
"""Bytes of a GeoPackage without features."""
COPIES = 2
"""Number of copies of a raster while its COG is made: the plain file and the COG. A cloud that
becomes COPC also needs two copies of its records."""
CLASSIFIED_SHARE = 1.2
"""Ratio of the size of a classified file to that of its LAZ input. LAS inputs shrink."""
MAX_PIXELS = 2e10
"""Maximum number of pixels of a mostly empty file. GDAL writes some 5e7 empty pixels per
second."""

TYPICAL = {
    "spool": 1.3,
    "surveys": 0.2,
    "assemble": 0.7,
    "filter": 0.4,
    "grid-dtm": 0.9,
    "grid-dsm": 0.5,
    "grid": 0.1,
    "export": 1.2,
}
"""Worker seconds per million points of stages without an earlier run, measured on a city. Other
machines differ."""

MIN_POINTS = 1_000_000
"""Minimum number of points of a run that is recorded, since the time of smaller runs is mostly
start-up."""

_NEWEST = 0.5
"""Weight of the newest run in the recorded rates."""


def projected_memory(plan: Plan) -> dict[str, int]:
    """Estimate the peak bytes of a worker by stage."""
    ground = (
        int(min(plan.inputs.points, max(plan.block_points, plan.max_part_points)))
        * GROUND_BYTES
    )
    largest = min(max(source.points for source in plan.inputs.sources), EXPORT_POINTS)
    expected = expected_passes(plan.method.passes, plan.method.kind, plan.inputs.density)
    spooled = PIECE_POINTS * SPOOL_POINT_BYTES
    assembled = plan.max_bucket_points * ASSEMBLY_POINT_BYTES
    return {
        "ingest": int(BASE_BYTES + max(spooled, assembled)),
        "filter": max((_pass_bytes(plan, step) for step in expected), default=0),
        "grid": BASE_BYTES + ground + plan.line_bytes,
        "export": BASE_BYTES + EXPORT_BYTES + largest,
    }


def _pass_bytes(plan: Plan, step: PlannedPass) -> int:
    """Estimate the peak bytes of a worker in a pass.

    It is the peak of a tile of mean density with the widest halo, or of the densest tile with
    the first halo if that is higher. A tile that does not fit into the memory is divided, down
    to single buckets. So the peak is at most that memory, or the peak of the densest bucket if
    that is higher.
    """
    if plan.joins(step):
        side = math.sqrt(plan.inputs.covered_m2)
        mean_tile = 0
    else:
        side = float(plan.method.tile)
        mean_tile = filter_peak(plan, step, side, widest_halo_m(plan, step))
    densest_tile = filter_peak(plan, step, side, step.halo_m, densest=True)
    densest_bucket = filter_peak(plan, step, plan.grid.bucket_m, step.halo_m, densest=True)
    peak, limit = max(mean_tile, densest_tile), plan.tile_memory_of(step)
    if step.fits_surfaces:
        peak, limit = elected_peak(peak), elected_peak(limit)
        if step.pass_.influence_radius_m is None:
            limit = plan.method.tile_memory  # A wider halo may use all of it.
    return min(peak, max(limit, densest_bucket))


def filter_peak(
    plan: Plan, step: PlannedPass, side_m: float, halo_m: float, densest: bool = False
) -> int:
    """Estimate the peak bytes of a worker with a tile of a side and halo, in metres.

    The tile has the mean density, or with ``densest`` it lies in the densest place.
    """
    side = side_m + 2 * halo_m
    bucket_m = plan.grid.bucket_m + 2 * step.pass_.label_margin_m
    area = min(side**2, plan.inputs.covered_m2)
    points = plan.inputs.density * area
    bucket = plan.inputs.density * bucket_m**2
    if densest:
        points = max(points, plan.inputs.density_map.max_points(side))
        bucket = plan.inputs.max_points(bucket_m)
    if step.pass_.raster_cell_m:
        area = min(side**2, math.prod(plan.sides_m))
    window = filter_bytes(points, area, plan.method.candidate_cell_m, step, plan.grid.fine_m)
    return tile_peak(window, bucket, step, plan.resources.memory)


def widest_halo_m(plan: Plan, step: PlannedPass) -> float:
    """Return the widest halo, in metres, of a tile with mean density and uncertified labels."""
    side, memory = float(plan.method.tile), plan.method.tile_memory
    return widest_halo(
        step, step.halo_m, lambda halo: filter_peak(plan, step, side, halo) <= memory
    )


def overlap_of(plan: Plan, steps: Iterable[PlannedPass]) -> float:
    """Return the ratio of a filter tile's padded area to its core area, the largest of all passes.

    Joined tiles do not extend beyond the survey.
    """
    return max((_overlap(plan, step) for step in steps), default=1.0)


def _overlap(plan: Plan, step: PlannedPass) -> float:
    overlap = 1.0
    for side, survey_side in zip(_tile_sides_m(plan, step), plan.sides_m, strict=True):
        padded = side + 2 * step.halo_m
        if plan.joins(step):
            # The outer tiles have no halo beyond the survey.
            padded = min(padded - 2 * step.halo_m * side / survey_side, survey_side)
        overlap *= padded / side
    return overlap


def _padded_m(side: float, survey_side: float, halo_m: float) -> float:
    """Return the side of the largest window within the survey, in metres.

    One of two tiles has a halo on one side only.
    """
    return min(side + min(2.0, survey_side / side - 1) * halo_m, survey_side)


def _tile_sides_m(plan: Plan, step: PlannedPass) -> tuple[float, float]:
    """Estimate the sides in metres of the tiles of a pass, which `tiler.filter.tasks.tiles` cuts."""
    if not plan.joins(step):
        return float(plan.method.tile), float(plan.method.tile)
    sides = list(plan.sides_m)
    n_tiles = plan.method.n_joined_tiles(plan.inputs.points)
    while max(sides) > plan.grid.bucket_m:
        window = [
            _padded_m(side, survey_side, step.halo_m)
            for side, survey_side in zip(sides, plan.sides_m, strict=True)
        ]
        longer = sides.index(max(sides))
        half = _padded_m(sides[longer] / 2, plan.sides_m[longer], step.halo_m)
        peak = filter_peak(plan, step, math.sqrt(math.prod(window)), 0.0)
        fits = peak <= plan.tile_memory_of(step)
        if fits and (n_tiles <= 1 or half > MAX_HALF * window[longer]):
            break
        sides[longer] /= 2
        n_tiles //= 2
    return sides[0], sides[1]


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
    sheets = _sheets_m2(plan)
    if not sheets:
        return Pixels(filled, whole - filled, whole)
    in_sheets = in_squares_with_points(math.sqrt(sum(sheets) / len(sheets)))
    return Pixels(
        min(filled, in_sheets), max(in_sheets - filled, 0.0), max(sheets) / resolution**2
    )


def _sheets_m2(plan: Plan) -> list[float]:
    """Return the areas in m2 of the bounds of the drawn sheets, or the one of all sheets, or [] without sheets.

    The list is empty as well before the file of the sheets is read.
    """
    if isinstance(plan.config.sheets, Sides):
        return [float(math.prod(plan.config.sheets))]
    metres = float(plan.frame.metres_xy)
    return [sheet.area.bounds.area() * metres**2 for sheet in plan.inputs.sheets]


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
        "drawn": _drawn_bytes(plan, pixels) * len(plan.config.drawn),
        "classified": _classified_bytes(plan),
        "scratch": int(COPIES * (_raster_scratch(plan, pixels, sizes) + _copc_scratch(plan))),
    }


def _drawn_bytes(plan: Plan, pixels: Pixels) -> int:
    """Return the bytes of a vector product: its file of all of the terrain, and those of the sheets."""
    whole = DRAWN_PIXEL_BYTES * pixels.filled + GEOPACKAGE_BYTES
    areas = _sheets_m2(plan)
    if not areas:
        return int(whole)
    in_sheets = (pixels.filled + pixels.empty) * float(plan.grid.resolution) ** 2
    sheets = in_sheets / (sum(areas) / len(areas))
    return int(whole + DRAWN_PIXEL_BYTES * pixels.filled + GEOPACKAGE_BYTES * sheets)


def _stored_bytes(plan: Plan) -> float:
    """Return the bytes per point in the store."""
    labels = max(sum(not step.pass_.elected for step in plan.method.steps) - 1, 0)
    size = SPOOL_BYTES + COLUMN_BYTES + LABEL_BYTES * labels
    if plan.writes_clouds:
        keeps_records = plan.config.classified != "laz" or any(
            s.copc or is_legacy(s.point_format) or is_url(s.path) for s in plan.inputs.sources
        )
        size += RECORD_BYTES if keeps_records else CLASS_BYTES
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
    return shutil.disk_usage(existing_folder(out)).free


def existing_folder(out: Path) -> Path:
    """Return OUT, or the nearest of its parents that exists."""
    folders = (out, *Path(os.path.realpath(out)).parents)
    return next(folder for folder in folders if folder.exists())


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


def remember(plan: Plan, stages: Mapping[str, StageResult]) -> None:
    """Record the rates of the stages that a run did completely.

    Errors of writing the cache are ignored. The plan then uses the rates of another machine.

    Parameters
    ----------
    plan : Plan
    stages : mapping
        Work of each stage by its key.
    """
    if plan.inputs.points < MIN_POINTS or plan.config.scheduler is not None:
        return
    known = _recorded_rates()
    for stage, result in stages.items():
        if result.computed and result.computed == result.tasks:
            rate = result.seconds * plan.resources.workers / plan.inputs.points * 1e6
            name = _rate_key(plan, stage)
            if name in known:
                rate = (1 - _NEWEST) * known[name] + _NEWEST * rate
            known[name] = rate
    path = _rates_file()
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)
        with open(partial, "x", encoding="utf-8") as file:
            json.dump({"version": __version__, "seconds_per_million": known}, file, indent=1)
        replace_file(partial, path)


def projected_seconds(plan: Plan) -> tuple[float, bool]:
    """Estimate the seconds of the whole job, and return whether all rates are from earlier runs here."""
    products = dict.fromkeys(("dtm", *plan.config.exported))
    stages = stage_seconds(plan, [f"grid-{name}" for name in products])
    known = _recorded_rates()
    return sum(stages.values()), all(_rate_key(plan, stage) in known for stage in stages)


def stage_seconds(
    plan: Plan, rasters: Iterable[str], until: str = "export"
) -> dict[str, float]:
    """Estimate the seconds of the stages of a job, in their order.

    Parameters
    ----------
    plan : Plan
    rasters : iterable of str
        Names of the stages of the rasters that are made.
    until : str
        Last part of the job: ``ingest``, ``filter``, ``grid`` or ``export``.
    """
    known = _recorded_rates()
    steps, kinds = plan.method.steps, plan.method.kinds
    filters = {
        f"filter{number}": step
        for number, step in enumerate(plan.method.passes)
        if step in steps
    }
    # Some passes are skipped for some clouds. Once earlier runs did some of these passes, the
    # others are not expected.
    did = [
        stage
        for stage, step in filters.items()
        if step.sometimes and _rate_key(plan, stage) in known
    ]
    if did:
        filters = {
            stage: step for stage, step in filters.items() if stage in did or not step.sometimes
        }
    if kinds:  # The kind is not known yet, so the passes of the slowest kind count.
        costs = dict.fromkeys(kinds, 0.0)
        for stage, step in filters.items():
            if step.kind in costs:
                costs[step.kind] += _rate(plan, known, stage)
        slowest = max(costs, key=lambda kind: costs[kind])
        filters = {
            stage: step for stage, step in filters.items() if step.kind in (None, slowest)
        }
    parts = {
        "ingest": ["spool", *(["surveys"] if plan.inputs.surveys else []), "assemble"],
        "filter": filters,
        "grid": rasters,
        "export": ["export"],
    }
    names = list(parts)
    stages = chain.from_iterable(parts[name] for name in names[: names.index(until) + 1])
    points, workers = plan.inputs.points, plan.resources.workers
    return {stage: _rate(plan, known, stage) * points / 1e6 / workers for stage in stages}


def _rate(plan: Plan, known: Mapping[str, float], stage: str) -> float:
    """Return the worker seconds per million points of a stage."""
    typical = TYPICAL.get(stage, TYPICAL[re.split(r"[-\d]", stage)[0]])
    return known.get(_rate_key(plan, stage), typical)


def _rate_key(plan: Plan, stage: str) -> str:
    """Return the key of a recorded rate. The rates of filter stages differ by method."""
    return f"{plan.config.method}:{stage}" if stage.startswith("filter") else stage


def _rates_file() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(home) / "tiler-dtm" / "rates.json"


def _recorded_rates() -> dict[str, float]:
    """Return the rates recorded by this version, or {} if there is no valid file."""
    try:
        content = parse_json_object(_rates_file().read_text())
        if content["version"] != __version__:
            return {}
        return {str(k): float(v) for k, v in content["seconds_per_million"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
