"""`auto` with the setting of a small grid that is best on all samples but one, scored on that one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import product
from statistics import mean
from typing import Any
from unittest import mock

import numpy as np

from ptd import classify
from ptd.matched import passes, surface
from ptd.methods.auto.method import Auto
from tests.benchmarks.scorecard_scenes import Cloud
from tiler.apps.evaluate import IGNORED, evaluate_labels

MAIN_SETTINGS = ("max_building_size_m", "seed_rise", "object_rise", "label_floor_m")
"""One of each step: openings, seeds, what is taken out again, the last pass."""

FACTORS = (0.75, 1.0, 1.25)
"""Of their defaults."""

GROUND = 2

MATCHED_GRID: dict[str, tuple[Any, ...]] = {
    "GROUND_M": tuple(round(f * passes.GROUND_M, 4) for f in FACTORS),
    "RIDGE_CONTRAST": tuple(tuple(f * limit for limit in surface.RIDGE_CONTRAST) for f in (0.5, 1.0, 2.0)),
}
"""Matched clouds: height above the surface up to which points are ground, contrast up to which ridges are followed."""

OWNERS = {"GROUND_M": passes, "RIDGE_CONTRAST": surface}
"""Modules whose constants these are."""


@dataclass(frozen=True)
class Fold:
    """A sample left out: what was best on the others, and total errors (fractions) of that and of the default."""

    sample: str
    settings: dict[str, Any]
    total: float
    default: float


@dataclass(frozen=True)
class LeaveOneOut:
    """All samples in turn.

    Attributes
    ----------
    grid : dict
        Values by name of the setting.
    settings : int
        How many combinations there are.
    folds : list of Fold
    best : float
        Least mean total error of one combination on all samples.
    """

    grid: dict[str, tuple[Any, ...]]
    settings: int
    folds: list[Fold]
    best: float


def default_grid() -> dict[str, tuple[float, ...]]:
    """Each of `MAIN_SETTINGS` times each of `FACTORS`."""
    default = Auto()
    return {name: tuple(round(f * getattr(default, name), 4) for f in FACTORS) for name in MAIN_SETTINGS}


def matched_default() -> dict[str, Any]:
    """What `auto` uses of `MATCHED_GRID`."""
    return {name: getattr(OWNERS[name], name) for name in MATCHED_GRID}


def matched_error(cloud: Cloud, settings: Mapping[str, Any]) -> float:
    """Total error of `auto` with these constants, a fraction of the points that count."""
    with ExitStack() as replaced:
        for name, value in settings.items():
            replaced.enter_context(mock.patch.object(OWNERS[name], name, value))
        return total_error(cloud, {})


def leave_one_out(
    samples: Iterable[str],
    grid: Mapping[str, tuple[Any, ...]] | None,
    default: Mapping[str, Any] | None,
    error: Callable[[str, Mapping[str, Any]], float],
) -> LeaveOneOut:
    """Score all combinations on all samples, then choose for each sample without it; ties go to the default.

    Parameters
    ----------
    samples : iterable of str
        Names of two or more clouds.
    grid : mapping or None
        Values by name of a setting, its default among them; None: `default_grid`.
    default : mapping or None
        The values that are used without a choice; None: those of `auto`'s parameters.
    error : callable
        What is to be least, of a cloud's name and the values of a combination.
    """
    chosen = dict(grid or default_grid())
    usual = dict(default or {name: getattr(Auto(), name) for name in chosen})
    names = list(samples)
    combinations = [dict(zip(chosen, values, strict=True)) for values in product(*chosen.values())]
    combinations.sort(key=lambda c: c != usual)  # a stable sort: the default first
    totals = np.array([[error(name, c) for name in names] for c in combinations])
    folds = []
    for k, name in enumerate(names):
        first = int(np.delete(totals, k, axis=1).mean(axis=1).argmin())
        changed = {p: v for p, v in combinations[first].items() if v != usual[p]}
        folds.append(Fold(name, changed, float(totals[first, k]), float(totals[0, k])))
    return LeaveOneOut(chosen, len(combinations), folds, min(mean(row) for row in totals.tolist()))


def total_error(cloud: Cloud, settings: Mapping[str, Any]) -> float:
    """Of `auto` with these parameters, as a fraction of the points that count."""
    found = classify(cloud.xyz, "auto", Auto(**settings), rgb=cloud.rgb, returns=cloud.returns).classification
    labels = np.where(found == GROUND, GROUND, 1).astype(np.uint8)
    return float(evaluate_labels(labels, cloud.classification, IGNORED)["total"])
