"""``dong2017``: coloured image matching of towns, after Dong et al. (ISPRS Archives XLII-2/W7:703, 2017; paper 004).

Vegetation is told by colour, seeds are looked for on the roads beside facades, and ground grows by tests against TINs
of growing density whose thresholds are estimated from the run.

=====================  ==============================  ========  =================================================
parameter              paper's name and value          default   reason
=====================  ==============================  ========  =================================================
facade_cell            GRIDESIZE (g), no value         1 m       a wall of two storeys fills such a cell with
                                                                 several times the points of flat ground
facade_height          default height H (h), no value  5 m       the eaves of a low house
glass_factor           coefficient for glass, no       0.5       half of a facade is matched
                       value
seed_distance          d, no value                     4 m       past eaves and pavements, within narrow streets
seed_variation         2 sigma                         2         the paper's
podium_radius          neighbourhood of a seed, no     15 m      the paper's figure 4: the true seed is beside the
                       value                                     podium
terrain_slope          0.3 (equation 1)                0.3       the paper's
seed_cell              none                            15 m      "of seeds near each other the lower": one per cell
first_spacing          4 m                             4 m       the paper's
last_spacing           2 m                             2 m       the paper's; see ``ptd/DESIGN.md``
tins                   "several"                       3         see ``ptd/DESIGN.md``
contour_share          none, read off a plot           0.99      all but the outliers among the ground found so far
widest_facet           none                            30 m      bounds what a window has to hold; twice a wide street
=====================  ==============================  ========  =================================================

sigma, which the paper gets from planes picked by hand, is that of ``--sigma``, or found by `ptd.roughness`. GLI's
threshold is Otsu's (3.3.1), the first distance the jump of the second difference (3.3.3), the later
thresholds come from the plane of angles and distances (3.3.4): none of them is a parameter.

Deviations: Otsu's threshold is used only where the histogram has a grey and a green mode, and lies between them. A
seed is dropped for a lower one only if ground cannot be so steep (equation 1), or on any slope the lowest alone
would stay. The first angle is not explained in the paper: it is the contour's among the points within the first
distance. The smallest of a point's angles counts, as the paper says in 3.3.4 (Axelsson takes the largest). Facets
wider than `widest_facet` test nothing. A ring of virtual seeds lies around the first TIN, as in every method here.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd import roughness
from ptd.cells import Int32, lowest_per_cell
from ptd.certify import Doubt
from ptd.facades import FacadeRule, Facades, density_of, facade_threshold, on_podium
from ptd.frame import OPEN, Cells, Scale, Window
from ptd.greenness import BINS, COLOURLESS, gli_bins, green_from, index_of_bin
from ptd.labelling import GROUND, UNCLASSIFIED
from ptd.params import check, parameter
from ptd.passes import Method, MethodRefusal, Model, Pass, Points, State, UInt8
from ptd.picks import picked_per_cell
from ptd.seeds import RING, box_with_ring, choose_seeds
from ptd.thresholds import outer_contour, second_difference_jump
from ptd.tin.mesh import Tin
from ptd.trial import Bins, Bool, Threshold, Trial

VEGETATION = 5
"""Label between passes: no ground by its colour. Seeds are `GROUND`, all else `UNCLASSIFIED`."""

BLOCK_CELLS = 2
"""Cells beyond the one at `seed_distance` that may hold points of the block around a seed: one cut, one beside it."""

PLANE = Bins(0.025, 120, 0.01, 60)
"""Histogram of distances and angles: twice the published thresholds in angle, eight times in distance."""

JUMP_BINS = 2
"""Bins of distance that are taken together to look for the jump."""


@dataclass(frozen=True)
class Dong2017:
    """Parameters of `dong2017`; see the module's table."""

    facade_cell_m: float = parameter(
        1.0, "side of the cells in which projected points are counted", unit="m", minimum=0.25, maximum=10.0,
        source="004 3.3.2: GRIDESIZE",
    )  # fmt: skip
    facade_height_m: float = parameter(
        5.0, "height of a building by default", unit="m", minimum=0.5, maximum=100.0, source="004 3.3.2: H"
    )
    glass_factor: float = parameter(
        0.5,
        "share of a facade that is matched, the rest is glass",
        minimum=0.01,
        maximum=1.0,
        source="004 3.3.2",
    )
    seed_distance_m: float = parameter(
        4.0, "distance of a seed from the facade", unit="m", minimum=1.0, maximum=30.0, source="004 3.1: d"
    )
    seed_variation: float = parameter(
        2.0,
        "noise around a seed, in sigma, stays below",
        minimum=0.5,
        maximum=10.0,
        source="004 3.1: 2 sigma",
    )
    podium_radius_m: float = parameter(
        15.0, "neighbourhood in which a lower seed drops one that is too high above it", unit="m", minimum=1.0,
        maximum=100.0, source="004 3.1: neighbourhood of a seed",
    )  # fmt: skip
    terrain_slope: float = parameter(
        0.3, "rise per metre between two seeds that both are ground", minimum=0.0, maximum=5.0,
        source="004 equation 1: 0.3",
    )  # fmt: skip
    seed_cell_m: float = parameter(
        15.0, "one seed, the lowest, per cell of this side", unit="m", minimum=2.0, maximum=200.0
    )
    first_spacing_m: float = parameter(
        4.0, "side of the cells of the first TIN of ground, halved until the last", unit="m", minimum=0.5,
        maximum=50.0, source="004 table 4: 4 m",
    )  # fmt: skip
    last_spacing_m: float = parameter(
        2.0, "side of the cells of the last TIN of ground", unit="m", minimum=0.25, maximum=50.0,
        source="004 table 4: 2 m",
    )  # fmt: skip
    tins: int = parameter(3, "TINs of each density", minimum=1, maximum=20, source="004 3.2: several TINs")
    contour_share: float = parameter(
        0.99, "share of the ground found so far within the contour that gives the thresholds", minimum=0.5,
        maximum=1.0, source="004 3.3.4",
    )  # fmt: skip
    widest_facet_m: float = parameter(
        30.0, "facets with a larger circumradius test no points", unit="m", minimum=5.0, maximum=1000.0
    )

    def __post_init__(self) -> None:
        check(self)

    @property
    def spacings_m(self) -> tuple[float, ...]:
        """Sides of the cells of the TINs of ground: the first, then halves down to the last."""
        found = [self.first_spacing_m]
        while found[-1] > self.last_spacing_m:
            found.append(max(found[-1] / 2, self.last_spacing_m))
        return tuple(found)

    @property
    def passes(self) -> tuple[Pass, ...]:
        """Survey, seeds, and a measurement and a densification for each density."""
        steps: list[Pass] = [Survey(self), SeedPass(self), FirstMeasurement(self), FirstGround(self)]
        for spacing in self.spacings_m:
            last = spacing == self.spacings_m[-1]
            steps.append(Measurement(self, spacing, f"measure-{spacing:g}m"))
            steps.append(Densification(self, spacing, last, f"densify-{spacing:g}m"))
        return tuple(steps)

    @property
    def halo_m(self) -> float:
        """With the margin enough to leave no mark: a facet's circle, and what decides on its virtual seeds."""
        reach = 2.0 * self.widest_facet_m + max((RING + 1) * self.seed_cell_m, self.first_spacing_m)
        return max(reach - self.margin_m, 0.0)

    @property
    def align_m(self) -> float:
        """Windows hold whole seed cells."""
        return self.seed_cell_m

    @property
    def margin_m(self) -> float:
        """Whatever the halo, statistics are exact, since windows hold the circles of the facets that they count."""
        return max(
            self.seed_reach_m, roughness.REACH_M, 2 * self.first_facet_m, 5 * self.first_spacing_m
        )  # fmt: skip

    @property
    def candidate_cell_m(self) -> float:
        """Every point counts: facades are told by density, and the lowest of a cell is at the noise's lower end."""
        return 0.0

    @property
    def first_facet_m(self) -> float:
        """Largest circumradius of a facet of seeds whose points are measured: neighbouring cells' seeds have less."""
        return 1.5 * self.seed_cell_m

    @property
    def seed_reach_m(self) -> float:
        """Metres from a point beyond which nothing changes whether it is a seed.

        Over the facade to the block on its other side, for it and for its neighbours in podium and seed cell.
        """
        own = 2 * self.seed_distance_m + 2 * BLOCK_CELLS * self.facade_cell_m
        return own + self.podium_radius_m + math.sqrt(2) * self.seed_cell_m


