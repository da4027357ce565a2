"""Classification of one file or many files: a run up to the labels, in a temporary store."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NotRequired, TypedDict

from tiler.config import RunConfig
from tiler.core.lattice import Cell
from tiler.core.points import LABELS, Counts, sum_by_class
from tiler.errors import ConfigError, ProcessingError, TilerError
from tiler.export.classified import write_classified
from tiler.export.cloud_frame import crs_to_write
from tiler.export.output_files import CloudCopy, CloudRecord
from tiler.export.tasks.class_counts import kept_text
from tiler.export.tasks.files import kept_pieces
from tiler.inputs import find_inputs, inspect, inspect_in_child, read_in_child
from tiler.io.locations import as_path, is_url, location
from tiler.io.overwrite_check import Target, check_links, check_targets
from tiler.io.result_folder import COPC_SUFFIX, STORE
from tiler.observe.events import Listener, Note, ignore_events
from tiler.pipeline import run
from tiler.plan import KEEP, Plan
from tiler.redaction import without_secrets
from tiler.runs.found import Source, by_source
from tiler.schedule import FORKS, ChildPool, ChildProcess, fork_server_running
from tiler.store import TileStore, open_store

SUFFIXES = (".laz", ".las")
"""Accepted suffixes of a classified file."""
ONE_WORKER_POINTS = 1_000_000
"""Number of points of a file below which a second worker costs more time than it saves."""


class FilterSummary(TypedDict):
    """Method, work and failures of a run up to its labels.

    ``marked`` is the number of uncertified labels. ``failed_tasks`` are those of run.json. Their points keep the
    classes of the source. ``files`` (number written) and ``quarantined`` (files that were left out or could not be
    written, as in run.json) exist only if the target is a folder.
    """

    seconds: float
    method: str
    parameters: Mapping[str, Any]
    tiles: int
    marked: int
    failed_tasks: list[Mapping[str, Any]]
    exit_code: int
    files: NotRequired[int]
    quarantined: NotRequired[list[Mapping[str, str]]]


class ClassifySummary(FilterSummary):
    """Points of a classified file, or of all files, as ``tiler classify --json`` prints them.

    ``kept`` are the points by class that were not labelled ground or noise and keep a class of the source other than 0,
    1 and 2.
    """

    points: int
    changed: int
    bytes: int
    classes: Counts
    kept: Counts | None
    notes: list[str]


def is_one_file(sources: Sequence[str], target: str) -> bool:
    """Return whether the target is a single classified file, not a folder of classified files."""
    if len(sources) != 1 or Path(target).is_dir() or not Path(target).suffix:
        return False
    source = sources[0]
    if is_url(source):
        return True
    is_glob = glob.has_magic(source) and not os.path.lexists(source)
    return not (is_glob or Path(source).is_dir())


# Children that inspect, filter and write share the imports.
@fork_server_running()
def classify_file(
    source: str | Path,
    target: str | Path,
    config: RunConfig | None = None,
    listener: Listener = ignore_events,
) -> ClassifySummary:
    """Classify one LAS or LAZ file: same points, same order, new classes.

    A file without a CRS is assumed to be in metres, which a note reports.

    Parameters
    ----------
    source, target : path
        Files. The suffix of the target selects LAZ, LAS or (``.copc.laz``) COPC, in which points have another order.
        The target gets its name once it is complete.
    config : RunConfig
    listener : callable
        Receives events, see `tiler.observe.events`.

    Raises
    ------
    TilerError
    """
    if is_url(target):
        raise ConfigError(
            f"{target}: one file is written here; give a file, `tiler run` writes to URLs"
        )
    source = as_path(source)
    target = Path(target)
    config = _checked(config)
    check_targets([Target("", target, SUFFIXES)], [source])
    # Reading a URL reports all of its errors.
    if not is_url(source) and not source.exists():
        raise ConfigError(f"{source}: no such file; give a LAS or LAZ file")
    with ChildProcess() as guard:
        return _classify(guard, source, target, config, listener)


@fork_server_running()
def classify_files(
    sources: Sequence[str],
    folder: str | Path,
    config: RunConfig | None = None,
    listener: Listener = ignore_events,
) -> ClassifySummary:
    """Classify many LAS or LAZ files into a folder, each together with its neighbours, as in a run.

    Parameters
    ----------
    sources : sequence of str
        Files, folders, globs and virtual point clouds.
    folder : path
        Folder of the classified files, which is made if necessary. Each file gets the name of its source, with the
        suffix ``.laz``. An existing file of that name is replaced, unless it is a source.
    config : RunConfig
    listener : callable
        Receives events, see `tiler.observe.events`.

    Raises
    ------
    TilerError
    """
    if is_url(folder):
        raise ConfigError(
            f"{folder}: files are written here; give a folder, `tiler run` writes to URLs"
        )
    folder = Path(folder)
    if folder.suffix.lower() in SUFFIXES:
        raise ConfigError(
            f"{folder}: several clouds are classified into a folder; give a folder"
        )
    _validate_not_inputs(sources, folder)
    config = _checked(config).updated(classified="laz")
    with _scratch_beside(folder / "file", config) as (scratch, settings):
        result = run(list(sources), scratch, settings, listener, until="filter")
        store = open_store(str(Path(scratch) / STORE))
        targets = {path: folder / name for path, name in result.plan.inputs.cloud_names.items()}
        check_targets([Target("", target) for target in targets.values()], targets)
        check_links("", folder, map(str, result.plan.inputs.cloud_names.values()))
        works = list(_works(store, result.plan, targets))
        for work in works:
            Path(work.out).parent.mkdir(parents=True, exist_ok=True)
        with ChildPool(result.plan.resources.workers) as guards:
            made = guards.each(
                lambda guard, work: _written(guard, store.url, work, config), works
            )
            records, failed = _records(works, made)
    if not records:
        raise ProcessingError(
            f"no file could be written; the first error: {failed[0]['error']}"
        )
    kept = sum_by_class(record.kept or {} for record in records)
    if text := kept_text(kept, result.summary["classes"]["no_part"]):
        listener(Note(text))
    notes = dict.fromkeys(note for record in records for note in record.notes or ())
    return {
        "files": len(records),
        "points": sum(record.points for record in records),
        "changed": sum(record.changed for record in records),
        "bytes": sum(record.bytes for record in records),
        "classes": sum_by_class(record.classes for record in records),
        "kept": kept,
        "notes": list(notes),
        **_facts(result.summary, config),
        "quarantined": [*result.summary["quarantined"], *failed],
        "exit_code": 5 if failed else result.exit_code,
    }


def _validate_not_inputs(sources: Sequence[str], folder: Path) -> None:
    """Raise ConfigError if files in the folder would replace inputs, or be inputs of the next call."""
    paths = find_inputs(sources)
    check_targets([Target("", folder / path.name) for path in paths if not is_url(path)], paths)
    for source in (Path(source) for source in sources if not is_url(source)):
        if source.is_dir() and folder.resolve().is_relative_to(source.resolve()):
            raise ConfigError(
                f"{folder}: lies in {source}, which holds the inputs; give another folder"
            )


def _records(
    works: Sequence[CloudCopy], made: Iterable[Callable[[], CloudRecord]]
) -> tuple[list[CloudRecord], list[dict[str, str]]]:
    """Return the records of the files that were written, and path and error of the other files."""
    records, failed = [], []
    for work, record in zip(works, made, strict=True):
        try:
            records.append(record())
        except TilerError as error:
            failed.append({"path": work.path, "error": str(error)})
    return records, failed


def _works(store: TileStore, plan: Plan, targets: Mapping[Path, Path]) -> Iterator[CloudCopy]:
    """Yield the arguments of `write_classified` for each source that was decoded."""
    spooled, buckets = store.committed("spool"), store.buckets()
    numbers, pieces, records = (
        store.get_state("sources") or {},
        kept_pieces(spooled),
        by_source(spooled),
    )
    for info in plan.inputs.sources:
        known = numbers.get(without_secrets(location(info.path)))
        if known is None:
            continue
        name = Source(info, known["number"], "").name
        if name not in pieces:
            continue
        touched = {Cell(ix, iy) for record in records[name] for ix, iy, _ in record.buckets}
        yield CloudCopy(
            path=location(info.path),
            source=known["number"],
            out=str(targets[info.path]),
            labels=LABELS,
            cells=tuple(sorted(touched & buckets.keys())),
            salvage=plan.config.salvage,
            reclass=plan.config.reclass,
            stamp=info.stamp,
            pieces=tuple(pieces[name]),
            wkt=crs_to_write(info, store.meta.frame.crs_wkt, plan.config.crs),
        )


def _checked(config: RunConfig | None) -> RunConfig:
    config = config or RunConfig()
    if config.method == KEEP:
        raise ConfigError(
            "--method keep does not change classes; use `tiler run --method keep` to grid the input classes"
        )
    return config


@contextmanager
def _scratch_beside(target: Path, config: RunConfig) -> Iterator[tuple[str, RunConfig]]:
    """Yield a temporary folder next to a target, and the settings of a run with its store in OUT."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        folder = TemporaryDirectory(prefix=".tiler-", dir=target.parent)
    except OSError as error:
        raise ConfigError(
            f"{target}: its folder cannot be made or written ({error.strerror}); give another folder"
        ) from error
    with folder as scratch:
        yield scratch, config.updated(store=None)


