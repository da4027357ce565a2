"""Passes of `auto` for laser scans that work on the raster of the lowest points, with a fixed radius."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.cut_off_land import on_strips, on_summits
from ptd.ground.labelling import GROUND
from ptd.ground.low_noise import low_noise
from ptd.ground.morphology import Bool, CellRaster, blocks
from ptd.ground.outliers import low_outliers
from ptd.ground.plateaus import ROOF_CELL_M, Plateaus, on_plateaus
from ptd.ground.treetops import on_treetops
from ptd.matched.step import is_matched
from ptd.methods.auto.cells import (
    DENSIFIED,
    OBJECT,
    OUTLIER,
    ROOF,
    SEED,
    CellCodes,
    ElectedCells,
    Lowest,
    lowest_points,
)
from ptd.methods.auto.params import AutoParameters
from ptd.passes import Pass, Points, State, UInt8


@dataclass(frozen=True)
class LidarPass(Pass):
    """A pass that only LiDAR clouds need, on the elected point of each cell."""

    kind = "lidar"
    elected = True

    def applies(self, state: State) -> bool:
        """Return whether the run is LiDAR, or was not surveyed."""
        return "survey" not in state or not is_matched(state)


@dataclass(frozen=True)
class NoisePass(LidarPass):
    """Pass that finds low noise among all points, and elects the lowest other point of each cell."""

    params: AutoParameters
    name: str = "noise"
    title = "find low noise"
    every_point = True
    elects = True
    elected = False
    influence_radius_m: float | None = None

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> ElectedCells:
        """Search dense layers above low points."""
        p = self.params
        cells, xyz = CellLattice.of(p.thin_cell_m, scale), Xyz(*points.columns())
        noise = np.zeros(len(points), np.bool_)
        if p.low_group:
            noise = low_noise(xyz, scale)
        return ElectedCells(xyz, noise, cells, window.inside(cells, p.noise_reach))


@dataclass(frozen=True)
class SeedPass(LidarPass):
    """Pass that classifies cells as low outliers, objects or seeds."""

    params: AutoParameters
    name: str = "seeds"
    title = "find the first ground"
    columns: tuple[str, ...] = ("labels",)
    influence_radius_m: float | None = None

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CellCodes:
        """Open the minimum raster with growing disks."""
        p = self.params
        cells = CellLattice.of(p.thin_cell_m, scale)
        x, y, z, codes = lowest_points(points, cells)
        outlier = codes == OUTLIER
        left = np.flatnonzero(~outlier)
        outlier[left] = low_outliers(
            x[left], y[left], z[left], scale, p.low_radius_m, p.low_depth_m, p.low_group
        )
        codes = np.where(outlier, np.uint8(OUTLIER), np.uint8(SEED))
        for index, inner in blocks(x, y, cells, p.shape.reach):
            low = Lowest(x[index], y[index], z[index], cells, p.thin_cell_m, scale)
            present = ~outlier[index]
            rises = low.steep_objects(present, p.seed_drop, p.shape) & present
            codes[index[rises & inner]] = OBJECT
        stats = {
            "low_outliers": int((codes == OUTLIER).sum()),
            "seeds": int((codes == SEED).sum()),
        }
        return CellCodes(x, y, codes, cells, window.inside(cells, p.seed_reach), stats)


@dataclass(frozen=True)
class SummitPass(LidarPass):
    """Pass that makes seeds of the cells that openings cut off ridges and summits."""

    params: AutoParameters
    name: str = "summits"
    title = "put back ridges and summits"
    columns: tuple[str, ...] = ("labels",)
    influence_radius_m: float | None = None

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CellCodes:
        """Find the object cells that continue the slopes of the seeds."""
        p = self.params
        cells = CellLattice.of(p.thin_cell_m, scale)
        x, y, z, codes = lowest_points(points, cells)
        lost, seed = codes == OBJECT, codes == SEED
        for index, inner in blocks(x, y, cells, p.summit_reach):
            block = Xyz(x[index], y[index], z[index])
            raster = CellRaster(block.x, block.y, cells)
            summits = on_summits(
                block,
                lost[index],
                seed[index],
                raster,
                scale,
                p.thin_cell_m,
                p.shape.radius,
                between_pits=True,
            )
            codes[index[summits & inner]] = SEED
        stats = {"summits": int((codes == SEED).sum() - seed.sum())}
        return CellCodes(x, y, codes, cells, window.inside(cells, p.summit_reach), stats)


@dataclass(frozen=True)
class RefinePass(LidarPass):
    """Pass that removes ground cells that rise from the mean of the ground."""

    params: AutoParameters
    name: str = "refine"
    title = "take out low objects"
    columns: tuple[str, ...] = ("labels",)
    influence_radius_m: float | None = None

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CellCodes:
        """Subtract the ground's mean and find the cells that rise from it, twice."""
        p = self.params
        cells = CellLattice.of(p.thin_cell_m, scale)
        x, y, z, previous_codes = lowest_points(points, cells)
        codes = np.where(previous_codes == OUTLIER, np.uint8(OUTLIER), np.uint8(OBJECT))
        for index, inner in blocks(x, y, cells, p.refine_reach):
            low = Lowest(x[index], y[index], z[index], cells, p.thin_cell_m, scale)
            ground = refined(low, previous_codes[index], p)
            codes[index[ground & inner]] = GROUND
        stats = {"ground": int((codes == GROUND).sum())}
        return CellCodes(x, y, codes, cells, window.inside(cells, p.refine_reach), stats)


