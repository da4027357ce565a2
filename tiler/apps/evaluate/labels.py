"""Counts of labels by reference class, and the scores of these counts.

The scores follow Sithole and Vosselman (2004, Experimental comparison of filter algorithms for bare-Earth
extraction from airborne laser scanning point clouds, ISPRS J. 59). With ``a`` ground kept, ``b`` ground lost,
``c`` objects labelled ground, and ``d`` objects rejected, type I = b / (a + b), type II = c / (c + d), and
total = (b + c) / n.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.apps.evaluate.results import ClassScores, Scores
from tiler.core.classes import GROUND
from tiler.errors import InputError

IGNORED = (7, 9, 17, 18, 26, 64, 65, 66, 67)
"""Reference classes that are neither ground nor object: noise, water, bridges, virtual points,
artefacts."""

ERRORS = ("type_1", "type_2", "total", "kappa", "f1")

UInt8s = npt.NDArray[np.uint8]
Int64s = npt.NDArray[np.int64]


def class_table(labels: UInt8s, reference: UInt8s) -> Int64s:
    """Count points by reference class and by label, which is ground or not.

    Parameters
    ----------
    labels, reference : uint8, shape (n,)
        ASPRS classes of the same points: the labels to judge, and the reference classes.

    Returns
    -------
    int64, shape (256, 2)
        For each reference class, the number of points not labelled ground, and the number labelled ground.
    """
    if labels.shape != reference.shape:
        raise InputError(
            f"{labels.size} labels against {reference.size} true ones; compare the same points"
        )
    key = 2 * reference.astype(np.intp) + (labels == GROUND)
    return np.bincount(key, minlength=512).reshape(256, 2).astype(np.int64)


def counts_of(table: Int64s, ignore: Sequence[int] = IGNORED) -> Int64s:
    """Return the counts a, b, c, d of a `class_table` and the number of points left out, int64 [5].

    The text of the module defines these counts.
    """
    left_out = np.zeros(256, np.bool_)
    left_out[list(ignore)] = True
    ground = np.zeros(2, np.int64)
    objects = table[~left_out].sum(axis=0)
    if not left_out[GROUND]:
        ground = table[GROUND]
        objects = objects - ground
    return np.array(
        [ground[1], ground[0], objects[1], objects[0], table[left_out].sum()], np.int64
    )


def confusion(labels: UInt8s, reference: UInt8s, ignore: Sequence[int] = IGNORED) -> Int64s:
    """Return `counts_of` the `class_table` of labels and reference classes.

    Parameters
    ----------
    labels, reference : uint8, shape (n,)
        ASPRS classes of the same points: the labels to judge, and the reference classes.
    ignore : sequence of int
        Reference classes that are left out.
    """
    return counts_of(class_table(labels, reference), ignore)


def scores(counts: Int64s) -> Scores:
    """Return errors and agreement from the five counts of `confusion`."""
    a, b, c, d, ignored = (int(n) for n in counts)
    n = a + b + c + d
    chance = (a + b) * (a + c) + (c + d) * (b + d)
    return {
        "points": n,
        "ignored": ignored,
        "ground_kept": a,
        "ground_lost": b,
        "object_taken": c,
        "object_kept": d,
        "type_1": ratio(b, a + b),
        "type_2": ratio(c, c + d),
        "total": ratio(b + c, n),
        "kappa": ratio((a + d) * n - chance, n * n - chance),
        "f1": ratio(2 * a, 2 * a + b + c),
    }


def ratio(part: float, whole: int) -> float | None:
    """Return a quotient, or None for a division by zero."""
    if not whole:
        return None
    return part / whole


def evaluate_labels(
    labels: UInt8s, reference: UInt8s, ignore: Sequence[int] = IGNORED
) -> Scores:
    """Return the `scores` of labels and reference classes, with the arguments of `confusion`."""
    return scores(confusion(labels, reference, ignore))


def class_scores(table: Int64s, ignore: Sequence[int] = IGNORED) -> dict[str, ClassScores]:
    """Return counts and errors of each reference class of a `class_table`, by class as text."""
    scores_by_class: dict[str, ClassScores] = {}
    for code in np.flatnonzero(table.sum(axis=1)).tolist():
        other, ground = (int(n) for n in table[code])
        wrong: int | None = ground
        if code == GROUND:
            wrong = other
        if code in ignore:
            wrong = None
        scores_by_class[str(code)] = {
            "points": other + ground,
            "labelled_ground": ground,
            "wrong": wrong,
            "error": None if wrong is None else wrong / (other + ground),
        }
    return scores_by_class


def mean_scores(scenes: Iterable[Mapping[str, Any]]) -> dict[str, float | None]:
    """Return the mean of each of `ERRORS` over scenes of equal weight, or None if all lack it."""
    scenes = list(scenes)
    means: dict[str, float | None] = {}
    for name in ERRORS:
        values = [scene[name] for scene in scenes if scene[name] is not None]
        means[name] = ratio(sum(values), len(values))
    return means
