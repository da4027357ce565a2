"""``dong2018``: two stages, the second from the noise of the points (Dong et al. 2018, paper 000).

Where a TIN is so dense that the noise of heights makes larger angles than the iteration angle, Axelsson's test loses
ground. So densification stops there and goes on with thresholds read from the ground points themselves, scale by
scale.

1. Noise sigma from planar patches (`ptd.roughness`, eq. 1), or ``--sigma``.
2. ``DEN_thr = k tan^2(alpha) / (3 sqrt(3) sigma^2)`` (eq. 3): where the TIN is denser, noise decides.
3. Stage one is `classic`; a facet denser than DEN_thr takes no more vertices. A cloud sparser than DEN_thr ends here,
   with exactly the labels that `classic` gives with the same parameters.
4. Stage two, for scales s = 4, 2, 1 m: one random ground point per cell of s makes an even TIN; distances and angles of
   all other ground points to it make a 2-D histogram; the reach of its outer contour is the new pair of thresholds;
   every unclassified point below both joins.

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
density_k           k: 10 (2..100)            0.2      k tan^2(alpha) is that of k = 4 at the paper's 6 degrees;
                                                       a denser stage one takes more low objects
first_scale         starting scale: none      4 m      larger cells blur the relief into the distances
last_scale          s_thr: 1                  1 m      the paper's
min_joined          n: 2000                   2000     the paper's; of the whole run, not of a tile (below)
contour_share       outer contour: none       0.01     of the fullest bin: about 2.5 standard deviations
pit_sigmas          none (seeds by hand)      6        beyond any noise
thin_cell           none                      0        as fine as DEN_thr asks; 1 m in sparse clouds
rounds, low_*,      as `classic`
label_floor
==================  ========================  =======  ===========================================================

Figures are in ``ptd/DESIGN.md``. Deviations, and what the paper leaves open:

- Its seeds were picked by hand. Ours are the lowest points per cell that are in no pit (`ptd.pits`): matched clouds
  have a blunder below the ground under nearly every cell.
- "Until the TIN's density passes DEN_thr" is decided facet by facet. Batches of all that passes would bring the mean
  of a run above it in the first round, with slopes and corners not yet reached.
- If nothing passes any more before the TIN is so dense, stage two follows too: noise is what ended it.
- Points are thinned in stage one, so that the TIN can just pass DEN_thr; a cell that cannot reach it is refused.
- Random is a hash of a point's absolute position. Facets of a circumradius above 20 m say nothing in stage two.
- n is counted over all tiles between two passes. On a city it never stops anything; per tile it would stop some tiles
  and not their neighbours, and show where tiles end.
- Both thresholds are noted for each scale, and where the angle does not grow or the distance does not shrink; none is
  changed for it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ptd import pits, roughness
from ptd.contour import contour_reach
from ptd.densify import densify_seeds
from ptd.even_tin import ANGLE_BIN_DEG, BINS, DISTANCE_BIN_M, EvenTin, reach_m
from ptd.frame import Cells, Scale, Window
from ptd.labelling import GROUND, LOW_NOISE, UNCLASSIFIED, LowNoise, Terrain
from ptd.methods.classic import Classic, ClassicModel, thinned
from ptd.methods.progressive import Progressive
from ptd.params import parameter
from ptd.passes import Int32, Method, MethodRefusal, Model, Pass, Points, State, UInt8
from ptd.trial import Bool

JOINED = 4
"""Label between passes: joined at the last scale; else the labels are ASPRS classes."""

SPARSE_M2 = 1.0
"""Points per square metre below which no plausible noise matters."""


@dataclass(frozen=True)
class Dong2018(Progressive):
    """Parameters of `dong2018`; see the module's table."""

    edge_length_reduce_m: float = parameter(
        0.0, "L1: the iteration angle shrinks on facets with shorter edges; 0: never", unit="m", minimum=0.0,
        maximum=1000.0, source="000 2.3",
    )  # fmt: skip
    thin_cell_m: float = parameter(
        0.0, "stage one: only the lowest point of a cell of this side can become a vertex; 0: as fine as DEN_thr asks",
        unit="m", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    rounds: int = parameter(8, "rounds of stage one; 0: until nothing passes", minimum=0, maximum=1000)
    density_k: float = parameter(
        0.2, "k: density coefficient of DEN_thr, the density of the TIN from which noise decides", minimum=0.001,
        maximum=1000.0, source="000 eq. 3",
    )  # fmt: skip
    first_scale_m: float = parameter(
        4.0, "stage two: largest cells of which one ground point is a vertex; halved from scale to scale", unit="m",
        minimum=1.0, maximum=64.0, source="000 2.5.3",
    )  # fmt: skip
    last_scale_m: float = parameter(
        1.0, "s_thr: no smaller cells", unit="m", minimum=0.25, maximum=1.0, source="000 2.5.3"
    )
    min_joined: int = parameter(
        2000,
        "n: stage two ends when fewer points of the run joined",
        minimum=0,
        maximum=10**9,
        source="000 2.5.3",
    )
    contour_share: float = parameter(
        0.01, "level of the outer contour as a share of the histogram's fullest bin", minimum=0.0001, maximum=0.9,
        source="000 figure 5",
    )  # fmt: skip
    pit_sigmas: float = parameter(
        6.0, "stage one: points in pits narrower than 3 m and so many sigma deep are no vertices", minimum=1.0,
        maximum=1000.0,
    )  # fmt: skip

    @property
    def scales_m(self) -> tuple[float, ...]:
        """Those of stage two."""
        n = int(math.log2(self.first_scale_m / self.last_scale_m) + 1e-9)
        return tuple(self.first_scale_m / 2**k for k in range(n + 1))

    @property
    def passes(self) -> tuple[Pass, ...]:
        """Noise and density, stage one, then two for each scale."""
        last = len(self.scales_m) - 1
        scales = ((MeasurePass(self, k), JoinPass(self, k, k == last)) for k in range(last + 1))
        return (NoisePass(self), StageOnePass(self), *(step for pair in scales for step in pair))

    @property
    def halo_m(self) -> float:
        """Two seed cells and 8 m for each round of stage one, as `classic`, less the margin that is there anyway."""
        return max(2.0 * self.max_building_size_m + 8.0 * min(self.rounds or 30, 30) - self.margin_m, 0.0)

    @property
    def margin_m(self) -> float:
        """What measuring passes and the scales need around a core, so that none of it is ever in doubt."""
        pit = pits.CELL_M * (pits.REACH_CELLS + 1)
        return max(super().margin_m, pit, roughness.REACH_M, reach_m(self.first_scale_m))

    @property
    def candidate_cell_m(self) -> float:
        """All passes see all points."""
        return 0.0

    def classic(self) -> Classic:
        """`classic` with the same parameters."""
        shared = {
            field.name: getattr(self, field.name) for field in fields(Classic) if hasattr(self, field.name)
        }
        return Classic(**{**shared, "thin_cell_m": self.thin_cell_m or 1.0})

    def threshold_m2(self, sigma_m: float) -> float:
        """DEN_thr of equation 3: points per square metre of the TIN from which noise decides."""
        return (
            self.density_k
            * math.tan(math.radians(self.iteration_angle_deg)) ** 2
            / (3 * math.sqrt(3) * sigma_m**2)
        )


@dataclass(frozen=True)
class NoisePass(Pass):
    """Steps 1 and 2: density, noise, DEN_thr, and whether the run leaves stage one."""

    params: Dong2018
    name: str = "noise"
    every_point: bool = True
    gives_labels: bool = False

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> PartialModel:
        """Look for planar patches."""
        return PartialModel(roughness.measure(points.xyz, window, core, scale))

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """``density_m2``, ``cells``, ``sigma_m``, ``patches``, ``threshold_m2``, ``thin_cell_m`` and ``dense``.

        Raises
        ------
        MethodRefusal
            No planar patch where the noise matters; a thinning cell that cannot reach DEN_thr.
        """
        parts = list(partials)
        found = roughness.merge(parts)
        given = state["run"]["sigma_m"]
        sigma = given if given is not None else found.sigma_m
        figures = {
            "density_m2": found.density_m2, "cells": sum(p["cells"] for p in parts), "sigma_m": sigma,
            "patches": found.patches, "threshold_m2": None, "thin_cell_m": None, "dense": False,
        }  # fmt: skip
        density = f"{found.density_m2:.3g} points/m2"
        least = self.params.threshold_m2(sigma or roughness.LARGEST_SIGMA_M)
        if found.density_m2 < SPARSE_M2 or (sigma is None and found.density_m2 <= least):
            return _noted(
                state, figures, f"{density}: too sparse for noise to matter, so the result is classic's"
            )
        if sigma is None:
            raise MethodRefusal(
                f"dong2018: {found.patches or 'no'} planar patches of ground are too few to estimate the noise of"
                f" heights, which matters at {density}; give it with --sigma METRES"
            )
        origin = "given" if given is not None else f"from {found.patches} planar patches"
        what = f"sigma {sigma:.3g} m ({origin}), {density}, DEN_thr {least:.3g} points/m2"
        figures["threshold_m2"] = least
        if found.density_m2 <= least:
            return _noted(state, figures, f"{what}: sparser than that, so the result is classic's")
        cell = self.params.thin_cell_m or _thin_cell(least)
        if 1.0 / cell**2 <= least:
            raise MethodRefusal(
                f"dong2018: with thin_cell {cell:g} m the TIN cannot be denser than {1 / cell**2:.3g} points/m2 and"
                f" never passes DEN_thr ({what}); use --set thin_cell={_thin_cell(least):g}, or 0 to have it chosen"
            )
        figures.update(dense=True, thin_cell_m=cell)
        return _noted(state, figures, f"{what}: two stages, vertices of stage one thinned to {cell:g} m")


def _thin_cell(threshold_m2: float) -> float:
    """The coarsest thinning cell, of whole centimetres and at most a metre, with which a TIN can pass a density."""
    centimetres = math.ceil(100.0 / math.sqrt(threshold_m2)) - 1
    return min(max(centimetres, 1), 100) / 100


def _noted(state: State, figures: dict[str, Any], *lines: str) -> dict[str, Any]:
    return {**state, **figures, "notes": [*state.get("notes", []), *(f"dong2018: {line}" for line in lines)]}


class PartialModel(Model):
    """A window of a pass that only measures."""

    def __init__(self, partial: dict[str, Any], **stats: Any) -> None:
        self._partial, self.stats = partial, stats

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Never called: the pass gives no labels."""
        raise NotImplementedError

    def partial(self) -> dict[str, Any]:
        """What was measured."""
        return self._partial


def even_edge_m(density_m2: float) -> float:
    """Edge of the equilateral facets of a TIN of that density: a vertex for each two of them."""
    return math.sqrt(2.0 / (math.sqrt(3.0) * density_m2))


@dataclass(frozen=True)
class StageOnePass(Pass):
    """Step 3. In a dense cloud only vertices are ground afterwards, as in the paper; else `classic` as it is."""

    params: Dong2018
    name: str = "stage-one"
    every_point: bool = True

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Model:
        """Densify the window's TIN."""
        if not state["dense"]:
            return ClassicModel(self.params.classic(), points.xyz, window, scale)
        return StageOneModel(self.params, points.xyz, window, scale, state)


class StageOneModel(Model):
    """A window's TIN where noise begins to matter."""

    def __init__(self, params: Dong2018, xyz: Int32, window: Window, scale: Scale, state: State) -> None:
        self._scale, self._closed = scale, window.closed
        x, y, z = (np.ascontiguousarray(c) for c in xyz)
        self._terrain: Terrain | None = None
        self.stats: dict[str, Any] = {"candidates": 0, "rounds": 0, "pit_points": 0, "vertices": 0}
        if not x.size:
            return
        self._depth = math.ceil(scale.counts_z(params.pit_sigmas * state["sigma_m"]))
        self._pits = pits.pits(x, y, z, params.pit_sigmas * state["sigma_m"], scale)
        low = self._pits.holds(x, y, z)
        cell = float(state["thin_cell_m"])
        x, y, z = thinned(np.stack([x, y, z])[:, ~low], cell, scale)
        edge = even_edge_m(state["threshold_m2"])
        limits = replace(params, edge_length_stop_m=max(params.edge_length_stop_m, edge)).limits(scale)
        cells = Cells.of(cell, scale)
        known = window.inside(Cells.of(pits.CELL_M, scale), pits.REACH_CELLS).inside(cells)
        tin, in_doubt, rounds = densify_seeds(
            x, y, z, np.zeros(x.size, np.bool_), Cells.of(params.max_building_size_m, scale), limits, params.rounds,
            known, scale,
        )  # fmt: skip
        none = np.zeros(0, np.int32)
        self._terrain = Terrain(
            tin, in_doubt, LowNoise(none, none, none, cells), limits, 0.0, vertices_only=True
        )
        self.stats.update(
            candidates=int(x.size), rounds=rounds, pit_points=int(low.sum()), vertices=tin.n_vertices
        )

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Vertices are ground, points in pits below the TIN low noise."""
        if self._terrain is None:
            return np.full(len(points), UNCLASSIFIED, np.uint8), np.full(len(points), self._closed)
        labels, marked = self._terrain.label(points)
        x, y, z = (np.ascontiguousarray(c) for c in points.xyz)
        low = np.flatnonzero((labels != GROUND) & self._pits.holds(x, y, z))
        below = z[low] < self._terrain.tin.heights(x[low], y[low]) - self._depth
        labels[low[below]] = LOW_NOISE
        return labels, marked


@dataclass(frozen=True)
class MeasurePass(Pass):
    """Step 4, the thresholds of scale number `index`."""

    params: Dong2018
    index: int
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True
    gives_labels: bool = False

    @property
    def name(self) -> str:  # type: ignore[override]
        """With the scale."""
        return f"measure-{self.params.scales_m[self.index]:g}"

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> PartialModel:
        """Histogram of the core's ground points that are not in the even TIN."""
        if not _goes_on(state):
            return PartialModel({})
        x, y, z = (np.ascontiguousarray(c) for c in points.xyz)
        labels = _labels(points)
        ground = _is_ground(labels)
        even = EvenTin(x, y, z, ground, self.params.scales_m[self.index], window, scale)
        own = (x >= core.west) & (x < core.east) & (y >= core.south) & (y < core.north)
        counts = even.histogram(x, y, z, own & even.left_out)
        bins = np.flatnonzero(counts)
        partial = {
            "joined": int(np.count_nonzero(own & (labels == JOINED))),
            "ground": int(np.count_nonzero(own & ground)),
            "bins": [[int(i), int(counts.flat[i])] for i in bins],
        }
        return PartialModel(partial, vertices=even.vertices, left_out=int(counts.sum()))

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """``scales``: a list of thresholds and figures, one more for each scale; ``stopped``: the reason, or None."""
        if not _goes_on(state):
            return dict(state)
        joined = ground = 0
        counts = np.zeros(BINS.distances * BINS.angles, np.int64)
        for part in partials:
            joined, ground = joined + part["joined"], ground + part["ground"]
            for i, n in part["bins"]:
                counts[i] += n
        return self._decided(counts.reshape(BINS.distances, BINS.angles), joined, ground, state)

    def _decided(self, counts: Any, joined: int, ground: int, state: State) -> dict[str, Any]:
        scale_m, before = self.params.scales_m[self.index], list(state.get("scales", []))
        lines = []
        if before:
            before[-1] = {**before[-1], "joined": joined}
            lines.append(f"{joined} points joined at the scale of {before[-1]['scale_m']:g} m")
            if joined < self.params.min_joined:
                why = f"fewer than {self.params.min_joined}"
                return _noted(state, {"scales": before, "stopped": why}, f"{lines[0]}, {why}: stage two ends")
        else:
            density = ground / (state["cells"] * roughness.PATCH_M**2)
            short = "; nothing more passed" if density <= state["threshold_m2"] else ""
            lines.append(f"stage one ended with {density:.3g} points/m2 in the TIN{short}")
        reach = contour_reach(counts, max(self.params.contour_share * float(counts.max()), 1e-9))
        if reach is None:
            lines.append(f"no ground is left out of the TIN at the scale of {scale_m:g} m: stage two ends")
            return _noted(state, {"stopped": "no ground left out of the TIN"}, *lines)
        found = {
            "scale_m": scale_m, "distance_m": round(reach[0] * DISTANCE_BIN_M, 6),
            "angle_deg": round(reach[1] * ANGLE_BIN_DEG, 6), "left_out": int(counts.sum()),
        }  # fmt: skip
        lines.append(f"scale {scale_m:g} m: {found['distance_m']:.3f} m, {found['angle_deg']:.1f} degrees")
        if before and found["angle_deg"] <= before[-1]["angle_deg"]:
            lines.append(f"warning: the angle does not grow at the scale of {scale_m:g} m; the paper's does")
        if before and found["distance_m"] >= before[-1]["distance_m"]:
            lines.append(
                f"warning: the distance does not shrink at the scale of {scale_m:g} m; the paper's does"
            )
        return _noted(state, {"scales": [*before, found]}, *lines)


@dataclass(frozen=True)
class JoinPass(Pass):
    """Step 4, the points that join at scale number `index`."""

    params: Dong2018
    index: int
    last: bool
    columns: tuple[str, ...] = ("labels",)
    every_point: bool = True

    @property
    def name(self) -> str:  # type: ignore[override]
        """With the scale."""
        return f"join-{self.params.scales_m[self.index]:g}"

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> JoinModel:
        """Build the even TIN again."""
        if not _goes_on(state):
            return JoinModel(None, 0.0, 0.0, True)
        x, y, z = (np.ascontiguousarray(c) for c in points.xyz)
        ground = _is_ground(_labels(points))
        even = EvenTin(x, y, z, ground, self.params.scales_m[self.index], window, scale)
        found = state["scales"][-1]
        return JoinModel(even, found["distance_m"], found["angle_deg"], self.last)


class JoinModel(Model):
    """A window's even TIN and the thresholds; without a TIN labels stay as they are."""

    def __init__(self, even: EvenTin | None, distance_m: float, angle_deg: float, last: bool) -> None:
        self._even, self._distance_m, self._angle_deg = even, distance_m, angle_deg
        self._label = GROUND if last else JOINED
        self.stats = {} if even is None else {"vertices": even.vertices}

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """What joined before is ground; what joins now is `JOINED`, or ground after the last scale."""
        before = _labels(points)
        labels = np.where(before == JOINED, np.uint8(GROUND), before)
        if self._even is None:
            return labels, np.zeros(len(points), np.bool_)
        x, y, z = (np.ascontiguousarray(c) for c in points.xyz)
        waiting = before == UNCLASSIFIED
        passed, marked = self._even.near(x, y, z, waiting, self._distance_m, self._angle_deg)
        labels[passed] = self._label
        return labels, marked


def _goes_on(state: State) -> bool:
    return bool(state["dense"]) and state.get("stopped") is None


def _labels(points: Points) -> UInt8:
    if points.labels is None:
        raise ValueError("points were given without the labels of the pass before")
    return points.labels


def _is_ground(labels: UInt8) -> Bool:
    ground: Bool = (labels == GROUND) | (labels == JOINED)
    return ground


METHOD = Method("dong2018", "two stages, the second with thresholds from the noise (Dong 2018), for image matching",
                Dong2018)  # fmt: skip
