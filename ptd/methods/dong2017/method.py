"""``dong2017``: coloured image matching of towns, after Dong et al. (ISPRS Archives XLII-2/W7:703, 2017, paper 004).

Vegetation is recognised by colour, seeds lie on the roads beside facades, and ground grows by
tests against TINs of growing density. Their thresholds are estimated from the run.

=====================  ==============================  ========  =================================================
parameter              paper's name and value          default   reason
=====================  ==============================  ========  =================================================
facade_cell            GRIDESIZE (g), no value         1 m       holds tens of points in a cloud of images
facade_height          default height H (h), no value  3 m       one storey: lower steps do not matter
glass_factor           coefficient for glass, no       0.5       half of a facade is matched
                       value
seed_distance          d, no value                     4 m       past eaves and pavements, within narrow streets
seed_variation         2 sigma                         2         the paper's
podium_radius          neighbourhood of a seed, no     15 m      the paper's figure 4: the true seed is beside the
                       value                                     podium
terrain_slope          0.3 (equation 1)                0.3       the paper's
seed_cell              none                            15 m      "of seeds near each other the lower", one per cell
first_spacing          4 m                             4 m       the paper's
last_spacing           2 m, the last one mentioned     1 m       "until all are classified" (3.2, step 4); figures in
                                                                 ``docs/filters.md``
tins                   "several"                       8         ground grows by two cells with each; figures there
contour_level          none, read off a plot           0.01      gives the published thresholds for similar noise
robust_cells           none                            on        ours, for photogrammetric clouds, see below; off:
                                                                 the paper's rule
=====================  ==============================  ========  =================================================

The paper gets sigma from planes picked by hand; here ``--sigma`` gives it, or
`ptd.ground.roughness` finds it. The threshold of greenness (GLI) is Otsu's (3.3.1), the first
distance is the jump of the second difference (3.3.3), and the later thresholds come from the
histogram of angles and distances (3.3.4). None of them is a parameter.

**Photogrammetric clouds**, the paper's subject, are filtered differently by default. Vegetation, facades and seeds are
found among the points, as above. Then ground grows on one robust height per cell of 1 m (`ptd.matched.cells`), starting
from the cells with a seed. Thresholds, TINs and densities are the paper's, but all densities are used three times. The
last pass classifies every point, also green ones, on both sides of the TIN of these cells, by the noise around them
(`ptd.matched.robust_cells`). ``--set robust_cells=no`` gives the paper's steps on points, which are also those for
LiDAR clouds.

Deviations:

- Otsu's threshold is used only between a grey and a green mode of the histogram.
- A cell holds a facade only if chance does not explain its number of points.
- A seed is dropped for a lower one only if ground cannot be so steep (equation 1). Otherwise
  only the lowest seed of a slope would stay.
- The paper does not explain the first angle. Here it is the largest angle of the contour of the
  points within the first distance.
- The smallest of a point's angles counts, as the paper says in 3.3.4 (Axelsson takes the
  largest).
- The paper tests only ground between facades. Here each TIN holds the points that passed in
  earlier ones of the same density, and a rim of virtual points on the planes of the ground, so
  ground grows beyond the facades. Facets across more than a few cells test nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ptd.arrays import Bool, Int64, UInt8
from ptd.frame import CellLattice, Scale, Window
from ptd.ground import roughness
from ptd.ground.distance_angle import Bins, Threshold, Trial, contour_reach
from ptd.ground.labelling import GROUND, UNCLASSIFIED
from ptd.matched.cells import CELL_M
from ptd.matched.robust_cells import MethodSurveyPass, NearGroundPass, OnLidar, OnMatchedCells
from ptd.methods.dong2017.growth import Growth, Stage, picks
from ptd.methods.dong2017.histograms import second_difference_jump
from ptd.methods.dong2017.seeds import (
    VEGETATION,
    ColourPass,
    Dong2017Parameters,
    SeedCellPass,
    SeedPass,
)
from ptd.passes import (
    Method,
    MethodRefusal,
    Partial,
    Pass,
    Points,
    State,
    StatisticsModel,
    add_notes,
)
from ptd.tin.mesh import Tin

BLOCK_CELLS = 2
"""Number of cells beyond `seed_distance` that the block around a seed needs: one that is cut,
and one next to it."""

MEASURED_SEEDS = 1.5
"""Largest circumradius, in seed cells, of a facet of neighbouring seeds whose points are
measured."""

ON_CELLS = "decided: facades and seeds are found among points; ground grows on the cells, green points may be ground"
"""Note for runs on a photogrammetric cloud."""

SLACK_M = 1.0
"""Addition to a radius that is larger than all rounding errors."""

TIMES_ON_CELLS = 3
"""Number of passes through all densities on cells.

