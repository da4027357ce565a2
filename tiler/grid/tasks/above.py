"""Entries in run.json about places where the terrain lies above all returns."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import Block, RasterSpec
from tiler.core.terrain_results import AbovePlace, AboveResult
from tiler.core.units_text import length_text, small_area_text
from tiler.core.words import counted
from tiler.grid.coarse import join_pieces
from tiler.grid.flaws import ABOVE_M, MIN_PLACE_M2, min_pixels
from tiler.grid.steps import Counts
from tiler.runs.job import Job

MAX_LISTED = 1000
"""run.json lists at most this many places, the worst ones."""


def report_above(job: Job, spec: RasterSpec, of_blocks: Mapping[Block, Counts]) -> None:
    """Add to run.json the places where the terrain lies above all returns, and note them."""
    places = places_of(of_blocks, spec, job.plan.grid.resolution**2)
    pixels = sum(counts["wrong"] for counts in of_blocks.values())
    job.results.above_returns = AboveResult(pixels, len(places), places[:MAX_LISTED])
    if places:
        job.note(_note(job, places))


def places_of(
    of_blocks: Mapping[Block, Counts], spec: RasterSpec, pixel_m2: Fraction
) -> list[AbovePlace]:
    """Join the places of blocks across their sides, leave out small places, and sort by height.

    Parameters
    ----------
    of_blocks : mapping
        Block -> counts of `tiler.grid.flaws.above`.
    spec : RasterSpec
    pixel_m2 : Fraction
        Area of a pixel.
    """
    found = {(block.row, block.col): counts for block, counts in of_blocks.items()}
    sides = {at: counts["sides"] for at, counts in found.items()}
    numbers = {at: counts["labels"] for at, counts in found.items()}
    joined = join_pieces(sides, numbers, corners=True)
    least, places = min_pixels(pixel_m2), []
    for pieces in joined.areas.values():
        parts = [found[piece.row, piece.col]["places"][piece.label - 1] for piece in pieces]
        n_pixels, top, left, bottom, right, heights = zip(*parts, strict=True)
        pixels = int(sum(n_pixels))
        if pixels < least:
            continue
        row, col = int(min(top)), int(min(left))
        block = Block(row, col, int(max(bottom)) - row + 1, int(max(right)) - col + 1)
        bounds = [edge / COUNTS_PER_UNIT for edge in spec.block_bounds(block).to_json()]
        places.append(AbovePlace(pixels, bounds, float(pixels * pixel_m2), max(heights)))
    return sorted(places, key=lambda place: (-place.height_m, -place.pixels, place.bounds))


def _note(job: Job, places: list[AbovePlace]) -> str:
    pixels = sum(place.pixels for place in places)
    units, worst = job.plan.frame.units, places[0]
    west, south, east, north = worst.bounds
    return (
        f"in {counted(pixels, 'pixel')} all returns lie more than {length_text(ABOVE_M, units.vertical)} below the "
        f"terrain, in {counted(len(places), 'place')} of at least "
        f"{small_area_text(float(MIN_PLACE_M2), units.horizontal)}: the terrain is too high there, or the returns are "
        f"noise; worst at x {(west + east) / 2:.0f}, y {(south + north) / 2:.0f}, by "
        f"{length_text(round(worst.height_m, 1), units.vertical)}"
    )
