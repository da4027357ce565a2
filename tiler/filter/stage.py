"""Stage filter of a run: the passes of the method, one after the other."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ptd.matched.evidence import SURE
from ptd.matched.passes import CanopyPass
from ptd.matched.survey import SurveyPass, run_facts
from ptd.methods import METHODS
from ptd.passes import MethodRefusal, Partial, Pass, State
from ptd.places import PLACES, TABLES, TREES
from tiler.core.records import TileRecord
from tiler.core.results import LabelCounts
from tiler.core.units import in_unit_of_crs
from tiler.errors import ConfigError, ProcessingError
from tiler.filter.reading import FilterTile
from tiler.filter.tasks.passes import (
    PassInputs,
    elected_name,
    filter_tasks,
    label_digests,
    labels_name,
    labels_scope,
    tile_records,
)
from tiler.observe.events import StagesPassedOver
from tiler.plan import KEEP
from tiler.plan.warnings import overridden_kind
from tiler.runs.compiling import filter_kernels, likely_kind
from tiler.runs.found import MATCHED, CanopyCells, IngestResult, Labelled
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task


def filter_points(job: Job, assembled: IngestResult) -> Labelled:
    """Run the passes of the method. Return the labels and the results of the passes."""
    if job.plan.config.method == KEEP:
        return Labelled.of(job.plan.config, assembled.digests, {})
    passes = METHODS[job.plan.config.method].params(**job.plan.method.parameters).passes
    # An earlier run may have used a method with more passes. The commits of the additional
    # passes are removed, because the labels of those passes may be overwritten.
    max_passes = max(job.store.get_state("passes") or 0, len(passes))
    job.store.put_state("passes", max_passes)
    for number in range(len(passes), max_passes):
        job.store.clear(f"filter{number}")
    config, known_states = job.plan.config, job.plan.method.statistics
    sigma = None if config.sigma is None else float(config.sigma)
    facts = run_facts(sigma, config.source_kind, job.plan.inputs.evidence)
    state: State = {"run": dataclasses.asdict(facts)}
    pass_inputs = PassInputs(assembled.digests)
    statistics: dict[str, State] = {}
    job.results.statistics = statistics
    has_written, last_pass = False, ""
    for number, step in enumerate(passes):
        if not step.applies(state):
            continue
        if last_pass:
            raise ValueError(
                f"method {config.method}: {step.name} applies, although {last_pass} gave the final labels"
            )
        if (step.elects or step.gives_labels) and not has_written:
            has_written = True
            _clear_passed_over(job, passes, state)
            passed_over = [
                f"filter{n}" for n, other in enumerate(passes) if not other.applies(state)
            ]
            job.listener(StagesPassedOver(passed_over))
        tasks = list(filter_tasks(job.plan, assembled, number, state, pass_inputs))
        kind = state["survey"]["kind"] if "survey" in state else likely_kind(job.plan)
        filtered = run_stage(job, f"filter{number}", tasks, filter_kernels(config.method, kind))
        if not filtered:
            raise ProcessingError(
                f"no tile could be filtered; the first error: {job.record.first_error(f'filter{number}')}"
            )
        if step.elects or step.gives_labels:
            is_last, candidates_only = labels_scope(job.plan, number, state)
            for task in tasks:
                if task.key not in filtered:
                    _write_empty_results(job, task, step, pass_inputs)
            pass_inputs = pass_inputs.after(
                number, step, is_last, candidates_only, assembled, filtered
            )
            last_pass = step.name if is_last else ""
        if step.gives_labels:
            job.results.filter = _label_counts(job, list(tile_records(filtered)), len(tasks))
        partials = (tile.partial for tile in tile_records(filtered))
        if known_states is None:
            state_after = _reduced(job, step, partials, state)
        else:
            state_after = _known_state(job, step, state)
        recorded = _without_known_places(state_after, state)
        job.store.put_state(f"after-{step.name}", recorded)
        statistics[step.name] = recorded
        state = state_after
        if step.name == SurveyPass.name:
            _warn_of_doubtful_kind(job, state["survey"])
    canopy = _canopy_cells(job, assembled, passes, statistics)
    return Labelled.of(config, pass_inputs.digests, statistics, canopy)


def _canopy_cells(
    job: Job, assembled: IngestResult, passes: Sequence[Pass], statistics: Mapping[str, State]
) -> CanopyCells | None:
    """Return where the store has the cells of the canopy search, or None if the filter found no canopy."""
    state = statistics.get(CanopyPass.name)
    if state is None or not state["canopy"]["share"]:
        return None
    number = next(n for n, step in enumerate(passes) if step.name == CanopyPass.name)
    # The cells of the search were elected by the last electing pass before it.
    electing = max(
        n for n, step in enumerate(passes[:number]) if step.elects and step.applies(state)
    )
    made, blocks = job.store.committed(f"filter{number}"), Counter[tuple[int, int]]()
    for tile in tile_records(made):
        for column, row, area_m2 in tile.partial["blocks"]:
            blocks[column, row] += area_m2
    digests = label_digests(assembled, made)
    return CanopyCells(elected_name(electing), labels_name(number), digests, blocks)


def _clear_passed_over(job: Job, passes: Sequence[Pass], state: State) -> None:
    """Remove the commits of passes that do not apply in this run, because their results may be overwritten."""
    for number, step in enumerate(passes):
        if not step.applies(state):
            job.store.clear(f"filter{number}")


def _without_known_places(state_after: State, state: State) -> State:
    """Return the state after a pass. Omit the tables of places that the state before the pass has.

    So a table, which may have a million places, is stored only once.
    """
    return {
        name: value
        for name, value in state_after.items()
        if name not in TABLES or name not in state
    }


def _known_state(job: Job, step: Pass, state: State) -> State:
    """Return the state after a pass as recorded in the file of ``--statistics``."""
    state_after: State | None = (job.plan.method.statistics or {}).get(step.name)
    if state_after is None and type(step).reduce is Pass.reduce:
        return state
    if state_after is None:
        raise ConfigError(
            f"--statistics {job.plan.config.statistics}: has no results of the pass {step.name}; use the --kind "
            "of the run that wrote it"
        )
    if step.name == SurveyPass.name and PLACES not in state_after:
        raise ConfigError(
            f"--statistics {job.plan.config.statistics}: was written by an earlier version, which did not measure "
            "density and noise in each place; repeat that run with this version"
        )
    if state_after.get("canopy", {}).get("share") and TREES not in {**state, **state_after}:
        raise ConfigError(
            f"--statistics {job.plan.config.statistics}: was written by an earlier version, which did not measure "
            "the height of trees in each place; repeat that run with this version"
        )
    state_after = {**{name: state[name] for name in TABLES if name in state}, **state_after}
    kind = job.plan.config.source_kind
    if kind is not None and state_after.get("run", {}).get("kind") != kind:
        job.note(
            f"--statistics: the kind of the clouds is taken from there; --kind {job.plan.config.kind} is not used"
        )
    return state_after


def _reduced(job: Job, step: Pass, partials: Iterable[Partial], state: State) -> State:
    """Return the state after a pass. Write the new notes of the pass to the log."""
    try:
        state_after = step.reduce(partials, state)
    except MethodRefusal as error:
        text = in_unit_of_crs(str(error), job.plan.frame.units)
        raise ConfigError(f"--method {job.plan.config.method}: {text}") from error
    for text in state_after.get("notes", [])[len(state.get("notes", [])) :]:
        job.note(text)
    return state_after


def _warn_of_doubtful_kind(job: Job, survey: Mapping[str, Any]) -> None:
    """Warn if the kind of the clouds is doubtful, because all later passes depend on the kind."""
    sure, looks_like = survey.get("sure"), survey.get("looks_like")
    if looks_like is not None and job.plan.method.statistics is None:
        text = overridden_kind(job.plan.config, looks_like)
    elif sure is not None and sure < SURE:
        other = "als" if survey["kind"] == MATCHED else "dim"
        words = {"lidar": "laser scanning", MATCHED: "image matching"}[survey["kind"]]
        text = (
            f"it is only {100 * sure:.0f} % sure that the clouds are from {words}; "
            f"use --kind {other} if they are not"
        )
    else:
        return
    job.doubt(text)


def _write_empty_results(job: Job, task: Task, step: Pass, inputs: PassInputs) -> None:
    """Write empty results for a tile that failed, so that no results of an earlier run remain."""
    work: FilterTile = task.arguments["work"]
    buckets = job.store.buckets_within(job.plan.buckets.hull(work.cells))
    for cell in work.cells:
        if work.elected_out is not None:
            job.store.write_elected(work.elected_out, cell, np.zeros((3, 0), np.int32))
            if step.gives_labels:
                job.store.write_elected_labels(work.labels_out, cell, np.zeros(0, np.uint8))
        elif work.labels_elected:
            labels = np.zeros(inputs.n_elected[cell], np.uint8)
            job.store.write_elected_labels(work.labels_out, cell, labels)
        else:
            bucket = buckets[cell]
            labels = np.zeros(
                bucket.n_candidates if work.candidates_only else bucket.n, np.uint8
            )
            job.store.write_labels(work.labels_out, cell, labels, work.candidates_only)


def _label_counts(job: Job, records: list[TileRecord], tiles: int) -> LabelCounts:
    core_area = sum(record.core_area for record in records)
    counts = LabelCounts(
        points=sum(record.points for record in records),
        ground=sum(record.ground for record in records),
        low_noise=sum(record.low_noise for record in records),
        unclassified=sum(record.unclassified for record in records),
        kept=sum(record.kept for record in records),
        marked=sum(record.marked for record in records),
        tiles=tiles,
        tiles_done_again=sum(record.tries > 1 for record in records),
        overlap_work=sum(record.window_area for record in records) / max(core_area, 1),
    )
    if counts.marked:
        job.note(
            f"{counts.marked:,} labels are not certified: points beyond the widest halo could change them; "
            "use a larger --halo"
        )
    return counts
