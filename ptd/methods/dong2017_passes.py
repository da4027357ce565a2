"""The passes of `ptd.methods.dong2017`."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ptd import roughness
from ptd.cells import Int32, lowest_per_cell
from ptd.contour import contour_reach
from ptd.facades import FacadeRule, Facades, density_of, facade_threshold, on_podium
from ptd.frame import Cells, Scale, Window
from ptd.greenness import BINS, COLOURLESS, gli_bins, green_from, index_of_bin
from ptd.growth import Growth, Stage, columns, labels_of, picks
from ptd.labelling import GROUND, UNCLASSIFIED
from ptd.passes import MethodRefusal, Model, Pass, Points, State, UInt8
from ptd.thresholds import second_difference_jump
from ptd.tin.mesh import Tin
from ptd.trial import Bins, Bool, Int64, Threshold, Trial

if TYPE_CHECKING:
    from ptd.methods.dong2017 import Dong2017

VEGETATION = 5
"""Label between passes: no ground by its colour. Seeds are `GROUND`, all else `UNCLASSIFIED`."""

PLANE = Bins(0.025, 120, 0.01, 60)
"""Histogram of distances and angles: eight times the published thresholds in distance, nearly twice in angle."""

JUMP_BINS = 2
"""Bins of distance that are taken together to look for the jump."""

MEASURED_CELLS = 2
"""Largest circumradius of a facet of ground whose points are measured, in cells."""


@dataclass(frozen=True)
class Survey(Pass):
    """Step 1 and what it takes to know facades: greenness, density and noise of the run."""

    params: Dong2017
    reach_m: float | None
    name: str = "survey"
    columns: tuple[str, ...] = ("rgb",)
    every_point: bool = True
    gives_labels: bool = False

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Model:
        """Count greenness and points per cell; measure planar patches."""
        own = _inside(points, core)
        bins = gli_bins(_rgb(points))
        counts = np.bincount(bins[own & (bins != COLOURLESS)], minlength=BINS)
        x, y, _ = columns(points)
        cells = Cells.of(self.params.facade_cell_m, scale)
        found: dict[str, Any] = {
            "gli": counts.tolist(), "points": int(own.sum()), "cells": _points_by_count(x, y, cells, own),
        }  # fmt: skip
        if state["run"]["sigma_m"] is None:
            found["patches"] = roughness.measure(points.xyz, window, core, scale)
        return Measured(found, {"points": int(own.sum())})

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """Threshold of greenness, density, noise."""
        gli, cells, patches = np.zeros(BINS, np.int64), Counter[int](), []
        for partial in partials:
            gli += np.array(partial["gli"], np.int64)
            cells.update({int(count): int(points) for count, points in partial["cells"]})
            if "patches" in partial:
                patches.append(partial["patches"])
        if not gli.any():
            raise MethodRefusal("no point has a colour, dong2017 tells vegetation by it; use another method")
        green, density = green_from(gli.tolist()), density_of(cells, self.params.facade_cell_m**2)
        sigma, origin = _sigma(state["run"]["sigma_m"], patches)
        share = gli[green:].sum() / gli.sum() if green is not None else 0.0
        vegetation = (
            "vegetation by colour: none, the histogram of greenness (GLI) has no two modes" if green is None else
            f"vegetation by colour: GLI above {index_of_bin(green):.3f} (Otsu), {share:.1%} of the points"
        )  # fmt: skip
        return {
            **state, "green_from": green, "density_m2": density, "sigma_m": sigma,
            "notes": [*state.get("notes", []), vegetation, f"noise {sigma:g} m ({origin}), {density:.1f} points/m2"],
        }  # fmt: skip


@dataclass(frozen=True)
class SeedPass(Pass):
    """Steps 2 to 4: facades, seeds beside them, podiums. Labels: vegetation, seeds, the rest."""

    params: Dong2017
    reach_m: float | None
    name: str = "seeds"
    columns: tuple[str, ...] = ("rgb",)
    every_point: bool = True

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> SeedModel:
        """Find the window's seeds."""
        return SeedModel(self.params, points, core, scale, state)

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """Refuse a run without facades or seeds."""
        total: Counter[str] = Counter()
        for partial in partials:
            total.update(partial)
        p = self.params
        if not total["facade_points"]:
            least = facade_threshold(state["density_m2"], p.facade_height_m, p.facade_cell_m, p.glass_factor)
            raise MethodRefusal(
                f"no facade found: no cell of {p.facade_cell_m:g} m holds more than {least:.0f} points (the cloud has "
                f"{state['density_m2']:.1f}/m2); seeds lie beside facades, so use another method, or --set "
                f"facade_height or --set glass_factor to something lower"
            )
        if not total["seeds"]:
            raise MethodRefusal(
                f"no seed found beside the facades ({total['facade_points']} points in them): no flat place "
                f"{p.seed_distance_m:g} m from one; use another method, or other --set seed_distance, a larger --sigma"
            )
        note = (
            f"facades: {total['facade_points']:,} points in dense cells; {total['seeds']:,} seeds beside them"
        )
        return {**state, "seeds": total["seeds"], "notes": [*state["notes"], note]}


