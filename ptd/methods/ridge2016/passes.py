"""The passes of `ridge2016`: one that counts how the terrain grows and one that labels, or both in one."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, pairwise

import numpy as np

from ptd.cells import lowest_per_cell
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.distance_angle import Bool
from ptd.ground.labelling import GROUND, LOW_NOISE, UNCLASSIFIED, LabelRule, TinLabels
from ptd.ground.seeds import RING, box_with_ring, choose_seeds
from ptd.methods.ridge2016.params import Ridge2016Parameters
from ptd.methods.ridge2016.seeds import Prepared
from ptd.methods.ridge2016.sorted_cells import indices_in_stacks
from ptd.methods.ridge2016.thinned_densification import GrowthCounter
from ptd.passes import Partial, Pass, Points, State, UInt8, add_notes
from ptd.tin.mesh import Tin

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

    params: Ridge2016Parameters
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
        params: Ridge2016Parameters,
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
            enough = -1
            if alone:
                enough = int(max_growth(self._points, params.growth))
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

    params: Ridge2016Parameters
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
        params: Ridge2016Parameters,
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

    params: Ridge2016Parameters
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
