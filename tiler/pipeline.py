"""The whole job, in order: plan, ingest (spool, assemble), filter, grid, export, run.json. Read this page first."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from ptd.methods import METHODS
from ptd.passes import MethodRefusal, Pass, RunFacts, State
from ptd.warm import warm_filters
from tiler.config import RunConfig
from tiler.core.lattice import Cell
from tiler.errors import ConfigError, DamagedError, InputError, ProcessingError
from tiler.healing import ROUNDS, heal
from tiler.job import Commits, Job, RunResult
from tiler.observe.eventlog import EventLog
from tiler.observe.events import Listener, combine, silent
from tiler.places import is_url, joined, open_cloud, put_file
from tiler.plan import KEEP, Plan, crs_name, make_plan, refuse, remember
from tiler.rasters import export, grid
from tiler.report import earlier_outputs
from tiler.report.html import NAME as REPORT
from tiler.report.html import write_report
from tiler.schedule import Task
from tiler.store import BucketInfo, TileStore, create_store, open_store, remove_store, store_exists
from tiler.tasks import (
    Assembled,
    Source,
    assemble_tasks,
    filter_tasks,
    fragments_of,
    label_digests,
    spool_tasks,
    strays_of,
)

STAGES = ("ingest", "filter", "grid", "export")
RUN, EVENTS = "run.json", "events.jsonl"
HASH_PIECE = 1 << 22


def run(
    inputs: Sequence[str],
    out: str | Path,
    config: RunConfig | None = None,
    listener: Listener = silent,
    until: str = "export",
) -> RunResult:
    """Clouds to terrain; goes on with what ``out`` holds.

    Parameters
    ----------
    inputs : sequence of str
        Files, folders, globs.
    out : path
        Folder of the results, made if it is not there; or a URL, whose last name is then that of a folder here for
        run.json, the log and the report.
    config : RunConfig
    listener : callable
        Told what happens, see `tiler.observe.events`.
    until : str
        Last stage to do: ``ingest``, ``filter``, ``grid`` or ``export``.

    Raises
    ------
    TilerError
        With the exit code of the command; nothing that was finished is lost.
    """
    if until not in STAGES:
        raise ConfigError(f"no stage {until!r}; there are {', '.join(STAGES)}")
    config, products = config or RunConfig(), str(out)
    out = Path(products.rstrip("/").rpartition("/")[2] if is_url(products) else products)
    started = time.monotonic()
    plan = make_plan(inputs, config, None if is_url(products) else out)
    _make_folder(out)
    if not is_url(products):
        products = str(out.resolve())  # workers have folders of their own
    url = config.store or joined(products, "store.zarr")
    if config.overwrite:
        remove_store(url)
    plan, store = _frozen(plan, url)
    with store.lock() as lease, _copied(out, products), EventLog(out / EVENTS) as log:
        job = Job(plan, out, products, store, combine(listener, log), lease=lease)
        result = _locked_run(job, until, started)
    if config.clean_store and until == "export":
        remove_store(url)
    return result


@contextmanager
def _copied(out: Path, products: str) -> Iterator[None]:
    """Copy run.json, the log and the report to where the products are, if that is a URL, however the run ends."""

    def copy() -> None:
        for path in (out / name for name in (RUN, EVENTS, REPORT)) if is_url(products) else ():
            if path.is_file():
                put_file(path, joined(products, path.name))

    try:
        yield
    except BaseException:
        with suppress(ProcessingError):  # what ended the run is told
            copy()
        raise
    copy()


def _locked_run(job: Job, until: str, started: float) -> RunResult:
    """The run itself, by the one process that holds the store."""
    plan, listener = job.plan, job.listener
    for text in plan.notes:
        listener("note", {"text": text})
    for text in plan.warnings:
        listener("warning", {"text": text})
    if is_url(job.products):
        job.note(
            f"{RUN}, {EVENTS} and {REPORT} are in {job.out}/; copies go to {job.products} when the run ends"
        )
    job.facts["earlier_outputs"] = earlier_outputs(job.out)
    try:
        _healing_stages(job, until)
    except BaseException:
        with suppress(ProcessingError):  # a full disk refuses this as well: what ended the run is told
            job.save("interrupted")
        raise
    finally:
        job.crew.close()
    if until != "export" and job.computed and job.facts["earlier_outputs"]:
        job.note(
            f"files in {job.products} are those of an earlier run until `tiler export` or `tiler run` writes them anew"
        )
    job.facts["seconds"] = round(time.monotonic() - started, 3)
    remember(plan, job.stages)
    summary = _report(job)
    listener("run_finished", {"seconds": job.facts["seconds"]})
    return RunResult(5 if job.quarantined or job.failed else 0, summary, job.computed == 0)


def _report(job: Job) -> dict[str, Any]:
    """Save run.json, and draw it for people; what it says. A report that fails leaves a finished run finished."""
    job.facts["report"] = REPORT
    summary = job.save("done")
    try:
        write_report(job.out, summary)
    except Exception as error:  # noqa: BLE001 - whatever it is: the results are there
        text = f"{REPORT} could not be drawn: {error}; `tiler report {job.out}` tries again"
        job.listener("warning", {"text": text})
        job.notes.append(text)
        job.facts["report"] = None
        summary = job.save("done")
    return summary


def _healing_stages(job: Job, until: str) -> None:
    """The stages, and again what wrote objects of the store that turn out to be damaged."""
    for number in range(ROUNDS + 1):
        job.failed, job.quarantined = [], [{"path": p, "error": e} for p, e in job.plan.unreadable]
        try:
            _stages(job, until)
            return
        except DamagedError as damage:
            if number == ROUNDS or not damage.keys:
                raise
            heal(job, damage.keys)


def _stages(job: Job, until: str) -> None:
    """The order of things."""
    sources = _numbered(job)
    spooled, sources = _spool(job, sources)
    assembled = _assemble(job, sources, spooled)
    if until == "ingest":
        return
    labels = _filter(job, assembled)
    if until == "filter":
        return
    gridding = grid(job, assembled, labels)
    if until == "grid":
        return
    export(job, gridding, sources, spooled, labels)


def _numbered(job: Job) -> list[Source]:
    """Sources with a number that stays theirs in this store, and the digest of their bytes."""
    known: dict[str, dict[str, Any]] = job.store.get_state("sources") or {}
    sources = []
    for info in job.plan.sources:
        path = str(info.path.resolve())
        entry = known.get(path, {"number": len(known)})
        stamp = [info.size, info.mtime_ns, info.digest]
        if entry.get("stamp") != stamp or job.plan.config.verify:
            entry = {**entry, "stamp": stamp, "content": _content_digest(info.path)}
        known[path] = entry
        if info.points:
            sources.append(Source(info, entry["number"], entry["content"]))
    job.store.put_state("sources", known)
    return sources


def _content_digest(path: Path) -> str:
    digest = hashlib.blake2b(digest_size=16)
    try:
        with open_cloud(path) as stream:
            while part := stream.read(HASH_PIECE):
                digest.update(part)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror or error}); see to the disk and its rights"
        ) from error
    return digest.hexdigest()


def _spool(job: Job, sources: list[Source]) -> tuple[Commits, list[Source]]:
    """Decode; a source with a piece that failed is left out whole."""
    spooled = job.perform("spool", spool_tasks(job.plan, sources))
    bad = {f["key"][:7]: f["error"] for f in job.failed if f["stage"] == "spool"}
    job.failed = [f for f in job.failed if f["stage"] != "spool"]
    good = [s for s in sources if f"s{s.number:06d}" not in bad]
    for source in sources:
        error = bad.get(f"s{source.number:06d}")
        if error is not None:
            job.quarantined.append({"path": str(source.info.path), "error": error})
            job.listener("warning", {"text": f"{source.info.path}: left out: {error}"})
    spooled = {k: c for k, c in spooled.items() if k[:7] not in bad}
    if not good:
        raise InputError(f"no input could be read; the first: {job.quarantined[0]['error']}")
    records = [record for _, record in spooled.values()]
    dropped: Counter[str] = Counter()
    for record in records:
        dropped.update(record["dropped"])
    read, stored = sum(r["read"] for r in records), sum(r["stored"] for r in records)
    rounding = max(r["largest_rounding"] for r in records)
    job.facts["counts"] = {
        "read": read,
        "stored": stored,
        "dropped": dict(dropped),
        "largest_rounding": rounding,
    }
    job.facts["inputs"] = [_input_facts(s, spooled) for s in sources]
    if rounding > 0:
        job.note(f"coordinates were rounded to counts for filtering, by {rounding:.3g} CRS units at most")
    for reason, count in dropped.items():
        job.note(f"{count:,} points dropped: {reason}")
    if stored == 0:
        raise InputError(
            f"all {read:,} points were dropped ({', '.join(dropped)}): nothing to make a terrain of"
        )
    return spooled, good


def _input_facts(source: Source, spooled: Commits) -> dict[str, Any]:
    prefix = f"s{source.number:06d}-"
    return {
        **source.info.to_json(), "content": source.content,
        "stored": sum(r["stored"] for key, (_, r) in spooled.items() if key.startswith(prefix)),
    }  # fmt: skip


def _assemble(job: Job, sources: list[Source], spooled: Commits) -> Assembled:
    """Points into buckets; tell of duplicates and of what takes no part."""
    fragments = fragments_of(spooled)
    tasks = list(assemble_tasks(job.plan, spooled, fragments, strays_of(job.plan, sources, spooled)))
    done, stale = job.sorted_out("assemble", tasks)
    _forget_labels(job, stale)
    job.take_back("assemble", stale)
    job.store.allocate(
        {cell: sum(stop - start for _, start, stop in runs) for cell, runs in fragments.items()}
    )
    _bring_back(job, sources, [task for task in tasks if task.key not in done])
    commits = job.perform("assemble", tasks)
    assembled = Assembled.of(commits)
    if not commits:
        raise ProcessingError(f"no bucket could be written; the first: {job.failed[0]['error']}")
    job.store.publish_index({c: BucketInfo(r["n"], r["n_candidates"]) for c, r in assembled.records.items()})
    within = sum(r["duplicates"]["within"] for r in assembled.records.values())
    between = sum(r["duplicates"]["between"] for r in assembled.records.values())
    taking = sum(r["n_participating"] for r in assembled.records.values())
    job.facts["counts"] |= {
        "duplicates_within_files": within, "duplicates_between_files": between, "participating": taking,
        "kept_out": job.facts["counts"]["stored"] - taking, "buckets": len(assembled.records),
    }  # fmt: skip
    _tell_of_strays(job, sources, assembled)
    if within or between:
        job.note(f"duplicates take part once: {between:,} points of other files, {within:,} within files")
    return assembled


def _bring_back(job: Job, sources: list[Source], todo: list[Task]) -> None:
    """Decode again the pieces that buckets need and that `tiler clean` removed."""
    needed = {piece for task in todo for bucket in task.arguments["buckets"] for piece, *_ in bucket[2]}
    gone = needed - job.store.pieces() if needed else set()
    if gone:
        job.note(f"{len(gone)} pieces were removed from the store since they were decoded; they are again")
        job.take_back("spool", gone)
        job.perform("spool", spool_tasks(job.plan, sources))


def _tell_of_strays(job: Job, sources: list[Source], assembled: Assembled) -> None:
    """List the points that belong to nothing."""
    paths = {source.number: str(source.info.path) for source in sources}
    found: list[dict[str, Any]] = []
    for record in assembled.records.values():
        for number, row, x, y, z in record["strays"]:
            found.append({"path": paths[number], "point": row, "x": x, "y": y, "z": z})
    job.facts["counts"]["strays"] = len(found)
    job.facts["strays"] = found
    if found:
        job.note(
            f"{len(found)} points far from all others of their file, or outside of its bounds, are not filtered"
        )


def _forget_labels(job: Job, stale: Commits) -> None:
    """Take back the tiles whose buckets are written anew: a bucket that moves to other rows loses its labels."""
    cells = {tuple(bucket["cell"]) for _, record in stale.values() for bucket in record["buckets"]}
    for number in range(job.store.get_state("passes") or 0):
        stage = f"filter{number}"
        tiles = job.store.committed(stage) if cells else {}
        job.take_back(
            stage, [k for k, (_, r) in tiles.items() if not cells.isdisjoint(map(tuple, r["cells"]))]
        )


def _filter(job: Job, assembled: Assembled) -> dict[Cell, str]:
    """Run the passes of the method; digests of the final labels by bucket."""
    if job.plan.config.method == KEEP:
        return assembled.digests
    passes = METHODS[job.plan.config.method].params(**job.plan.parameters).passes
    ever = max(job.store.get_state("passes") or 0, len(passes))
    job.store.put_state("passes", ever)
    for number in range(len(passes), ever):
        job.store.clear(f"filter{number}")  # its labels are about to be overwritten
    config, known = job.plan.config, job.plan.statistics
    sigma = None if config.sigma is None else float(config.sigma)
    state: dict[str, Any] = {"run": dataclasses.asdict(RunFacts(job.plan.meta.has_rgb, sigma))}
    labels = assembled.digests
    warm = functools.partial(warm_filters, config.method)
    job.facts["statistics"] = {}
    for number, step in enumerate(passes):
        tasks = list(filter_tasks(job.plan, assembled, number, state, labels))
        filtered = job.perform(f"filter{number}", tasks, warm)
        if not filtered:
            raise ProcessingError(f"no tile could be filtered; the first: {job.failed[0]['error']}")
        partials = (record["partial"] for _, record in filtered.values())
        state = _reduced(job, step, partials, state) if known is None else known[step.name]
        job.store.put_state(f"after-{step.name}", state)
        job.facts["statistics"][step.name] = state
        if step.gives_labels:
            job.facts["filter"] = _filter_facts(job, [r for _, r in filtered.values()], len(tasks))
            for task in tasks:
                if task.key not in filtered:
                    _keep_classes(job, task)
            labels = label_digests(assembled, filtered)
    return labels


def _reduced(job: Job, step: Pass, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
    """The state after a pass; what it decided is told."""
    try:
        found = step.reduce(partials, state)
    except MethodRefusal as error:
        raise ConfigError(f"--method {job.plan.config.method}: {error}") from error
    for text in found.get("notes", [])[len(state.get("notes", [])) :]:
        job.note(text)
    return found


def _keep_classes(job: Job, task: Task) -> None:
    """The points of a tile that failed have no label: not that of an earlier run, either."""
    buckets = job.store.buckets()
    for cell in (Cell(*indices) for indices in task.arguments["cells"]):
        job.store.write_labels(task.arguments["labels_out"], cell, np.zeros(buckets[cell].n, np.uint8))


def _filter_facts(job: Job, records: list[dict[str, Any]], tiles: int) -> dict[str, Any]:
    def total(name: str) -> int:
        return sum(r[name] for r in records)

    names = ("points", "ground", "low_noise", "unclassified", "kept", "marked")
    again = sum(r["tries"] > 1 for r in records)
    facts: dict[str, Any] = {name: total(name) for name in names}
    facts |= {
        "tiles": tiles,
        "tiles_done_again": again,
        "overlap_work": total("window_area") / max(total("core_area"), 1),
    }
    if facts["marked"]:
        job.note(
            f"{facts['marked']:,} labels are not certified: points beyond the widest halo could change them"
        )
    return facts


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"-o {out}: cannot be made ({error.strerror}); name a folder that can be written"
        ) from error


def _frozen(plan: Plan, url: str) -> tuple[Plan, TileStore]:
    """The store, and the plan with what its first run settled: frame, buckets, tiles, resolution, thinning."""
    if not store_exists(url):
        store = create_store(url, plan.meta)
        first = {"tile": str(plan.tile), "resolution": str(plan.resolution)}
        store.put_state("settled", {**first, "memory": plan.memory, "thin": plan.thin_ground})
        return plan, store
    store = open_store(url)
    old, new = store.meta, plan.meta
    if (old.frame.crs_wkt, old.frame.units) != (new.frame.crs_wkt, new.frame.units):
        raise ConfigError(
            f"{url}: holds points in {crs_name(old.frame.crs_wkt)}, the inputs are in {crs_name(new.frame.crs_wkt)}; "
            "use --overwrite or another -o"
        )
    if new.has_rgb and not old.has_rgb:
        raise ConfigError(
            f"{url}: was made without colours, the inputs have some; use --overwrite or another -o"
        )
    settled: dict[str, Any] = store.get_state("settled") or {}
    config, frozen = plan.config, Fraction(settled.get("tile", str(plan.tile)))
    tile = config.tile_size or frozen
    resolution = config.resolution or Fraction(settled.get("resolution", str(plan.resolution)))
    memory = settled.get("memory", plan.memory) if tile == frozen else plan.memory
    plan = dataclasses.replace(
        plan, meta=old, tile=tile, resolution=resolution, tile_memory=memory, thin=settled.get("thin")
    )
    refuse(plan, None)
    return plan, store
