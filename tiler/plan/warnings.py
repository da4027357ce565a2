"""Warnings about inputs that are probably wrong, and about settings that do not suit the data or cost too much."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

from ptd.matched.evidence import DIM, Finding
from ptd.matched.survey import in_words
from ptd.methods import METHODS
from tiler.config import RunConfig
from tiler.core.crs import crs_name, misplaced, point_scale_factor
from tiler.core.units import (
    METRE,
    length_option,
    length_text,
    short_unit,
    whole_length,
    written_unit,
)
from tiler.core.words import counted
from tiler.plan.estimates import overlap_of, pixels_of
from tiler.plan.memory import WIDE_TILE
from tiler.plan.method import steps_of
from tiler.plan.model import Plan
from tiler.plan.sizes import middle

MAX_RELIEF_M = 9000
"""Largest height difference that terrain can have."""
MIN_SIDE_M = 100
"""Side in metres below which clouds may be higher than wide, such as single buildings or
trees."""
MUCH_OVERLAP = 3.0
"""Ratio of a tile's padded area to its core area, as a mean of all passes, above which a
warning recommends larger tiles."""

FEW_PIXELS = 5
"""Number of columns and rows of a terrain below which a warning names the resolution."""

MANY_PIXELS = 1e9
"""Number of pixels below which files are written without a warning, however empty they are."""
MOSTLY_EMPTY = 0.99
"""Share of empty pixels above which a warning recommends `--sheets`."""

STRETCHED = 1.05
"""Ratio of lengths in the CRS to lengths on the ground, or its inverse, above which a warning
recommends reprojection. Projections for surveys stay within 1.03."""


def warnings_of(plan: Plan) -> list[str]:
    """Return the warnings about inputs that are probably wrong and about costly settings."""
    wkt, (x, y) = plan.frame.crs_wkt, middle(plan.inputs.extent)
    outside = misplaced(wkt, x, y)
    # Far outside the area of use, lengths are distorted as well, for the same reason.
    crs = _stretched(wkt, x, y) if outside is None else [outside]
    return [*_too_high(plan), *crs, *_much_overlap(plan), *_without_use(plan)]


def incomplete_files(plan: Plan) -> list[str]:
    """Warn about damaged files of which points are lost."""
    warnings = []
    for source in plan.inputs.sources:
        if source.unread_points:
            warnings.append(
                f"{source.path}: {counted(source.unread_points, 'record')} behind the {source.points:,} points of its "
                "header look like points and were not read; use --salvage to read them"
            )
        elif source.is_incomplete:
            stated = (
                f"{source.stated_points:,}" if source.stated_points else "an unknown number of"
            )
            warnings.append(
                f"{source.path}: {source.points:,} of {stated} points could be read; "
                "get the file again to have them all"
            )
    return warnings


def _too_high(plan: Plan) -> list[str]:
    units = plan.frame.units
    boxes = [
        (s.path, s.bounds) for s in plan.inputs.sources if s.points and s.bounds is not None
    ]
    warnings = []
    relief = (max(b[5] for _, b in boxes) - min(b[2] for _, b in boxes)) * float(units.vertical)
    if relief > MAX_RELIEF_M:
        warnings.append(
            f"heights span {relief:,.0f} m, more than any terrain; check for noise far from the ground, "
            "or give the unit of z with --units h,v"
        )
    for path, (x0, y0, z0, x1, y1, z1) in boxes:
        side = max(x1 - x0, y1 - y0, 1.0) * float(units.horizontal)
        rise = (z1 - z0) * float(units.vertical)
        if side > MIN_SIDE_M and rise > 2 * side:
            warnings.append(
                f"{path}: rises {rise:,.0f} m over {side:,.0f} m; check for noise, or give the unit of z with "
                "--units h,v"
            )
    return warnings


def _much_overlap(plan: Plan) -> list[str]:
    """Warn about halos that multiply the work. A cloud of unknown kind counts as a LiDAR cloud."""
    steps = steps_of(plan.method.passes, plan.method.kind or "lidar")
    halos = [step.halo_m for step in steps]
    # Joined tiles are also divided to occupy all workers, which costs work but saves time.
    one_worker = replace(plan.method, tile_workers=min(plan.method.tile_workers, 1))
    alone = replace(plan, method=one_worker)
    tile = float(plan.method.tile)
    work = []
    for step in steps:
        if plan.joins(step):
            work.append(overlap_of(alone, [step]))
            continue
        padded = [min(tile + 2 * step.halo_m, side) / min(tile, side) for side in plan.sides_m]
        work.append(math.prod(padded))
    if sum(work) <= MUCH_OVERLAP * len(work):
        return []
    text = (
        f"with up to {max(halos):g} m of halo need {sum(work) / len(work):.1f} times the work"
    )
    if plan.config.tile_size is None:
        memory = f"{plan.method.tile_memory / 2**20:,.0f} MiB"
        return [f"tiles that fit into {memory} of memory, {text}; use more --memory"]
    unit = plan.frame.units.horizontal
    wider = length_option(whole_length(WIDE_TILE * max(halos), unit, math.ceil), unit)
    return [f"tiles of {tile:g} m {text}; leave out --tile-size, or use --tile-size {wider}"]


def _without_use(plan: Plan) -> list[str]:
    """Warn about settings of which the user probably expects something else."""
    warnings = []
    resolution = plan.grid.resolution
    columns, rows = (math.ceil(side / float(resolution)) for side in plan.sides_m)
    if plan.config.pixel is not None and max(columns, rows) < FEW_PIXELS:
        unit = plan.frame.units.horizontal
        warnings.append(
            f"the terrain has only {columns} x {rows} pixels of {length_text(resolution, unit)}; use a smaller "
            "--resolution"
        )
    if plan.config.sheet_name is not None and plan.config.sheets is None:
        warnings.append("--sheet-name has no effect without --sheets")
    cut = plan.config.sheets is not None
    if plan.config.product_name and cut and "{name" not in plan.config.sheet_template:
        warnings.append("--product-name has no effect if --sheet-name has no {name}")
    return warnings


def _stretched(wkt: str | None, x: float, y: float) -> list[str]:
    """Warn about a CRS whose lengths are not those on the ground, such as Web Mercator."""
    scale = None if wkt is None else point_scale_factor(wkt, x, y)
    if scale is None or 1 / STRETCHED < scale < STRETCHED:
        return []
    return [
        f"lengths in the CRS {crs_name(wkt)} are {scale:.2f} times those on the ground here (x {x:,.0f}, y {y:,.0f}), "
        "and the filter does not correct them; reproject the clouds to a CRS for surveys, such as UTM"
    ]


def _is_for_lidar(method: str) -> bool:
    return method in METHODS and METHODS[method].for_lidar


def preflight_warnings(
    config: RunConfig,
    finding: Finding | None,
    density: float,
    halo_m: float | None,
    unit: Fraction = METRE,
) -> Iterator[str]:
    """Yield the warnings that follow from the headers and a sample of the points.

    Parameters
    ----------
    config : RunConfig
    finding : Finding or None
        Source of the clouds; None if the fields of their points do not decide it.
    density : float
        Points per m2.
    halo_m : float or None
        Halo of the method that usually suffices; None if every pass has a fixed radius.
    unit : Fraction
        Metres per horizontal unit of the CRS.
    """
    given = config.source_kind
    if finding is not None and given not in (None, finding.kind) and config.statistics is None:
        yield overridden_kind(config, in_words(finding))
    elif finding is not None and finding.kind == DIM and _is_for_lidar(config.method):
        yield (
            f"the points look like image matching ({finding.why}), but method {config.method} is made for LiDAR; "
            "use --preset dim"
        )
    spacing = 1 / math.sqrt(density)
    if config.pixel is not None and float(config.pixel) < 0.7 * spacing:
        coarser = f"{math.ceil(spacing / float(unit) * 10) / 10:g}"
        if unit != METRE:
            coarser += written_unit(unit)
        yield (
            f"--resolution {length_text(config.pixel, unit)} is finer than the point spacing of "
            f"{spacing / float(unit):.2g} {short_unit(unit)}, so most pixels will be interpolated; use --resolution "
            f"{coarser}"
        )
    if config.halo is not None and halo_m is not None and float(config.halo) < halo_m / 2:
        yield (
            f"--halo {length_text(config.halo, unit)} is too small for method {config.method}, so most tiles will be "
            f"repeated with a wider halo; leave it out, or use --halo {halo_m:g}"
        )


def overridden_kind(config: RunConfig, looks_like: str) -> str:
    """Return the warning that the user gives another kind than the points show."""
    other = "als" if config.kind == "dim" else "dim"
    return (
        f"the points look like {looks_like}; {config.kind_option} overrides that, which loses ground if it is wrong: "
        f"use --kind {other} then"
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
