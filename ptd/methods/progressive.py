"""Parameters that all methods of progressive densification share. Each method's table lists differences."""

from __future__ import annotations

from dataclasses import dataclass

from ptd.frame import Scale
from ptd.ground.criteria import FacetLimits
from ptd.ground.outliers import search_margin
from ptd.params import check, parameter

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
