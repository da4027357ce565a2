"""Parameters of `auto`, and what it decides from the survey of the run.

All that differs from cloud to cloud is in `settings`; what was decided is told in notes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ptd.frame import Scale
from ptd.ground.criteria import Limits
from ptd.ground.outliers import search_margin
from ptd.ground.roughness import Roughness
from ptd.matched.passes import GROUND_M
from ptd.matched.survey import DIM, LIDAR, Seen, surveyed
from ptd.methods.auto.objects import Drop, Residuals, Shape
from ptd.methods.auto.plateaus import Plateaus
from ptd.methods.progressive import Progressive
from ptd.params import check, like, parameter

RING_M = 20.0
"""Side of the cells of virtual seeds around the ground."""
ROUND_HALO_M = 8.0
"""How far doubt advances in a round, seldom more."""
CUT_SIZE = 0.6
"""Share of `AutoParameters.roof_size_m` for roofs that the border of the data cuts: a terrace may go on there."""
SPARSE_M2, DENSE_M2 = 1.0, 2.0
"""Points per square metre up to which the last pass is as the parameters say, and from which it is as narrow as the
noise allows."""
DENSE_FLOOR_M, FLOOR_BASE_M, FLOOR_SIGMAS = 0.12, 0.05, 3.0
"""Floor of the last pass for dense clouds: at least the first, else the second and so many times the noise."""
LASER_SIGMA_M = 0.03
"""Noise of airborne lasers: what more is measured, or not measurable, comes from plants, unless the user says it."""
DENSE_SLOPE = 0.5
"""Share of ``label_slope_m`` for dense clouds."""


@dataclass(frozen=True)
class AutoParameters:
    """Rules and sizes; table in `auto`."""

    max_building_size_m: float = parameter(
        36.0, "objects up to so wide are told from the terrain: twice the largest disk", unit="m", minimum=2.0,
        maximum=1000.0,
    )  # fmt: skip
    thin_cell_m: float = parameter(
        1.0, "the lowest point of a cell of this side decides what the cell is", unit="m", minimum=0.1, maximum=100.0,
    )  # fmt: skip
    low_radius_m: float = like(Progressive, "low_radius_m")
    low_depth_m: float = like(Progressive, "low_depth_m")
    low_group: int = like(Progressive, "low_group")
    seed_drop_m: float = parameter(
        0.05, "seeds: heights that need no object", unit="m", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    seed_rise: float = parameter(
        0.06, "seeds: steepest drop per radius that flat ground has", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    seed_slope: float = parameter(
        0.2, "seeds: more of it per slope of the ground", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    slope_reach_m: float = parameter(
        9.0, "slopes are between means of boxes that reach so far", unit="m", minimum=1.0, maximum=100.0,
    )  # fmt: skip
    rounds: int = parameter(4, "rounds of densification", minimum=1, maximum=1000)
    iteration_distance_m: float = like(Progressive, "iteration_distance_m")
    iteration_angle_deg: float = like(Progressive, "iteration_angle_deg", 28.0)
    terrain_angle_deg: float = like(Progressive, "terrain_angle_deg")
    edge_length_reduce_m: float = like(Progressive, "edge_length_reduce_m")
    veto_drop_m: float = parameter(
        0.7, "veto of densified cells: heights that need no object", unit="m", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    veto_rise: float = parameter(
        0.2, "veto of densified cells: steepest drop per radius that flat ground has", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    veto_slope: float = parameter(
        0.2, "veto of densified cells: more of it per slope of the ground", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    residual_slope_reach_m: float = parameter(
        3.0, "residuals: slopes are between means of boxes that reach so far", unit="m", minimum=1.0, maximum=100.0,
    )  # fmt: skip
    residual_around_m: float = parameter(
        15.0, "residuals: how far around objects are counted", unit="m", minimum=1.0, maximum=100.0,
    )  # fmt: skip
    object_trend_m: float = parameter(
        20.0, "objects on ground: the mean that is taken off reaches so far", unit="m", minimum=1.0, maximum=100.0,
    )  # fmt: skip
    object_size_m: float = parameter(
        12.0, "objects on ground: the widest", unit="m", minimum=2.0, maximum=1000.0,
    )  # fmt: skip
    object_drop_m: float = parameter(
        0.2, "objects on ground: heights that need no object", unit="m", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    object_rise: float = parameter(
        0.1, "objects on ground: steepest drop per radius that flat ground has", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    object_slope: float = parameter(
        0.2, "objects on ground: more of it per slope of the ground", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    object_lack: float = parameter(
        2.0, "objects on ground: more of the rise where no objects are around", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    object_share: float = parameter(
        0.3, "objects on ground: share of objects around from which on nothing is lacking", minimum=0.01, maximum=1.0,
    )  # fmt: skip
    bump_trend_m: float = parameter(
        15.0, "bumps of ground: the mean that is taken off reaches so far", unit="m", minimum=1.0, maximum=100.0,
    )  # fmt: skip
    bump_size_m: float = parameter(
        12.0, "bumps of ground: the widest", unit="m", minimum=2.0, maximum=1000.0,
    )  # fmt: skip
    bump_drop_m: float = parameter(
        0.1, "bumps of ground: heights that need no object", unit="m", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    bump_rise: float = parameter(
        0.1, "bumps of ground: steepest drop per radius that flat ground has", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    bump_slope: float = parameter(
        0.4, "bumps of ground: more of it per slope of the ground", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    bump_lack: float = parameter(
        1.0, "bumps of ground: more of the rise where no objects are around", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    bump_share: float = parameter(
        0.1, "bumps of ground: share of objects around from which on nothing is lacking", minimum=0.01, maximum=1.0,
    )  # fmt: skip
    roof_size_m: float = parameter(
        200.0, "roofs: the widest that is told from terrain by its edges all around", unit="m", minimum=2.0,
        maximum=1000.0,
    )  # fmt: skip
    roof_rounds: int = parameter(
        3, "roofs: how often, as lower ones lean on higher ones", minimum=1, maximum=10,
    )  # fmt: skip
    roof_cell_m: float = parameter(
        2.0, "roofs: the lowest ground of a cell of this side is its height", unit="m", minimum=0.1, maximum=100.0,
    )  # fmt: skip
    roof_step_m: float = parameter(
        1.0, "roofs: neighbours on a roof differ by no more", unit="m", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    roof_gap_m: float = parameter(
        8.0, "roofs: neighbours are no farther apart", unit="m", minimum=0.1, maximum=100.0,
    )  # fmt: skip
    roof_view_m: float = parameter(
        24.0, "roofs: how far is looked around for other ground", unit="m", minimum=0.1, maximum=100.0,
    )  # fmt: skip
    roof_fall_m: float = parameter(
        1.5, "roofs: ground lower by more lies below", unit="m", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    roof_slope: float = parameter(
        0.2, "roofs: and by more than so much per distance, as terrain slopes", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    roof_share: float = parameter(
        0.9, "roofs: at least so much of the ground seen around lies below", minimum=0.01, maximum=1.0,
    )  # fmt: skip
    roof_unseen: float = parameter(
        0.6, "roofs: at most this share of the looks around meets no ground", minimum=0.0, maximum=1.0,
    )  # fmt: skip
    roof_area_m2: float = parameter(
        80.0, "roofs: the smallest; smaller ones are found by openings", unit="m2", minimum=0.0, maximum=1e6,
    )  # fmt: skip
    label_floor_m: float = like(Progressive, "label_floor_m", 0.24)
    label_slope_m: float = parameter(
        1.0, "last pass: so much more per slope of the facet", unit="m", minimum=0.0, maximum=10.0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        check(self)

    def limits(self, scale: Scale) -> Limits:
        """The facet test's thresholds."""
        return Limits.of(
            scale, distance_m=self.iteration_distance_m, angle_deg=self.iteration_angle_deg,
            terrain_deg=self.terrain_angle_deg, reduce_m=self.edge_length_reduce_m, stop_m=0.0,
        )  # fmt: skip

    def _cells(self, metres: float) -> int:
        return max(round(metres / self.thin_cell_m), 1)

    @property
    def seed_drop(self) -> Drop:
        """When a cell is no seed."""
        return Drop(self.seed_drop_m, self.seed_rise, self.seed_slope)

    @property
    def veto_drop(self) -> Drop:
        """When a densified cell is taken out again."""
        return Drop(self.veto_drop_m, self.veto_rise, self.veto_slope)

    @property
    def shape(self) -> Shape:
        """Sizes that seeds and veto share."""
        return Shape(self._cells(self.max_building_size_m / 2), self._cells(self.slope_reach_m))

    @property
    def objects(self) -> Residuals:
        """When a cell rises from the ground's trend among all cells."""
        drop = Drop(self.object_drop_m, self.object_rise, self.object_slope)
        return self._residuals(
            drop, self.object_trend_m, self.object_size_m, self.object_lack, self.object_share
        )

    @property
    def bumps(self) -> Residuals:
        """When a cell rises from the ground's trend among the cells of ground."""
        drop = Drop(self.bump_drop_m, self.bump_rise, self.bump_slope)
        return self._residuals(drop, self.bump_trend_m, self.bump_size_m, self.bump_lack, self.bump_share)

    def _residuals(self, drop: Drop, trend_m: float, size_m: float, lack: float, enough: float) -> Residuals:
        return Residuals(
            drop=drop, trend=self._cells(trend_m), radius=self._cells(size_m / 2),
            slope=self._cells(self.residual_slope_reach_m), around=self._cells(self.residual_around_m), lack=lack,
            enough=enough,
        )  # fmt: skip

    @property
    def seed_reach(self) -> int:
        """Cells beyond which nothing has a part in what a cell is after the pass `seeds`."""
        return self.shape.reach + search_margin(self.low_radius_m, 1, self.thin_cell_m)

    @property
    def refine_reach(self) -> int:
        """Cells beyond which nothing has a part in what a cell is after the pass `refine`."""
        return self.shape.reach + self.objects.reach + self.bumps.reach

    def plateaus(self, scale: Scale) -> Plateaus:
        """When ground lies on a roof."""

        def cells(metres: float) -> int:
            return max(round(metres / self.roof_cell_m), 1)

        return Plateaus(
            step=scale.counts_z(self.roof_step_m), gap=cells(self.roof_gap_m), view=cells(self.roof_view_m),
            fall=scale.counts_z(self.roof_fall_m), slope=scale.counts_z(self.roof_slope * self.roof_cell_m),
            share=self.roof_share, unseen=self.roof_unseen,
            area=max(round(self.roof_area_m2 / self.roof_cell_m**2), 1), widest=cells(self.roof_size_m),
            widest_cut=cells(CUT_SIZE * self.roof_size_m),
        )  # fmt: skip

    @property
    def roof_reach(self) -> int:
        """Cells (of thinning) beyond which nothing has a part in what a cell is after the pass `roofs`."""
        return math.ceil((self.plateaus(Scale()).reach + 1) * self.roof_cell_m / self.thin_cell_m)

    @property
    def halo_m(self) -> float:
        """Two cells of the ring for the first TIN's circles, and what the rounds need."""
        return 2.0 * RING_M + ROUND_HALO_M * min(self.rounds, 30)

    @property
    def align_m(self) -> float:
        """Windows of TINs hold whole cells of the ring."""
        return RING_M

    @property
    def margin_m(self) -> float:
        """And whole thinning cells, where those do not divide the ring's."""
        return self.thin_cell_m

    @property
    def candidate_cell_m(self) -> float:
        """Cell of which the lowest point is the candidate."""
        return self.thin_cell_m


