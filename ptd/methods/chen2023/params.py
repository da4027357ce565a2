"""Parameters of `chen2023`. Its table in `method.py` gives the reasons for their defaults."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

from ptd.frame import Scale
from ptd.ground.outliers import search_margin
from ptd.matched.robust_cells import RobustCells
from ptd.methods.chen2023.progressive_opening import Opening, height_thresholds, window_widths
from ptd.methods.chen2023.seed_clusters import ClusterLimits
from ptd.methods.classic import Classic
from ptd.methods.progressive import Progressive
from ptd.params import like, parameter


def _cells_of(metres: float, cell_m: float) -> Fraction:
    return Fraction(repr(float(metres))) / Fraction(repr(float(cell_m)))


@dataclass(frozen=True)
class Chen2023Parameters(Progressive):
    """Settings of `chen2023`, to which `ptd.methods.chen2023.method.Chen2023` adds the passes."""

    max_building_size_m: float = parameter(
        30.0, "largest building that the windows remove; the cells of the ring are half as wide", unit="m",
        minimum=1.0, maximum=1000.0, source="Chen 2023, 3.2 (1)",
    )  # fmt: skip
    thin_cell_m: float = parameter(
        1.0, "c: cells of the minimum raster, whose lowest points alone can become vertices", unit="m", minimum=0.1,
        maximum=10.0, source="Chen 2023, 2.2 A",
    )  # fmt: skip
    initial_window: int = parameter(
        1,
        "W_0: windows of 2 k W_0 + 1 cells, k = 1, 2, ...",
        1,
        1000,
        source="Chen 2023, 3.2 (2), eq. 1",
    )
    rounds: int = like(Classic, "rounds", 4)
    exponential_windows: bool = parameter(
        False,
        "windows of 2 W_0^k + 1 cells instead; W_0 must be 2 or more",
        source="Chen 2023, eq. 2",
    )
    terrain_slope: float = parameter(
        0.3, "s: largest drop of ground per metre by which the window grows", minimum=0.0, maximum=10.0,
        source="Chen 2023, eq. 3",
    )  # fmt: skip
    initial_drop_m: float = parameter(
        0.3,
        "h_0: drop of ground that any window allows",
        0.0,
        100.0,
        "m",
        source="Chen 2023, eq. 3",
    )
    largest_drop_m: float = parameter(
        2.5, "h_max: largest drop of ground from one window to the next", unit="m", minimum=0.01,
        maximum=100.0, source="Chen 2023, eq. 3",
    )  # fmt: skip
    mean_layers: int = parameter(
        5, "empty cells within this many cells of filled ones are interpolated, others take the nearest "
        "height", minimum=0,
        maximum=1000, source="Chen 2023, 2.2 A",
    )  # fmt: skip
    tail_gap_m: float = parameter(
        20.0, "elevation histogram: a tail lies beyond a gap of this height; 0: no tails", unit="m", minimum=0.0,
        maximum=10000.0, source="Chen 2023, 2.1 a",
    )  # fmt: skip
    tail_share: float = parameter(
        0.001, "elevation histogram: a tail holds at most this share of the run's candidates", minimum=0.0,
        maximum=0.1, source="Chen 2023, 2.1 a",
    )  # fmt: skip
    long_side: float = parameter(
        1.5, "seeds: the highest corner of a facet is noise if a side is longer than this multiple of "
        "max_building_size; 0: off",
        minimum=0.0, maximum=1000.0, source="Chen 2023, 2.3 (1)",
    )  # fmt: skip
    narrow_angle_deg: float = parameter(
        15.0, "seeds: facets with a smaller angle do not join seeds to clusters", unit="deg", minimum=0.0,
        maximum=60.0, source="Chen 2023, 2.3 (2)",
    )  # fmt: skip
    cluster_seeds: int = parameter(
        50,
        "seeds: largest number of seeds in a small cluster; 0: none is small",
        minimum=0,
        maximum=10**6,
        source="Chen 2023, 2.3 (2)",
    )
    prominence_m: float = parameter(
        1.0, "seeds: a small cluster this much higher than the seeds around it is noise", unit="m", minimum=0.0,
        maximum=100.0, source="Chen 2023, 2.3 (2)",
    )  # fmt: skip
    label_pass: bool = like(Classic, "label_pass")
    robust_cells: bool = like(RobustCells, "robust_cells")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exponential_windows and self.initial_window < 2:
            raise ValueError(
                "initial_window 1: exponential windows never grow from 1; use 2 or more"
            )
        if self.thin_cell_m > self.max_building_size_m:
            raise ValueError(
                f"thin_cell_m {self.thin_cell_m:g}: windows are made of such cells; use at most max_building_size_m, "
                f"{self.max_building_size_m:g} m"
            )

    @property
    def widths(self) -> list[int]:
        """Widths of the windows, in cells."""
        size = _cells_of(self.max_building_size_m, self.thin_cell_m)
        return window_widths(self.initial_window, self.exponential_windows, size)

    @property
    def halo_m(self) -> float:
        """Halo in metres: the widest window, four cells of the ring, and 8 m per round.

        It certified most tiles of a city.
        """
        window = max(self.widths) * self.thin_cell_m
        return window + 4.0 * self.ring_cell_m + 8.0 * min(self.rounds or 30, 30)

    @property
    def ring_cell_m(self) -> float:
        """Size of the cells of virtual points around the border: half the largest building."""
        return self.max_building_size_m / 2.0

    @property
    def margin_cells(self) -> int:
        """Number of cells around a point in which the searches for outliers look.

        It is at least one, so that each candidate of a core is known and counts in one tile
        only.
        """
        return search_margin(self.low_radius_m, 1, self.thin_cell_m)

    @property
    def candidate_cell_m(self) -> float:
        """Size of the cells whose lowest point is the candidate."""
        return self.thin_cell_m

    def opening(self, scale: Scale) -> Opening:
        """Windows and thresholds in counts."""
        drops = height_thresholds(
            self.widths,
            self.terrain_slope,
            self.thin_cell_m,
            self.initial_drop_m,
            self.largest_drop_m,
        )
        return Opening(self.widths, [scale.counts_z(drop) for drop in drops], self.mean_layers)

    def clusters(self, scale: Scale) -> ClusterLimits:
        """Limits of the seeds' refinement in counts."""
        side, cosine = (
            self.long_side * self.max_building_size_m,
            math.cos(math.radians(self.narrow_angle_deg)),
        )
        prominence = scale.counts_z(self.prominence_m)
        return ClusterLimits(
            scale.counts(side), cosine, self.cluster_seeds, prominence, scale.z_ratio
        )
