"""Scores of the classes of a cloud: counts of labels by reference class, whose points come in any order.

The scores follow Sithole and Vosselman (2004, Experimental comparison of filter algorithms for bare-Earth
extraction from airborne laser scanning point clouds, ISPRS J. 59). With ``a`` ground kept, ``b`` ground lost,
``c`` objects labelled ground, and ``d`` objects rejected, type I = b / (a + b), type II = c / (c + d), and
total = (b + c) / n. IoU = a / (a + b + c) is the intersection over union of ground, and MCC the correlation of both
classes (Matthews 1975, Biochimica et Biophysica Acta 405).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ptd.arrays import AnyArray, Bool, Indices, Int64, UInt8
from tiler.apps.evaluate.maps import ErrorGrid
from tiler.apps.results import ClassScores, CloudScores, LabelScores, Pairing, Scores
from tiler.core.points import GROUND, WITHHELD_FLAG
from tiler.errors import InputError
from tiler.io.las.headers import read_header
from tiler.io.las.point_formats import class_and_flags, coordinate
from tiler.io.las.reader import NEEDED, PointReader

IGNORED = (7, 9, 17, 18, 26, 64, 65, 66, 67)
"""Reference classes that are neither ground nor object: noise, water, bridges, virtual points,
artefacts."""

ERRORS = ("type_1", "type_2", "total", "kappa", "f1", "iou", "mcc")


def class_table(labels: UInt8, reference: UInt8) -> Int64:
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


def counts_of(table: Int64, ignore: Sequence[int] = IGNORED) -> Int64:
    """Return the counts a, b, c, d of a `class_table` and the number of points left out, int64 [5].

    The text of the module defines these counts.
    """
    left_out = np.zeros(256, np.bool_)
    left_out[list(ignore)] = True
    ground = table[GROUND] * (not left_out[GROUND])
    objects = table[~left_out].sum(axis=0) - ground
    return np.array([*ground[::-1], *objects[::-1], table[left_out].sum()], np.int64)


def scores(counts: Int64) -> Scores:
    """Return errors and agreement from the five counts of `counts_of`."""
    a, b, c, d, ignored = (int(n) for n in counts)
    n = a + b + c + d
    chance = (a + b) * (a + c) + (c + d) * (b + d)
    margins = (a + b) * (a + c) * (c + d) * (b + d)
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
        "iou": ratio(a, a + b + c),
        "mcc": ratio(a * d - b * c, math.sqrt(margins)),
    }


def ratio(part: float, whole: float) -> float | None:
    """Return a quotient, or None for a division by zero."""
    return part / whole if whole else None


def evaluate_labels(labels: UInt8, reference: UInt8, ignore: Sequence[int] = IGNORED) -> Scores:
    """Return the `scores` of labels and reference classes.

    Parameters
    ----------
    labels, reference : uint8, shape (n,)
        ASPRS classes of the same points: the labels to judge, and the reference classes.
    ignore : sequence of int
        Reference classes that are left out.
    """
    return scores(counts_of(class_table(labels, reference), ignore))


def class_scores(table: Int64, ignore: Sequence[int] = IGNORED) -> dict[str, ClassScores]:
    """Return counts and errors of each reference class of a `class_table`, by class as text."""
    scores_by_class: dict[str, ClassScores] = {}
    for code in np.flatnonzero(table.sum(axis=1)).tolist():
        other, ground = (int(n) for n in table[code])
        wrong = None if code in ignore else other if code == GROUND else ground
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
    values = {
        name: [scene[name] for scene in scenes if scene[name] is not None] for name in ERRORS
    }
    return {name: ratio(sum(known), len(known)) for name, known in values.items()}


_STEP = 1_000_000
PER_UNIT = 10_000
"""Counts per unit of the CRS. Coordinates are compared in counts."""


class ClassifiedPoints(NamedTuple):
    """Points of a file: coordinates (int64 counts, shape (3, n)), classes and a mask of withheld points."""

    place: Int64
    classes: UInt8
    withheld: Bool

    def take(self, at: AnyArray) -> ClassifiedPoints:
        """Return the points of an index array or mask."""
        return ClassifiedPoints(self.place[:, at], self.classes[at], self.withheld[at])


class LabelComparison:
    """Counts of the paired points of two files.

    Attributes
    ----------
    table : int64, shape (256, 2)
        Counts of `tiler.apps.evaluate.clouds.class_table`.
    withheld : int
        Number of points that are withheld in the reference, and are not judged.
    grid : ErrorGrid or None
        Grid that receives the errors per cell.
    """

    def __init__(self, grid: ErrorGrid | None = None) -> None:
        self.table = np.zeros((256, 2), np.int64)
        self.withheld = 0
        self.grid = grid

    def add(self, labels: UInt8, reference: ClassifiedPoints) -> None:
        """Count the labels of the reference's points."""
        if reference.withheld.any():
            self.withheld += int(reference.withheld.sum())
            labels, reference = labels[~reference.withheld], reference.take(~reference.withheld)
        self.table += class_table(labels, reference.classes)
        if self.grid is not None:
            self.grid.add(reference.place, PER_UNIT, labels, reference.classes)

    def facts(self, ignore: Sequence[int]) -> LabelScores:
        """Return the scores, overall and by class, and the numbers of points left out."""
        per_class = self.table.sum(axis=1)
        left_out: dict[str, int] = {
            str(code): int(per_class[code]) for code in ignore if per_class[code]
        }
        return {
            **scores(counts_of(self.table, ignore)),
            "ignore": sorted(ignore),
            "left_out": left_out,
            "withheld": self.withheld,
            "classes": class_scores(self.table, ignore),
        }


