"""``classic``: progressive TIN densification after Axelsson (2000), as TerraScan runs it.

Papers: 000 Dong 2018, 001 Chen 2023, 003 Ridge 2016. Parameters carry their unit in the name;
``--set`` takes the name without it as well.

==================  =========================  =======  ==========================================================
parameter           paper's name and value     default  reason
==================  =========================  =======  ==========================================================
max_building_size   max building size: 30      20 m     003's value; larger cells lose hill tops, smaller ones
                    (000), 20 (003),                    take seeds on roofs. Halls and stadiums need more.
                    TerraScan 60
terrain_angle       terrain angle: 88          88 deg   the papers' value
iteration_angle     iteration angle: 6         25 deg   6 loses a quarter of the ground of the ISPRS samples (type
                                                        I 24 %); figures in ``docs/filters.md``
iteration_distance  iteration distance: 1.4    1.4 m    the papers' value for slopes
                    (slopes), 0.8 (flat)
edge_length_reduce  L1: 5, an illustration     5 m      keeps the wide angle from climbing onto low objects where
                                                        the TIN is dense
edge_length_stop    L2: 2, an illustration     0 (off)  the TIN would lose points without a gain
rounds              none: until no point       8        later rounds are chains that climb roofs, and need wider
                    passes                              halos
thin_cell           m: about the DTM's         1 m      halves time and memory, costs 0.03 percentage
                                                        points of error
                    resolution (003)
low_radius, _depth, TerraScan's low points,    5 m, 4 m, a depth of 1.5 m deletes courtyards
low_group           no values                  5
label_pass          none                       on       ours: points of facets that take no more vertices would
                                                        be lost (type I)
label_floor         none                       0.3 m    ours: close to a vertex, noise can make any angle
==================  =========================  =======  ==========================================================

Deviations: points join in batches instead of one per facet at a time (001), so their order does
not matter. The mirrored point keeps its height. A ring of virtual seeds surrounds the data
(001, step 5) and is never output. The last pass is ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ptd.arrays import AnyArray, Int32
from ptd.cells import Xyz, cell_keys, lowest_per_cell
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.criteria import FacetLimits
from ptd.ground.densify import densify_seeds
from ptd.ground.labelling import LabelRule, TinLabels
from ptd.ground.outliers import LowNoise, low_outliers, search_margin
from ptd.params import check, parameter
from ptd.passes import Method, Pass, Points, State

AXELSSON = "Axelsson 2000"


@dataclass(frozen=True)
class Progressive:
    """Parameters of outliers, seeds, facet test and final labelling."""

    max_building_size_m: float = parameter(
        20.0, "size of the cells whose lowest point is a seed; at least the width of the largest building", unit="m",
        minimum=1.0, maximum=1000.0, source="Dong 2018, 2.1, Ridge 2016, 4.2",
    )  # fmt: skip
    terrain_angle_deg: float = parameter(
        88.0, "steepest terrain; on steeper facets a point is tested mirrored through their highest corner", unit="deg",
        minimum=1.0, maximum=90.0, source="Dong 2018, 2.1",
    )  # fmt: skip
    iteration_angle_deg: float = parameter(
        25.0, "largest angle between a facet and the line from a point to its nearest corner", unit="deg",
        minimum=0.1, maximum=89.0, source=AXELSSON,
    )  # fmt: skip
    iteration_distance_m: float = parameter(
        1.4,
        "largest distance of a point to its facet. Raise it if hills and breaks are cut off, lower it if low "
        "objects join",
        unit="m",
        minimum=0.01,
        maximum=100.0,
        source=AXELSSON,
    )
    edge_length_reduce_m: float = parameter(
        5.0, "L1: the iteration angle shrinks on facets with shorter edges; 0: never", unit="m", minimum=0.0,
        maximum=1000.0, source="Dong 2018, 2.3",
    )  # fmt: skip
    edge_length_stop_m: float = parameter(
        0.0, "L2: facets with shorter edges take no more vertices; 0: all do", unit="m", minimum=0.0,
        maximum=1000.0, source="Dong 2018, 2.3",
    )  # fmt: skip
    thin_cell_m: float = parameter(
        1.0, "only the lowest point of a cell of this size can become a vertex; 0: every point", unit="m",
        minimum=0.0, maximum=100.0, source="Ridge 2016, 3.3",
    )  # fmt: skip
    low_radius_m: float = parameter(5.0, "low outliers: radius of the search", 1.0, 50.0, "m")
    low_depth_m: float = parameter(
        4.0,
        "low outliers: depth below all points within the radius that are not in the same clump",
        0.1,
        100.0,
        "m",
    )
    low_group: int = parameter(
        5, "low outliers: largest number of points in a clump of them; 0: no search", 0, 1000
    )
    label_floor_m: float = parameter(
        0.3,
        "last pass: points closer to the TIN than this are ground at any angle. Raise it if thin ground is lost, "
        "lower it if low plants stay",
        unit="m",
        minimum=0.0,
        maximum=10.0,
    )

    def __post_init__(self) -> None:
        check(self)

    def limits(self, scale: Scale) -> FacetLimits:
        """Thresholds of the facet test."""
        return FacetLimits.of(
            scale, distance_m=self.iteration_distance_m, angle_deg=self.iteration_angle_deg,
            terrain_deg=self.terrain_angle_deg, reduce_m=self.edge_length_reduce_m, stop_m=self.edge_length_stop_m,
        )  # fmt: skip

    @property
    def candidate_cell_m(self) -> float:
        """Size of the cells whose lowest point is the candidate."""
        return self.thin_cell_m

    @property
    def align_m(self) -> float:
        """Size of the seed cells. Windows consist of whole seed cells."""
        return self.max_building_size_m

    @property
    def low_cell_m(self) -> float:
        """Size of the cells whose lowest points are searched for low outliers."""
        return self.thin_cell_m or 1.0

    @property
    def margin_cells(self) -> int:
        """Search radius of low outliers in cells, rounded up."""
        return search_margin(self.low_radius_m, self.low_group, self.low_cell_m)

    @property
    def margin_m(self) -> float:
        """Distance beyond the whole cells of a window at which points still decide on outliers inside."""
        return self.margin_cells * self.low_cell_m


@dataclass(frozen=True)
class Classic(Progressive):
    """Parameters of `classic` (see the module's table), and the pass that follows from them."""

    rounds: int = parameter(8, "rounds of densification; 0: until no point passes", 0, 1000)
    label_pass: bool = parameter(
        True, "points near the finished TIN become ground too, not only its vertices"
    )

    heights_only: ClassVar[bool] = False
    """Field of `ptd.ground.labelling.LabelRule`."""

    @property
    def passes(self) -> tuple[Pass, ...]:
        """The single pass, which needs no figures of the run."""
        return (ClassicPass(self),)

    def ground_rule(self, limits: FacetLimits, scale: Scale) -> LabelRule:
        """Return the rule by which the finished TIN labels points."""
        floor = scale.counts(self.label_floor_m) if self.label_pass else 0.0
        return LabelRule(limits, floor, not self.label_pass, self.heights_only)

    @property
    def halo_m(self) -> float:
        """Halo in metres: two seed cells for the circles of the first TIN, and 8 m per round.

        It certified most tiles of a city.
        """
        return 2.0 * self.max_building_size_m + 8.0 * min(self.rounds or 30, 30)


@dataclass(frozen=True)
class ClassicPass(Pass):
    """One pass: outliers, seeds, densification, labels."""

    params: Classic
    name: str = "classic"
    title: str = "seeds, densification, labels"

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> TinLabels:
        """Densify the window's TIN."""
        p = self.params
        x, y, z = thinned(points.columns(), p.thin_cell_m, scale)
        stats = {"candidates": int(x.size), "rounds": 0, "low_outliers": 0, "vertices": 0}
        model = TinLabels(window.closed, stats)
        if not x.size:
            return model
        outlier = low_outliers(x, y, z, scale, p.low_radius_m, p.low_depth_m, p.low_group)
        cells, limits = CellLattice.of(p.low_cell_m, scale), p.limits(scale)
        # In a cell cut by the window another point may be the lowest. Outliers are certified
        # one search radius inside.
        known = window.inside(cells, p.margin_cells)
        seed_cells = CellLattice.of(p.max_building_size_m, scale)
        tin, uncertified, rounds = densify_seeds(
            Xyz(x, y, z), outlier, seed_cells, limits, p.rounds, known, scale
        )
        stats.update(rounds=rounds, low_outliers=int(outlier.sum()))
        model.low = LowNoise(x[outlier], y[outlier], z[outlier], cells)
        model.finish(tin, uncertified, p.ground_rule(limits, scale))
        return model


def thinned(
    columns: tuple[Int32, Int32, Int32], cell_m: float, scale: Scale
) -> tuple[Int32, Int32, Int32]:
    """The lowest candidate per cell, in row-major order of the cells. If `cell_m` is 0, all points by cells of 1 m."""
    x, y, z = columns
    if x.size == 0:
        return x, y, z
    if cell_m:
        keep: AnyArray = lowest_per_cell(x, y, z, CellLattice.of(cell_m, scale))
    else:
        cells = CellLattice.of(1.0, scale)
        col0, row0 = cells.column(int(x.min())), cells.row(int(y.min()))
        keys = cell_keys(x, y, cells, col0, row0, 1 << 31)
        keep = np.lexsort((z, y, x, keys))
    return x[keep], y[keep], z[keep]


METHOD = Method(
    "classic",
    "progressive TIN densification (Axelsson 2000), the reference for airborne LiDAR",
    Classic,
    for_lidar=True,
)
