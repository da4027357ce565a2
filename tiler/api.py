"""Python interface: `run`, `classify`, `check`, `check_clouds` and `open_store`, equivalent to the commands.

Errors of a command are raised as `tiler.errors.TilerError` with the same line. Nothing is printed: notes and warnings
are in the result, are passed to ``progress``, and are sent to the logger ``tiler``. A script does not need
``if __name__ == "__main__":``, since workers do not import it.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from tiler.apps.acceptance import check_clouds as measure_clouds
from tiler.apps.acceptance import read_specification
from tiler.apps.check import (
    CHANGE_M,
    AgainstOptions,
    PointOptions,
    measure,
    parse_requirements,
    terrain_in,
    with_earlier,
)
from tiler.apps.classify import ClassifySummary, classify_file, classify_files, is_one_file
from tiler.apps.resolutions import run_resolutions
from tiler.apps.results import AcceptanceSummary, CheckSummary
from tiler.config import RunConfig
from tiler.core.units import parse_length, unit_named
from tiler.errors import ConfigError, InputError, ProcessingError, TilerError
from tiler.io.locations import as_path, local_or_url
from tiler.io.result_folder import CHECK, is_results, local_folder, read_run
from tiler.observe.events import Event, Listener, Note, Warned, combine
from tiler.observe.json_lines import Progress, ProgressRecords
from tiler.observe.progress import NotebookBar, in_notebook, open_progress
from tiler.report.accuracy import read_measured, write_measured
from tiler.report.html import write_report_at
from tiler.report.notebook import check_markup, classified_markup
from tiler.runs.job import RunResult
from tiler.store import TileStore
from tiler.store import open_store as open_store_at

__all__ = [
    "AcceptanceResult",
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
    "check_clouds",
    "classify",
    "open_store",
    "run",
]

PathLike: TypeAlias = str | Path
Settings: TypeAlias = RunConfig | Mapping[str, Any]
"""Settings of a run, by the names of ``tiler config --template``: ``{"resolution": "50cm",
"products": ["dtm"]}``."""
TellProgress: TypeAlias = Callable[[Progress], object]
ShowProgress: TypeAlias = TellProgress | bool | None
"""Function that receives each `Progress`, or a choice of display.

