"""``ridge2016``: progressive TIN densification for steep mountains beside settlements.

Remote Sensing 8(1):71 (2016); file 003. What is not in the table is `classic`'s, with its defaults and reasons.

====================  =============================  ========  =======================================================
parameter             paper's name and value         default   reason
====================  =============================  ========  =======================================================
max_building_size     grid cell size w: 20           20 m      the paper's value. "Half of the classic's" would be 10:
                                                               more ridges, but type II doubles (``ptd/DESIGN.md``)
terrain_angle         maximum terrain angle t: 88    88 deg    the paper's value
iteration_angle       maximum angle theta: 6         25 deg    `classic`'s: 6 loses the ground of sparse clouds
iteration_distance    maximum distance d: 1.4        1.4 m     the paper's value
edge_length_stop      minimum edge length l: 1       1 m       the paper's value
ridge_side            m_r: 1.5                       1.5       the paper's value
ridge_angle           theta_r: 25                    25 deg    the paper's value
ridge_radius          "within a radius of 2 m"       2 m       the paper's value
seed_confidence       1 - alpha: 98 %                0.98      the paper's value
thin_cell             m: "the resolution of the      1 m       the DTM's default resolution
                      final acquired DTM"
growth                p_min: 0.001                   0.001     the paper's value
rounds                none                           12        a bound for the halo: few runs need as many
label_floor           none                           0.3 m     `classic`'s; 0 is the paper's rule
====================  =============================  ========  =======================================================

Steps: seeds per cell (2.1); ridge points (2.1, equation 1, `ptd.ridges`); seed refinement (2.2, equations 2-10,
`ptd.conicoid`); densification (2.3, equations 11 and 12, `ptd.thinned`).

Equation 11 ends the rounds when the terrain class grows by at most p_min of all points. Both are figures of the run,
which no tile knows. So a first pass runs all rounds and counts in each the points of its tile's core that join the
class; their sums tell which round is the last, and the second pass runs exactly as many. Twice the work, but no tile
ends earlier than its neighbour. A tile that is not certain of its count is done again with a wider halo; what stays
uncertain is summed as well, and if it could move the last round a note says so.

Deviations: seeds are judged against one TIN and dropped together, since one after the other depends on their order;
virtual seeds around the data (`ptd.seeds`) neither make ridges nor take part in fits; growth is what joins the class,
not less what leaves it (beside new vertices the facet test gets stricter: in the second round the class often shrinks
while the TIN climbs on), and the class is that of the last pass, with its floor; low outliers are taken out first (of
the paper's data nothing is said).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.cells import lowest_per_cell
from ptd.certify import Doubt
from ptd.conicoid import contradicted
from ptd.frame import Cells, Scale, Window
from ptd.labelling import UNCLASSIFIED, LowNoise, Terrain
from ptd.methods.progressive import Progressive
from ptd.outliers import low_outliers
from ptd.params import parameter
from ptd.passes import Int32, Method, Model, Pass, Points, State, UInt8
from ptd.ridges import RidgeRule, ridge_points
from ptd.seeds import RING, box_with_ring, choose_seeds
from ptd.stacks import Stacks
from ptd.thinned import Tally, densify_thinned
from ptd.tin.mesh import Tin

PAPER = "003"


@dataclass(frozen=True)
class Ridge2016(Progressive):
    """Parameters of `ridge2016`; see the module's table."""

    max_building_size_m: float = parameter(
        20.0, "w: side of the cells whose lowest point is a seed", unit="m", minimum=5.0, maximum=1000.0,
        source="003 table 1",
    )  # fmt: skip
    edge_length_stop_m: float = parameter(
        1.0, "l: facets with shorter edges take no more vertices; 0: all do", unit="m", minimum=0.0,
        maximum=1000.0, source="003 table 1",
    )  # fmt: skip
    thin_cell_m: float = parameter(
        1.0, "m: only the lowest terrain point of a cell of this side stays in the TIN; about the DTM's resolution",
        unit="m", minimum=0.1, maximum=100.0, source="003 2.3",
    )  # fmt: skip
    ridge_side: float = parameter(
        1.5, "m_r: a facet on a ridge has a side longer than this many cells, in x or in y", minimum=0.0,
        maximum=100.0, source="003 2.1",
    )  # fmt: skip
    ridge_angle_deg: float = parameter(
        25.0, "theta_r: and such angles to facets that fall away from it on two sides", unit="deg", minimum=0.0,
        maximum=90.0, source="003 2.1",
    )  # fmt: skip
    ridge_radius_m: float = parameter(
        2.0, "around the centre of such a facet the lowest point is a seed too", unit="m", minimum=0.1, maximum=5.0,
        source="003 2.1",
    )  # fmt: skip
    seed_confidence: float = parameter(
        0.98, "1 - alpha: seeds whose residual from a conicoid through their neighbours is less probable than alpha "
        "are dropped; 1: none", minimum=0.5, maximum=1.0, source="003 2.2",
    )  # fmt: skip
    seed_residual_m: float = parameter(
        0.0, "but not those with a smaller residual", unit="m", minimum=0.0, maximum=100.0
    )
    growth: float = parameter(
        0.001, "p_min: rounds end when the terrain grew by no more than this share of the run's points; 0: never",
        minimum=0.0, maximum=1.0, source="003 equation 11",
    )  # fmt: skip
    rounds: int = parameter(12, "rounds of densification at most", minimum=1, maximum=100)

    @property
    def passes(self) -> tuple[Pass, ...]:
        """Where the growth ends the rounds it is counted first."""
        last = RidgePass(self)
        return (GrowthPass(self), last) if self.growth else (last,)

    @property
    def halo_m(self) -> float:
        """Seven seed cells for what decides on ridges and seeds, 30 m for the rounds: measured on a city's edge."""
        return 7.0 * self.max_building_size_m + 30.0

    @property
    def candidate_cell_m(self) -> float:
        """Every point is a candidate: that is what the paper's densification is for."""
        return 0.0


