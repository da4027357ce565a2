"""``dong2018``: two stages, the second from the noise of the points (Dong et al. 2018, paper 000).

In a dense TIN the noise of heights makes larger angles than the iteration angle, and Axelsson's
test loses ground. So densification stops at the density at which noise decides, and continues
with thresholds read from the ground points themselves, scale by scale.

1. Noise sigma from planar patches (`ptd.ground.roughness`, eq. 1), or ``--sigma``.
2. ``DEN_thr = k tan^2(alpha) / (3 sqrt(3) sigma^2)`` (eq. 3): in a denser TIN, noise decides.
3. Stage one is `classic`; a facet denser than DEN_thr takes no more vertices. A cloud sparser than DEN_thr ends here,
   with exactly the labels that `classic` gives with the same parameters.
4. Stage two, for scales s = 4, 2, 1 m: one random ground point per cell of size s makes an even TIN. The distances and
   angles of all other ground points to it make a 2-D histogram, and the reach of its outer contour gives a new pair of
   thresholds. Every unclassified point below both joins the ground.

==================  ========================  =======  ===========================================================
parameter           paper's name and value    default  reason
==================  ========================  =======  ===========================================================
max_building_size   grid size: 30             20 m     that of `classic`
terrain_angle       terrain angle: 88         88 deg   the paper's
iteration_angle     max angle: 6              25 deg   that of `classic`: sparse clouds end in stage one
iteration_distance  max distance: 1.4         1.4 m    the paper's on slopes
                    (slopes), 0.8 (flat)
edge_length_reduce  L1: none (table 3)        0 (off)  the paper's
edge_length_stop    L2: none (table 3)        0 (off)  the paper's; DEN_thr sets one in dense clouds
density_k           k: 10 (2..100)            0.2      gives k tan^2(alpha) of k = 4 at the paper's 6 degrees;
                                                       a denser stage one takes more low objects
first_scale         starting scale: none      4 m      larger cells blur the relief into the distances
last_scale          s_thr: 1                  1 m      the paper's
min_joined          n: 2000                   2000     the paper's; counted over the run, not per tile (below)
contour_share       outer contour: none       0.01     of the fullest bin: about 2.5 standard deviations
pit_sigmas          none (seeds by hand)      6        beyond any noise
thin_cell           none                      0        as fine as DEN_thr requires; 1 m in sparse clouds
rounds, low_*,      as `classic`
label_floor
robust_cells        none                      on       ours, for photogrammetric clouds, see below; off: the
                                                       paper's rule
==================  ========================  =======  ===========================================================

**Photogrammetric clouds**, the paper's subject, are filtered differently by default (`ptd.matched.robust_cells`).
Stage one gets one robust height per cell of 1 m. The last pass classifies points on both sides of its TIN by the noise
around them. These heights are sparse means of many points, so by equation 3 noise does not end stage one. Stage two is
omitted, because the last pass recovers the ground that noise would lose. ``--set robust_cells=no`` gives the steps
above, which are also those for LiDAR clouds.

Figures are in ``docs/filters.md``. Deviations, and answers to questions that the paper leaves
open:

- The paper's seeds were picked by hand. Ours are the lowest points per cell that do not lie in
  a pit (`pits`), because photogrammetric clouds have a blunder below the ground under nearly
  every cell.
- "Until the TIN's density passes DEN_thr" is decided facet by facet. In batches, the mean
  density of a run would pass it in the first round, before slopes and corners are reached.
- If densification ends before the TIN reaches DEN_thr, stage two follows as well, because noise
  ended stage one.
- Points are thinned in stage one, so that the TIN can just pass DEN_thr. A thinning cell that
  cannot reach it is refused.
- A random choice is a hash of the point's absolute position. Facets of a circumradius above 20
  m test no points in stage two.
- n is counted over all tiles between two passes. On a city it never stops a run; per tile it
  would stop some tiles and not their neighbours, and so show the edges of tiles.
- Both thresholds are reported for each scale, with a warning if the angle does not grow or the
  distance does not shrink. The thresholds are used as they are.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, cast

import numpy as np

from ptd.arrays import Bool, UInt8
from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale, Window
from ptd.ground import noise_sums, roughness
from ptd.ground.densify import densify_seeds
from ptd.ground.distance_angle import contour_reach
from ptd.ground.labelling import GROUND, LOW_NOISE, UNCLASSIFIED, LabelRule, TinLabels
from ptd.matched.robust_cells import RobustCells, for_both_kinds
from ptd.methods.classic import Classic, ClassicPass, Progressive, thinned
from ptd.methods.dong2018.surfaces import (
    ANGLE_BIN_DEG,
    BINS,
    DISTANCE_BIN_M,
    PIT_CELL_M,
    PIT_REACH_CELLS,
    EvenTin,
    pits,
    reach_m,
)
from ptd.params import DECIMALS, like, parameter
from ptd.passes import (
    Method,
    MethodRefusal,
    Model,
    Partial,
    Pass,
    Points,
    State,
    StatisticsModel,
    add_notes,
)

STAGE_ONE_ALONE = (
    "dong2018: robust heights of cells are too sparse and too accurate for noise to matter, so there is no "
    "stage two"
)
"""Note for runs on a photogrammetric cloud."""


@dataclass(frozen=True)
class Dong2018(Progressive):
    """Parameters of `dong2018` (see the module's table), and the passes and reaches that follow from them."""

    edge_length_reduce_m: float = parameter(
        0.0, "L1: the iteration angle shrinks on facets with shorter edges; 0: never", unit="m", minimum=0.0,
        maximum=1000.0, source="Dong 2018, 2.3",
    )  # fmt: skip
    thin_cell_m: float = parameter(
        0.0, "stage one: only the lowest point of a cell of this size can become a vertex; 0: as DEN_thr requires",
        unit="m", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    rounds: int = parameter(8, "rounds of stage one; 0: until no point passes", 0, 1000)
    density_k: float = parameter(
        0.2, "k: density coefficient of DEN_thr, the density of the TIN from which noise decides", minimum=0.001,
        maximum=1000.0, source="Dong 2018, eq. 3",
    )  # fmt: skip
    first_scale_m: float = parameter(
        4.0, "stage two: largest cells, each gives one vertex; halved from scale to scale", unit="m",
        minimum=1.0, maximum=64.0, source="Dong 2018, 2.5.3",
    )  # fmt: skip
    last_scale_m: float = parameter(
        1.0, "s_thr: smallest cells", 0.25, 1.0, "m", source="Dong 2018, 2.5.3"
    )
    min_joined: int = parameter(
        2000,
        "n: stage two ends when fewer points of the run join",
        0,
        10**9,
        source="Dong 2018, 2.5.3",
    )
    contour_share: float = parameter(
        0.01, "level of the outer contour as a share of the histogram's fullest bin", minimum=0.0001, maximum=0.9,
        source="Dong 2018, figure 5",
    )  # fmt: skip
    pit_sigmas: float = parameter(
        6.0, "stage one: points in pits narrower than 3 m and at least this many sigma deep cannot become vertices",
        minimum=1.0,
        maximum=1000.0,
    )  # fmt: skip
    robust_cells: bool = like(RobustCells, "robust_cells")

    @property
    def scales_m(self) -> tuple[float, ...]:
        """Sizes of the cells of stage two, beginning with the largest."""
        n = int(math.log2(self.first_scale_m / self.last_scale_m) + 1e-9)
        return tuple(self.first_scale_m / 2**k for k in range(n + 1))

    def classic(self) -> Classic:
        """`classic` with the same parameters."""
        shared = {
            field.name: getattr(self, field.name)
            for field in fields(Classic)
            if hasattr(self, field.name)
        }
        return Classic(**{**shared, "thin_cell_m": self.thin_cell_m or 1.0})

    def threshold_m2(self, sigma_m: float) -> float:
        """DEN_thr of equation 3: points per square metre of the TIN above which noise decides."""
        return (
            self.density_k
            * math.tan(math.radians(self.iteration_angle_deg)) ** 2
            / (3 * math.sqrt(3) * sigma_m**2)
        )

    @property
    def passes(self) -> tuple[Pass, ...]:
        """The measurement of noise and density, stage one, then a measurement and a labelling for each scale."""
        method_passes: list[Pass] = [NoisePass(self), StageOnePass(self)]
        for m in self.scales_m:
            method_passes.append(
                MeasurePass(self, m, f"measure-{m:g}", f"measure distances to a TIN of {m:g} m")
            )
            last = m == self.scales_m[-1]
            method_passes.append(JoinPass(m, last, f"join-{m:g}", f"densify a TIN of {m:g} m"))
        if self.robust_cells:
            return for_both_kinds(method_passes, self.classic().passes, STAGE_ONE_ALONE)
        return tuple(method_passes)

    @property
    def halo_m(self) -> float:
        """Two seed cells and 8 m for each round of stage one, as in `classic`, without the margin."""
        return max(
            2.0 * self.max_building_size_m + 8.0 * min(self.rounds or 30, 30) - self.margin_m,
            0.0,
        )

    @property
    def margin_m(self) -> float:
        """Margin of the measuring passes and the scales, with which all points of a core are certified."""
        pit = PIT_CELL_M * (PIT_REACH_CELLS + 1)
        return max(super().margin_m, pit, roughness.REACH_M, reach_m(self.first_scale_m))

    @property
    def candidate_cell_m(self) -> float:
        """0: all passes read all points."""
        return 0.0


SPARSE_M2 = 1.0
"""Points per square metre below which no plausible noise has an effect."""
MAX_STOP_M = 1000.0
"""Upper limit of ``edge_length_stop_m``. Noise of many metres would require longer edges."""


@dataclass(frozen=True)
class NoisePass(Pass):
    """Steps 1 and 2: measure density and noise, and decide whether the run needs stage two."""

    params: Dong2018
    name: str = "noise"
    title = "decide whether noise matters"
    every_point: bool = True
    gives_labels: bool = False

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> StatisticsModel:
        """Measure density and planar patches."""
        return StatisticsModel(roughness.measure(points.xyz, window, core, scale))

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Add the figures of the run to the state.

        These are ``density_m2``, ``cells``, ``sigma_m``, ``patches``, ``threshold_m2``,
        ``thin_cell_m`` and ``dense``.

        Raises
        ------
        MethodRefusal
            If noise matters and there is no planar patch, or if a thinning cell cannot reach DEN_thr.
        """
        parts = cast(list[noise_sums.PatchCounts], list(partials))
        measured = noise_sums.merge(parts)
        given = state["run"]["sigma_m"]
        sigma, origin = measured.sigma_m, f"from {measured.patches} planar patches"
        if given is not None:
            sigma, origin = given, "given"
        figures = {
            "density_m2": measured.density_m2,
            "cells": sum(p["cells"] for p in parts),
            "sigma_m": sigma,
            "patches": measured.patches,
            "threshold_m2": None,
            "thin_cell_m": None,
            "dense": False,
        }
        density = f"{measured.density_m2:.3g} points/m2"
        assumed = noise_sums.MAX_SIGMA_M if sigma is None else sigma
        least = self.params.threshold_m2(assumed)
        if measured.density_m2 < SPARSE_M2 or (sigma is None and measured.density_m2 <= least):
            return with_notes(
                state,
                figures,
                f"{density}: too sparse for noise to matter, so the result is classic's",
            )
        if sigma is None:
            raise MethodRefusal(
                f"dong2018: {measured.patches or 'no'} planar patches of ground are too few to estimate the noise of"
                f" heights, which matters at {density}; give it with --sigma METRES"
            )

        summary = f"sigma {sigma:.3g} m ({origin}), {density}, DEN_thr {least:.3g} points/m2"
        figures["threshold_m2"] = least
        if measured.density_m2 <= least:
            return with_notes(
                state, figures, f"{summary}: sparser than that, so the result is classic's"
            )
        cell = self.params.thin_cell_m or _thin_cell(least)
        if 1.0 / cell**2 <= least:
            raise MethodRefusal(
                f"dong2018: with thin_cell {cell:g} m the TIN cannot be denser than {1 / cell**2:.3g} points/m2 and"
                f" never passes DEN_thr ({summary}); use --set thin_cell={_thin_cell(least):g}, or 0 to have it chosen"
            )
        figures.update(dense=True, thin_cell_m=cell)
        return with_notes(
            state,
            figures,
            f"{summary}: two stages, vertices of stage one thinned to {cell:g} m",
        )


def _thin_cell(threshold_m2: float) -> float:
    """The coarsest thinning cell (whole centimetres, at most 1 m) with which a TIN can exceed a density."""
    centimetres = math.ceil(100.0 / math.sqrt(threshold_m2)) - 1
    return min(max(centimetres, 1), 100) / 100


def with_notes(state: State, figures: Mapping[str, Any], *lines: str) -> State:
    """The state with more figures, and with notes about them."""
    return {
        **state,
        **figures,
        "notes": add_notes(state, *(f"dong2018: {line}" for line in lines)),
    }


def even_edge_m(density_m2: float) -> float:
    """Edge of the facets of an equilateral TIN of a density, which has a vertex for two facets."""
    return math.sqrt(2.0 / (math.sqrt(3.0) * density_m2))


@dataclass(frozen=True)
class StageOnePass(Pass):
    """Step 3: densify until noise decides. In dense clouds only vertices become ground, as in the paper."""

    params: Dong2018
    name: str = "stage-one"
    title = "find the first terrain"
    every_point: bool = True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        """Densify the window's TIN."""
        if not state["dense"]:
            return ClassicPass(self.params.classic()).fit(points, window, core, scale, state)
        return StageOneModel(self.params, points, window, scale, state)


class StageOneModel(TinLabels):
    """The TIN of a window after stage one."""

    def __init__(
        self,
        params: Dong2018,
        points: Points,
        window: Window,
        scale: Scale,
        state: State,
    ) -> None:
        super().__init__(
            window.closed, {"candidates": 0, "rounds": 0, "pit_points": 0, "vertices": 0}
        )
        x, y, z = points.columns()
        if not x.size:
            return
        self._depth = math.ceil(scale.counts_z(params.pit_sigmas * state["sigma_m"]))
        self._pits = pits(x, y, z, params.pit_sigmas * state["sigma_m"], scale)
        low = self._pits.holds(x, y, z)
        cell = float(state["thin_cell_m"])
        x, y, z = thinned((x[~low], y[~low], z[~low]), cell, scale)
        edge = min(round(even_edge_m(state["threshold_m2"]), DECIMALS), MAX_STOP_M)
        limits = replace(
            params, edge_length_stop_m=max(params.edge_length_stop_m, edge)
        ).limits(scale)
        cells = CellLattice.of(cell, scale)
        known = window.inside(CellLattice.of(PIT_CELL_M, scale), PIT_REACH_CELLS).inside(cells)
        tin, uncertified, rounds = densify_seeds(
            Xyz(x, y, z),
            np.zeros(x.size, np.bool_),
            CellLattice.of(params.max_building_size_m, scale),
            limits,
            params.rounds,
            known,
            scale,
        )
        self.stats.update(candidates=int(x.size), rounds=rounds, pit_points=int(low.sum()))
        self.finish(tin, uncertified, LabelRule(limits, 0.0, vertices_only=True))

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label vertices as ground, and points in pits below the TIN as low noise."""
        labels, uncertified_labels = super().label(points)
        if self.tin is not None:
            x, y, z = points.columns()
            low = np.flatnonzero((labels != GROUND) & self._pits.holds(x, y, z))
            below = z[low] < self.tin.heights(x[low], y[low]) - self._depth
            labels[low[below]] = LOW_NOISE
        return labels, uncertified_labels


JOINED = 4
"""Label of points that joined at the most recent scale; other labels between passes are ASPRS
classes."""


@dataclass(frozen=True)
class MeasurePass(Pass):
    """Step 4: measure the thresholds of distance and angle at one scale."""

    params: Dong2018
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
        self._label = GROUND if last else JOINED
        self.stats = {} if even is None else {"vertices": even.vertices}

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


METHOD = Method(
    "dong2018",
    "two stages, the second with thresholds from the noise (Dong 2018), for image matching",
    Dong2018,
)
