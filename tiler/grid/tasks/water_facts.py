"""Entries about water in run.json and the log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.map_lines import rings_of_areas
from tiler.core.terrain_results import Doubt, StationResult, WaterResult
from tiler.core.units_text import length_text
from tiler.core.water import RIVER, Station, Water, Waters, lengths_along
from tiler.core.words import listed
from tiler.grid.records import LevelRecord
from tiler.grid.water_level import NOISE_M
from tiler.observe.events import Warned
from tiler.runs.job import Job
from tiler.store import Commits

MIN_CONFIDENCE = 0.8
"""A body of water with a confidence below this causes a warning."""
MAX_FLOATING = 0.005
"""A body of water causes a warning if more than this share of its shore lies below its
level."""


def report_levels(job: Job, waters: Waters, records: Mapping[int, LevelRecord]) -> None:
    """Report the rivers whose levels are known at too few positions, and warn about bodies that need to be checked.

    Parameters
    ----------
    job : Job
    waters : Waters
    records : mapping
        Record of each body by its number. Bodies with a given level have none.
    """
    unit = job.plan.frame.units.vertical
    doubts: list[Doubt] = []
    level: list[str] = []
    for body in waters.bodies:
        record = records.get(body.number)
        if body.kind == RIVER and body.flow is None and record is not None:
            level.append(_named(body))
        doubts += _doubts(body, record, unit)
    if level:
        job.note(
            f"decided: level water, as heights are known at fewer than two positions along it: {listed(level, 5)}"
        )
    job.results.water_doubts = doubts
    for doubt in doubts:
        job.listener(Warned(doubt.text))


def _doubts(body: Water, record: LevelRecord | None, unit: Fraction) -> list[Doubt]:
    """Return warnings about a body of water, each with a text and a position (x, y)."""
    doubts: list[tuple[str, tuple[float, float]]] = []
    if body.confidence is not None and body.confidence < MIN_CONFIDENCE:
        text = (
            f"{_named(body)} is water with {body.confidence:.0%} certainty; check it, and if it is not water delete it "
            "from water.gpkg and give that file with --water"
        )
        doubts.append((text, _first_vertex(body)))
    share, lowest = (0.0, None) if record is None else record.floating
    if share > MAX_FLOATING and lowest is not None:
        x, y = (value / COUNTS_PER_UNIT for value in lowest)
        text = (
            f"{_named(body)}: {share:.1%} of its shore lies more than {length_text(NOISE_M, unit)} below its level, "
            f"the lowest at ({x:.1f}, {y:.1f}); check its level and its outline there (edit water.gpkg and give it "
            "with --water)"
        )
        doubts.append((text, (x, y)))
    if record is not None and record.uneven:
        text = (
            f"{_named(body)}: its returns differ in height by more than waves, as if from two flight strips; the lower "
            "level is used (to change it, set `level` in water.gpkg and give it with --water)"
        )
        doubts.append((text, _first_vertex(body)))
    return [Doubt(text, list(position)) for text, position in doubts]


def _first_vertex(body: Water) -> tuple[float, float]:
    """Return the first vertex of the outline of a body in units of the CRS."""
    x, y = body.area.polygons[0][0][0].tolist()
    return x / COUNTS_PER_UNIT, y / COUNTS_PER_UNIT


def _named(body: Water) -> str:
    x, y = _first_vertex(body)
    return f"{body.kind} {body.number} at ({x:.1f}, {y:.1f})"


def report_waters(job: Job, waters: Waters, terrain: Commits) -> None:
    """Add the bodies of water to run.json, each with its number of pixels of the terrain."""
    pixels: dict[str, int] = {}
    for _, counts in terrain.values():
        for area, count in counts["water"]:
            pixels[area] = pixels.get(area, 0) + count
    pixel_m2 = float(job.plan.grid.resolution) ** 2
    rings = rings_of_areas([body.area for body in waters.bodies])
    job.results.water = [
        replace(_result(body, pixels.get(body.area.key, 0), pixel_m2), rings=rings_of_body)
        for body, rings_of_body in zip(waters.bodies, rings, strict=True)
    ]


def _result(body: Water, pixels: int, pixel_m2: float) -> WaterResult:
    high, low = body.range
    return WaterResult(
        number=body.number,
        kind=body.kind,
        level=high,
        level_end=low,
        pixels=pixels,
        area_m2=pixels * pixel_m2,
        sure=body.confidence,
        bounds=[v / COUNTS_PER_UNIT for v in body.area.bounds.to_json()],
        stations=_stations(body),
    )


def _stations(body: Water) -> list[StationResult]:
    """Return the stations of a river, in units of the CRS."""
    import numpy as np

    if not body.stations:
        return []
    along = lengths_along(np.array([station[:2] for station in body.stations]))
    return [_station(s, float(a)) for s, a in zip(body.stations, along, strict=True)]


def _station(station: Station, along: float) -> StationResult:
    left, right = (
        None if z is None else z / COUNTS_PER_UNIT for z in (station.left, station.right)
    )
    level = station.level / COUNTS_PER_UNIT
    return StationResult(along / COUNTS_PER_UNIT, station.seen, level, left, right)
