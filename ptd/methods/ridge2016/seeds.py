"""The seeds of `ridge2016`: one per cell and the ridge points, except those that a conicoid contradicts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ptd.cells import lowest_per_cell, position_keys
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.outliers import LowNoise, low_outliers
from ptd.ground.seeds import RING, box_with_ring, choose_seeds
from ptd.methods.ridge2016.conicoid import conicoid_outliers
from ptd.methods.ridge2016.params import Ridge2016Parameters
from ptd.methods.ridge2016.ridges import RidgeRule, ridge_points
from ptd.methods.ridge2016.sorted_cells import Stacks
from ptd.methods.ridge2016.thinned_densification import Round, densify_thinned
from ptd.passes import Int32
from ptd.tin.mesh import Tin


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
        params: Ridge2016Parameters,
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

    def _tin(self, seeds: Int32) -> tuple[Tin, npt.NDArray[np.bool_]]:
        """TIN of seeds and virtual seeds, and a mask of its vertices that are not virtual."""
        s, v = self.stacks, self.virtual
        tin = Tin.build(
            *(np.concatenate([c[seeds], v[:, k]]) for k, c in enumerate((s.x, s.y, s.z)))
        )
        virtual = position_keys(v[:, 0], v[:, 1])
        return tin, np.isin(position_keys(*tin.vertices.T[:2]), virtual, invert=True)

    def _ridge_points(self, p: Ridge2016Parameters, seeds: Int32, scale: Scale) -> Int32:
        side_m = p.ridge_side * p.max_building_size_m
        rule = RidgeRule.of(
            scale, side_m=side_m, angle_deg=p.ridge_angle_deg, radius_m=p.ridge_radius_m
        )
        return ridge_points(*self._tin(seeds), self.stacks, rule, self.region)

    def _refined(self, p: Ridge2016Parameters, seeds: Int32, scale: Scale) -> Int32:
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
