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
from ptd.matched import bent_hull, ground_model, objects, surface
from ptd.methods.auto.method import Auto
from tests.benchmarks.scorecard_scenes import Cloud
from tiler.apps.evaluate import IGNORED, evaluate_labels

MAIN_SETTINGS = ("max_building_size_m", "seed_rise", "object_rise", "label_floor_m")
"""One of each step: openings, seeds, what is taken out again, the last pass."""

FACTORS = (0.75, 1.0, 1.25)
"""Of their defaults."""

GROUND = 2

MATCHED_SETTINGS = {
    "FALL_M": objects, "CONTRAST": bent_hull, "RIDGE_CONTRAST": bent_hull, "ABOVE_M": surface, "GAP": surface,
    "SCALES_M": surface, "BESIDE": surface, "GROUND_M": ground_model,
}  # fmt: skip
"""Constants of matched clouds, at least one of each step, and their modules: the rim of large
objects, which hull holds, what lies about the surface, over what it is averaged, what counts
less beside objects, the last label."""

MATCHED_FACTORS, MAX_CHANGED = (0.67, 1.0, 1.5), 1
"""Of their defaults, and how many differ from these at once."""


def _times(factor: float, value: Any) -> Any:
    """A constant, or each number of one, times a factor."""
    if isinstance(value, tuple):
        return tuple(_times(factor, v) for v in value)
    return round(factor * value, 4)


MATCHED_GRID: dict[str, tuple[Any, ...]] = {
    name: tuple(_times(f, getattr(owner, name)) for f in MATCHED_FACTORS)
    for name, owner in MATCHED_SETTINGS.items()
}
"""Each of them times each of `MATCHED_FACTORS`."""


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
    most_changed : int or None
        How many values of a combination differ from the default at most; None: any number.
    """

    grid: dict[str, tuple[Any, ...]]
    settings: int
    folds: list[Fold]
    best: float
    most_changed: int | None = None


def default_grid() -> dict[str, tuple[float, ...]]:
    """Each of `MAIN_SETTINGS` times each of `FACTORS`."""
    default = Auto()
    return {
        name: tuple(round(f * getattr(default, name), 4) for f in FACTORS)
        for name in MAIN_SETTINGS
    }


def matched_default() -> dict[str, Any]:
    """What `auto` uses of `MATCHED_GRID`."""
    return {name: getattr(owner, name) for name, owner in MATCHED_SETTINGS.items()}


def matched_error(cloud: Cloud, settings: Mapping[str, Any]) -> float:
    """Total error of `auto` with these constants, a fraction of the points that count."""
    with ExitStack() as replaced:
        for name, value in settings.items():
            replaced.enter_context(mock.patch.object(MATCHED_SETTINGS[name], name, value))
        return total_error(cloud, {})


def leave_one_out(
    samples: Iterable[str],
    grid: Mapping[str, tuple[Any, ...]] | None,
    default: Mapping[str, Any] | None,
    error: Callable[[str, Mapping[str, Any]], float],
    most_changed: int | None = None,
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
    most_changed : int or None
        Combinations in which more values than this differ from the default are left out.
    """
    chosen = dict(grid or default_grid())
    usual = dict(default or {name: getattr(Auto(), name) for name in chosen})
    names = list(samples)
    combinations = [
        dict(zip(chosen, values, strict=True)) for values in product(*chosen.values())
    ]
    if most_changed is not None:
        combinations = [
            c for c in combinations if sum(c[p] != usual[p] for p in c) <= most_changed
        ]
    combinations.sort(key=lambda c: c != usual)  # a stable sort: the default first
    totals = np.array([[error(name, c) for name in names] for c in combinations])
    folds = []
    for k, name in enumerate(names):
        first = int(np.delete(totals, k, axis=1).mean(axis=1).argmin())
        changed = {p: v for p, v in combinations[first].items() if v != usual[p]}
        folds.append(Fold(name, changed, float(totals[first, k]), float(totals[0, k])))
    return LeaveOneOut(
        chosen,
        len(combinations),
        folds,
        min(mean(row) for row in totals.tolist()),
        most_changed,
    )


def total_error(cloud: Cloud, settings: Mapping[str, Any]) -> float:
    """Of `auto` with these parameters, as a fraction of the points that count."""
    found = classify(
        cloud.xyz, "auto", Auto(**settings), rgb=cloud.rgb, returns=cloud.returns
    ).classification
    labels = np.where(found == GROUND, GROUND, 1).astype(np.uint8)
    return float(evaluate_labels(labels, cloud.classification, IGNORED)["total"])
