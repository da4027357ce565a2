"""Stage two of `dong2018`: for each scale a pass that finds the thresholds and one that applies them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ptd.frame import Scale, Window
from ptd.ground import noise_sums
from ptd.ground.distance_angle import Bool
from ptd.ground.histogram_contour import contour_reach
from ptd.ground.labelling import GROUND, UNCLASSIFIED
from ptd.methods.dong2018.even_tin import ANGLE_BIN_DEG, BINS, DISTANCE_BIN_M, EvenTin
from ptd.methods.dong2018.params import Dong2018Parameters
from ptd.methods.dong2018.stage_one import with_notes
from ptd.passes import Model, Partial, Pass, Points, State, StatisticsModel, UInt8

JOINED = 4
"""Label of points that joined at the most recent scale; other labels between passes are ASPRS
classes."""


@dataclass(frozen=True)
class MeasurePass(Pass):
    """Step 4: measure the thresholds of distance and angle at one scale."""

    params: Dong2018Parameters
    scale_m: float
    name: str
    title: str
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True
    gives_labels: bool = False

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> StatisticsModel:
        """Make the histogram of the core's ground points that are not in the even TIN."""
        if not _goes_on(state):
            return StatisticsModel({})
        x, y, z = points.columns()
        labels = points.known_labels()
        ground = _is_ground(labels)
        even = EvenTin(x, y, z, ground, self.scale_m, window, scale)
        is_in_core = core.contains(x, y)
        counts = even.histogram(x, y, z, is_in_core & even.left_out)
        bins = np.flatnonzero(counts)
        partial = {
            "joined": int(np.count_nonzero(is_in_core & (labels == JOINED))),
            "ground": int(np.count_nonzero(is_in_core & ground)),
            "bins": [[int(i), int(counts.flat[i])] for i in bins],
        }
        return StatisticsModel(
            partial, {"vertices": even.vertices, "left_out": int(counts.sum())}
        )

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Add the thresholds and figures of this scale to the state.

        ``scales`` lists those of all scales, ``stopped`` is the reason of an early end or None.
        """
        if not _goes_on(state):
            return dict(state)
        joined = ground = 0
        counts = np.zeros(BINS.distances * BINS.angles, np.int64)
        for part in partials:
            joined, ground = joined + part["joined"], ground + part["ground"]
            for i, n in part["bins"]:
                counts[i] += n
        return self._decided(counts.reshape(BINS.distances, BINS.angles), joined, ground, state)

    def _decided(self, counts: Any, joined: int, ground: int, state: State) -> State:
        previous_scales, lines = list(state.get("scales", [])), []
        if previous_scales:
            previous_scales[-1] = {**previous_scales[-1], "joined": joined}
            lines.append(
                f"{joined} points joined at the scale of {previous_scales[-1]['scale_m']:g} m"
            )
            if joined < self.params.min_joined:
                why = f"fewer than {self.params.min_joined}"
                return with_notes(
                    state,
                    {"scales": previous_scales, "stopped": why},
                    f"{lines[0]}, {why}: stage two ends",
                )
        else:
            density = ground / (state["cells"] * noise_sums.PATCH_M**2)
            short = ""
            if density <= state["threshold_m2"]:
                short = "; nothing more passed"
            lines.append(f"stage one ended with {density:.3g} points/m2 in the TIN{short}")
        reach_bins = contour_reach(
            counts, max(self.params.contour_share * float(counts.max()), 1e-9)
        )
        if reach_bins is None:
            lines.append(
                f"no ground is left out of the TIN at the scale of {self.scale_m:g} m: stage two ends"
            )
            return with_notes(state, {"stopped": "no ground left out of the TIN"}, *lines)
        scale_figures = {
            "scale_m": self.scale_m,
            "distance_m": round(reach_bins[0] * DISTANCE_BIN_M, 6),
            "angle_deg": round(reach_bins[1] * ANGLE_BIN_DEG, 6),
            "left_out": int(counts.sum()),
        }
        lines.append(
            f"scale {self.scale_m:g} m: {scale_figures['distance_m']:.3f} m, {scale_figures['angle_deg']:.1f} degrees"
        )
        if previous_scales and scale_figures["angle_deg"] <= previous_scales[-1]["angle_deg"]:
            lines.append(
                f"warning: the angle does not grow at the scale of {self.scale_m:g} m; the paper's does"
            )
        if previous_scales and scale_figures["distance_m"] >= previous_scales[-1]["distance_m"]:
            lines.append(
                f"warning: the distance does not shrink at the scale of {self.scale_m:g} m; the paper's does"
            )
        return with_notes(state, {"scales": [*previous_scales, scale_figures]}, *lines)


@dataclass(frozen=True)
class JoinPass(Pass):
    """Step 4: add the points below the thresholds of one scale to the ground."""

    scale_m: float
    last: bool
    name: str
    title: str
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> JoinModel:
        """Build the even TIN again."""
        if not _goes_on(state):
            return JoinModel(None, 0.0, 0.0, True)
        x, y, z = points.columns()
        ground = _is_ground(points.known_labels())
        even = EvenTin(x, y, z, ground, self.scale_m, window, scale)
        last_scale = state["scales"][-1]
        return JoinModel(even, last_scale["distance_m"], last_scale["angle_deg"], self.last)


class JoinModel(Model):
    """Model that tests points against a window's even TIN. Without a TIN labels stay unchanged."""

    def __init__(
        self, even: EvenTin | None, distance_m: float, angle_deg: float, last: bool
    ) -> None:
        self._even, self._distance_m, self._angle_deg = even, distance_m, angle_deg
        self._label = JOINED
        if last:
            self._label = GROUND
        self.stats = {}
        if even is not None:
            self.stats = {"vertices": even.vertices}

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label points that joined before as ground, new ones as `JOINED`, or ground after the last scale."""
        previous_labels = points.known_labels()
        labels = np.where(previous_labels == JOINED, np.uint8(GROUND), previous_labels)
        if self._even is None:
            return labels, np.zeros(len(points), np.bool_)
        x, y, z = points.columns()
        waiting = previous_labels == UNCLASSIFIED
        passed, uncertified_labels = self._even.near(
            x, y, z, waiting, self._distance_m, self._angle_deg
        )
        labels[passed] = self._label
        return labels, uncertified_labels


def _goes_on(state: State) -> bool:
    return bool(state["dense"]) and state.get("stopped") is None


def _is_ground(labels: UInt8) -> Bool:
    ground: Bool = (labels == GROUND) | (labels == JOINED)
    return ground