@dataclass(frozen=True)
class Survey(Pass):
    """Step 1 and what it takes to know facades: greenness, density and noise of the run."""

    params: Dong2017
    name: str = "survey"
    columns: tuple[str, ...] = ("rgb",)
    every_point: bool = True
    gives_labels: bool = False

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Model:
        """Count greenness and points per cell; measure planar patches."""
        own = _inside(points, core)
        bins = gli_bins(_rgb(points))
        counts = np.bincount(bins[own & (bins != COLOURLESS)], minlength=BINS)
        x, y, _ = _columns(points)
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
    name: str = "seeds"
    columns: tuple[str, ...] = ("rgb",)
    every_point: bool = True

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> SeedModel:
        """Find the window's seeds."""
        return SeedModel(self.params, points, window, core, scale, state)

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
    name: str = "measure-first"
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True
    gives_labels: bool = False

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Model:
        """Count the open points of the core in facets between real seeds."""
        labels = _labels(points)
        own = _inside(points, core) & (labels == UNCLASSIFIED)
        tin = _tin(points, np.flatnonzero(labels == GROUND))
        counts = Trial(tin, scale, self.params.first_facet_m).count(*_columns(points), own, PLANE)
        return Measured({"plane": counts.tolist()}, {"measured": int(counts.sum())})

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """The first distance by the jump; the angle of the contour below it."""
        plane = _summed(partials)
        rows = plane.sum(axis=1).reshape(-1, JUMP_BINS).sum(axis=1)
        jump = second_difference_jump(rows.tolist())
        contour = (
            None if jump is None else outer_contour(plane[: jump * JUMP_BINS], self.params.contour_share)
        )
        if jump is None or contour is None:
            raise MethodRefusal(
                f"no jump in the distances to the TIN of {state['seeds']} seeds: too few seeds near each other; "
                "use another method, or --set seed_cell to something larger"
            )
        found = Threshold(jump * JUMP_BINS * PLANE.distance_m, contour[1] * PLANE.angle_rad)
        return _with_threshold(state, "first TIN of seeds", found)