Wide TINs continue beyond a bank that only the finest TINs climbed.
"""

MAX_SEED_CELLS = 3.0
"""Largest circumradius, in seed cells, of a facet of seeds that tests points: seeds lie along
streets."""


@dataclass(frozen=True)
class Dong2017(Dong2017Parameters):
    """Parameters of `dong2017` (see the module's table), and the passes and reaches that follow from them."""

    @property
    def passes(self) -> tuple[Pass, ...]:
        """Colours and seeds on points, then growth of ground from the seeds, on cells if photogrammetric."""
        seeds = (
            ColourPass(self, max(roughness.REACH_M, self.facade_cell_m)),
            SeedPass(self, self.seed_reach_m),
        )
        if not self.robust_cells:
            return *seeds, *self._growing_on_points()
        return (
            MethodSurveyPass(notes=(ON_CELLS,)),
            *seeds,
            *(OnLidar.of(step) for step in self._growing_on_points()),
            SeedCellPass(),
            *(
                OnMatchedCells.of(step, f"{step.name}-of-cells")
                for step in self._growing_on_cells()
            ),
            NearGroundPass(),
        )

    def _growing_on_points(self) -> list[Pass]:
        """The TIN of the seeds, then a measurement and a densification for each density."""
        steps = self._first_steps()
        for spacing in self.spacings_m:
            steps.append(self._measurement(spacing))
            steps.append(self._densification(spacing, last=spacing == self.spacings_m[-1]))
        return steps

    def _growing_on_cells(self) -> list[Pass]:
        """`_growing_on_points`, repeated. At the density of the cells themselves there is nothing to measure."""
        steps = self._first_steps()
        spacings = [s for s in self.spacings_m if s >= CELL_M] or [CELL_M]
        for again in ("", *(f"-{n}" for n in range(2, TIMES_ON_CELLS + 1))):
            for spacing in spacings:
                if spacing > CELL_M:
                    steps.append(self._measurement(spacing, again))
                steps.append(self._densification(spacing, again))
        return steps

    def _first_steps(self) -> list[Pass]:
        first, measured_m = self.first_stage, MEASURED_SEEDS * self.seed_cell_m
        return [
            FirstMeasurement(self, measured_m, 2 * measured_m + SLACK_M),
            FirstGround(first, first.reach_m + SLACK_M),
        ]

    def _measurement(self, spacing_m: float, again: str = "") -> Pass:
        reach_m = (2 * MEASURED_CELLS + 1) * spacing_m + SLACK_M
        title = f"measure distances to a TIN of {spacing_m:g} m" + again.replace(
            "-", ", round "
        )
        return Measurement(self, spacing_m, f"measure-{spacing_m:g}m{again}", title, reach_m)

    def _densification(self, spacing_m: float, again: str = "", last: bool = False) -> Pass:
        stage = Stage.of_ground(spacing_m, self.tins)
        title = f"densify a TIN of {spacing_m:g} m" + again.replace("-", ", round ")
        return Densification(
            stage, last, f"densify-{spacing_m:g}m{again}", title, stage.reach_m
        )

    @property
    def first_stage(self) -> Stage:
        """The TIN of the seeds."""
        return Stage(self.seed_cell_m, MAX_SEED_CELLS * self.seed_cell_m, 1, rim=False)

    @property
    def halo_m(self) -> float:
        """Reach of the first densification, which is the widest."""
        return Stage.of_ground(self.first_spacing_m, self.tins).reach_m

    @property
    def align_m(self) -> float:
        """Size of the cells of the first densification. Windows consist of whole cells of it."""
        return self.first_spacing_m

    @property
    def margin_m(self) -> float:
        """0: no point beyond the cells decides."""
        return 0.0

    @property
    def candidate_cell_m(self) -> float:
        """0: every point counts, because density reveals facades and the lowest points are noise."""
        return 0.0

    @property
    def seed_reach_m(self) -> float:
        """Metres from a point within which points decide whether it is a seed.

        It covers the way over the facade to the flatness block on the other side, and the same
        for all seeds in the podium radius and in the seed cell.
        """
        point_reach_m = 2 * self.seed_distance_m + 2 * BLOCK_CELLS * self.facade_cell_m
        return point_reach_m + self.podium_radius_m + math.sqrt(2) * self.seed_cell_m


HISTOGRAM_BINS = Bins(0.025, 120, 0.01, 60)
"""Histogram of distances and angles, which covers eight times the published distance and twice
the angle."""

JUMP_BINS = 2
"""Bins of distance that are merged before the search for the jump."""

MEASURED_CELLS = 2
"""Largest circumradius of a facet of ground whose points are measured, in cells."""


class LabelledPointPass(Pass):
    """A pass on all points and their labels."""

    columns = ("labels",)
    every_point = True


@dataclass(frozen=True)
class FirstMeasurement(LabelledPointPass):
    """Step 5: distances of all points to the TIN of the seeds."""

    params: Dong2017Parameters
    widest_m: float
    influence_radius_m: float | None
    name: str = "measure-first"
    title = "measure distances to the seeds"
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
class FirstGround(LabelledPointPass):
    """Step 5: label the points within the first thresholds of the seeds' TIN."""

    stage: Stage
    influence_radius_m: float | None
    name: str = "first"
    title = "find the first ground"

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Growth:
        """Build the TIN of the seeds."""
        return Growth(self.stage, Threshold(**state["threshold"]), points, window, scale)


@dataclass(frozen=True)
class Measurement(LabelledPointPass):
    """Step 6: measure distances and angles of the present ground to a TIN of one point per cell."""

    params: Dong2017Parameters
    spacing_m: float
    name: str
    title: str
    influence_radius_m: float | None
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
class Densification(LabelledPointPass):
    """Step 6: label the points that pass in one of several TINs of one density."""

    stage: Stage
    last: bool
    name: str
    title: str
    halo_m: float | None

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


METHOD = Method(
    "dong2017",
    "coloured image matching of towns: seeds beside facades (Dong 2017)",
    Dong2017,
    needs=("rgb",),
)
