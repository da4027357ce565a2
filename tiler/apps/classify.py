"""One file in, one file out: the job up to the labels, in a scratch store that is gone afterwards."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tiler.config import RunConfig
from tiler.errors import ConfigError
from tiler.export import WriteClassified, write_classified
from tiler.filter import LABELS
from tiler.ingest import inspect, inspect_guarded, read_guarded
from tiler.io.locations import cloud_path, is_url, state_at
from tiler.io.overwrite_check import Target, check_targets
from tiler.io.result_folder import COPC_SUFFIX, STORE
from tiler.observe.events import Listener, silent
from tiler.pipeline import run
from tiler.plan import KEEP
from tiler.schedule import Guard
from tiler.stages.file_tasks import kept_pieces
from tiler.store import open_store

ONE_WORKER_POINTS = 1_000_000
"""Below this a second worker costs more to start than it takes off the first."""


def classify_file(
    source: str | Path, target: str | Path, config: RunConfig | None = None, listener: Listener = silent
) -> dict[str, Any]:
    """Classify one LAS or LAZ file: same points, same order, new classes.

    A file without a CRS is taken to be in metres, which is noted.

    Parameters
    ----------
    source, target : path
        The target is LAZ, LAS or, as ``.copc.laz``, COPC, where points are not in the order of the source; it
        appears under its name only when it is whole.
    config : RunConfig
    listener : callable
        Told what happens, see `tiler.observe.events`.

    Returns
    -------
    dict
        ``points``, ``changed``, ``classes`` (class to points), ``bytes``, ``notes``, ``seconds``, ``method``,
        ``parameters``, ``tiles``, ``marked``, and ``failed_tasks``, as run.json lists them: the points of these keep
        the classes of the source.

    Raises
    ------
    TilerError
    """
    if is_url(target):
        raise ConfigError(f"{target}: one file is written here; name a file, `tiler run` writes to URLs")
    source, target, config = cloud_path(source), Path(target), config or RunConfig()
    if config.method == KEEP:
        raise ConfigError(
            "--method keep changes no class; `tiler run --method keep` grids what the input brings"
        )
    check_targets([Target("", target, (".laz", ".las"))], [source])
    if state_at(str(source)) is None:
        raise ConfigError(f"{source}: no such file; name a LAS or LAZ file")
    with Guard() as guard:
        return _classify(guard, source, target, config, listener)


def _classify(
    guard: Guard, source: Path, target: Path, config: RunConfig, listener: Listener
) -> dict[str, Any]:
    """`classify_file`, once it is known that it can work."""
    info = (
        inspect(source, config.salvage)
        if config.in_process
        else inspect_guarded(guard, source, config.salvage)
    )
    if info.georeference.kind == "missing" and config.crs is None:
        listener(
            "note", {"text": f"{source}: has no CRS; metres are assumed, --units or --crs say otherwise"}
        )
        config = config.updated(crs="none")
    if config.workers is None and info.points < ONE_WORKER_POINTS:
        config = config.updated(workers=1)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        folder = TemporaryDirectory(prefix=".tiler-", dir=target.parent)
    except OSError as error:
        raise ConfigError(
            f"{target}: its folder cannot be made or written ({error.strerror}); name another"
        ) from error
    with folder as scratch:
        config = config.updated(store=None)
        summary = run([str(source)], scratch, config, listener, until="filter", known=[info]).summary
        store = open_store(str(Path(scratch) / STORE))
        work = WriteClassified(
            path=str(source),
            source=0,
            out=str(target),
            labels=LABELS,
            cells=tuple(store.buckets()),
            salvage=config.salvage,
            stamp=info.stamp,
            pieces=tuple(*kept_pieces(store.committed("spool")).values()),
            copc=target.name.lower().endswith(COPC_SUFFIX),
        )
        if config.in_process:
            record = write_classified(store.url, work)
        else:  # other fields of the records are decoded now, which may crash where the coordinates did not
            record = read_guarded(guard, _write, source, store.url, work)
    written = {name: record[name] for name in ("points", "changed", "classes", "bytes", "notes")}
    return {
        **written,
        "seconds": summary["seconds"],
        "method": config.method,
        "parameters": summary["plan"]["parameters"],
        "tiles": summary["filter"]["tiles"],
        "marked": summary["filter"]["marked"],
        "failed_tasks": summary["failed_tasks"],
    }


def _write(source: Path, store_url: str, work: WriteClassified) -> dict[str, Any]:
    """`write_classified` with the file that it reads as its first argument."""
    return write_classified(store_url, replace(work, path=str(source)))
