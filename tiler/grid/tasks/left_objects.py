"""Objects left in the terrain and unsure places: their entries in run.json, and notes."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import shapely

from tiler.core.breaklines import area_within
from tiler.core.chances import LEFT, expected_loss
from tiler.core.raster import Block, RasterSpec
from tiler.core.results import LeftObject, UnsurePlace
from tiler.core.units import length_text
from tiler.core.words import counted
from tiler.grid.steps import Counts
from tiler.grid.tasks.findings import MAX_LISTED, bounds_of, rings_around
from tiler.runs.job import Job

LISTED = 0.5
"""Share of an unsure place in objects from which it is not listed again."""


def report_left_objects(
    job: Job, spec: RasterSpec, of_blocks: Mapping[Block, Counts]
) -> list[LeftObject]:
    """Add to run.json the objects that are probably left in the terrain, and note them. Return all of them."""
    pixel_m2 = float(job.plan.grid.resolution**2)
    found = [
        _object(spec, values, pixel_m2)
        for counts in of_blocks.values()
        for values in counts["objects"]
    ]
    found.sort(key=lambda place: (-_loss(place), place.bounds))
    job.results.left_objects = found[:MAX_LISTED]
    if found:
        (west, south, east, north), unit = found[0].bounds, job.plan.frame.units.vertical
        job.note(
            f"{counted(len(found), 'place')} may be objects left in the terrain; the worst is at "
            f"x {(west + east) / 2:.0f}, y {(south + north) / 2:.0f}, "
            f"{length_text(round(found[0].height_m, 1), unit)} above the land around"
        )
    return found


def report_unsure(
    job: Job, spec: RasterSpec, of_blocks: Mapping[Block, Counts], objects: Iterable[LeftObject]
) -> None:
    """Add to run.json the places where the terrain is unsure, and note their number.

    Those are left out of which ``objects`` cover `LISTED` or more.
    """
    pixel_m2 = float(job.plan.grid.resolution**2)
    areas = shapely.STRtree([area_within(left.rings) for left in objects])
    every = [values for counts in of_blocks.values() for values in counts["unsure"]]
    every.sort(key=lambda v: (-v["chance"] * v["error_m"] ** 2 * v["pixels"], v["rectangles"]))
    places = (_unsure(spec, values, pixel_m2) for values in every)
    others = (p for p in places if not _is_covered(area_within(p.rings), areas))
    job.results.unsure = list(itertools.islice(others, MAX_LISTED))
    if job.results.unsure:
        listed = counted(len(job.results.unsure), "place")
        least = "at least " if len(job.results.unsure) == MAX_LISTED else ""
        job.note(f"the terrain is unsure in {least}{listed}, see review.gpkg")


def _is_covered(area: Any, objects: shapely.STRtree) -> bool:
    near = objects.geometries[objects.query(area)]
    return bool(area.intersection(shapely.union_all(near)).area >= LISTED * area.area)


def _loss(place: LeftObject) -> float:
    return expected_loss(LEFT, place.chance, place.height_m, place.area_m2) or 0.0


def _object(spec: RasterSpec, values: Mapping[str, float], pixel_m2: float) -> LeftObject:
    top, left, bottom, right = np.array(values["rectangles"], np.int64).T
    return LeftObject(
        bounds=bounds_of(spec, (top.min(), left.min()), (bottom.max(), right.max())),
        area_m2=values["pixels"] * pixel_m2,
        height_m=values["height_m"],
        steep=values["steep"],
        ground=int(values["ground"]),
        chance=values["chance"],
        rings=rings_around(spec, top, left, bottom, right),
    )


def _unsure(spec: RasterSpec, values: Mapping[str, Any], pixel_m2: float) -> UnsurePlace:
    top, left, bottom, right = np.array(values["rectangles"], np.int64).T
    return UnsurePlace(
        bounds=bounds_of(spec, (top.min(), left.min()), (bottom.max(), right.max())),
        area_m2=values["pixels"] * pixel_m2,
        error_m=values["error_m"],
        gap_m=values["gap_m"],
        slope=values["tilt"],
        objects=values["objects"],
        chance=values["chance"],
        rings=rings_around(spec, top, left, bottom, right),
    )