True shows bars in a terminal or a notebook, and lines elsewhere. False shows nothing. None
shows a bar only in a notebook."""

_logger = logging.getLogger("tiler")
_logger.addHandler(logging.NullHandler())  # Without a handler, Python would print warnings.


def run(
    inputs: PathLike | Iterable[PathLike],
    out: PathLike,
    config: Settings | None = None,
    *,
    until: str = "export",
    progress: ShowProgress = None,
    **settings: Any,
) -> RunResult:
    """Make a terrain model and classified clouds from point clouds, like ``tiler run``.

    After an interruption the same call resumes the run.

    Parameters
    ----------
    inputs : path or sequence of paths
        Files, folders, globs or URLs of point clouds.
    out : path or URL
        Folder of the results, which is created if it does not exist.
    config : mapping or RunConfig, optional
        Settings by the names of ``tiler config --template``. Lengths without a unit are in metres.
    until : {"ingest", "filter", "grid", "export"}
        Last stage to run.
    progress : callable or bool, optional
        Function that is called at intervals with a `Progress` (docs/progress.md). True shows bars in a terminal or a
        notebook, and lines elsewhere. False shows nothing. By default a bar is shown only in a notebook.
    **settings
        Settings as keywords: ``resolution=0.5, crs=2154``. Give a setting once, here or in ``config``.

    Returns
    -------
    RunResult
        With several resolutions, such as ``resolution=[0.5, 2]``, the result of the finest, which has the others.

    Raises
    ------
    TilerError
        The run failed. The error has the line and the ``exit_code`` of the command. Finished work is kept.

    Examples
    --------
    >>> import tiler
    >>> result = tiler.run("clouds/", "out", method="classic", resolution=2, workers=1)
    >>> result.exit_code, result.summary["counts"]["read"]
    (0, 1849)
    >>> sorted(name for name in result.files if name.endswith(".tif"))
    ['dtm.tif']
    >>> try:
    ...     tiler.run("clouds/", "out", resolution="fine")
    ... except tiler.TilerError as error:
    ...     print(error)
    resolution: 'fine' is not a length; give a number in metres or with a unit (1, 0.5, 1/3, 3ft)
    """
    with _listening(progress) as listener:
        return run_resolutions(
            _texts("inputs", inputs),
            _text("out", out),
            _settings(config, settings),
            listener,
            until=until,
        )


@dataclass(frozen=True)
class ClassifyResult:
    """Result of `classify`, which a notebook shows as a table.

    Attributes
    ----------
    exit_code : int
        0, or 5 if a tile failed (its points keep their classes) or a file was left out.
    summary : mapping
        Output of ``tiler classify --json``: points, changed, classes, method, parameters, seconds and more.
    path : Path
        Path of the classified cloud, or of the folder for several clouds.
    notes : tuple of str
        Decisions and findings, one line per item.
    """

    exit_code: int
    summary: ClassifySummary = field(repr=False)
    path: Path
    notes: tuple[str, ...] = ()

    @property
    def classes(self) -> dict[int, int]:
        """Number of points by class."""
        return {int(code): points for code, points in self.summary["classes"].items()}

    def _repr_html_(self) -> str:
        return classified_markup(self.summary, self.path, self.notes)


def classify(
    source: PathLike | Iterable[PathLike],
    target: PathLike,
    config: Settings | None = None,
    *,
    progress: ShowProgress = None,
    **settings: Any,
) -> ClassifyResult:
    """Classify LAS or LAZ files, like ``tiler classify``. The points get new classes.

    Parameters
    ----------
    source : path or URL, or several of them
        Cloud, or several clouds, folders and globs.
    target : path
        Path of the classified cloud, whose suffix selects LAZ, LAS or COPC (``.copc.laz``, in spatial order; LAZ and
        LAS keep the order of the points). The file appears when it is complete. For several clouds, the path of a
        folder that gets one LAZ file per cloud.
    config, progress, **settings
        Settings and progress, see `run`.

    Returns
    -------
    ClassifyResult

    Raises
    ------
    TilerError
        The classification failed. The error has the line and the ``exit_code`` of the command.

    Examples
    --------
    >>> import tiler
    >>> result = tiler.classify("clouds/a.las", "ground.laz", method="classic", workers=1)
    >>> result.classes[2] > 1500
    True
    """
    told: list[str] = []

    def keep(event: Event) -> None:
        if isinstance(event, Note | Warned):
            told.append(event.text)

    path, sources = _text("target", target), _texts("source", source)
    with _listening(progress) as listener:
        both, chosen = combine(keep, listener), _settings(config, settings)
        if is_one_file(sources, path):
            summary = classify_file(sources[0], path, chosen, both)
        else:
            summary = classify_files(sources, path, chosen, both)
    notes = tuple(dict.fromkeys([*told, *summary["notes"]]))
    return ClassifyResult(summary["exit_code"], summary, Path(path), notes)


@dataclass(frozen=True)
class CheckResult:
    """Result of `check`, which a notebook shows as tables.

    Attributes
    ----------
    exit_code : int
        0, or 5 if a requirement is not met.
    summary : mapping
        Output of ``tiler check --json``: ``accuracy`` by checkpoints, ``seams``, ``strips``, ``requirements``,
        ``figures``. Each of the first three exists only if it was measured.
    report : str or None
        Path or URL of the updated report, if the DTM was given as the OUT folder of a run.
    """

    exit_code: int
    summary: CheckSummary = field(repr=False)
    report: str | None = None

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
    against: PathLike | None = None,
    change: float | str | None = None,
    difference: PathLike | None = None,
) -> CheckResult:
    """Measure the vertical accuracy of a DTM, its seams, the fit of flight strips, and changes, like ``tiler check``.

    Parameters
    ----------
    dtm : path or URL
        Raster of heights, or the OUT folder of a run. Its check.json and report.html are then written as well.
    points : path, optional
        Checkpoints: CSV (x, y, z, type NVA or VVA, cover), GeoJSON, GeoPackage and others.
    points_crs : str, optional
        CRS of x and y of the checkpoints. The default is the CRS of their file, or else of the DTM.
    points_unit : {"m", "ft", "usft"}, optional
        Unit of the heights of the checkpoints. The default is the unit of the DTM.
    points_rmse : length
        RMSE of the heights of the checkpoints themselves, in metres or with a unit.
    tile_size : length, optional
        Distance between possible seams. The default is the tile size in the run.json next to the DTM.
    strips : sequence of paths
        Classified clouds, whose flight strips are compared.
    require : sequence of str
        Limits as ``name=value``, such as ``rmse=0.1``. ``tiler check --help`` lists the names.
    figures : path, optional
        Folder for histogram.svg and map.svg of the checkpoints.
    against : path or URL, optional
        Earlier DTM, or OUT folder of an earlier run. It may have other pixels.
    change : length
        Least difference to the earlier DTM that is a change. The default is 0.5 m.
    difference : path, optional
        GeoTIFF that receives this DTM minus the earlier one.

    Returns
    -------
    CheckResult

    Raises
    ------
    TilerError
        The measurement failed. The error has the line and the ``exit_code`` of the command.

    Examples
    --------
    >>> import tiler
    >>> result = tiler.check("out/dtm.tif", "checkpoints.csv", require=["rmse=0.1"])
    >>> result.met, result.summary["accuracy"]["nva"]["points"]
    (True, 3)
    """
    place = local_or_url(_text("dtm", dtm))
    is_out = is_results(place)
    summary = measure(
        as_path(terrain_in(place) if is_out else place),
        None if points is None else Path(_text("points", points)),
        PointOptions(
            points_crs,
            None if points_unit is None else unit_named(points_unit),
            float(parse_length(points_rmse)),
        ),
        None if tile_size is None else parse_length(tile_size),
        _texts("strips", strips),
        parse_requirements(_texts("require", require)),
        None if figures is None else Path(_text("figures", figures)),
        _against(against, change, difference),
    )
    report = None
    if is_out:
        out = local_folder(place)
        earlier = read_measured(out, CHECK, read_run(str(place)) or {})
        # A check that is older than the terrain measured another one.
        if earlier and not earlier.get("older", "unreadable" in earlier):
            write_measured(out, CHECK, with_earlier(summary, earlier))
        else:
            write_measured(out, CHECK, summary)
        report = write_report_at(place)
    met = all(requirement["met"] for requirement in summary["requirements"])
    return CheckResult(0 if met else 5, summary, report)


@dataclass(frozen=True)
class AcceptanceResult:
    """Result of `check_clouds`.

    Attributes
    ----------
    exit_code : int
        0, or 5 if a row that the specification asks for is not met or could not be measured, or 4 if ``difference`` was
        asked and there is nothing to write.
    summary : mapping
        Output of ``tiler check CLOUDS --json``: ``rows`` with what is asked and found, and more.
    """

    exit_code: int
    summary: AcceptanceSummary = field(repr=False)

    @property
    def met(self) -> bool:
        """Whether all rows that the specification asks for are met."""
        return self.summary["met"]


def check_clouds(
    clouds: PathLike | Iterable[PathLike],
    spec: PathLike | None = None,
    *,
    difference: PathLike | None = None,
    page: PathLike | None = None,
    sheets: PathLike | None = None,
    sheet_field: str | None = None,
    workers: int | None = None,
    memory: int | str | None = None,
) -> AcceptanceResult:
    """Measure density, distribution, swaths and records of clouds, and compare them, like ``tiler check CLOUDS``.

    Parameters
    ----------
    clouds : path or sequence of paths
        Files, folders, globs or virtual point clouds.
    spec : str or path, optional
        Specification of a survey: ``usgs-ql0``, ``usgs-ql1``, ``usgs-ql2``, or a TOML file (docs/acceptance.md). By
        default everything is measured and nothing is asked.
    difference : path, optional
        GeoTIFF that receives the largest absolute difference of two swaths in each cell, in metres.
    page : path, optional
        HTML file that receives the rows, the pairs of swaths and the notes as a page.
    sheets : path, optional
        File of polygons. First returns must cover half of each.
    sheet_field : str, optional
        Field of the polygons with the names of the sheets.
    workers : int, optional
        Number of processes that read files. By default it is the number of cores, at most 8.
    memory : int or str, optional
        Memory limit of each process, in bytes or as text such as ``"2GB"``. By default this process may use half of the
        machine's memory, and so may the others together.

    Returns
    -------
    AcceptanceResult

    Raises
    ------
    TilerError
        The measurement failed. The error has the line and the ``exit_code`` of the command.

    Examples
    --------
    >>> import tiler
    >>> result = tiler.check_clouds("clouds/")
    >>> {row["name"]: row["found"] for row in result.summary["rows"]}["las_version"]
    ['1.4']
    """
    specification = None if spec is None else read_specification(_text("spec", spec))
    target = None if difference is None else Path(_text("difference", difference))
    page_file = None if page is None else Path(_text("page", page))
    grid = None if sheets is None else _text("sheets", sheets)
    field_name = None if sheet_field is None else _text("sheet_field", sheet_field)
    if grid is None and field_name is not None:
        raise ConfigError(
            f"--sheet-field {sheet_field}: names the sheets of a file; give --sheets FILE as well"
        )
    limits = {"workers": workers, "memory": memory}
    config = RunConfig.from_mapping({k: v for k, v in limits.items() if v is not None})
    summary = measure_clouds(
        _texts("clouds", clouds),
        specification,
        target,
        page_file,
        grid,
        field_name,
        config.workers,
        config.memory,
    )
    if not summary["met"]:
        return AcceptanceResult(5, summary)
    is_missing = target is not None and summary["difference"] is None
    return AcceptanceResult(ProcessingError.exit_code if is_missing else 0, summary)


def _against(
    against: PathLike | None, change: float | str | None, difference: PathLike | None
) -> AgainstOptions | None:
    if against is None:
        for option, value in (("--difference", difference), ("--change", change)):
            if value is not None:
                raise ConfigError(f"{option}: there is no earlier DTM; give it with --against")
        return None
    place = _text("against", against)
    return AgainstOptions(
        as_path(terrain_in(place) if is_results(place) else place),
        float(parse_length(CHANGE_M if change is None else change)),
        None if difference is None else Path(_text("difference", difference)),
    )


def open_store(path: PathLike) -> TileStore:
    """Open the tile store of a run to read its points. No points are read yet.

    Parameters
    ----------
    path : path or URL
        Path or URL of the store, ``OUT/store.zarr``.

    Returns
    -------
    TileStore

    Raises
    ------
    StoreError
        There is no store, or this version did not write it.

    Examples
    --------
    >>> import tiler
    >>> store = tiler.open_store("out/store.zarr")
    >>> [cell] = store.buckets()
    >>> block = store.read_bucket(cell, ("xyz", "classification"))
    >>> store.meta.frame.coordinates(block.xyz).shape
    (1849, 3)
    """
    return open_store_at(_text("path", path))


def _texts(name: str, paths: PathLike | Iterable[PathLike]) -> list[str]:
    """Return one or several paths as texts. Raise ConfigError like `_text`."""
    if isinstance(paths, str | bytes | os.PathLike) or not isinstance(paths, Iterable):
        return [_text(name, paths)]
    return [_text(name, path) for path in paths]


def _text(name: str, path: object) -> str:
    """Return a path as text. Raise ConfigError if the value of the argument ``name`` cannot be a path."""
    if not isinstance(path, str | os.PathLike):
        raise ConfigError(
            f"{name}: {path!r} is {type(path).__name__}, not a path; give a str or a pathlib.Path"
        )
    text = str(path)
    if "\0" in text:
        raise ConfigError(f"{name}: {text!r} contains a NUL character; give a path without it")
    return text


def _settings(config: Settings | None, keywords: Mapping[str, Any]) -> RunConfig:
    """Return the configuration from a mapping or RunConfig, together with keywords."""
    if not isinstance(config, RunConfig | Mapping | None):
        raise ConfigError(
            f"config: {config!r} is {type(config).__name__}, not a mapping; give a dict of settings"
        )
    if isinstance(config, RunConfig):
        return _over(config, keywords)
    given = dict(config or {})
    for name in keywords:
        if name in given:
            raise ConfigError(f"{name} is given in config and as a keyword; give it once")
    return RunConfig.from_mapping(given | dict(keywords))


def _over(config: RunConfig, keywords: Mapping[str, Any]) -> RunConfig:
    """Return a RunConfig in which keywords replace its settings."""
    parsed = RunConfig.from_mapping(keywords)
    return config.updated(**{name: getattr(parsed, name) for name in keywords})


@contextmanager
def _listening(progress: ShowProgress) -> Iterator[Listener]:
    """Yield a listener of a job, for the log and for the display that ``progress`` selects."""
    log = ProgressRecords(_log)
    if callable(progress):
        yield combine(log, ProgressRecords(progress))
    elif progress is not False and in_notebook():
        yield combine(log, ProgressRecords(NotebookBar()))
    elif progress is True:
        with open_progress(sys.stderr) as shown:
            yield combine(log, shown)
    else:
        yield log


def _log(progress: Progress) -> None:
    if progress["message"] is not None:
        _logger.log(
            logging.WARNING if progress["level"] == "warning" else logging.INFO,
            progress["message"],
        )
