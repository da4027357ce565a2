"""A method with two branches: heights in laser clouds, one elected point per cell in others.

It has nothing to do with terrain. It uses every feature of `ptd.passes.Pass`, in integers, so
results are equal to the bit for any order of points and tiles.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ptd.frame import CellLattice, Scale, Window
from ptd.params import parameter
from ptd.passes import Method, Model, Pass, Points, State, StatisticsModel

HIGH, LOW = 3, 4
CELL_M, SEEN_M, SPREAD_M, TERRAIN_M, MEAN_M = 1.0, 6.0, 3.0, 5.0, 1.0


def around(of: np.ndarray, among: np.ndarray, reach: float) -> list[list[int]]:
    """Indices of the points at most a distance away in x and in y, for each point (rows x, y of counts)."""
    if among.shape[1] == 0 or of.shape[1] == 0:
        return [[] for _ in range(of.shape[1])]
    found: list[list[int]] = (
        cKDTree(among[:2].T).query_ball_point(of[:2].T, reach, p=np.inf).tolist()
    )
    return found


class Census(Pass):
    name, gives_labels, every_point, influence_radius_m = "census", False, True, 0.0

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> StatisticsModel:
        z = points.xyz[2, core.contains(points.xyz[0], points.xyz[1])].astype(np.int64)
        return StatisticsModel({"n": int(z.size), "sum": int(z.sum())})

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        parts = list(partials)
        mean = sum(p["sum"] for p in parts) // sum(p["n"] for p in parts)
        return {**state, "mean": mean, "survey": {"kind": state["run"]["kind"] or "lidar"}}


class OnLidar(Pass):
    def applies(self, state: State) -> bool:
        return bool(state["survey"]["kind"] == "lidar")


class OfImages(Pass):
    def applies(self, state: State) -> bool:
        return bool(state["survey"]["kind"] == "dim")


class Split(Model):
    def __init__(self, mean: int, codes: tuple[int, int]) -> None:
        self.stats, self.mean, self.codes = {}, mean, codes

    def label(self, points: Points) -> Any:
        high = points.xyz[2] > self.mean
        if points.labels is not None:
            assert set(np.unique(points.labels)) <= {HIGH, LOW}
            high = points.labels == HIGH
        return np.where(high, *self.codes).astype(np.uint8), np.zeros(len(points), bool)


class SplitPass(OnLidar):
    name, influence_radius_m, every_point = "split", 0.0, True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Split:
        return Split(state["mean"], (HIGH, LOW))


class LidarPass(SplitPass):
    """The last pass of its branch."""

    name, columns = "laser", ("labels",)

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Split:
        return Split(state["mean"], (1, 2))


class Medians(Model):
    """The lower median height of each cell, at its middle, labelled by whether it is even."""

    def __init__(self, xyz: np.ndarray, cells: CellLattice) -> None:
        columns, rows = cells.cell_indices(xyz[0], xyz[1])
        order = np.lexsort((xyz[2], columns, rows))
        columns, rows, z = columns[order], rows[order], xyz[2, order]
        first = np.flatnonzero(
            np.r_[True, (np.diff(columns) != 0) | (np.diff(rows) != 0)][: len(z)]
        )
        n = np.diff(np.r_[first, len(z)])
        x = [(cells.west(int(c)) + cells.west(int(c) + 1)) // 2 for c in columns[first]]
        y = [(cells.south(int(r)) + cells.south(int(r) + 1)) // 2 for r in rows[first]]
        self.xyz = np.array([x, y, z[first + (n - 1) // 2]], np.int32).reshape(3, -1)
        self.stats = {"cells": len(n)}

    def label(self, points: Points) -> Any:
        return parity(points), np.zeros(len(points), bool)

    def elect(self, bounds: Window) -> np.ndarray:
        return self.xyz[:, bounds.contains(self.xyz[0], self.xyz[1])]


class MedianPass(OfImages):
    name, elects, every_point, influence_radius_m = "medians", True, True, CELL_M

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Medians:
        return Medians(points.xyz, CellLattice.of(CELL_M, scale))


def parity(points: Points) -> np.ndarray:
    return np.where(points.xyz[2] % 2 == 0, HIGH, LOW).astype(np.uint8)


class Rising(Model):
    """Points more than a metre above the lowest point around them are high."""

    def __init__(self, points: Points, reach: float, metre: float) -> None:
        assert np.array_equal(points.known_labels(), parity(points)), (
            "labels of the elected points"
        )
        self.xyz, self.reach, self.metre, self.stats = (
            points.xyz,
            reach,
            metre,
            {"elected": len(points)},
        )

    def label(self, points: Points) -> Any:
        near = around(points.xyz, self.xyz, self.reach)
        low = np.array([self.xyz[2, i].min() for i in near]).reshape(len(points))
        codes = np.where(points.xyz[2] - low > self.metre, HIGH, LOW).astype(np.uint8)
        return codes, np.zeros(len(points), bool)


class RisingPass(OfImages):
    name, elected, columns, influence_radius_m = "rising", True, ("labels",), SEEN_M

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Rising:
        return Rising(points, scale.counts(SEEN_M), scale.counts_z(1.0))


class Spread(Model):
    """Points near a high point are high; only the points to be labelled are searched."""

    def __init__(self, reach: float) -> None:
        self.reach, self.stats = reach, {}

    def label(self, points: Points) -> Any:
        labels = points.known_labels()
        near = around(points.xyz, points.xyz, self.reach)
        high = np.array([(labels[i] == HIGH).any() for i in near], bool)
        return np.where(high, HIGH, LOW).astype(np.uint8), np.zeros(len(points), bool)


class SpreadPass(OfImages):
    name, elected, columns, influence_radius_m, label_margin_m = (
        "spread",
        True,
        ("labels",),
        0.0,
        SPREAD_M,
    )

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Spread:
        assert set(np.unique(points.known_labels())) <= {HIGH, LOW}
        return Spread(scale.counts(SPREAD_M))


class Mean(Model):
    """Points whose neighbours have, on average, the height of the low points around are ground."""

    def __init__(self, points: Points, scale: Scale) -> None:
        self.low, self.scale = (
            points.take(points.known_labels() == LOW).xyz.astype(np.int64),
            scale,
        )
        self.stats = {"low": int(self.low.shape[1])}

    def label(self, points: Points) -> Any:
        assert points.labels is not None
        assert not points.labels.any(), "no pass before labelled points of the cloud"
        z = points.xyz[2].astype(np.int64)
        ground = np.zeros(len(points), bool)
        terrain = around(points.xyz, self.low, self.scale.counts(TERRAIN_M))
        near = around(points.xyz, points.xyz, self.scale.counts(MEAN_M))
        for i, (low, own) in enumerate(zip(terrain, near, strict=True)):
            if low:
                rise = int(z[own].sum()) // len(own) - int(self.low[2, low].sum()) // len(low)
                ground[i] = abs(rise) < self.scale.counts_z(0.4)
        return np.where(ground, 2, 1).astype(np.uint8), np.zeros(len(points), bool)


class MeanPass(OfImages):
    name, elected, columns, influence_radius_m, label_margin_m = (
        "mean",
        True,
        ("labels",),
        TERRAIN_M,
        MEAN_M,
    )

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Mean:
        return Mean(points, scale)


@dataclass(frozen=True)
class Parameters:
    unused_m: float = parameter(1.0, "nothing", unit="m", minimum=0.0, maximum=9.0)
    halo_m = 8.0
    align_m = 8.0
    margin_m = 0.0
    candidate_cell_m = 1.0

    @property
    def passes(self) -> tuple[Pass, ...]:
        images = (MedianPass(), RisingPass(), SpreadPass(), MeanPass())
        return (Census(), SplitPass(), LidarPass(), *images)


METHOD = Method("medians", "laser or images", Parameters)