@dataclass(frozen=True)
class GrowthPass(Pass):
    """All rounds, to count what joins the terrain class in each, and in `reduce` the round that is the last."""

    params: Ridge2016
    name: str = "growth"
    gives_labels: bool = False

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> GrowthModel:
        """Densify as long as any run would."""
        return GrowthModel(self.params, points.xyz, window, core, scale)

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """State with ``ridge2016``: ``rounds`` to run; ``points``, ``gained`` and ``unsure`` of the run."""
        points, gained, unsure = 0, [0] * self.params.rounds, [0] * self.params.rounds
        for part in partials:
            points += part["points"]
            gained = [a + b for a, b in zip(gained, part["gained"], strict=True)]
            unsure = [a + b for a, b in zip(unsure, part["unsure"], strict=True)]
        last, note = last_round(points, gained, unsure, self.params.growth)
        found = {"rounds": last, "points": points, "gained": gained[:last], "unsure": unsure[:last]}
        return {**state, "ridge2016": found, "notes": [*state.get("notes", []), note]}


def last_round(points: int, gained: list[int], unsure: list[int], growth: float) -> tuple[int, str]:
    """The round in which at most a share of all points joined the terrain class, and what to tell of it.

    Parameters
    ----------
    points : int
    gained : list of int
        Points that joined it in each round.
    unsure : list of int
        Points whose label is not certain after each round, as they lie near a tile's edge.
    growth : float
        p_min of equation 11.
    """
    limit = Fraction(repr(float(growth))) * points
    last = next((k for k, n in enumerate(gained, 1) if n <= limit), len(gained))
    share = 100 * gained[last - 1] / max(points, 1)
    note = f"densification ends after {last} rounds, the last of which added {share:.2f} % of all points to the terrain"
    if gained[last - 1] > limit:
        note += f": still more than {100 * growth:g} %, but no more rounds were wanted"
    slack = [before + after for before, after in pairwise([0, *unsure[:last]])]
    if any((n - s <= limit) != (n + s <= limit) for n, s in zip(gained[:last], slack, strict=True)):
        note += "; points near tile edges could change that: a wider halo makes it certain"
    return last, note


