"""Places to review: from the problems of a run, and from the rows of an earlier file on which the user decided."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import shapely

from tiler.core.breaklines import area_within
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.results import ReviewResult
from tiler.core.review import (
    BARE,
    FIXED,
    HOLES,
    LEAST_SIDE_M,
    NUMBERS,
    STATUSES,
    TEXTS,
    ReviewRow,
    decided_or_noted,
    is_place,
    without_copies,
)
from tiler.core.words import counted
from tiler.errors import InputError
from tiler.export.output_files import OutFile, ReviewFileRecord
from tiler.export.review import DeliveredTerrain, write_review
from tiler.export.tasks.outdated import archive
from tiler.export.tasks.sheets import name_of, sheet_finder
from tiler.io.locations import is_url, joined, state_at
from tiler.io.overwrite_check import same_file
from tiler.io.result_folder import REVIEW
from tiler.io.vector import CUT, POLYGONS, Feature, read_in_crs
from tiler.io.vector.opening import IN_USE
from tiler.observe.events import Note, Warned
from tiler.report.problems import AT_BORDER, INSIDE, WITHOUT_RETURNS, Problem
from tiler.runs.found import Gridded, final_raster
from tiler.runs.job import Job
from tiler.schedule import Task, call_isolated, calling

PIXELS = {WITHOUT_RETURNS: BARE, INSIDE: HOLES, AT_BORDER: HOLES}
"""Pixels that form a place, by the kind of the problem."""


def review_task(job: Job, gridding: Gridded, out: str) -> Task:
    """Return the task that writes the places to review."""
    sheet_at = sheet_finder(gridding.sheets)
    found = []
    for problem in job.problems():
        if problem.where is not None:
            west, south, east, north = problem.where
            sheet = sheet_at(*(problem.at or ((west + east) / 2, (south + north) / 2)))
            name = "" if sheet is None else name_of(gridding, "dtm", sheet)
            found.append(_row(problem, gridding, name))
    terrain, seen = None, []
    if any(row.pixels for row in found):
        raster, area = final_raster("dtm", gridding.plan.config), gridding.plan.inputs.area_key
        waters = gridding.waters.stored_key
        terrain = DeliveredTerrain(raster, gridding.spec, gridding.coarse, waters, area)
        seen = [gridding.checksums("survey"), gridding.checksums(raster)]
    call = calling(
        write_review,
        to=OutFile(out, REVIEW),
        found=tuple(found),
        decided=tuple(_decided(job)),
        terrain=terrain,
    )
    return Task.of("export", REVIEW, call, seen)


def report_review(job: Job) -> None:
    """Add the numbers of places to review to run.json."""
    if commit := job.store.committed("export").get(REVIEW):
        record = ReviewFileRecord.of(commit[1])
        job.results.review = ReviewResult(record.open, record.ok, record.fixed)
        job.results.found_right = record.right


def _row(problem: Problem, gridding: Gridded, sheet: str) -> ReviewRow:
    """Return the row of a problem that has a position. ``sheet`` is the terrain's sheet that its middle lies in."""
    unit = float(gridding.plan.frame.units.horizontal)
    side, area_m2 = LEAST_SIDE_M / unit, problem.area_m2
    if problem.rings:
        shape = area_within(problem.rings)
    else:
        west, south, east, north = problem.where or (0.0, 0.0, 0.0, 0.0)
        if area_m2 is None and west < east:
            area_m2 = (east - west) * (north - south) * unit**2
        across, along = max(side - (east - west), 0) / 2, max(side - (north - south), 0) / 2
        shape = shapely.box(west - across, south - along, east + across, north + along)
    parts = shapely.MultiPolygon(shapely.get_parts(shapely.normalize(shape)).tolist())
    return ReviewRow(
        shape=shapely.to_wkb(parts, hex=True),
        reason=problem.what,
        why=problem.why,
        remedy=problem.remedy,
        action=problem.action,
        stake_m=problem.stake_m,
        area_m2=area_m2,
        chance=problem.chance,
        sheet=sheet,
        pixels=PIXELS.get(problem.what, ""),
        where=problem.where or (),
    )


