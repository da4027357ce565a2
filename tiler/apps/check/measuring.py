"""All checks of one DTM, and limits for their results, such as ``rmse=0.1``.

Child processes read the files, because a damaged file may crash them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

from tiler.apps.check.accuracy import check_dtm
from tiler.apps.check.against import AgainstOptions, compare, pixels_of, validate_difference
from tiler.apps.check.consistency import seams_of, strip_differences
from tiler.apps.check.figures import validate_figure_files, write_figures
from tiler.apps.check.points import PointOptions, read_checkpoints
from tiler.apps.results import Accuracy, CheckSummary, Judgement, Measured, Seams
from tiler.core.units import parse_length
from tiler.errors import ConfigError, InputError
from tiler.io.locations import joined, state_at
from tiler.io.result_folder import raster_places, read_run
from tiler.schedule import call_isolated, fork_server_running, half_of_memory

SECONDS, SECONDS_PER_PIXEL = 120.0, 1e-5
"""Time that a comparison of rasters may take. It takes 0.2 to 0.6 s per million pixels."""


MEASURED_PARTS = ("accuracy", "seams", "strips", "against")
"""Parts of what a check measures."""


@dataclass(frozen=True)
class Metric:
    """Result of a check that can have a limit.

    Attributes
    ----------
    part : str
        Part of the report: ``accuracy``, ``seams`` or ``strips``.
    value : callable
        Function that returns the value of the metric from that part, or None.
    is_length : bool
        Whether the metric is a length. Otherwise it is a number of points.
    at_least : bool
        Whether the limit is a minimum. Otherwise it is a maximum.
    """

    part: str
    value: Callable[[Mapping[str, Any]], float | None]
    is_length: bool = True
    at_least: bool = False


def _nva(key: str) -> Callable[[Mapping[str, Any]], float | None]:
    return lambda accuracy: None if accuracy["nva"][key] is None else abs(accuracy["nva"][key])


METRICS: dict[str, Metric] = {
    "rmse": Metric("accuracy", _nva("rmse_v")),
    "mean": Metric("accuracy", _nva("bias")),
    "median": Metric("accuracy", _nva("median")),
    "nmad": Metric("accuracy", _nva("nmad")),
    "p95": Metric("accuracy", _nva("p95_abs")),
    "max": Metric("accuracy", _nva("max_abs")),
    "outliers": Metric("accuracy", _nva("outliers"), is_length=False),
    "points": Metric("accuracy", _nva("points"), False, at_least=True),
    "seam": Metric("seams", lambda seams: seams["excess"]),
    "strips": Metric("strips", lambda strips: strips["all"]["rmse"]),
}
"""Metrics by name.

