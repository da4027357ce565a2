"""Tasks that find where each of several surveys has points, and what follows for the buckets (`tiler.core.surveys`)."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np

from ptd.arrays import Int64
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.records import BucketRecord
from tiler.core.results import SurveyResult, SurveyStep
from tiler.core.surveys import CELL_M, REACH_M, CellMask, survey_cells_of
from tiler.ingest.assemble import BucketParts
from tiler.ingest.coverage import Outranked
from tiler.ingest.surveys import BINS_PER_M, Sources, find_surveys
from tiler.ingest.tasks.points import group_tasks, sources_in
from tiler.plan import Plan
from tiler.schedule import Task, calling
from tiler.schedule.task import Call
from tiler.store import Commits

Surveys = Mapping[int, int]
"""Number of each source's survey by the number of the source. The survey with the lowest number counts most."""


def survey_tasks(
    plan: Plan, spooled: Commits, buckets: Iterable[BucketParts], surveys: Surveys
) -> Iterator[Task]:
    """Yield a task per group of neighbouring buckets."""

    def call(group: tuple[BucketParts, ...]) -> Call:
        of_buckets = tuple(tuple(_in_bucket(bucket, surveys).values()) for bucket in group)
        return calling(find_surveys, buckets=group, surveys=of_buckets)

    return group_tasks("surveys", plan, spooled, buckets, call)


def _in_bucket(bucket: BucketParts, surveys: Surveys) -> dict[int, Sources]:
    """Return the sources in a bucket by the number of their survey, in ascending order."""
    sources: dict[int, list[int]] = defaultdict(list)
    for source in sorted(sources_in(bucket.fragments)):
        sources[surveys[source]].append(source)
    return {number: tuple(sources[number]) for number in sorted(sources)}


@dataclass
class FoundSurveys:
    """Results of the tasks of `survey_tasks` in all buckets.

    Attributes
    ----------
    masks : mapping of Cell to mapping of int to CellMask
        Cells of each survey in each bucket, by the number of the survey.
    cells : Counter of int
        Number of cells with points of each survey.
    differences : mapping of (int, int) to Counter of int
        Histogram of the heights of the second survey above the first one.
    """

    masks: dict[Cell, dict[int, CellMask]] = field(default_factory=dict)
    cells: Counter[int] = field(default_factory=Counter)
    differences: dict[tuple[int, int], Counter[int]] = field(
        default_factory=lambda: defaultdict(Counter)
    )


def found_surveys(
    commits: Commits, buckets: Sequence[BucketParts], surveys: Surveys
) -> FoundSurveys:
    """Return what the tasks found, with the numbers of the surveys."""
    found = FoundSurveys()
    parts = {bucket.cell: bucket for bucket in buckets}
    for _, stored in commits.values():
        for bucket in stored["buckets"]:
            cell = Cell(*bucket["cell"])
            numbers = list(_in_bucket(parts[cell], surveys))
            masks = map(CellMask.of, bucket["masks"])
            found.masks[cell] = dict(zip(numbers, masks, strict=True))
            found.cells.update(dict(zip(numbers, bucket["numbers"], strict=True)))
            for i, j, bins, counts in bucket["differences"]:
                histogram = found.differences[numbers[i], numbers[j]]
                histogram.update(dict(zip(bins, counts, strict=True)))
    return found


def with_outranked(
    plan: Plan, buckets: Iterable[BucketParts], found: FoundSurveys, surveys: Surveys
) -> Iterator[BucketParts]:
    """Yield the buckets with their outranked surveys, those near which a survey counts more."""
    lattice = survey_cells_of(plan.frame)
    reach = math.ceil(plan.frame.counts(Fraction(REACH_M)))
    for bucket in buckets:
        of_bucket = _in_bucket(bucket, surveys)
        around = plan.buckets.bounds(bucket.cell).pad(reach)
        near = plan.buckets.among(around, found.masks)
        window = _cells_in(lattice, around)
        outranked = []
        for number, sources in of_bucket.items():
            above = (
                mask
                for cell in near
                for other, mask in found.masks[cell].items()
                if other < number
            )
            if cells := CellMask.united(above, *window):
                outranked.append(Outranked(sources, cells))
        yield replace(bucket, outranked=tuple(outranked)) if outranked else bucket


def _cells_in(lattice: Lattice, bounds: Bounds) -> tuple[int, int, int, int]:
    """Return column and row of the first cell that touches the bounds, and the numbers of columns and rows."""
    column, row = lattice.index_of(bounds.x0), lattice.index_of(bounds.y0)
    return column, row, lattice.end_of(bounds.x1) - column, lattice.end_of(bounds.y1) - row


def survey_results(
    plan: Plan,
    found: FoundSurveys,
    records: Iterable[BucketRecord],
    surveys: Surveys,
    stored: Mapping[int, int],
) -> list[SurveyResult]:
    """Return the results of each survey, the one that counts most first.

    Parameters
    ----------
    plan : Plan
    found : FoundSurveys
    records : iterable of BucketRecord
    surveys : mapping of int to int
    stored : mapping of int to int
        Number of stored points of each source.
    """
    points, hidden, hidden_cells = Counter[int](), Counter[int](), Counter[int]()
    for source, n_points in stored.items():
        points[surveys[source]] += n_points
    for record in records:
        for source, n_points, n_cells in record.outranked or ():
            hidden[surveys[source]] += n_points
            hidden_cells[surveys[source]] += n_cells
    return [
        SurveyResult(
            name=survey.name,
            first=survey.days and survey.days[0].isoformat(),
            last=survey.days and survey.days[1].isoformat(),
            files=len(survey.paths),
            points=points[number],
            used=points[number] - hidden[number],
            density=points[number] / max(found.cells[number] * CELL_M**2, 1),
            area_m2=float((found.cells[number] - hidden_cells[number]) * CELL_M**2),
            steps=[
                _step(plan.inputs.surveys[other].name, histogram)
                for (other, upper), histogram in sorted(found.differences.items())
                if upper == number
            ],
        )
        for number, survey in enumerate(plan.inputs.surveys)
    ]


def _step(other: str, histogram: Counter[int]) -> SurveyStep:
    bins, counts = np.array(sorted(histogram.items()), np.int64).T
    median = _median(bins, counts)
    order = np.argsort(abs(bins - median), kind="stable")
    spread = _median(abs(bins - median)[order], counts[order])
    return SurveyStep(other, median / BINS_PER_M, spread / BINS_PER_M, int(counts.sum()))


def _median(values: Int64, counts: Int64) -> int:
    """Return the lower median of ascending values, each of which occurs several times."""
    total = np.cumsum(counts)
    return int(values[np.searchsorted(total, (total[-1] + 1) // 2)])