@dataclass(frozen=True)
class FirstGround(Pass):
    """Step 5: the points within the first thresholds of the seeds' TIN."""

    params: Dong2017
    name: str = "first"
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Grown:
        """Build the seeds' TIN with its ring."""
        p, x, y, z = self.params, *_columns(points)
        model = Grown(Threshold(**state["threshold"]), window, scale, last=False)
        seeds = np.flatnonzero(_labels(points) == GROUND)
        if seeds.size:
            cells = Cells.of(p.seed_cell_m, scale)
            sx, sy, sz = x[seeds], y[seeds], z[seeds]
            doubt = Doubt(window, window.inside(cells, RING), box_with_ring(x, y, cells), scale)
            chosen = choose_seeds(sx, sy, sz, np.ones(seeds.size, np.bool_), cells, doubt)
            vertices = np.concatenate([np.stack([sx, sy, sz])[:, chosen.chosen], chosen.virtual.T], axis=1)
            model.add(Trial(Tin.build(*vertices), scale, p.widest_facet_m, doubt), doubt)
        return model


@dataclass(frozen=True)
class Measurement(Pass):
    """Step 6: distances and angles of the ground found so far to a TIN of one point per cell."""

    params: Dong2017
    spacing_m: float
    name: str
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True
    gives_labels: bool = False

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Model:
        """Count the ground points of the core that are no vertices."""
        labels = _labels(points)
        own = _inside(points, core) & (labels == GROUND)
        tin = _tin(points, _picks(points, labels == GROUND, Cells.of(self.spacing_m, scale), 0))
        counts = Trial(tin, scale, 2.0 * self.spacing_m).count(*_columns(points), own, PLANE)
        return Measured({"plane": counts.tolist()}, {"measured": int(counts.sum())})

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """Largest distance and angle of the outer contour."""
        contour = outer_contour(_summed(partials), self.params.contour_share)
        if contour is None:
            raise MethodRefusal(
                f"no ground near the TIN of {state['seeds']} seeds to measure at {self.spacing_m:g} m; "
                "use another method"
            )
        found = Threshold(contour[0] * PLANE.distance_m, contour[1] * PLANE.angle_rad)
        return _with_threshold(state, f"TIN of {self.spacing_m:g} m", found)


