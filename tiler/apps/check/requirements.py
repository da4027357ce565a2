"""Limits for the results of a check, such as ``rmse=0.1``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from tiler.apps.check.results import Judgement, Measured
from tiler.core.units import parse_length
from tiler.errors import ConfigError


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
    def value(accuracy: Mapping[str, Any]) -> float | None:
        figure: float | None = accuracy["nva"][key]
        if figure is None:
            return None
        return abs(figure)

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
        if value is None:
            met = False
        elif metric.at_least:
            met = value >= limit
        else:
            met = value <= limit
        unit = "m" if metric.is_length else ""
        judged.append(
            {"name": requirement.name, "limit": limit, "value": value, "unit": unit, "met": met}
        )
    return judged
