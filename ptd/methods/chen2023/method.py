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

1. The tails of the run's elevation histogram (one candidate per cell) are cut at a gap (`elevation_histogram`), where
   the paper chooses from a plot. Then points isolated in height are removed. The paper corrects the rest by hand. Here
   groups of low points are searched for instead.
2. A minimum raster is filled (`minimum_grid`). Cells beyond the reach of interpolation take the nearest height, not 0.
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

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ptd.cells import Xyz, lowest_per_cell, position_keys
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.densify import REFUSED, VERTEX, densify
from ptd.ground.labelling import GROUND, LOW_NOISE, LabelRule, TinLabels
from ptd.ground.outliers import LowNoise, isolated_in_height, low_outliers
from ptd.ground.seeds import RING, box_with_ring, choose_seeds
from ptd.matched.robust_cells import for_both_kinds
from ptd.methods.chen2023.elevation_histogram import ElevationsPass, outside
from ptd.methods.chen2023.params import Chen2023Parameters
from ptd.methods.chen2023.progressive_opening import potential_seeds
from ptd.methods.chen2023.seed_clusters import noisy_seeds
from ptd.passes import Int32, Method, Pass, Points, State, Stats, UInt8
from ptd.tin.mesh import Tin

Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Chen2023(Chen2023Parameters):
    """Parameters of `chen2023` (see the module's table), and the passes that follow from them."""

    @property
    def passes(self) -> tuple[Pass, ...]:
        """The histogram of heights, then the filter, both on robust cells if the cloud is photogrammetric."""
        tails = ElevationsPass(self.thin_cell_m, self.tail_gap_m, self.tail_share)
        method_passes = (tails, ChenPass(self))
        if self.robust_cells:
            return for_both_kinds(method_passes)
        return method_passes


@dataclass(frozen=True)
class ChenPass(Pass):
    """The pass after the histogram: outliers, seeds, densification, labels."""

    params: Chen2023Parameters
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
        params: Chen2023Parameters,
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
        tin = _triangulate(x, y, z, seeds, ring)
        noise = self._noise(tin, x, y, np.flatnonzero(seeds), ring, region)
        self.stats.update(potential_seeds=int(seeds.sum()), noisy_seeds=int(noise.size))
        if noise.size:
            seeds[noise] = False
            tin = _triangulate(x, y, z, seeds, ring)
        state = np.where(outlier, REFUSED, np.where(seeds, VERTEX, 0)).astype(np.uint8)
        _, rounds = densify(tin, Xyz(x, y, z), state, limits, p.rounds, region)
        floor = 0.0
        if p.label_pass:
            floor = scale.counts(p.label_floor_m)
        self.finish(
            tin, region.triangles(tin), LabelRule(limits, floor, vertices_only=not p.label_pass)
        )
        self.stats.update(rounds=rounds)

    def _noise(
        self,
        tin: Tin,
        x: Int32,
        y: Int32,
        seeds: npt.NDArray[np.intp],
        ring: Int32,
        region: UncertifiedRegion,
    ) -> npt.NDArray[np.intp]:
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


def _triangulate(x: Int32, y: Int32, z: Int32, seeds: Bool, ring: Int32) -> Tin:
    columns = (np.concatenate([c[seeds], v]) for c, v in zip((x, y, z), ring.T, strict=True))
    return Tin.build(*columns, max_vertices=int(x.size) + len(ring))


METHOD = Method(
    "chen2023", "morphological seeds cleaned in their TIN, then batches (Chen 2023)", Chen2023
)