def _facts(summary: Mapping[str, Any], config: RunConfig) -> FilterSummary:
    """Return the properties of the run that a result contains in addition to those of the files."""
    return {
        "seconds": summary["seconds"],
        "method": config.method,
        "parameters": summary["plan"]["parameters"],
        "tiles": summary["filter"]["tiles"],
        "marked": summary["filter"]["marked"],
        "failed_tasks": summary["failed_tasks"],
        "exit_code": summary["exit_code"],
    }


def _written(
    guard: ChildProcess, store_url: str, work: CloudCopy, config: RunConfig
) -> CloudRecord:
    """Write a file, by default in a child process.

    Decoding may crash, because writing copies fields that the filter did not decode.
    """
    if config.in_process:
        return write_classified(open_store(store_url), cloud=work)
    return read_in_child(guard, _write, as_path(work.path), store_url, work)


def _classify(
    guard: ChildProcess, source: Path, target: Path, config: RunConfig, listener: Listener
) -> ClassifySummary:
    info = (
        inspect(source, config.salvage)
        if config.in_process
        else inspect_in_child(guard, source, config.salvage)
    )
    if FORKS:
        guard.leave()  # The next child has the imports that the server makes meanwhile.
    if info.georeference.kind == "missing" and config.crs is None:
        config = config.updated(crs="none")
    if config.workers is None and info.points < ONE_WORKER_POINTS:
        config = config.updated(workers=1)
    copc = target.name.lower().endswith(COPC_SUFFIX)
    form = "copc" if copc else target.suffix.lower().removeprefix(".")
    config = config.updated(classified=form)
    with _scratch_beside(target, config) as (scratch, settings):
        result = run([str(source)], scratch, settings, listener, until="filter", known=[info])
        store = open_store(str(Path(scratch) / STORE))
        (work,) = _works(store, result.plan, {info.path: target})
        record = _written(guard, store.url, replace(work, copc=copc), config)
    if text := kept_text(record.kept or {}, result.summary["classes"]["no_part"]):
        listener(Note(text))
    return {
        "points": record.points,
        "changed": record.changed,
        "classes": record.classes,
        "kept": record.kept,
        "bytes": record.bytes,
        "notes": record.notes or [],
        **_facts(result.summary, config),
    }


def _write(source: Path, store_url: str, work: CloudCopy) -> CloudRecord:
    return write_classified(open_store(store_url), cloud=replace(work, path=str(source)))
