"""The Python interface: `run`, `classify`, `check` and `open_store`, as the commands do it.

What a command refuses raises the same line as a `tiler.errors.TilerError`. Nothing is printed: what is decided on the
way is in the result, is given to ``progress``, and goes to the logger ``tiler``. A script needs no
``if __name__ == "__main__":``, as workers import nothing of it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from tiler.apps.check import PointOptions, measure, parse_requirements
from tiler.apps.classify import classify_file
from tiler.config import RunConfig
from tiler.core.units import parse_length, unit_named
from tiler.errors import ConfigError, InputError, ProcessingError, TilerError
from tiler.io.locations import cloud_path
from tiler.observe.events import Listener, combine
from tiler.observe.json_lines import Progress, ProgressRecords
from tiler.pipeline import run as run_job
from tiler.report.notebook import check_markup, classified_markup
from tiler.runs.job import RunResult
from tiler.store import TileStore
from tiler.store import open_store as open_store_at

__all__ = [
    "CheckResult",
    "ClassifyResult",
    "ConfigError",
    "InputError",
    "ProcessingError",
    "Progress",
    "RunConfig",
    "RunResult",
    "TilerError",
    "check",
    "classify",
    "open_store",
    "run",
]

PathLike: TypeAlias = str | Path
Settings: TypeAlias = RunConfig | Mapping[str, Any]
"""Settings of a run, by the names of ``tiler config --template``: ``{"resolution": "50cm", "products": ["dtm"]}``."""
TellProgress: TypeAlias = Callable[[Progress], object]

_logger = logging.getLogger("tiler")
_logger.addHandler(logging.NullHandler())  # who wants the log says so: Python would print warnings


def run(
    inputs: PathLike | Iterable[PathLike],
    out: PathLike,
    config: Settings | None = None,
    *,
    until: str = "export",
    progress: TellProgress | None = None,
) -> RunResult:
    """Turn point clouds into a terrain model and classified clouds, as ``tiler run``.

    The same call again goes on where this one was interrupted.

    Parameters
    ----------
    inputs : path or sequence of paths
        Files, folders, globs, URLs.
    out : path or URL
        Folder of the results, made if it is not there.
    config : mapping or RunConfig, optional
        Settings by the names of ``tiler config --template``; lengths are metres unless written with a unit.
    until : {"ingest", "filter", "grid", "export"}
        Last stage to do.
    progress : callable, optional
        Given a `Progress` now and then: how far the job is, and what people should know (docs/progress.md).

    Returns
    -------
    RunResult

    Raises
    ------
    TilerError
        The one line of the command, with its ``exit_code``; nothing that was finished is lost.

    Examples
    --------
    >>> import tiler
    >>> result = tiler.run("clouds/", "out", {"method": "classic", "resolution": 2, "workers": 1})
    >>> result.exit_code, result.summary["counts"]["read"]
    (0, 1849)
    >>> sorted(name for name in result.files if name.endswith(".tif"))
    ['dtm.tif']
    >>> try:
    ...     tiler.run("clouds/", "out", {"resolution": "fine"})
    ... except tiler.TilerError as error:
    ...     print(error)
    resolution: 'fine' is no length: write a number, with a unit if it is not metres (1, 0.5, 1/3, 3ft)
    """
    listener = _listener(progress)
    return run_job(_texts(inputs), str(out), _settings(config), listener, until=until)


@dataclass(frozen=True)
class ClassifyResult:
    """How `classify` ended; a notebook shows it as a table.

    Attributes
    ----------
    exit_code : int
        0, or 5 if points of tiles that failed kept their classes.
    summary : dict
        What ``tiler classify --json`` prints: points, changed, classes, method, parameters, seconds and more.
    path : Path
        The classified cloud.
    notes : tuple of str
        What was decided or found on the way.
    """

    exit_code: int
    summary: dict[str, Any] = field(repr=False)
    path: Path
    notes: tuple[str, ...] = ()

    @property
    def classes(self) -> dict[int, int]:
        """Class -> points of it."""
        return {int(code): points for code, points in self.summary["classes"].items()}

    def _repr_html_(self) -> str:
        return classified_markup(self.summary, self.path, self.notes)


def classify(
    source: PathLike,
    target: PathLike,
    config: Settings | None = None,
    *,
    progress: TellProgress | None = None,
) -> ClassifyResult:
    """Classify one LAS or LAZ file, as ``tiler classify``: same points, same order, new classes.

    Parameters
    ----------
    source : path or URL
    target : path
        LAZ or LAS, by its name; it appears when it is whole.
    config, progress
        As of `run`.

    Returns
    -------
    ClassifyResult

    Raises
    ------
    TilerError
        The one line of the command, with its ``exit_code``.

    Examples
    --------
    >>> import tiler
    >>> result = tiler.classify("clouds/a.las", "ground.laz", {"method": "classic", "workers": 1})
    >>> result.classes[2] > 1500
    True
    """
    told: list[str] = []

    def keep(event: str, fields: dict[str, Any]) -> None:
        if event in ("note", "warning"):
            told.append(fields["text"])

    facts = classify_file(source, target, _settings(config), combine(keep, _listener(progress)))
    notes = tuple(dict.fromkeys([*told, *facts["notes"]]))
    return ClassifyResult(5 if facts["failed_tasks"] else 0, facts, Path(target), notes)


@dataclass(frozen=True)
class CheckResult:
    """What `check` measured; a notebook shows it as tables.

    Attributes
    ----------
    exit_code : int
        0, or 5 if a requirement is not met.
    summary : dict
        What ``tiler check --json`` prints: ``accuracy`` by checkpoints, ``seams``, ``strips``, ``requirements``,
        ``figures``; the first three where there is something to measure by.
    """

    exit_code: int
    summary: dict[str, Any] = field(repr=False)

    @property
    def met(self) -> bool:
        """Whether all requirements are met."""
        return all(requirement["met"] for requirement in self.summary["requirements"])

    def _repr_html_(self) -> str:
        return check_markup(self.summary)


def check(
    dtm: PathLike,
    points: PathLike | None = None,
    *,
    points_crs: str | None = None,
    points_unit: str | None = None,
    points_rmse: float | str = 0,
    tile_size: float | str | None = None,
    strips: Iterable[PathLike] = (),
    require: Iterable[str] = (),
    figures: PathLike | None = None,
) -> CheckResult:
    """Measure how good a DTM is, as ``tiler check``: vertical accuracy, seams of tiles, fit of flight strips.

    Parameters
    ----------
    dtm : path or URL
        A raster of heights.
    points : path, optional
        Checkpoints: CSV (x, y, z, type NVA or VVA, cover), GeoJSON, GeoPackage and others.
    points_crs : str, optional
        CRS of their x and y; what the file says, else the DTM's, if left out.
    points_unit : {"m", "ft", "usft"}, optional
        Of their heights; the DTM's if left out.
    points_rmse : length
        RMSE of the checkpoints' own heights, in metres or with a unit.
    tile_size : length, optional
        Look for seams at its multiples; tiles of the run.json beside the DTM if left out.
    strips : sequence of paths
        Classified clouds whose flight strips are compared.
    require : sequence of str
        ``name=value``, as ``rmse=0.1``: see ``tiler check --help``.
    figures : path, optional
        Folder for histogram.svg and map.svg of the checkpoints.

    Returns
    -------
    CheckResult

    Raises
    ------
    TilerError
        The one line of the command, with its ``exit_code``.

    Examples
    --------
    >>> import tiler
    >>> result = tiler.check("out/dtm.tif", "checkpoints.csv", require=["rmse=0.1"])
    >>> result.met, result.summary["accuracy"]["nva"]["points"]
    (True, 3)
    """
    report = measure(
        cloud_path(dtm),
        None if points is None else Path(points),
        PointOptions(
            points_crs,
            None if points_unit is None else unit_named(points_unit),
            float(parse_length(points_rmse)),
        ),
        None if tile_size is None else parse_length(tile_size),
        _texts(strips),
        parse_requirements(_texts(require)),
        None if figures is None else Path(figures),
    )
    met = all(requirement["met"] for requirement in report["requirements"])
    return CheckResult(0 if met else 5, report)


def open_store(path: PathLike) -> TileStore:
    """Open the tile store of a run, to read the points in it; cheap.

    Parameters
    ----------
    path : path or URL
        ``OUT/store.zarr``.

    Returns
    -------
    TileStore

    Raises
    ------
    StoreError
        There is none, or it is not one that this version wrote.

    Examples
    --------
    >>> import tiler
    >>> store = tiler.open_store("out/store.zarr")
    >>> [cell] = store.buckets()
    >>> block = store.read_bucket(cell, ("xyz", "classification"))
    >>> store.meta.frame.coordinates(block.xyz).shape
    (1849, 3)
    """
    return open_store_at(str(path))


def _texts(paths: PathLike | Iterable[PathLike]) -> list[str]:
    """Paths as texts, also where there is one alone."""
    return [str(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]


def _settings(config: Settings | None) -> RunConfig:
    return config if isinstance(config, RunConfig) else RunConfig.from_mapping(config or {})


def _listener(progress: TellProgress | None) -> Listener:
    """Who is told of a job: the log, and who asked for it."""
    log = ProgressRecords(_log)
    return log if progress is None else combine(log, ProgressRecords(progress))


def _log(record: Progress) -> None:
    if record["message"] is not None:
        _logger.log(logging.WARNING if record["level"] == "warning" else logging.INFO, record["message"])