def _decided(job: Job) -> list[ReviewRow]:
    """Return the rows that the user decided on or noted, of the file in OUT and of one that is given with ``--edits``.

    A file in OUT that cannot be read is moved, and one with columns of the user is copied, so that nothing is lost.
    Raise InputError if another program has locked the file.
    """
    given, here = job.plan.config.edits, joined(job.products, REVIEW)
    rows = decided_or_noted(_rows(job, given)) if given is not None else []
    is_given = given is not None and same_file(given, here)
    edits = rows if is_given else _in_survey(job, rows)
    if is_url(here) or state_at(here) is None:
        return edits
    try:
        places = _read(job, here)
        if not is_given and any(not is_place(p.layer, p.attributes) for p in places):
            raise InputError(f"{here}: has no layer of places to review")
    except InputError as error:
        if IN_USE in str(error):
            raise
        text = f"{error}; moved to {archive(job, [REVIEW])}/, so its statuses are not used"
        job.listener(Warned(text))
        return edits
    _keep_other_columns(job, places)
    if is_given:
        return edits
    decided = without_copies(decided_or_noted([_row_of(place) for place in places]), rows)
    unknown = sorted({row.status for row in decided} - set(STATUSES))
    if unknown:
        job.listener(
            Warned(f"{here}: unknown status {unknown[0]!r}; give one of {', '.join(STATUSES)}")
        )
    if unused := [row for row in decided if row.status == FIXED]:
        number = counted(len(unused), "fixed place")
        remedy = f"use --edits {here}" if given is None else f"copy them into {given}"
        job.listener(Warned(f"{here}: {number} not among the edits of this run; {remedy}"))
    return [*decided, *edits]


def _in_survey(job: Job, rows: Sequence[ReviewRow]) -> list[ReviewRow]:
    """Return the rows inside the extent of the clouds, with a note on the others, which are of another survey."""
    survey = shapely.box(*(v / COUNTS_PER_UNIT for v in job.plan.inputs.extent.to_json()))
    inside = [row for row in rows if shapely.intersects(survey, shapely.from_wkb(row.shape))]
    if n_outside := len(rows) - len(inside):
        number = counted(n_outside, "place")
        verb = "lies" if n_outside == 1 else "lie"
        job.note(
            f"{job.plan.config.edits}: {number} of it {verb} outside the survey, so {REVIEW} does not list "
            f"{'it' if n_outside == 1 else 'them'}",
            Note,
        )
    return inside


def _keep_other_columns(job: Job, places: Sequence[Feature]) -> None:
    """Copy the file in OUT if the user added columns, since the new file does not have them."""
    own = {"rank", *TEXTS, *NUMBERS}
    added = sorted({name for place in places for name in place.attributes} - own)
    if added:
        folder = archive(job, [REVIEW], copies=True)
        job.note(
            f"{REVIEW}: the columns {', '.join(added)} are in {folder}/{REVIEW} and not in the new file; "
            "texts in the column `note` stay",
            Note,
        )


def _rows(job: Job, name: str) -> list[ReviewRow]:
    """Return the places to review in a file."""
    features = _read(job, name) if state_at(name) else ()
    return [_row_of(f) for f in features if is_place(f.layer, f.attributes)]


def _read(job: Job, name: str) -> tuple[Feature, ...]:
    arguments = (Path(name), POLYGONS, job.plan.frame.crs_wkt, True, False, True)
    if job.plan.config.in_process:
        return read_in_crs(*arguments).features
    drawing = call_isolated(read_in_crs, *arguments, paths=(Path(name),), smaller=CUT)
    return drawing.features


def _row_of(feature: Feature) -> ReviewRow:
    """Return the row of a feature. A column that the user removed, or changed to another type, is empty."""
    parts = shapely.MultiPolygon(shapely.get_parts(feature.geometry).tolist())
    values: dict[str, Any] = {}
    for name in TEXTS:
        text = feature.attributes.get(name)
        values[name] = text if isinstance(text, str) else ""
    for name in NUMBERS:
        number = feature.attributes.get(name)
        values[name] = float(number) if isinstance(number, int | float) else None
    return ReviewRow(shape=shapely.to_wkb(parts, hex=True, output_dimension=2), **values)