@dataclass(frozen=True)
class FirstMeasurement(Pass):
    """Step 5: distances of all points to the TIN of the seeds."""

    params: Dong2017
    widest_m: float
    reach_m: float | None
    name: str = "measure-first"
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True
    gives_labels: bool = False

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Measured:
        """Count the open points of the core in compact facets."""
        labels = labels_of(points)
        tin = Tin.build(*points.xyz[:, labels == GROUND])
        trial = Trial(tin, scale, self.widest_m)
        return _measured(trial, points, core, labels == UNCLASSIFIED)

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """The first distance by the jump; the angle of the contour below it."""
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
        found = Threshold(jump * JUMP_BINS * PLANE.distance_m, contour.angle_rad)
        return _with_threshold(state, "first TIN of seeds", found)


@dataclass(frozen=True)
class FirstGround(Pass):
    """Step 5: the points within the first thresholds of the seeds' TIN."""

    stage: Stage
    reach_m: float | None
    name: str = "first"
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Growth:
        """Build the TIN of the seeds."""
        return Growth(self.stage, Threshold(**state["threshold"]), points, window, scale)


@dataclass(frozen=True)
class Measurement(Pass):
    """Step 6: distances and angles of the ground found so far to a TIN of one point per cell."""

    params: Dong2017
    name: str
    spacing_m: float
    reach_m: float | None
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True
    gives_labels: bool = False

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Measured:
        """Count the ground points of the core that are no vertices."""
        ground = labels_of(points) == GROUND
        vertices = points.xyz[:, picks(points, ground, Cells.of(self.spacing_m, scale), 0)]
        trial = Trial(Tin.build(*vertices), scale, MEASURED_CELLS * self.spacing_m)
        return _measured(trial, points, core, ground)

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """Reach of the outer contour."""
        contour = _contour(_summed(partials), self.params.contour_level)
        if contour is None:
            raise MethodRefusal(
                f"no ground near the TIN of {state['seeds']} seeds to measure at {self.spacing_m:g} m; "
                "use another method"
            )
        return _with_threshold(state, f"TIN of {self.spacing_m:g} m", contour)


@dataclass(frozen=True)
class Densification(Pass):
    """Step 6: points that pass in one of several TINs of one density."""

    name: str
    stage: Stage
    last: bool
    halo_m: float | None
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Growth:
        """Build the TINs."""
        kind = FinalGrowth if self.last else Growth
        return kind(self.stage, Threshold(**state["threshold"]), points, window, scale)


class FinalGrowth(Growth):
    """Its labels are the final ones."""

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Vegetation is unclassified in the end."""
        labels, marked = super().label(points)
        labels[labels == VEGETATION] = UNCLASSIFIED
        return labels, marked


class Measured(Model):
    """A window of a pass that only measures."""

    def __init__(self, partial: dict[str, Any], stats: dict[str, Any]) -> None:
        self._partial, self.stats = partial, stats

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Not called."""
        raise NotImplementedError("the pass gives no labels")

    def partial(self) -> dict[str, Any]:
        """Of the core."""
        return self._partial