Accuracy is that of non-vegetated checkpoints, because vegetated accuracy is never judged.
"""


@dataclass(frozen=True)
class Requirement:
    """Limit of a metric, in metres or as a number of points."""

    name: str
    limit: Fraction


def parse_requirements(texts: Iterable[str]) -> list[Requirement]:
    """Return the requirements of ``name=value`` texts, in which lengths without a unit are metres.

    Raise ConfigError if a name is unknown or a value is invalid.
    """
    requirements = []
    for text in texts:
        name, sign, value = (part.strip() for part in text.partition("="))
        if not sign or name not in METRICS:
            raise ConfigError(
                f"--require {text}; give NAME=VALUE with one of {', '.join(METRICS)}"
            )
        if METRICS[name].is_length:
            requirements.append(Requirement(name, parse_length(value)))
        elif value.isdecimal():
            requirements.append(Requirement(name, Fraction(int(value))))
        else:
            raise ConfigError(f"--require {text}: {value!r} is not a number of points")
    return requirements


def judge(requirements: Sequence[Requirement], measured: Measured) -> list[Judgement]:
    """Compare the results of checks with requirements.

    Raises
    ------
    ConfigError
        The part of a requirement was not measured.
    """
    judged: list[Judgement] = []
    for requirement in requirements:
        metric = METRICS[requirement.name]
        part: Any = measured.get(metric.part)
        if part is None:
            option = {"accuracy": "--points", "seams": "--tile-size", "strips": "--strips"}[
                metric.part
            ]
            raise ConfigError(f"--require {requirement.name} is not measured without {option}")
        value = metric.value(part)
        if value is not None and metric.is_length:
            value *= part["metres_per_unit"]
        limit = float(requirement.limit)
        met = value is not None and (value >= limit if metric.at_least else value <= limit)
        unit = "m" if metric.is_length else ""
        judged.append(
            {"name": requirement.name, "limit": limit, "value": value, "unit": unit, "met": met}
        )
    return judged


def with_earlier(summary: CheckSummary, earlier: Mapping[str, Any]) -> CheckSummary:
    """Return the measurements of a check with those of an earlier check of the same terrain that it did not repeat.

    Earlier requirements remain, and are judged by the latest measurements, unless the check has a limit of its own.
    """
    parts = {part: earlier[part] for part in MEASURED_PARTS if part in earlier}
    together = cast(CheckSummary, {**parts, **summary})
    given = {requirement["name"] for requirement in summary["requirements"]}
    kept = [
        Requirement(asked["name"], Fraction(repr(asked["limit"])))
        for asked in earlier.get("requirements", ())
        if asked["name"] in METRICS.keys() - given and METRICS[asked["name"]].part in together
    ]
    together["requirements"] = [*judge(kept, together), *summary["requirements"]]
    return together


def terrain_in(out: str) -> str:
    """Return the path or URL of the DTM in the results of a run, or raise InputError if there is none."""
    for name in raster_places(read_run(out), "dtm"):
        if state_at(joined(out, name)) is not None:
            return joined(out, name)
    raise InputError(f"{out}: contains no DTM; finish its run, or give the path of a DTM")


# Children that measure share the imports.
@fork_server_running()
def measure(
    dtm: Path,
    points: Path | None,
    options: PointOptions,
    tile_m: Fraction | None,
    strips: Sequence[str] = (),
    requirements: Sequence[Requirement] = (),
    figures: Path | None = None,
    against: AgainstOptions | None = None,
) -> CheckSummary:
    """Check a DTM by checkpoints, its seams, overlapping strips and an earlier DTM, as far as these are given.

    Parameters
    ----------
    dtm, points : Path
        Raster, and file of checkpoints.
    options : PointOptions
    tile_m : Fraction or None
        Side of a tile, see `seams_of`.
    strips : sequence of str
        Classified clouds.
    requirements : sequence of Requirement
    figures : Path, optional
        Folder for drawings of the checkpoints.
    against : AgainstOptions, optional
        Earlier DTM.

    Raises
    ------
    TilerError
    """
    if against is not None:
        validate_difference(dtm, against)
    if figures is not None:
        if points is None:
            raise ConfigError("--figures draws checkpoints; give them with --points")
        validate_figure_files(figures, dtm, points, strips)
    read = [path for path in (dtm, points) if path is not None]
    accuracy, seams = call_isolated(
        _accuracy_and_seams,
        dtm,
        points,
        options,
        tile_m,
        paths=read,
        memory_bytes=half_of_memory(),
    )
    measured: Measured = {"dtm": str(dtm)}
    if accuracy is not None:
        measured["accuracy"] = accuracy
    if seams is not None:
        measured["seams"] = seams
    if strips:
        measured["strips"] = strip_differences(strips)
    if against is not None:
        rasters, memory_bytes = (dtm, against.old), half_of_memory()
        pixels = call_isolated(pixels_of, dtm, paths=(dtm,), memory_bytes=memory_bytes)
        measured["against"] = call_isolated(
            compare,
            dtm,
            against,
            paths=rasters,
            memory_bytes=memory_bytes,
            seconds=SECONDS + pixels * SECONDS_PER_PIXEL,
            remedy="give a part of the area, or copy the rasters to a faster disk",
        )
    if len(measured) == 1:
        raise ConfigError(
            f"{dtm}: nothing to check; give --points, --tile-size (there is no run.json beside it), "
            "--strips or --against"
        )
    judgements = judge(requirements, measured)
    drawings: list[str] = []
    if figures is not None:
        drawings = call_isolated(
            write_figures, figures, dtm, accuracy, paths=(dtm,), memory_bytes=half_of_memory()
        )
    return {**measured, "requirements": judgements, "figures": drawings}


def _accuracy_and_seams(
    dtm: Path, points: Path | None, options: PointOptions, tile_m: Fraction | None
) -> tuple[Accuracy | None, Seams | None]:
    accuracy = None if points is None else check_dtm(dtm, read_checkpoints(points), options)
    return accuracy, seams_of(dtm, tile_m)
