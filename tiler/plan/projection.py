"""Estimates, before any point is read, of the memory of a worker and of the work that halos add."""

from __future__ import annotations

import math
from collections.abc import Iterable

from tiler.plan.halos import widest_halo
from tiler.plan.memory import (
    BASE_BYTES,
    EXPORT_BYTES,
    EXPORT_POINTS,
    GROUND_BYTES,
    PlannedPass,
    bucket_bytes,
    elected_peak,
    filter_bytes,
    held_bytes,
    ingest_bytes,
)
from tiler.plan.method import MAX_HALF, expected_passes
from tiler.plan.model import PIECE_POINTS, Plan


def projected_memory(plan: Plan) -> dict[str, int]:
    """Estimate the peak bytes of a worker by stage."""
    ground = (
        int(min(plan.inputs.points, max(plan.block_points, plan.max_part_points)))
        * GROUND_BYTES
    )
    largest = min(max(source.points for source in plan.inputs.sources), EXPORT_POINTS)
    expected = expected_passes(plan.method.passes, plan.method.kind, plan.inputs.density)
    return {
        "ingest": ingest_bytes(PIECE_POINTS, plan.max_bucket_points),
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
    kept_buckets = 0
    if step.pass_.label_margin_m:
        kept_buckets = held_bytes(plan.resources.memory)
    return int(BASE_BYTES + window + bucket_bytes(bucket) + kept_buckets)


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