def evaluate_files(
    cloud: Path | str, reference: Path | str, ignore: Sequence[int] = IGNORED
) -> CloudScores:
    """Score the classes of a cloud against those of a reference cloud.

    Files with the same points in the same order are read side by side in bounded memory.
    Otherwise both are held in memory, and points are paired by their coordinates, rounded to
    counts of `PER_UNIT`. Points at one position are paired in the order of their files. Points
    that are withheld in the reference are not judged.

    Raises
    ------
    InputError
        A file cannot be read, or no point of the reference is in the cloud.
    """
    findings, how = compare_files(Path(cloud), Path(reference))
    return {**findings.facts(ignore), **how}


def compare_files(
    cloud: Path, reference: Path, grid: ErrorGrid | None = None
) -> tuple[LabelComparison, Pairing]:
    """Compare two files, and return the counts and how points were paired.

    An empty ``grid`` receives the errors per cell. Raise InputError as `evaluate_files` does.
    """
    findings = LabelComparison(grid)
    if _in_order(cloud, reference, findings):
        return findings, {"matched_by": "order", "unmatched_reference": 0, "unmatched_cloud": 0}
    if grid is not None:
        grid.clear()
    findings = LabelComparison(grid)
    cloud_points, true = _whole(cloud), _whole(reference)
    in_cloud, in_reference = _pairs(cloud_points.place, true.place)
    if len(in_cloud) == 0:
        raise InputError(
            f"{reference}: none of its points is in {cloud}; give the reference of this cloud"
        )
    findings.add(cloud_points.classes[in_cloud], true.take(in_reference))
    return findings, {
        "matched_by": "coordinates",
        "unmatched_reference": len(true.classes) - len(in_reference),
        "unmatched_cloud": len(cloud_points.classes) - len(in_cloud),
    }


def _read(path: Path) -> Iterator[ClassifiedPoints]:
    header = read_header(path)
    with PointReader(header, NEEDED) as reader:
        for start in range(0, header.point_count, _STEP):
            records = reader.read(start, min(_STEP, header.point_count - start))
            xyz = [coordinate(records, header, axis) for axis in range(3)]
            positions = np.round(np.stack(xyz) * PER_UNIT).astype(np.int64)
            classes, flags = class_and_flags(records, header.point_format)
            yield ClassifiedPoints(positions, classes, (flags & WITHHELD_FLAG) > 0)


def _in_order(cloud: Path, reference: Path, findings: LabelComparison) -> bool:
    """Compare two files point by point. Return False if their points are in different orders.

    The counts in ``findings`` are then incomplete.
    """
    if read_header(cloud).point_count != read_header(reference).point_count:
        return False
    for cloud_points, true in zip(_read(cloud), _read(reference), strict=True):
        if not np.array_equal(cloud_points.place, true.place):
            return False
        findings.add(cloud_points.classes, true)
    return True


def _whole(path: Path) -> ClassifiedPoints:
    parts = list(_read(path))
    if not parts:
        raise InputError(f"{path}: no points; nothing to compare")
    return ClassifiedPoints(
        np.concatenate([p.place for p in parts], axis=1),
        np.concatenate([p.classes for p in parts]),
        np.concatenate([p.withheld for p in parts]),
    )


def _pairs(place: Int64, true_place: Int64) -> tuple[Indices, Indices]:
    both = np.concatenate((place, true_place), axis=1)
    # The n-th point at a position is paired with the n-th point of the other file at that
    # position.
    order = np.lexsort((both[2], both[1], both[0]))
    ordered = both[:, order]
    new = np.r_[True, np.any(ordered[:, 1:] != ordered[:, :-1], axis=0)]
    group = np.empty(len(order), np.int64)
    group[order] = np.cumsum(new) - 1
    cloud_numbers, other = (_numbered(part) for part in np.split(group, [place.shape[1]]))
    _, in_cloud, in_reference = np.intersect1d(
        cloud_numbers, other, assume_unique=True, return_indices=True
    )
    return in_cloud, in_reference


def _numbered(group: Int64) -> Int64:
    """Return a number per point, unique for its position and the number of earlier points there."""
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    start = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]][: len(group)])
    turn = np.arange(len(group)) - np.repeat(start, np.diff(np.r_[start, len(group)]))
    out = np.empty(len(group), np.int64)
    out[order] = (ordered << 24) + np.minimum(turn, (1 << 24) - 1)
    return out
