"""``chen2023``: seeds by a progressive morphological opening, cleaned in their TIN, then densification in batches.

Paper: Chen, Wang, He, Ding and Kong (2023), Frontiers in Earth Science 10:1015153. Its six
parameters are the first six of the table. The paper gives no values, neither for these nor for
the rest. Figures are in ``docs/filters.md``.

===================  ==========================  ========  =============================================================
parameter            paper's name                default   reason
===================  ==========================  ========  =============================================================
max_building_size    max building size           30 m      000's value (003: 20, which leaves a hall of sample 22)
initial_window       initial window size, W_0    1         the finest steps separate small drops from large ones
terrain_angle        max terrain angle           88 deg    as `classic`
rounds               number of iterations        4         the seeds are dense: more rounds change 0.05 percentage
                                                           points of error and need wider halos
iteration_angle      iterator angle              25 deg    as `classic`
iteration_distance   iterator distance           1.4 m     as `classic`
exponential_windows  equation 2 instead of 1     off       fewer windows, more error: with wide steps the thresholds
                                                           let low roofs pass or cut hill tops
thin_cell            c                           1 m       as `classic`
terrain_slope        s                           0.3       17 degrees; with c = 1 m and W_0 = 1 ground may drop by
                                                           0.9 m from one window to the next
initial_drop         h_0                         0.3 m     noise and low growth, as the floor of the last pass
largest_drop         h_max                       2.5 m     "the minimum height of buildings in the area": a storey
mean_layers          "eight neighbourhoods"      5         holes of up to 10 cells are interpolated
tail_gap, _share     thresholds seen in a plot   20 m,     so few candidates beyond so wide a gap in height are not
                                                 0.001     terrain
low_radius, _depth   "surrounding points"        5 m, 4 m  as `classic`
low_group            correction by hand          5         as `classic`: low groups, which are not isolated
long_side            "larger side length"        1.5       times max_building_size: about the diagonal of the
                                                           largest building that is removed
narrow_angle         "narrow"                    15 deg    facets that climb a storey within 0.7 m are narrower
cluster_seeds        "small"                     50        a small building
prominence           "locally prominent"         1 m       densification would bring back lower clusters
edge_length_reduce,  none                        5 m, 0,   as `classic`
_stop; label_pass,                               on,
label_floor                                      0.3 m
robust_cells         none                        on        ours, for photogrammetric clouds, which the paper does not
                                                           treat: `ptd.matched.robust_cells`
===================  ==========================  ========  =============================================================

The six steps, with the deviations:

1. The tails of the run's elevation histogram (one candidate per cell) are cut at a gap (`ElevationsPass`), where
   the paper chooses from a plot. Then points isolated in height are removed. The paper corrects the rest by hand. Here
   groups of low points are searched for instead.
2. A minimum raster is filled (`fill_empty`). Cells beyond the reach of interpolation take the nearest height, not 0.
3. The raster is opened with squares (`progressive_opening`). The paper says "window", symmetrical because its number of
   cells is odd, and uses the equations of Zhang et al. (2003), whose windows are square. An object drops by more than
   h_k from one surface to the next; the paper also mentions the point's own height above a surface. The last window is
   the first one wider than the largest building.
4. Seeds are cleaned in their TIN (`seed_clusters`), which already holds the ring of step 5. Without the ring, the
   slivers along the hull would be the over-long and narrow facets.
5. The ring is that of `classic`, on a lattice of half the largest building. Each empty cell up to two cells from seeds,
   in large voids as well, gets a virtual seed at the interpolated height. These seeds are never output.
6. Densification in batches, and our last pass, which labels all points.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Indices, Int32, Int64, UInt8
from ptd.cells import Xyz, lowest_per_cell, position_keys
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.densify import (
    REFUSED,
    RING,
    VERTEX,
    box_with_ring,
    choose_seeds,
    densify,
    tin_with_ring,
)
from ptd.ground.labelling import GROUND, LOW_NOISE, LabelRule, TinLabels
from ptd.ground.outliers import LowNoise, isolated_in_height, low_outliers, search_margin
from ptd.matched.robust_cells import RobustCells, for_both_kinds
from ptd.methods.chen2023.progressive_opening import (
    Opening,
    height_thresholds,
    potential_seeds,
    window_widths,
)
from ptd.methods.chen2023.seed_clusters import ClusterLimits, noisy_seeds
from ptd.methods.classic import Classic, Progressive
from ptd.params import like, parameter
from ptd.passes import Method, Partial, Pass, Points, State, StatisticsModel, Stats, add_notes
from ptd.tin.mesh import Tin


@dataclass(frozen=True)
class Chen2023(Progressive):
    """Parameters of `chen2023` (see the module's table), and the passes that follow from them."""

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
        size = Fraction(repr(float(self.max_building_size_m))) / Fraction(
            repr(float(self.thin_cell_m))
        )
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

    @property
    def passes(self) -> tuple[Pass, ...]:
        """The histogram of heights, then the filter, both on robust cells if the cloud is photogrammetric."""
        tails = ElevationsPass(self.thin_cell_m, self.tail_gap_m, self.tail_share)
        method_passes = (tails, ChenPass(self))
        if self.robust_cells:
            return for_both_kinds(method_passes)
        return method_passes


BIN_M = 1.0

Histogram = dict[int, int]
"""Number of points per bin; bin k holds heights from k to below k + 1 metres."""


class Tails(NamedTuple):
    """The range of heights that is kept, and the numbers of points below and above it."""

    low_bin: int
    high_bin: int
    below: int
    above: int


def _bins(z: Int32, scale: Scale) -> Int64:
    """Return the bin of each height. Bin 0 starts at height 0 of the CRS."""
    return np.floor(z / scale.counts_z(BIN_M)).astype(np.int64)


def histogram(z: Int32, scale: Scale) -> Histogram:
    """Number of heights in each bin that holds any."""
    bins, counts = np.unique(_bins(z, scale), return_counts=True)
    return dict(zip(bins.tolist(), counts.tolist(), strict=True))


def merged(parts: Iterable[Mapping[int, int]]) -> Histogram:
    """The histogram of all parts together. Sums of integers do not depend on their order."""
    total: Counter[int] = Counter()
    for part in parts:
        total.update(part)
    return dict(sorted(total.items()))


def find_tails(counts: Histogram, gap_bins: int, share: float) -> Tails | None:
    """Cut both tails of a histogram at gaps.

    The paper chooses from a plot of the histogram. Here a tail is the part beyond at least
    ``gap_bins`` empty bins, if it has at most ``share`` of all points. Terrain fills its
    elevations without gaps, so a lonely peak stays, however few points it has. A second survey
    area far above the first stays because of its share.

    Returns
    -------
    Tails or None
        None for an empty histogram.
    """
    if not counts:
        return None
    bins = sorted(counts)
    room = share * sum(counts.values())
    low, below = _inner_end(bins, counts, gap_bins, room)
    high, above = _inner_end(bins[::-1], counts, gap_bins, room)
    return Tails(low, high, below, above)


def _inner_end(bins: list[int], counts: Histogram, gap: int, room: float) -> tuple[int, int]:
    """The first bin after the last gap with at most `room` points before it, and the number of these points."""
    end, cut, seen = bins[0], 0, 0
    for before, after in pairwise(bins):
        seen += counts[before]
        if seen > room:
            break
        if abs(after - before) > gap:
            end, cut = after, seen
    return end, cut


def outside(z: Int32, scale: Scale, kept: list[int] | None) -> tuple[Bool, Bool]:
    """Return masks of the heights below and above the kept range. Both are false if there is no range."""
    if kept is None:
        return np.zeros(z.size, np.bool_), np.zeros(z.size, np.bool_)
    bins = _bins(z, scale)
    return bins < kept[0], bins > kept[1]


@dataclass(frozen=True)
class ElevationsPass(Pass):
    """Measure the run's histogram. The state gets ``tails``: the lowest and highest bin kept, or None.

    Attributes
    ----------
    cell_m : float
        Size of the cells of candidates.
    gap_m, share : float
        See `find_tails`; a gap of 0 finds no tails.
    """

    cell_m: float
    gap_m: float
    share: float
    name: str = "elevations"
    title = "measure the range of heights"
    gives_labels: bool = False

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> StatisticsModel:
        """Count the candidates of the core. Bins and counts are pairs, because names in JSON are texts."""
        x, y, z = points.columns()
        keep = lowest_per_cell(x, y, z, CellLattice.of(self.cell_m, scale))
        keep = keep[core.contains(x[keep], y[keep])]
        return StatisticsModel(
            {"elevations": sorted(histogram(z[keep], scale).items())}, {"candidates": keep.size}
        )

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Merge the counts, find the tails, and report the cut."""
        counts = merged({int(k): int(n) for k, n in part["elevations"]} for part in partials)
        gap_bins = math.ceil(self.gap_m / BIN_M)
        tails = find_tails(counts, gap_bins, self.share) if gap_bins else None
        if tails is None:
            return {**state, "tails": None}
        cut = (tails.below, "below", tails.low_bin), (tails.above, "above", tails.high_bin + 1)
        notes = (
            f"{n} candidates {side} {level * BIN_M:g} m are outliers: beyond a gap of {self.gap_m:g} m "
            f"in the run's elevations, and no more than {self.share:g} of all"
            for n, side, level in cut
            if n
        )
        return {
            **state,
            "tails": [tails.low_bin, tails.high_bin],
            "notes": add_notes(state, *notes),
        }


@dataclass(frozen=True)
class ChenPass(Pass):
    """The pass after the histogram: outliers, seeds, densification, labels."""

    params: Chen2023
    name: str = "chen2023"
    title = "find the ground, label all points"

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> ChenModel:
        """Find the seeds and densify the window's TIN."""
        return ChenModel(self.params, points, window, scale, state.get("tails"))


class ChenModel(TinLabels):
    """The finished TIN of a window."""

    def __init__(
        self,
        params: Chen2023,
        points: Points,
        window: Window,
        scale: Scale,
        tails: list[int] | None,
    ) -> None:
        self.params, self._scale, self._tails = params, scale, tails
        self._cells = CellLattice.of(params.thin_cell_m, scale)
        x, y, z = points.columns()
        keep = lowest_per_cell(x, y, z, self._cells)
        x, y, z = x[keep], y[keep], z[keep]
        low, other = self._outliers(x, y, z)
        outliers = {"low_outliers": int(low.sum()), "other_outliers": int(other.sum())}
        stats: Stats = {"candidates": int(x.size), **outliers, "windows": params.widths}
        stats |= dict.fromkeys(("potential_seeds", "noisy_seeds", "rounds", "vertices"), 0)
        super().__init__(window.closed, stats)
        if not (low | other).all():
            self.low = LowNoise(x[low], y[low], z[low], self._cells)
            self._densify(x, y, z, low | other, window)

    def _outliers(self, x: Int32, y: Int32, z: Int32) -> tuple[Bool, Bool]:
        """Step 1: masks of low noise and of other outliers."""
        p, (low, high) = self.params, outside(z, self._scale, self._tails)
        rest = np.flatnonzero(~(low | high))
        args = x[rest], y[rest], z[rest], self._scale, p.low_radius_m, p.low_depth_m
        high[rest] = isolated_in_height(*args)
        low[rest] = low_outliers(*args, p.low_group)
        return low, high & ~low

    def _densify(self, x: Int32, y: Int32, z: Int32, outlier: Bool, window: Window) -> None:
        p, scale = self.params, self._scale
        limits = p.limits(scale)
        ring_cells = CellLattice.of(p.ring_cell_m, scale)
        # In a cell cut by the window another point may be the lowest. Outliers are certain one
        # search radius inside.
        known = window.inside(self._cells, p.margin_cells)
        region = UncertifiedRegion(
            known, known.inside(ring_cells, RING), box_with_ring(x, y, ring_cells), scale
        )
        seeds, uncertified = potential_seeds(
            x, y, z, ~outlier, self._cells, p.opening(scale), known
        )
        region.add_points(x, y, uncertified)
        ring = choose_seeds(x, y, z, seeds, ring_cells, region, uncertified).virtual
        points, max_vertices = Xyz(x, y, z), x.size + len(ring)
        tin = tin_with_ring(points, seeds, ring, max_vertices)
        noise = self._noise(tin, x, y, np.flatnonzero(seeds), ring, region)
        self.stats.update(potential_seeds=int(seeds.sum()), noisy_seeds=int(noise.size))
        if noise.size:
            seeds[noise] = False
            tin = tin_with_ring(points, seeds, ring, max_vertices)
        state = np.where(outlier, REFUSED, np.where(seeds, VERTEX, 0)).astype(np.uint8)
        _, rounds = densify(tin, points, state, limits, p.rounds, region)
        floor = scale.counts(p.label_floor_m) if p.label_pass else 0.0
        self.finish(
            tin, region.triangles(tin), LabelRule(limits, floor, vertices_only=not p.label_pass)
        )
        self.stats.update(rounds=rounds)

    def _noise(
        self,
        tin: Tin,
        x: Int32,
        y: Int32,
        seeds: Indices,
        ring: Int32,
        region: UncertifiedRegion,
    ) -> Indices:
        """Step 4: return the seeds that are noise. Positions of seeds for which this is open become uncertified."""
        vx, vy = (np.ascontiguousarray(tin.vertices[:, axis]) for axis in (0, 1))
        # Seeds share no position with one another, nor with the ring, which lies in cells
        # without seeds.
        real = np.isin(
            position_keys(vx, vy), position_keys(ring[:, 0], ring[:, 1]), invert=True
        )
        noise, uncertified = noisy_seeds(
            tin, real, self.params.clusters(self._scale), region.triangles(tin)
        )
        region.add_points(vx, vy, uncertified)
        return seeds[
            np.isin(position_keys(x[seeds], y[seeds]), position_keys(vx[noise], vy[noise]))
        ]

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label the points of the window, and return a mask of the uncertified labels too."""
        labels, uncertified_labels = super().label(points)
        if self.tin is not None:
            below, _ = outside(points.xyz[2], self._scale, self._tails)
            labels[below & (labels != GROUND)] = LOW_NOISE
        return labels, uncertified_labels


METHOD = Method(
    "chen2023",
    "morphological seeds cleaned in their TIN, then batches (Chen 2023)",
    Chen2023,
    for_lidar=True,
)