def refined(low: Lowest, codes: UInt8, p: AutoParameters) -> Bool:
    """Return a mask of the cells that stay ground: bool [n]."""
    before = (codes == SEED) | (codes == DENSIFIED)
    ground = before & ~low.residual_objects(before, codes != OUTLIER, p.objects)
    stays: Bool = ground & ~low.residual_objects(ground, ground, p.bumps)
    return stays & ~low.outvoted(before, stays, p.vote_width)


@dataclass(frozen=True)
class RoofPass(LidarPass):
    """Pass that classifies surfaces of ground above their surroundings as roofs."""

    params: AutoParameters
    again: bool
    step_m: float
    name: str
    title: str
    influence_radius_m: float | None
    columns: tuple[str, ...] = ("labels",)

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CellCodes:
        """Compare each connected surface with the ground around it."""
        p = self.params
        cells, wide = CellLattice.of(p.thin_cell_m, scale), CellLattice.of(ROOF_CELL_M, scale)
        roof_rule = Plateaus.of(scale, p.roof_size_m, self.step_m)
        x, y, z, codes = lowest_points(points, cells)
        ground, earlier_roofs = codes == GROUND, codes == ROOF
        for index, inner in blocks(x, y, cells, p.roof_reach):
            if self.again and not earlier_roofs[index].any():
                continue  # No roof was found before, so the result is the same.
            raster = CellRaster(x[index], y[index], wide)
            roofs = on_plateaus(
                z[index], ground[index], earlier_roofs[index], raster, roof_rule
            )
            codes[index[roofs & inner]] = ROOF
        stats = {"roofs": int(ground.sum() - (codes == GROUND).sum())}
        return CellCodes(x, y, codes, cells, window.inside(cells, p.roof_reach), stats)


@dataclass(frozen=True)
class TreetopPass(LidarPass):
    """Pass that classifies ground on crowns of slopes as roofs, and strips of land at the border as ground."""

    params: AutoParameters
    name: str = "treetops"
    title = "take out crowns on slopes, put back strips at the border"
    columns: tuple[str, ...] = ("labels",)
    influence_radius_m: float | None = None

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CellCodes:
        """Compare small surfaces of ground with the plane of the ground around, and smooth ones at the border."""
        p = self.params
        cells = CellLattice.of(p.thin_cell_m, scale)
        x, y, z, codes = lowest_points(points, cells)
        roof_rule = Plateaus.of(scale, p.roof_size_m)
        ground, roofs, lost = codes == GROUND, codes == ROOF, codes == OBJECT
        for index, inner in blocks(x, y, cells, p.treetop_reach):
            block = Xyz(x[index], y[index], z[index])
            crowns = on_treetops(
                block, ground[index], roofs[index], cells, p.thin_cell_m, scale
            )
            codes[index[crowns & inner]] = ROOF
            strips = on_strips(
                block, lost[index], ground[index], cells, p.thin_cell_m, roof_rule, scale
            )
            codes[index[strips & inner]] = GROUND
        stats = {
            "treetops": int((ground & (codes == ROOF)).sum()),
            "strips": int((lost & (codes == GROUND)).sum()),
        }
        return CellCodes(x, y, codes, cells, window.inside(cells, p.treetop_reach), stats)


@dataclass(frozen=True)
class AnnexPass(LidarPass):
    """Pass that classifies ground that rises beside roofs as roofs, such as ramps and low annexes."""

    params: AutoParameters
    name: str = "annexes"
    title = "take out low parts of buildings"
    columns: tuple[str, ...] = ("labels",)
    influence_radius_m: float | None = None

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CellCodes:
        """Subtract the ground's mean and find the cells near roofs that rise from it."""
        p = self.params
        cells = CellLattice.of(p.thin_cell_m, scale)
        x, y, z, codes = lowest_points(points, cells)
        ground, roofs = codes == GROUND, codes == ROOF
        for index, inner in blocks(x, y, cells, p.annex_reach):
            if not roofs[index].any():
                continue
            low = Lowest(x[index], y[index], z[index], cells, p.thin_cell_m, scale)
            annexes = low.annexes(ground[index], roofs[index], p.objects, p.annex_width)
            codes[index[annexes & inner]] = ROOF
        stats = {"annexes": int(ground.sum() - (codes == GROUND).sum())}
        return CellCodes(x, y, codes, cells, window.inside(cells, p.annex_reach), stats)