@dataclass(frozen=True)
class RidgePass(Pass):
    """Outliers, seeds, ridge points, seed refinement, densification, labels."""

    params: Ridge2016
    name: str = "ridge2016"

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> RidgeModel:
        """Densify by as many rounds as the growth left."""
        rounds = state["ridge2016"]["rounds"] if self.params.growth else self.params.rounds
        return RidgeModel(self.params, points.xyz, window, scale, rounds)


class Prepared:
    """A window before its densification: no outliers, refined seeds.

    Attributes
    ----------
    stacks : Stacks
        All points but low noise.
    seeds : int32 [m]
        Indices into the stacks.
    virtual : int32 [k, 3]
    doubt : Doubt
    low : LowNoise
    limits : Limits
    floor : float
        Of the final labels, counts.
    counts : dict
        What was found and dropped.
    """

    def __init__(self, params: Ridge2016, xyz: Int32, window: Window, scale: Scale) -> None:
        p = params
        self.limits, self.floor = p.limits(scale), scale.counts(p.label_floor_m)
        x, y, z = (np.ascontiguousarray(c) for c in xyz)
        thin = Cells.of(p.thin_cell_m, scale)
        lowest = lowest_per_cell(x, y, z, thin)
        lx, ly, lz = x[lowest], y[lowest], z[lowest]
        outlier = low_outliers(lx, ly, lz, scale, p.low_radius_m, p.low_depth_m, p.low_group)
        self.low = LowNoise(lx[outlier], ly[outlier], lz[outlier], thin)
        if outlier.any():
            kept = ~self.low.holds(x, y, z)
            x, y, z = x[kept], y[kept], z[kept]
        self.stacks = Stacks(x, y, z, thin)
        cells = Cells.of(p.max_building_size_m, scale)
        known = window.inside(thin, p.margin_cells)
        self.doubt = Doubt(known, known.inside(cells, RING), box_with_ring(x, y, cells), scale)
        found = choose_seeds(
            self.stacks.x, self.stacks.y, self.stacks.z, np.ones(x.size, np.bool_), cells, self.doubt
        )
        self.virtual = found.virtual
        ridge = self._ridge_points(params, found.chosen, scale)
        seeds = np.union1d(found.chosen, ridge)
        self.seeds = self._refined(params, seeds, scale)
        self.counts = {
            "points": int(xyz.shape[1]), "low_outliers": int(outlier.sum()), "seeds": int(found.chosen.size),
            "ridge_points": int(seeds.size - found.chosen.size), "dropped_seeds": int(seeds.size - self.seeds.size),
        }  # fmt: skip

    def rounds(self) -> Iterator[tuple[Tin, UInt8]]:
        """The TIN that the points are tested against in each round, and its triangles in doubt."""
        return densify_thinned(self.stacks, self.seeds, self.virtual, self.limits, self.doubt)

    def _tin(self, seeds: Int32) -> tuple[Tin, npt.NDArray[np.bool_]]:
        """TIN of seeds and virtual seeds, and which of its vertices are not virtual."""
        s, v = self.stacks, self.virtual
        tin = Tin.build(*(np.concatenate([c[seeds], v[:, k]]) for k, c in enumerate((s.x, s.y, s.z))))
        virtual = _positions(v[:, 0], v[:, 1])
        return tin, np.isin(_positions(*tin.vertices.T[:2]), virtual, invert=True)

    def _ridge_points(self, p: Ridge2016, seeds: Int32, scale: Scale) -> Int32:
        side_m = p.ridge_side * p.max_building_size_m
        rule = RidgeRule.of(scale, side_m=side_m, angle_deg=p.ridge_angle_deg, radius_m=p.ridge_radius_m)
        return ridge_points(*self._tin(seeds), self.stacks, rule, self.doubt)

    def _refined(self, p: Ridge2016, seeds: Int32, scale: Scale) -> Int32:
        tin, data = self._tin(seeds)
        length, least = scale.counts(p.max_building_size_m), scale.counts_z(p.seed_residual_m)
        wrong = contradicted(tin, data, length, p.seed_confidence, least, self.doubt)
        dropped = _positions(*tin.vertices[wrong].T[:2])
        return seeds[np.isin(_positions(self.stacks.x[seeds], self.stacks.y[seeds]), dropped, invert=True)]