class SeedModel(Model):
    """Seeds of a window."""

    def __init__(self, params: Dong2017, points: Points, core: Window, scale: Scale, state: State) -> None:
        self.green = state["green_from"]
        keep = ~_green(points, self.green)
        x, y, z = (np.ascontiguousarray(c) for c in points.xyz[:, keep])
        self._facade_points = 0
        chosen = np.zeros(0, np.int32)
        if x.size:
            least = facade_threshold(
                state["density_m2"], params.facade_height_m, params.facade_cell_m, params.glass_factor
            )
            facades = Facades(x, y, z, Cells.of(params.facade_cell_m, scale), least)
            inside = facades.points()
            self._facade_points = int(_within(x[inside], y[inside], core).sum())
            chosen = _seeds(params, facades, scale, state["sigma_m"])
        self._seeds = {tuple(v) for v in np.stack([x, y, z], axis=1)[chosen].tolist()}
        self._own = int(_within(x[chosen], y[chosen], core).sum())
        self.stats = {"seeds": len(self._seeds), "facade_cells": int(facades.holds.sum()) if x.size else 0}

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Vegetation, seeds, the rest."""
        x, y, z = columns(points)
        labels = np.full(x.size, UNCLASSIFIED, np.uint8)
        if self._seeds:
            seeds = np.array(sorted(self._seeds), np.int32).T
            at = np.flatnonzero(np.isin(x, seeds[0]) & np.isin(y, seeds[1]) & np.isin(z, seeds[2]))
            for i in at:
                if (int(x[i]), int(y[i]), int(z[i])) in self._seeds:
                    labels[i] = GROUND
        labels[_green(points, self.green)] = VEGETATION
        return labels, np.zeros(len(points), np.bool_)

    def partial(self) -> dict[str, Any]:
        """Points in facades and seeds of the core."""
        return {"facade_points": self._facade_points, "seeds": self._own}


def _seeds(p: Dong2017, facades: Facades, scale: Scale, sigma_m: float) -> Int32:
    """Steps 3 and 4: indices of the points of `facades` that are seeds."""
    cell = p.facade_cell_m
    rule = FacadeRule(
        max(1, round(p.seed_distance_m / cell)), max(1, round(p.seed_distance_m / (math.sqrt(2) * cell))),
        # A facade is counted from the height on that fills its cell so far.
        scale.counts_z(p.glass_factor * p.facade_height_m), scale.counts(p.seed_variation * sigma_m), scale.z_ratio,
    )  # fmt: skip
    x, y, z = facades.x, facades.y, facades.z
    found = facades.seeds(rule)
    found = found[
        ~on_podium(x[found], y[found], z[found], scale, p.podium_radius_m, p.terrain_slope, sigma_m)
    ]
    return found[lowest_per_cell(x[found], y[found], z[found], Cells.of(p.seed_cell_m, scale))]


def _sigma(given: float | None, patches: list[dict[str, Any]]) -> tuple[float, str]:
    if given is not None:
        return given, "--sigma"
    found = roughness.merge(patches)
    if found.sigma_m is None:
        raise MethodRefusal("no planar patch to measure the noise of heights; say it with --sigma (metres)")
    return found.sigma_m, f"from {found.patches:,} planar patches"


def _measured(trial: Trial, points: Points, core: Window, which: Bool) -> Measured:
    """The chosen points of the core in the plane of distances and angles."""
    counts = trial.count(*columns(points), which & _inside(points, core), PLANE)
    return Measured({"plane": counts.tolist()}, {"measured": int(counts.sum())})


def _summed(partials: Iterable[dict[str, Any]]) -> Int64:
    plane = np.zeros((PLANE.distances, PLANE.angles), np.int64)
    for partial in partials:
        plane += np.array(partial["plane"], np.int64)
    return plane


def _contour(plane: Int64, level: float) -> Threshold | None:
    """Largest distance and angle of the outer contour around the plane's peak; None without counts."""
    found = contour_reach(plane, max(level * plane.max(), 1.0)) if plane.size else None
    return None if found is None else Threshold(found[0] * PLANE.distance_m, found[1] * PLANE.angle_rad)


def _with_threshold(state: State, where: str, found: Threshold) -> dict[str, Any]:
    note = f"{where}: distance {found.distance_m:.3f} m, angle {found.angle_rad:.3f} rad"
    before = state.get("threshold")
    if before is not None:
        shrinks, grows = found.distance_m <= before["distance_m"], found.angle_rad >= before["angle_rad"]
        odd = [
            *([] if shrinks else ["distance does not shrink"]),
            *([] if grows else ["angle does not grow"]),
        ]
        note += f" ({' and '.join(odd)}, unlike in the paper)" if odd else ""
    return {**state, "threshold": found._asdict(), "notes": [*state["notes"], note]}


def _points_by_count(x: Int32, y: Int32, cells: Cells, own: Bool) -> list[list[int]]:
    """[number, points of the core in cells with so many points], in the order of the numbers."""
    if not x.size:
        return []
    c = cells
    columns = ((x.astype(np.int64) + c.origin_x) * c.q) // c.p
    rows = ((y.astype(np.int64) + c.origin_y) * c.q) // c.p
    keys = (rows - rows.min()) * (int(columns.max() - columns.min()) + 1) + columns - columns.min()
    _, slot, counts = np.unique(keys, return_inverse=True, return_counts=True)
    found, points = np.unique(counts[slot[own]], return_counts=True)
    return [[int(n), int(p)] for n, p in zip(found, points, strict=True)]


def _within(x: Int32, y: Int32, window: Window) -> Bool:
    found: Bool = (x >= window.west) & (x < window.east) & (y >= window.south) & (y < window.north)
    return found


def _inside(points: Points, window: Window) -> Bool:
    return _within(points.xyz[0], points.xyz[1], window)


def _rgb(points: Points) -> npt.NDArray[np.uint16]:
    if points.rgb is None:
        raise ValueError("the pass was given no colours")
    return points.rgb


def _green(points: Points, green_from: int | None) -> Bool:
    if green_from is None:
        return np.zeros(len(points), np.bool_)
    found: Bool = gli_bins(_rgb(points)) >= green_from
    return found