@dataclass(frozen=True)
class Densification(Pass):
    """Step 6: points that pass in one of several TINs of one density."""

    params: Dong2017
    spacing_m: float
    last: bool
    name: str
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Grown:
        """Build TINs of different picks from the ground found before."""
        p, (x, y, _), labels = self.params, _columns(points), _labels(points)
        cells = Cells.of(self.spacing_m, scale)
        model = Grown(Threshold(**state["threshold"]), window, scale, self.last)
        if not x.size:
            return model
        known = window.inside(cells)
        doubt = Doubt(known, known, box_with_ring(x, y, cells), scale)
        for salt in range(p.tins):
            tin = _tin(points, _picks(points, labels == GROUND, cells, salt))
            model.add(Trial(tin, scale, p.widest_facet_m, doubt), doubt)
        return model


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

    def __init__(
        self, params: Dong2017, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> None:
        self.green = state["green_from"]
        reach = math.ceil(scale.counts(params.seed_reach_m))
        self.known = _shrunk(window, reach)
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
            self._facade_points = int(_inside_columns(x[inside], y[inside], core).sum())
            chosen = _seeds(params, facades, scale, state["sigma_m"])
        self._seeds = {tuple(v) for v in np.stack([x, y, z], axis=1)[chosen].tolist()}
        self._own = int(_inside_columns(x[chosen], y[chosen], core).sum())
        self.stats = {"seeds": len(self._seeds), "facade_cells": int(facades.holds.sum()) if x.size else 0}

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Vegetation, seeds, the rest."""
        x, y, z = _columns(points)
        labels = np.full(x.size, UNCLASSIFIED, np.uint8)
        if self._seeds:
            seeds = np.array(sorted(self._seeds), np.int32).T
            at = np.flatnonzero(np.isin(x, seeds[0]) & np.isin(y, seeds[1]) & np.isin(z, seeds[2]))
            for i in at:
                if (int(x[i]), int(y[i]), int(z[i])) in self._seeds:
                    labels[i] = GROUND
        labels[_green(points, self.green)] = VEGETATION
        return labels, ~_inside(points, self.known)

    def partial(self) -> dict[str, Any]:
        """Points in facades and seeds of the core."""
        return {"facade_points": self._facade_points, "seeds": self._own}


class Grown(Model):
    """Ground so far, and TINs that give more."""

    def __init__(self, threshold: Threshold, window: Window, scale: Scale, last: bool) -> None:
        self.threshold, self.scale, self.last = threshold, scale, last
        self._closed = window.closed
        self._trials: list[Trial] = []
        self._doubt: Doubt | None = None
        self.stats = {"tins": 0, "vertices": 0}

    def add(self, trial: Trial, doubt: Doubt) -> None:
        """One more TIN, in the same doubt as all."""
        self._trials.append(trial)
        self._doubt = doubt
        self.stats = {"tins": len(self._trials), "vertices": trial.tin.n_vertices}

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """What passes in one of the TINs is ground; after the last pass vegetation is unclassified."""
        x, y, z = _columns(points)
        labels = _labels(points).copy()
        open_points = labels == UNCLASSIFIED
        marked = np.full(x.size, self._closed and not self._trials) & open_points
        for trial in self._trials:
            assert self._doubt is not None  # set with the first trial
            passed, doubtful = trial.test(x, y, z, open_points, self.threshold, self._doubt)
            labels[passed] = GROUND
            marked |= doubtful
            sure = passed & ~doubtful
            marked[sure] = False
            open_points &= ~sure
        if self.last:
            labels[labels == VEGETATION] = UNCLASSIFIED
        return labels, marked


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


def _with_threshold(state: State, where: str, found: Threshold) -> dict[str, Any]:
    note = f"{where}: distance {found.distance_m:.3f} m, angle {found.angle_rad:.3f} rad"
    before = state.get("threshold")
    if before is not None:
        odd = [
            *(["distance does not shrink"] if found.distance_m > before["distance_m"] else []),
            *(["angle does not grow"] if found.angle_rad < before["angle_rad"] else []),
        ]
        note += f" ({' and '.join(odd)}, unlike in the paper)" if odd else ""
    return {**state, "threshold": found._asdict(), "notes": [*state["notes"], note]}


def _summed(partials: Iterable[dict[str, Any]]) -> npt.NDArray[np.int64]:
    plane = np.zeros((PLANE.distances, PLANE.angles), np.int64)
    for partial in partials:
        plane += np.array(partial["plane"], np.int64)
    return plane


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


def _picks(points: Points, which: Bool, cells: Cells, salt: int) -> npt.NDArray[np.int64]:
    index = np.flatnonzero(which)
    x, y, z = (np.ascontiguousarray(c) for c in points.xyz[:, index])
    return index[picked_per_cell(x, y, z, cells, salt)]


def _tin(points: Points, index: npt.NDArray[np.int64]) -> Tin:
    return Tin.build(*points.xyz[:, index])


def _shrunk(window: Window, by: int) -> Window:
    return Window(
        window.west + by if window.west > -OPEN else -OPEN, window.south + by if window.south > -OPEN else -OPEN,
        window.east - by if window.east < OPEN else OPEN, window.north - by if window.north < OPEN else OPEN,
    )  # fmt: skip


def _inside_columns(x: Int32, y: Int32, window: Window) -> Bool:
    found: Bool = (x >= window.west) & (x < window.east) & (y >= window.south) & (y < window.north)
    return found


def _inside(points: Points, window: Window) -> Bool:
    return _inside_columns(points.xyz[0], points.xyz[1], window)


def _columns(points: Points) -> tuple[Int32, Int32, Int32]:
    x, y, z = (np.ascontiguousarray(c) for c in points.xyz)
    return x, y, z


def _labels(points: Points) -> UInt8:
    if points.labels is None:
        raise ValueError("the pass was given no labels")
    return points.labels


def _rgb(points: Points) -> npt.NDArray[np.uint16]:
    if points.rgb is None:
        raise ValueError("the pass was given no colours")
    return points.rgb


def _green(points: Points, green_from: int | None) -> Bool:
    if green_from is None:
        return np.zeros(len(points), np.bool_)
    found: Bool = gli_bins(_rgb(points)) >= green_from
    return found


METHOD = Method(
    "dong2017", "coloured image matching of towns: seeds beside facades (Dong 2017)", Dong2017, needs=("rgb",)
)