def _positions(x: npt.NDArray[np.int32], y: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
    return (x.astype(np.int64) << 32) + y


class GrowthModel(Model):
    """What joins the terrain class of a window's core, round by round."""

    def __init__(self, params: Ridge2016, xyz: Int32, window: Window, core: Window, scale: Scale) -> None:
        self.stats: dict[str, Any] = {"points": int(xyz.shape[1]), "rounds": 0}
        self._points = int(_within(xyz[0], xyz[1], core).sum())
        self._gained, self._unsure = np.zeros(params.rounds, np.int64), np.zeros(params.rounds, np.int64)
        if xyz.shape[1]:
            prepared = Prepared(params, xyz, window, scale)
            self.stats.update(prepared.counts, rounds=self._count(prepared, core))

    def _count(self, prepared: Prepared, core: Window) -> int:
        s = prepared.stacks
        own = _within(s.x, s.y, core)
        seed = np.zeros(own.size, np.bool_)
        seed[prepared.seeds] = True
        tally = Tally(s.x[own], s.y[own], s.z[own], prepared.limits, prepared.floor, seed[own])
        done = 0
        for done, (tin, in_doubt) in enumerate(islice(prepared.rounds(), self._gained.size), 1):
            # Rounds that are not run would add nothing, and change nothing of what is not certain.
            self._gained[done - 1], self._unsure[done - 1 :] = tally.count(tin, in_doubt)
        return done

    def label(self, points: Points) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """Not called: the pass only counts."""
        raise NotImplementedError

    def partial(self) -> dict[str, Any]:
        """``points`` of the core, and in each round ``gained`` and ``unsure`` (see `last_round`)."""
        return {"points": self._points, "gained": self._gained.tolist(), "unsure": self._unsure.tolist()}

    def uncertain(self) -> int:
        """Points whose label is not certain after some round."""
        return int(self._unsure.max(initial=0))


class RidgeModel(Model):
    """A window's finished TIN."""

    def __init__(self, params: Ridge2016, xyz: Int32, window: Window, scale: Scale, rounds: int) -> None:
        self.stats: dict[str, Any] = {"points": int(xyz.shape[1]), "rounds": 0}
        self._closed = window.closed
        self.terrain: Terrain | None = None
        if not xyz.shape[1]:
            return
        prepared = Prepared(params, xyz, window, scale)
        for done, (tin, in_doubt) in enumerate(islice(prepared.rounds(), rounds), 1):
            self.terrain = Terrain(tin, in_doubt, prepared.low, prepared.limits, prepared.floor)
            self.stats.update(prepared.counts, rounds=done, vertices=tin.n_vertices)

    def label(self, points: Points) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """Labels and marks of points of the window."""
        if self.terrain is None:
            n = len(points)
            return np.full(n, UNCLASSIFIED, np.uint8), np.full(n, self._closed)
        return self.terrain.label(points)


def _within(x: Int32, y: Int32, core: Window) -> npt.NDArray[np.bool_]:
    inside: npt.NDArray[np.bool_] = (x >= core.west) & (x < core.east) & (y >= core.south) & (y < core.north)
    return inside


METHOD = Method(
    "ridge2016",
    "densification with ridge points and tested seeds, for steep mountains beside settlements",
    Ridge2016,
)
