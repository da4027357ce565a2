"""``ridge2016``: progressive TIN densification for steep mountains beside settlements.

Remote Sensing 8(1):71 (2016); file 003. Parameters that are not in the table are those of
`classic`.

====================  =============================  ========  =======================================================
parameter             paper's name and value         default   reason
====================  =============================  ========  =======================================================
max_building_size     grid cell size w: 20           20 m      the paper's value. "Half of the classic's" would be 10:
                                                               more ridges, but type II doubles (``docs/filters.md``)
terrain_angle         maximum terrain angle t: 88    88 deg    the paper's value
iteration_angle       maximum angle theta: 6         25 deg    `classic`'s: 6 loses the ground of sparse clouds
iteration_distance    maximum distance d: 1.4        1.4 m     the paper's value
edge_length_stop      minimum edge length l: 1       1 m       the paper's value
ridge_side            m_r: 1.5                       1.5       the paper's value
ridge_angle           theta_r: 25                    25 deg    the paper's value
ridge_radius          "within a radius of 2 m"       2 m       the paper's value
seed_confidence       1 - alpha: 98 %                0.98      the paper's value
seed_residual         none                           0 (off)   the test alone decides, as in the paper
thin_cell             m: "the resolution of the      1 m       the DTM's default resolution
                      final acquired DTM"
growth                p_min: 0.001                   0.001     the paper's value
rounds                none                           12        a bound for the halo: few runs need as many
label_floor           none                           0.3 m     `classic`'s; 0 is the paper's rule
robust_cells          none                           on        ours, for photogrammetric clouds like the paper's data:
                                                               `ptd.matched.robust_cells`; off: the paper's rule
====================  =============================  ========  =======================================================

Steps: seeds per cell (2.1); ridge points (2.1, equation 1, `ridges`); seed refinement (2.2, equations 2-10,
`conicoid`); densification (2.3, equations 11 and 12, `thinned_densification`).

Equation 11 ends the rounds when the terrain class grows by at most p_min of all points. Both
numbers belong to the run and are unknown in a tile. So a first pass runs all rounds and counts,
in each, the points of its tile's core that join the class. The sums over all tiles determine
the last round. The labels of the first pass say in which round a point became a vertex. A
vertex is replaced only by a lower one of its cell, and never returns, so these labels give the
second pass the TIN of the last round. No tile ends earlier than its neighbour. A tile with an
uncertified count is repeated with a wider halo. The remaining uncertified points are summed as
well. If they could change the last round, a note reports it.

Deviations:

- Seeds are judged against one TIN and dropped together, because judging one after the other
  depends on their order.
- Virtual seeds around the data (`ptd.ground.densify`) neither make ridges nor take part in fits.
- Growth is the number of points that join the class. Points that leave it are not subtracted,
  because the facet test gets stricter next to new vertices: in the second round the class often
  shrinks while the TIN grows. The class is that of the last pass, with its floor.
- Low outliers are removed first; the paper does not mention them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, pairwise

import numpy as np

from ptd.arrays import Bool, Int32, UInt8
from ptd.cells import Xyz, lowest_per_cell, position_keys
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.densify import RING, box_with_ring, choose_seeds, tin_with_ring
from ptd.ground.labelling import GROUND, LOW_NOISE, UNCLASSIFIED, LabelRule, TinLabels
from ptd.ground.outliers import LowNoise, low_outliers
from ptd.matched.robust_cells import RobustCells, for_both_kinds
from ptd.methods.classic import Progressive
from ptd.methods.ridge2016.conicoid import conicoid_outliers
from ptd.methods.ridge2016.ridges import RidgeRule, Stacks, indices_in_stacks, ridge_points
from ptd.methods.ridge2016.thinned_densification import GrowthCounter, Round, densify_thinned
from ptd.params import like, parameter
from ptd.passes import Method, Partial, Pass, Points, State, add_notes
from ptd.tin.mesh import Tin


@dataclass(frozen=True)
class Ridge2016(Progressive):
    """Parameters of `ridge2016` (see the module's table), and the passes that follow from them."""

    max_building_size_m: float = parameter(
        20.0, "w: size of the cells whose lowest point is a seed", unit="m", minimum=5.0, maximum=1000.0,
        source="Ridge 2016, table 1",
    )  # fmt: skip
    edge_length_stop_m: float = parameter(
        1.0, "l: facets with shorter edges take no more vertices; 0: all do", unit="m", minimum=0.0,
        maximum=1000.0, source="Ridge 2016, table 1",
    )  # fmt: skip
    thin_cell_m: float = parameter(
        1.0, "m: only the lowest terrain point of a cell of this size stays in the TIN; about the DTM's resolution",
        unit="m", minimum=0.1, maximum=100.0, source="Ridge 2016, 2.3",
    )  # fmt: skip
    ridge_side: float = parameter(
        1.5, "m_r: a facet on a ridge has a side longer than this many cells, in x or in y", minimum=0.0,
        maximum=100.0, source="Ridge 2016, 2.1",
    )  # fmt: skip
    ridge_angle_deg: float = parameter(
        25.0, "theta_r: smallest angle at which facets fall away from it on two sides", unit="deg",
        minimum=0.0,
        maximum=90.0, source="Ridge 2016, 2.1",
    )  # fmt: skip
    ridge_radius_m: float = parameter(
        2.0, "radius around the centre of such a facet within which the lowest point becomes a seed", unit="m",
        minimum=0.1, maximum=5.0,
        source="Ridge 2016, 2.1",
    )  # fmt: skip
    seed_confidence: float = parameter(
        0.98, "1 - alpha: seeds whose residual from a conicoid through their neighbours is less probable than alpha "
        "are dropped; 1: none", minimum=0.5, maximum=1.0, source="Ridge 2016, 2.2",
    )  # fmt: skip
    seed_residual_m: float = parameter(
        0.0, "seeds with a smaller residual are always kept", 0.0, 100.0, "m"
    )
    growth: float = parameter(
        0.001, "p_min: rounds end when the terrain grows by at most this share of the run's points; 0: never",
        minimum=0.0, maximum=1.0, source="Ridge 2016, equation 11",
    )  # fmt: skip
    rounds: int = parameter(12, "largest number of rounds of densification", 1, 100)
    robust_cells: bool = like(RobustCells, "robust_cells")

    @property
    def passes(self) -> tuple[Pass, ...]:
        """One pass, or two if the growth of the terrain decides on the number of rounds.

        The first of two passes counts.
        """
        method_passes: tuple[Pass, ...] = (RidgePass(self),)
        if self.growth:
            method_passes = (GrowthPass(self), TerrainPass(self))
        if self.robust_cells:
            return for_both_kinds(method_passes)
        return method_passes

    @property
    def halo_m(self) -> float:
        """Halo in metres: seven seed cells for ridges and seeds, and 30 m for the rounds.

        It was measured on the edge of a city.
        """
        return 7.0 * self.max_building_size_m + 30.0

    @property
    def candidate_cell_m(self) -> float:
        """0: every point is a candidate, which is the purpose of the paper's densification."""
        return 0.0


class Prepared:
    """A window ready for densification: outliers removed, ridge points added, seeds tested.

    Attributes
    ----------
    stacks : Stacks
        All points except low noise.
    seeds : int32 [m]
        Indices into the stacks.
    virtual : int32 [k, 3]
    region : UncertifiedRegion
    low : LowNoise
    limits : FacetLimits
    floor : float
        Floor of the final labels, counts.
    counts : dict
        Numbers of points found and dropped.
    """

    def __init__(
        self,
        params: Ridge2016,
        columns: tuple[Int32, Int32, Int32],
        window: Window,
        scale: Scale,
    ) -> None:
        p = params
        self.limits = p.limits(scale)
        self.floor = scale.counts(p.label_floor_m)
        x, y, z = columns
        thin = CellLattice.of(p.thin_cell_m, scale)
        lowest = lowest_per_cell(x, y, z, thin)
        lx, ly, lz = x[lowest], y[lowest], z[lowest]
        outlier = low_outliers(lx, ly, lz, scale, p.low_radius_m, p.low_depth_m, p.low_group)
        self.low = LowNoise(lx[outlier], ly[outlier], lz[outlier], thin)
        if outlier.any():
            kept = ~self.low.holds(x, y, z)
            x, y, z = x[kept], y[kept], z[kept]
        self.stacks = Stacks(x, y, z, thin)
        cells = CellLattice.of(p.max_building_size_m, scale)
        known = window.inside(thin, p.margin_cells)
        self.region = UncertifiedRegion(
            known, known.inside(cells, RING), box_with_ring(x, y, cells), scale
        )
        selection = choose_seeds(
            self.stacks.x,
            self.stacks.y,
            self.stacks.z,
            np.ones(x.size, np.bool_),
            cells,
            self.region,
        )
        self.virtual = selection.virtual
        ridge = self._ridge_points(params, selection.chosen, scale)
        seeds = np.union1d(selection.chosen, ridge)
        self.seeds = self._refined(params, seeds, scale)
        self.counts = {
            "points": int(columns[0].size),
            "low_outliers": int(outlier.sum()),
            "seeds": int(selection.chosen.size),
            "ridge_points": int(seeds.size - selection.chosen.size),
            "dropped_seeds": int(seeds.size - self.seeds.size),
        }

    def rounds(self) -> Iterator[Round]:
        """The TIN of each round, against which points are tested."""
        return densify_thinned(self.stacks, self.seeds, self.virtual, self.limits, self.region)

    def _tin(self, seeds: Int32) -> tuple[Tin, Bool]:
        """TIN of seeds and virtual seeds, and a mask of its vertices that are not virtual."""
        s, v = self.stacks, self.virtual
        tin = tin_with_ring(Xyz(s.x, s.y, s.z), seeds, v)
        virtual = position_keys(v[:, 0], v[:, 1])
        return tin, np.isin(position_keys(*tin.vertices.T[:2]), virtual, invert=True)

    def _ridge_points(self, p: Ridge2016, seeds: Int32, scale: Scale) -> Int32:
        side_m = p.ridge_side * p.max_building_size_m
        rule = RidgeRule.of(
            scale, side_m=side_m, angle_deg=p.ridge_angle_deg, radius_m=p.ridge_radius_m
        )
        return ridge_points(*self._tin(seeds), self.stacks, rule, self.region)

    def _refined(self, p: Ridge2016, seeds: Int32, scale: Scale) -> Int32:
        tin, data = self._tin(seeds)
        length = scale.counts(p.max_building_size_m)
        least = scale.counts_z(p.seed_residual_m)
        wrong = conicoid_outliers(tin, data, length, p.seed_confidence, least, self.region)
        dropped = position_keys(*tin.vertices[wrong].T[:2])
        return seeds[
            np.isin(
                position_keys(self.stacks.x[seeds], self.stacks.y[seeds]), dropped, invert=True
            )
        ]


SEED = 8
"""First label of vertices between the passes.

`SEED` marks vertices of the first TIN, ``SEED + k`` those that enter TIN number k. Other labels are ASPRS classes.
"""

TERRAIN_HALO_CELLS = 4.0
"""Margin of a tile, in seed cells, that circles of the last TIN seldom leave. Circles of the
ring need three."""


@dataclass(frozen=True)
class GrowthPass(Pass):
    """Run all rounds, count the points that join the terrain class in each, and find the last round."""

    params: Ridge2016
    name: str = "growth"
    title = "find when growth ends"

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> GrowthModel:
        """Densify in all rounds."""
        return GrowthModel(self.params, points, window, core, scale)

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Add the key ``ridge2016`` to the state.

        It holds the number of ``rounds`` to run, and ``points``, ``gained`` and ``unsure`` of
        the run.
        """
        points, gained, uncertified = 0, [0] * self.params.rounds, [0] * self.params.rounds
        for part in partials:
            points += part["points"]
            gained = [a + b for a, b in zip(gained, part["gained"], strict=True)]
            uncertified = [a + b for a, b in zip(uncertified, part["unsure"], strict=True)]
        last, note = last_round(points, gained, uncertified, self.params.growth)
        figures = {
            "rounds": last,
            "points": points,
            "gained": gained[:last],
            "unsure": uncertified[:last],
        }
        return {**state, "ridge2016": figures, "notes": add_notes(state, note)}


def max_growth(points: int, growth: float) -> Fraction:
    """Largest number of points that may join in the last round: p_min of equation 11 times all points, exactly."""
    return Fraction(repr(float(growth))) * points


def last_round(
    points: int, gained: list[int], uncertified: list[int], growth: float
) -> tuple[int, str]:
    """The first round in which few enough points joined the terrain class, and a note on it.

    Parameters
    ----------
    points : int
    gained : list of int
        Points that joined in each round.
    uncertified : list of int
        Points near the edge of a tile whose label is uncertified after each round.
    growth : float
        p_min of equation 11.
    """
    limit = max_growth(points, growth)
    last = next((k for k, n in enumerate(gained, 1) if n <= limit), len(gained))
    share = 100 * gained[last - 1] / max(points, 1)
    note = f"densification ends after {last} rounds, the last of which added {share:.2f} % of all points to the terrain"
    if gained[last - 1] > limit:
        note += f": still more than {100 * growth:g} %, but no more rounds were allowed"
    slack = [before + after for before, after in pairwise([0, *uncertified[:last]])]
    if any(
        (n - s <= limit) != (n + s <= limit) for n, s in zip(gained[:last], slack, strict=True)
    ):
        note += "; points near tile edges could change that: a wider halo makes it certain"
    return last, note


class GrowthModel(TinLabels):
    """Model that counts the points of a core that join the terrain class in each round, and labels new vertices."""

    def __init__(
        self,
        params: Ridge2016,
        points: Points,
        window: Window,
        core: Window,
        scale: Scale,
    ) -> None:
        super().__init__(window.closed, {"points": len(points), "rounds": 0})
        self._points = int(core.contains(points.xyz[0], points.xyz[1]).sum())
        self._gained = np.zeros(params.rounds, np.int64)
        self._uncertified = np.zeros(params.rounds, np.int64)
        self._prepared: Prepared | None = None
        if len(points):
            self._prepared = Prepared(params, points.columns(), window, scale)
            # If the window is the whole run, its last round is known. Further rounds are run
            # without counting, because `--statistics` of another run may ask for them.
            alone = not window.closed and self._points == len(points)
            enough = int(max_growth(self._points, params.growth)) if alone else -1
            self._codes = np.full(self._prepared.stacks.x.size, UNCLASSIFIED, np.uint8)
            self.stats.update(
                self._prepared.counts, rounds=self._count(self._prepared, core, enough)
            )

    def _count(self, prepared: Prepared, core: Window, enough: int) -> int:
        s = prepared.stacks
        is_in_core = core.contains(s.x, s.y)
        seed = np.zeros(is_in_core.size, np.bool_)
        seed[prepared.seeds] = True
        tally = GrowthCounter(
            s.x[is_in_core],
            s.y[is_in_core],
            s.z[is_in_core],
            prepared.limits,
            prepared.floor,
            seed[is_in_core],
        )
        done = 0
        for k, step in enumerate(islice(prepared.rounds(), self._gained.size)):
            self._codes[step.vertex & (self._codes == UNCLASSIFIED)] = SEED + k
            if k == 0 or self._gained[k - 1] > enough:
                # Fill `_uncertified` up to the end, because rounds that are not run would not
                # change these points.
                self._gained[k], self._uncertified[k:] = tally.count(step.tin, step.uncertified)
            done = k + 1
        return done

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label the points, and return a mask of the uncertified labels too.

        Earlier low noise stays unless it is ground.
        """
        if self._prepared is None:
            return super().label(points)
        s, (x, y, z) = self._prepared.stacks, points.columns()
        indices = indices_in_stacks(x, y, z, s.x, s.y, s.z, s.raster)
        labels = np.where(indices >= 0, self._codes[indices], np.uint8(UNCLASSIFIED))
        labels[self._prepared.low.holds(x, y, z)] = LOW_NOISE
        return labels, self._prepared.region.covers(x, y)

    def partial(self) -> Partial:
        """Number of ``points`` in the core, and in each round ``gained`` and ``unsure`` (see `last_round`)."""
        return {
            "points": self._points,
            "gained": self._gained.tolist(),
            "unsure": self._uncertified.tolist(),
        }

    def uncertain(self) -> int:
        """Number of points whose label is uncertified after some round."""
        return int(self._uncertified.max(initial=0))


@dataclass(frozen=True)
class TerrainPass(Pass):
    """Build the TIN of the last round and label all points."""

    params: Ridge2016
    name: str = "ridge2016"
    title = "grow the terrain, label all points"
    columns: tuple[str, ...] = ("labels",)

    @property
    def halo_m(self) -> float:  # type: ignore[override]
        """Metres around a tile within which the circles of the last TIN lie. No round follows."""
        return TERRAIN_HALO_CELLS * self.params.max_building_size_m

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> TerrainModel:
        """Build the TIN."""
        return TerrainModel(self.params, points, window, scale, state["ridge2016"]["rounds"])


class TerrainModel(TinLabels):
    """Model that labels the points of a window by the TIN of a round."""

    def __init__(
        self,
        params: Ridge2016,
        points: Points,
        window: Window,
        scale: Scale,
        rounds: int,
    ) -> None:
        super().__init__(
            window.closed, {"points": len(points), "rounds": rounds, "vertices": 0}
        )
        labels = points.known_labels()
        x, y, z = points.take(labels != LOW_NOISE).columns()
        if not x.size:
            return
        thin, cells = (
            CellLattice.of(size, scale)
            for size in (params.thin_cell_m, params.max_building_size_m)
        )
        known = window.inside(thin)
        region = UncertifiedRegion(
            known, known.inside(cells, RING), box_with_ring(x, y, cells), scale
        )
        virtual = choose_seeds(x, y, z, np.ones(x.size, np.bool_), cells, region).virtual
        vertices = points.take((labels >= SEED) & (labels < SEED + rounds)).columns()
        # In the first TIN all seeds are vertices, also several per cell. Later TINs have one
        # per cell.
        if rounds > 1:
            lowest = lowest_per_cell(*vertices, thin)
            vertices = vertices[0][lowest], vertices[1][lowest], vertices[2][lowest]
        tin = Tin.build(
            *(np.concatenate([c, v]) for c, v in zip(vertices, virtual.T, strict=True))
        )
        rule = LabelRule(params.limits(scale), scale.counts(params.label_floor_m))
        self.finish(tin, region.triangles(tin), rule)

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label the points, and return a mask of the uncertified labels too.

        Earlier low noise stays unless it is ground.
        """
        labels, uncertified_labels = super().label(points)
        labels[(labels != GROUND) & (points.known_labels() == LOW_NOISE)] = LOW_NOISE
        return labels, uncertified_labels


@dataclass(frozen=True)
class RidgePass(Pass):
    """All steps in one pass: outliers, seeds, ridge points, seed refinement, densification, labels."""

    params: Ridge2016
    name: str = "ridge2016"
    title = "grow the terrain, label all points"

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> TinLabels:
        """Densify by all rounds."""
        model = TinLabels(window.closed, {"points": len(points), "rounds": 0})
        if not len(points):
            return model
        prepared = Prepared(self.params, points.columns(), window, scale)
        done, last = deque(
            enumerate(islice(prepared.rounds(), self.params.rounds), 1), maxlen=1
        ).pop()
        model.low = prepared.low
        model.stats.update(prepared.counts, rounds=done)
        model.finish(last.tin, last.uncertified, LabelRule(prepared.limits, prepared.floor))
        return model


METHOD = Method(
    "ridge2016",
    "densification with ridge points and tested seeds, for steep mountains beside settlements",
    Ridge2016,
    for_lidar=True,
)
