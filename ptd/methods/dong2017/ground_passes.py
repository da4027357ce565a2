"""The passes of `dong2017` that grow ground from seeds: measurements and densifications in turn."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ptd.frame import CellLattice, Scale, Window
from ptd.ground.distance_angle import Bins, Bool, Int64, Threshold, Trial
from ptd.ground.histogram_contour import contour_reach
from ptd.ground.labelling import GROUND, UNCLASSIFIED
from ptd.methods.dong2017.distance_threshold import second_difference_jump
from ptd.methods.dong2017.growth import Growth, Stage, picks
from ptd.methods.dong2017.params import Dong2017Parameters
from ptd.methods.dong2017.seed_passes import VEGETATION
from ptd.passes import (
    MethodRefusal,
    Partial,
    Pass,
    Points,
    State,
    StatisticsModel,
    UInt8,
    add_notes,
)
from ptd.tin.mesh import Tin

HISTOGRAM_BINS = Bins(0.025, 120, 0.01, 60)
"""Histogram of distances and angles, which covers eight times the published distance and twice
the angle."""

JUMP_BINS = 2
"""Bins of distance that are merged before the search for the jump."""

MEASURED_CELLS = 2
"""Largest circumradius of a facet of ground whose points are measured, in cells."""


@dataclass(frozen=True)
class FirstMeasurement(Pass):
    """Step 5: distances of all points to the TIN of the seeds."""

    params: Dong2017Parameters
    widest_m: float
    influence_radius_m: float | None
    name: str = "measure-first"
    title = "measure distances to the seeds"
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True
    gives_labels: bool = False

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> StatisticsModel:
        """Count the unclassified points of the core in facets that are not wide, by distance and angle."""
        labels = points.known_labels()
        tin = Tin.build(*points.xyz[:, labels == GROUND])
        trial = Trial(tin, scale, self.widest_m)
        return _measured(trial, points, core, labels == UNCLASSIFIED)

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Take the first distance from the jump, and the angle from the contour below that distance."""
        plane = _summed(partials)
        rows = plane.sum(axis=1).reshape(-1, JUMP_BINS).sum(axis=1)
        jump = second_difference_jump(rows.tolist())
        within = plane[: (jump or 0) * JUMP_BINS]
        contour = _contour(within, self.params.contour_level)
        if jump is None or contour is None:
            raise MethodRefusal(
                f"no jump in the distances to the TIN of {state['seeds']} seeds: too few seeds near each other; "
                "use another method, or --set seed_cell to something larger"
            )
        threshold = Threshold(jump * JUMP_BINS * HISTOGRAM_BINS.distance_m, contour.angle_rad)
        return _with_threshold(state, "first TIN of seeds", threshold)


@dataclass(frozen=True)
class FirstGround(Pass):
    """Step 5: label the points within the first thresholds of the seeds' TIN."""

    stage: Stage
    influence_radius_m: float | None
    name: str = "first"
    title = "find the first ground"
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Growth:
        """Build the TIN of the seeds."""
        return Growth(self.stage, Threshold(**state["threshold"]), points, window, scale)


@dataclass(frozen=True)
class Measurement(Pass):
    """Step 6: measure distances and angles of the present ground to a TIN of one point per cell."""

    params: Dong2017Parameters
    spacing_m: float
    name: str
    title: str
    influence_radius_m: float | None
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True
    gives_labels: bool = False

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> StatisticsModel:
        """Count the ground points of the core that are not vertices."""
        ground = points.known_labels() == GROUND
        vertices = points.xyz[
            :, picks(points, ground, CellLattice.of(self.spacing_m, scale), 0)
        ]
        trial = Trial(Tin.build(*vertices), scale, MEASURED_CELLS * self.spacing_m)
        return _measured(trial, points, core, ground)

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Take both thresholds from the outer contour."""
        contour = _contour(_summed(partials), self.params.contour_level)
        if contour is None:
            raise MethodRefusal(
                f"no ground near the TIN of {state['seeds']} seeds to measure at {self.spacing_m:g} m; "
                "use another method"
            )
        denser = self.spacing_m < state.get("spacing_m", math.inf)
        after = _with_threshold(state, f"TIN of {self.spacing_m:g} m", contour, denser)
        return {**after, "spacing_m": self.spacing_m}


@dataclass(frozen=True)
class Densification(Pass):
    """Step 6: label the points that pass in one of several TINs of one density."""

    stage: Stage
    last: bool
    name: str
    title: str
    halo_m: float | None
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Growth:
        """Build the TINs."""
        threshold = Threshold(**state["threshold"])
        if self.last:
            return FinalGrowth(self.stage, threshold, points, window, scale)
        return Growth(self.stage, threshold, points, window, scale)


class FinalGrowth(Growth):
    """Growth with the final labels."""

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label the points, with vegetation as unclassified."""
        labels, uncertified_labels = super().label(points)
        labels[labels == VEGETATION] = UNCLASSIFIED
        return labels, uncertified_labels


def _measured(trial: Trial, points: Points, core: Window, which: Bool) -> StatisticsModel:
    counts = trial.count(
        *points.columns(), which & core.contains(points.xyz[0], points.xyz[1]), HISTOGRAM_BINS
    )
    return StatisticsModel({"plane": counts.tolist()}, {"measured": int(counts.sum())})


def _summed(partials: Iterable[Partial]) -> Int64:
    plane = np.zeros((HISTOGRAM_BINS.distances, HISTOGRAM_BINS.angles), np.int64)
    for partial in partials:
        plane += np.array(partial["plane"], np.int64)
    return plane


def _contour(plane: Int64, level: float) -> Threshold | None:
    """Return the largest distance and angle of the outer contour around the peak, or None without counts."""
    if not plane.size:
        return None
    contour_bins = contour_reach(plane, max(level * plane.max(), 1.0))
    if contour_bins is None:
        return None
    return Threshold(
        contour_bins[0] * HISTOGRAM_BINS.distance_m, contour_bins[1] * HISTOGRAM_BINS.angle_rad
    )


def _with_threshold(state: State, where: str, found: Threshold, denser: bool = True) -> State:
    """The state with new thresholds. With `denser`, a note says if they develop unlike the paper's."""
    note = f"{where}: distance {found.distance_m:.3f} m, angle {found.angle_rad:.3f} rad"
    previous = state.get("threshold")
    if previous is not None and denser:
        odd = []
        if found.distance_m > previous["distance_m"]:
            odd.append("distance does not shrink")
        if found.angle_rad < previous["angle_rad"]:
            odd.append("angle does not grow")
        if odd:
            note += f" ({' and '.join(odd)}, unlike in the paper)"
    return {**state, "threshold": found._asdict(), "notes": add_notes(state, note)}
