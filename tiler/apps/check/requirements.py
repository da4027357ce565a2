"""Limits that the figures of a check have to meet, such as ``rmse=0.1``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from tiler.core.units import parse_length
from tiler.errors import ConfigError

Report = Mapping[str, Any]


@dataclass(frozen=True)
class Metric:
    """A figure that can be required.

    Attributes
    ----------
    value : callable
        From a report (parts ``accuracy``, ``seams``, ``strips``) to the figure, None where it is not there.
    part : str
    is_length : bool
        Else a number of points.
    at_least : bool
        Else at most.
    """

    part: str
    value: Callable[[Mapping[str, Any]], float | None]
    is_length: bool = True
    at_least: bool = False


def _nva(key: str) -> Callable[[Mapping[str, Any]], float | None]:
    def value(accuracy: Mapping[str, Any]) -> float | None:
        found: float | None = accuracy["nva"][key]
        return None if found is None else abs(found)

    return value


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
"""Figures by name; those of checkpoints are of the non-vegetated ones, since vegetated accuracy is never judged."""


@dataclass(frozen=True)
class Requirement:
    """A limit of a figure: metres, or a number of points."""

    name: str
    limit: Fraction


def parse_requirements(texts: Iterable[str]) -> list[Requirement]:
    """``name=value`` texts; lengths are metres unless written with a unit. Raises ConfigError."""
    found = []
    for text in texts:
        name, sign, value = (part.strip() for part in text.partition("="))
        if not sign or name not in METRICS:
            raise ConfigError(f"--require {text}: write NAME=VALUE with one of {', '.join(METRICS)}")
        if METRICS[name].is_length:
            found.append(Requirement(name, parse_length(value)))
        elif value.isdecimal():
            found.append(Requirement(name, Fraction(int(value))))
        else:
            raise ConfigError(f"--require {text}: {value!r} is no number of points")
    return found


def judge(requirements: Sequence[Requirement], report: Report) -> list[dict[str, Any]]:
    """Compare a report with requirements.

    Returns
    -------
    list of dict
        ``name``, ``limit`` and ``value`` (metres or points; None: not measured), ``met``. What was not measured is
        not met.

    Raises
    ------
    ConfigError
        A requirement whose part of the check was not asked for.
    """
    judged = []
    for requirement in requirements:
        metric = METRICS[requirement.name]
        part = report.get(metric.part)
        if part is None:
            option = {"accuracy": "--points", "seams": "--tile-size", "strips": "--strips"}[metric.part]
            raise ConfigError(f"--require {requirement.name}: is not measured without {option}")
        value = metric.value(part)
        if value is not None and metric.is_length:
            value *= part["metres_per_unit"]
        limit = float(requirement.limit)
        met = value is not None and (value >= limit if metric.at_least else value <= limit)
        judged.append({"name": requirement.name, "limit": limit, "value": value, "met": met})
    return judged
