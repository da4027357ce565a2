"""Warnings about flaws of the finished terrain: remaining roofs, and crowns that were classified as ground."""

from __future__ import annotations

from ptd.matched.crowns import Crowns
from ptd.matched.passes import CanopyPass
from tiler.core.raster import RasterSpec
from tiler.errors import CorruptStoreError, ProcessingError
from tiler.filter.tasks.labelled import Labelled
from tiler.grid.flaws import Advice, crown_advice, find_crowns, find_roofs
from tiler.grid.records import BlockRecord
from tiler.grid.steps import Counts
from tiler.observe.events import Warned
from tiler.runs.job import Job
from tiler.schedule import Task, calling
from tiler.schedule.worker import compute
from tiler.store import Commits

CROWN_BLOCKS = 16
"""One task searches for crowns in this many blocks. A block takes at most half a second."""


def advise(
    job: Job, labelled: Labelled, spec: RasterSpec, made: Commits, waters: str | None
) -> None:
    """Warn about roofs in the terrain, and about crowns in the terrain of a photogrammetric cloud.

    ``waters`` is the key of the bodies of water in the store, if there are any.
    """
    building = job.plan.method.parameters.get("max_building_size_m")
    # A filter that searches for canopies reports crowns itself.
    checks_crowns = labelled.matched and CanopyPass.name not in labelled.statistics
    if not (building or checks_crowns):
        return
    inputs = [building, checks_crowns, waters]
    advice_state = job.store.get_state("advice")
    # The search is repeated if the terrain or the inputs changed, or if an earlier version
    # stored no positions.
    if (
        job.record.stages["grid-dtm"].computed
        or not advice_state
        or advice_state.get("asked") != inputs
        or "at" not in advice_state
    ):
        filled = tuple(
            key for key, (_, stored) in made.items() if BlockRecord.of(stored).filled
        )
        found = [_roofs(job, spec, filled, waters) if building is not None else None]
        found.append(_crowns(job, spec, filled) if checks_crowns else None)
        advices = [advice for advice in found if advice is not None]
        texts = [advice.text for advice in advices]
        positions = [[advice.x, advice.y] for advice in advices]
        advice_state = {"asked": inputs, "texts": texts, "at": positions}
        job.store.put_state("advice", advice_state)
    job.results.advice, job.results.advice_at = advice_state["texts"], advice_state["at"]
    for line in advice_state["texts"]:
        job.listener(Warned(line))


def _roofs(
    job: Job, spec: RasterSpec, filled: tuple[str, ...], waters: str | None
) -> Advice | None:
    parameters = job.plan.method.parameters
    call = calling(
        find_roofs,
        spec=spec,
        filled=filled,
        building_m=parameters["max_building_size_m"],
        roof_m=parameters.get("roof_size_m"),
        waters=waters,
    )
    (counts,) = _run_tasks(job, [Task.of("advice", "roofs", call)])
    advice = counts["advice"]
    return None if advice is None else Advice(*advice)


def _crowns(job: Job, spec: RasterSpec, filled: tuple[str, ...]) -> Advice | None:
    tasks = []
    for i in range(0, len(filled), CROWN_BLOCKS):
        call = calling(find_crowns, spec=spec, names=filled[i : i + CROWN_BLOCKS])
        tasks.append(Task.of("advice", f"crowns{i:06d}", call))
    parts = [Crowns(counts["n_tested"], counts["found"]) for counts in _run_tasks(job, tasks)]
    return crown_advice(parts, spec)


def _run_tasks(job: Job, tasks: list[Task]) -> list[Counts]:
    """Run tasks on workers, and return their counts in the order of the tasks."""
    records = {}
    for outcome in job.executors.choose().run(compute, job.store.url, tasks):
        if outcome.again:
            continue
        if outcome.damaged:
            damaged_text = ", ".join(outcome.damaged)
            raise CorruptStoreError(
                f"{job.store.url}: {damaged_text}: damaged or missing; run again",
                outcome.damaged,
            )
        if outcome.record is None:
            raise ProcessingError(
                f"the search for flaws in the terrain failed: {outcome.error}"
            )
        records[outcome.task.key] = outcome.record
    return [records[task.key] for task in tasks]