@dataclass(frozen=True)
class Settings:
    """What the parameters come to in a run."""

    label_floor_m: float
    label_slope_m: float


def settings(params: AutoParameters, survey: Mapping[str, Any]) -> Settings:
    """Thresholds for a run, from what `decided` says of it."""
    sigma = survey["label_sigma_m"]
    dense = min(max((survey["density_m2"] - SPARSE_M2) / (DENSE_M2 - SPARSE_M2), 0.0), 1.0)
    floor = params.label_floor_m
    if sigma is not None:
        floor = min(max(DENSE_FLOOR_M, FLOOR_BASE_M + FLOOR_SIGMAS * sigma), floor)
    return Settings(
        label_floor_m=params.label_floor_m + dense * (floor - params.label_floor_m),
        label_slope_m=params.label_slope_m * (1.0 - dense * (1.0 - DENSE_SLOPE)),
    )


def decided(
    params: AutoParameters, found: Roughness, seen: Seen, run: Mapping[str, Any]
) -> tuple[dict[str, Any], list[str]]:
    """What the run is, and lines that say so.

    Parameters
    ----------
    params : AutoParameters
    found : Roughness
        Density and noise.
    seen : Seen
    run : mapping
        `ptd.passes.RunFacts`.

    Returns
    -------
    survey : dict
        See `ptd.matched.survey.surveyed`; and ``label_sigma_m``: what of the noise the last pass of a laser scan
        allows for.
    notes : list of str
    """
    survey, note = surveyed(found, seen, run)
    sigma = label_sigma = survey["sigma_m"]
    if survey["kind"] == LIDAR and run["sigma_m"] is None:
        label_sigma = LASER_SIGMA_M if sigma is None else min(sigma, LASER_SIGMA_M)
    survey["label_sigma_m"] = label_sigma
    notes = [note]
    if survey["kind"] == DIM:
        notes.append(
            f"decided: ground is up to {GROUND_M:g} m and twice the local noise from the surface, "
            "after a vote of neighbours"
        )
        return survey, notes
    chosen = settings(params, survey)
    if label_sigma != sigma:
        notes.append(
            f"decided: {LASER_SIGMA_M:g} m is taken for a laser's noise; more comes from plants (else give --sigma)"
        )
    notes.append(
        f"decided: ground is up to {chosen.label_floor_m:.2f} m + {chosen.label_slope_m:.2g} m x slope from the surface"
    )
    return survey, notes
