"""Parameters of `auto`, and constants that need no setting.

Eighteen parameters can be set. The constants were measured (table in ``docs/filters.md``). No
visible property of a cloud shows how to change them, so they are listed here with their
reasons.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from ptd.frame import Scale
from ptd.ground import low_noise, treetops
from ptd.ground.criteria import FacetLimits
from ptd.ground.cut_off_land import PIT_REACH_CELLS, STRIP_REACH_M
from ptd.ground.outliers import search_margin
from ptd.ground.plateaus import ROOF_CELL_M, Plateaus
from ptd.methods.auto.cells import ANNEX_ROUNDS, Drop, Residuals, Shape
from ptd.methods.classic import Progressive
from ptd.params import check, like, parameter

RING_M = 20.0
"""Size of the cells of virtual seeds around the ground."""
ROUND_HALO_M = 8.0
"""Distance by which the uncertified region grows in a round; it seldom grows farther."""
TERRAIN_ANGLE_DEG = 88.0
"""Steepest terrain of the facet test, as in all methods; 60 or 90 degrees change the mean error
by 0.01 percentage points."""
REGROWTH = 0.5
"""Share of the iteration distance and angle within which the last TIN adds edges of banks that
were removed with objects. Shares of 0.3 and 0.7 gain less; with 0.7, low roofs and shrubs
return as well."""
SEED_DROP_M = 0.05
"""Drop by noise that is allowed when seeds are chosen."""


@dataclass(frozen=True)
class Reaches:
    """Search distances of the rules for objects, in metres.

    Attributes
    ----------
    slope_m, residual_slope_m : float
        Half width of the boxes whose means give slopes. ``slope_m``, for seeds, extends past the wall of a house.
        ``residual_slope_m`` is small, because the trend of the ground is subtracted.
    around_m : float
        Distance within which objects are counted. If there are few, a bump is terrain.
    object_trend_m, bump_trend_m : float
        Half width of the boxes of the mean that is subtracted. The mean follows hills but not the objects on them.
    """

    slope_m: float = 9.0
    residual_slope_m: float = 3.0
    around_m: float = 15.0
    object_trend_m: float = 20.0
    bump_trend_m: float = 15.0


@dataclass(frozen=True)
class Rise:
    """Limits of the rise from the ground's mean, in addition to `AutoParameters.object_rise`.

    Attributes
    ----------
    drop_m : float
        Drop in metres that is always allowed.
    per_slope : float
        Extra drop allowed per unit of slope.
    enough : float
        Share of objects around from which on `LACK` has no effect.
    """

    drop_m: float
    per_slope: float
    enough: float


LACK = 2.0
"""Extra rise allowed where no objects are around, because a bump is more likely terrain
there."""
OBJECTS = Rise(drop_m=0.2, per_slope=0.2, enough=0.3)
"""Limits among all cells. In clouds up to 1 point/m2 a drop below 0.2 m is within the floor of
the last pass."""
BUMPS = Rise(drop_m=0.1, per_slope=0.4, enough=0.1)
"""Limits among the remaining cells of ground. Their mean no longer contains removed objects, so
a smaller drop is allowed, but more per unit of slope."""

VOTE_REACH_M = 2.0
"""Distance within which the cells around a remaining cell of ground vote on it: a cell or two that the limits left on
a ramp would bring the whole ramp back in the last TIN."""
ANNEX_REACH_M = 8.0
"""Distance from a roof within which ground that rises like an object is a part of the building, such as a ramp for
loading. Farther away it may be a terrace or a bank."""


@dataclass(frozen=True)
class AutoParameters:
    """Parameters of `auto`, to which `ptd.methods.auto.method.Auto` adds the passes."""

    max_building_size_m: float = parameter(
        36.0, "widest object removed from the seeds; wider buildings are removed as roofs. Raise it if halls stay in "
        "the terrain, lower it if hill tops are cut off", unit="m", minimum=2.0, maximum=1000.0,
    )  # fmt: skip
    thin_cell_m: float = parameter(
        1.0, "the lowest point of a cell of this size decides for the cell; choose about the size of the smallest "
        "terrain features", unit="m", minimum=0.1, maximum=100.0,
    )  # fmt: skip
    low_radius_m: float = like(Progressive, "low_radius_m")
    low_depth_m: float = like(Progressive, "low_depth_m")
    low_group: int = like(Progressive, "low_group")
    seed_rise: float = parameter(
        0.06, "seeds: steepest drop of flat ground, metres per metre. Raise it if rough ground is lost", minimum=0.0,
        maximum=100.0,
    )  # fmt: skip
    seed_slope: float = parameter(
        0.2, "seeds: extra drop allowed per unit of slope. Raise it if ground on steep slopes is lost", minimum=0.0,
        maximum=100.0,
    )  # fmt: skip
    rounds: int = parameter(
        4, "rounds in which ground grows from the seeds; with more rounds it follows steeper terrain, but the halo "
        "must be wider", minimum=1, maximum=1000,
    )  # fmt: skip
    iteration_distance_m: float = like(Progressive, "iteration_distance_m")
    iteration_angle_deg: float = like(Progressive, "iteration_angle_deg", 28.0)
    edge_length_reduce_m: float = like(Progressive, "edge_length_reduce_m")
    object_size_m: float = parameter(
        12.0,
        "widest object (car, shrub, wall) that is removed from the ground",
        2.0,
        1000.0,
        "m",
    )
    object_rise: float = parameter(
        0.1, "steepest rise of ground above the mean around it, metres per metre. Lower it if low objects stay, raise "
        "it if banks and bumps are lost", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    roof_size_m: float = parameter(
        200.0,
        "widest roof; a roof differs from terrain in its edges, which fall on all sides",
        2.0,
        1000.0,
        "m",
    )
    label_floor_m: float = like(Progressive, "label_floor_m", 0.24)
    label_slope_m: float = parameter(
        1.0, "last pass: extra height allowed per unit of slope", 0.0, 10.0, "m"
    )
    refine: bool = parameter(
        True, "photogrammetric clouds: reclassify points near the edge of the ground with decision trees that were "
        "trained on scenes with reference classes; no: classify by the height above the surface only",
    )  # fmt: skip

    fine_surface: bool = parameter(
        True, "last pass: where 3 points/m2 or more lie near the ground, compare points with a surface of cells of "
        "0.4 m; no: compare all points with the TIN of the lowest point of each metre"
    )  # fmt: skip

    reaches: ClassVar[Reaches] = Reaches()

    def __post_init__(self) -> None:
        check(self)

    def limits(self, scale: Scale, share: float = 1.0) -> FacetLimits:
        """Return the thresholds of the facet test, with a share of its distance and angle."""
        return FacetLimits.of(
            scale, distance_m=share * self.iteration_distance_m, angle_deg=share * self.iteration_angle_deg,
            terrain_deg=TERRAIN_ANGLE_DEG, reduce_m=self.edge_length_reduce_m, stop_m=0.0,
        )  # fmt: skip

    def _cells(self, metres: float) -> int:
        return max(round(metres / self.thin_cell_m), 1)

    @property
    def seed_drop(self) -> Drop:
        """Rule that excludes a cell from the seeds."""
        return Drop(SEED_DROP_M, self.seed_rise, self.seed_slope)

    @property
    def shape(self) -> Shape:
        """Sizes of the rule for seeds."""
        return Shape(
            self._cells(self.max_building_size_m / 2), self._cells(self.reaches.slope_m)
        )

    @property
    def objects(self) -> Residuals:
        """Rule by which a cell rises from the ground's mean, among all cells."""
        return self._residuals(OBJECTS, self.reaches.object_trend_m)

    @property
    def bumps(self) -> Residuals:
        """Rule by which a cell rises from the ground's mean, among the cells of ground."""
        return self._residuals(BUMPS, self.reaches.bump_trend_m)

    def _residuals(self, rise: Rise, trend_m: float) -> Residuals:
        return Residuals(
            drop=Drop(rise.drop_m, self.object_rise, rise.per_slope), trend=self._cells(trend_m),
            radius=self._cells(self.object_size_m / 2), slope=self._cells(self.reaches.residual_slope_m),
            around=self._cells(self.reaches.around_m), lack=LACK, enough=rise.enough,
        )  # fmt: skip

    @property
    def noise_reach(self) -> int:
        """Distance in cells beyond which points do not change the elected point of a cell."""
        return math.ceil(low_noise.REACH_M / self.thin_cell_m)

    @property
    def seed_reach(self) -> int:
        """Distance in cells beyond which points do not change the code of a cell in the pass `seeds`."""
        return self.shape.reach + search_margin(self.low_radius_m, 1, self.thin_cell_m)

    @property
    def summit_reach(self) -> int:
        """Distance in cells beyond which points do not change the code of a cell in the pass `summits`."""
        return self.shape.radius + PIT_REACH_CELLS

    @property
    def refine_reach(self) -> int:
        """Distance in cells beyond which points do not change the code of a cell in the pass `refine`."""
        return self.objects.reach + self.bumps.reach + self.vote_width

    @property
    def vote_width(self) -> int:
        """Half width in cells of the square whose cells vote on the cell in the middle."""
        return self._cells(VOTE_REACH_M)

    @property
    def roof_reach(self) -> int:
        """Distance in thinning cells beyond which points do not change the code of a cell in a pass `roofs`."""
        return math.ceil(
            (Plateaus.of(Scale(), self.roof_size_m).reach + 1) * ROOF_CELL_M / self.thin_cell_m
        )

    @property
    def annex_width(self) -> int:
        """Distance in cells from a roof within which annexes lie."""
        return self._cells(ANNEX_REACH_M)

    @property
    def annex_reach(self) -> int:
        """Distance in cells beyond which points do not change the code of a cell in the pass `annexes`."""
        return ANNEX_ROUNDS * max(self.objects.reach, self.annex_width)

    @property
    def treetop_reach(self) -> int:
        """Distance in thinning cells beyond which points do not change the code of a cell in the pass `treetops`."""
        return math.ceil(max(treetops.reach_m(), STRIP_REACH_M) / self.thin_cell_m)

    @property
    def halo_m(self) -> float:
        """Halo in metres: two cells of the ring for circles of the first TIN, and 8 m for each of at most 30 rounds."""
        return 2.0 * RING_M + ROUND_HALO_M * min(self.rounds, 30)

    @property
    def align_m(self) -> float:
        """Size of the cells of the ring. Windows of TINs contain whole cells of it."""
        return RING_M

    @property
    def margin_m(self) -> float:
        """Margin of one thinning cell, so that windows contain whole thinning cells, whatever the ring's cells are."""
        return self.thin_cell_m

    @property
    def candidate_cell_m(self) -> float:
        """Size of the cells whose lowest points are the candidates."""
        return self.thin_cell_m
