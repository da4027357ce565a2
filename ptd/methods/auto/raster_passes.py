"""Passes of `auto` for laser scans that work on the raster of the lowest points, with a fixed radius."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from ptd.arrays import UInt8
from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.cut_off_land import on_strips, on_summits
from ptd.ground.labelling import GROUND
from ptd.ground.low_noise import low_noise
from ptd.ground.morphology import CellRaster, blocks
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
from ptd.passes import Pass, Points, State


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
        noise = low_noise(xyz, scale) if p.low_group else np.zeros(len(points), np.bool_)
        return ElectedCells(xyz, noise, cells, window.inside(cells, p.noise_reach))


class CellBlock(NamedTuple):
    """The lowest points of the cells of a block and of the margin around it, with their lattice."""

    points: Xyz
    cells: CellLattice
    cell_m: float
    scale: Scale

    @property
    def lowest(self) -> Lowest:
        """The raster of the points."""
        return Lowest(*self.points, self.cells, self.cell_m, self.scale)


@dataclass(frozen=True)
class RasterPass(LidarPass):
    """Pass that derives the code of each cell from the cells around it, block by block.

    Attributes
    ----------
    params : AutoParameters
    reach : int
        Distance in cells beyond which cells do not change a code.
    influence_radius_m : float
        The same distance in metres, and one cell more.
    counted : tuple of (str, int or None, int)
        For each count of the statistics its name, and the codes before and after the search in blocks of the cells
        that it counts. None: any code.
    """

    params: AutoParameters
    reach: int
    influence_radius_m: float | None
    columns = ("labels",)
    counted: ClassVar[tuple[tuple[str, int | None, int], ...]]

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CellCodes:
        """Derive the codes of all cells of the window."""
        cell_m = self.params.thin_cell_m
        cells = CellLattice.of(cell_m, scale)
        x, y, z, labels = lowest_points(points, cells)
        before = self.first_codes(Xyz(x, y, z), labels, scale)
        after = before.copy()
        for index, inner in blocks(x, y, cells, self.reach):
            block = CellBlock(Xyz(x[index], y[index], z[index]), cells, cell_m, scale)
            codes = before[index]
            new_codes = self.block_codes(block, codes)
            changed = np.flatnonzero((new_codes != codes) & inner)
            after[index[changed]] = new_codes[changed]
        certain = window.inside(cells, self.reach)
        stats = {}
        for name, old, new in self.counted:
            of_old = True if old is None else before == old
            stats[name] = int(((after == new) & of_old).sum())
        return CellCodes(x, y, after, cells, certain, stats)

    def first_codes(self, points: Xyz, labels: UInt8, scale: Scale) -> UInt8:
        """Return the codes before the search in blocks: uint8 [n]."""
        return labels

    @abstractmethod
    def block_codes(self, block: CellBlock, codes: UInt8) -> UInt8:
        """Return the new codes of a block from those of `first_codes`: uint8 [n]."""


@dataclass(frozen=True)
class SeedPass(RasterPass):
    """Pass that finds low outliers, and objects among the other cells by openings with growing disks."""

    name: str = "seeds"
    title = "find the first ground"
    counted = (("low_outliers", None, OUTLIER), ("seeds", None, SEED))

    def first_codes(self, points: Xyz, labels: UInt8, scale: Scale) -> UInt8:
        """Find the low outliers that are not low noise."""
        p = self.params
        outlier = labels == OUTLIER
        left = np.flatnonzero(~outlier)
        x, y, z = (axis[left] for axis in points)
        outlier[left] = low_outliers(x, y, z, scale, p.low_radius_m, p.low_depth_m, p.low_group)
        return np.where(outlier, np.uint8(OUTLIER), np.uint8(SEED))

    def block_codes(self, block: CellBlock, codes: UInt8) -> UInt8:
        """Find the seeds that rise like objects."""
        p, seeds = self.params, codes == SEED
        rises = block.lowest.steep_objects(seeds, p.seed_drop, p.shape) & seeds
        return np.where(rises, np.uint8(OBJECT), codes)


@dataclass(frozen=True)
class SummitPass(RasterPass):
    """Pass that makes seeds of the cells that openings cut off ridges and summits."""

    name: str = "summits"
    title = "put back ridges and summits"
    counted = (("summits", OBJECT, SEED),)

    def block_codes(self, block: CellBlock, codes: UInt8) -> UInt8:
        """Find the object cells that continue the slopes of the seeds."""
        points = block.points
        summits = on_summits(
            points,
            codes == OBJECT,
            codes == SEED,
            CellRaster(points.x, points.y, block.cells),
            block.scale,
            block.cell_m,
            self.params.shape.radius,
            between_pits=True,
        )
        return np.where(summits, np.uint8(SEED), codes)


@dataclass(frozen=True)
class RefinePass(RasterPass):
    """Pass that removes ground cells that rise from the mean of the ground."""

    name: str = "refine"
    title = "take out low objects"
    counted = (("ground", None, GROUND),)

    def block_codes(self, block: CellBlock, codes: UInt8) -> UInt8:
        """Subtract the ground's mean and find the cells that rise from it, twice."""
        p, low = self.params, block.lowest
        before = (codes == SEED) | (codes == DENSIFIED)
        ground = before & ~low.residual_objects(before, codes != OUTLIER, p.objects)
        stays = ground & ~low.residual_objects(ground, ground, p.bumps)
        stays &= ~low.outvoted(before, stays, p.vote_width)
        rest = np.where(codes == OUTLIER, np.uint8(OUTLIER), np.uint8(OBJECT))
        return np.where(stays, np.uint8(GROUND), rest)


@dataclass(frozen=True)
class RoofPass(RasterPass):
    """Pass that classifies surfaces of ground above their surroundings as roofs."""

    _: KW_ONLY
    again: bool
    step_m: float
    name: str
    title: str
    counted = (("roofs", GROUND, ROOF),)

    def block_codes(self, block: CellBlock, codes: UInt8) -> UInt8:
        """Compare each connected surface with the ground around it."""
        earlier_roofs = codes == ROOF
        if self.again and not earlier_roofs.any():
            return codes  # No roof was found before, so the result is the same.
        x, y, z = block.points
        wide = CellRaster(x, y, CellLattice.of(ROOF_CELL_M, block.scale))
        roof_rule = Plateaus.of(block.scale, self.params.roof_size_m, self.step_m)
        roofs = on_plateaus(z, codes == GROUND, earlier_roofs, wide, roof_rule)
        return np.where(roofs, np.uint8(ROOF), codes)


@dataclass(frozen=True)
class TreetopPass(RasterPass):
    """Pass that classifies ground on crowns of slopes as roofs, and strips of land at the border as ground."""

    name: str = "treetops"
    title = "take out crowns on slopes, put back strips at the border"
    counted = (("treetops", GROUND, ROOF), ("strips", OBJECT, GROUND))

    def block_codes(self, block: CellBlock, codes: UInt8) -> UInt8:
        """Compare small surfaces of ground with the plane of the ground around, and smooth ones at the border."""
        points, cells, cell_m, scale = block
        ground = codes == GROUND
        crowns = on_treetops(points, ground, codes == ROOF, cells, cell_m, scale)
        rule = Plateaus.of(scale, self.params.roof_size_m)
        strips = on_strips(points, codes == OBJECT, ground, cells, cell_m, rule, scale)
        return np.where(crowns, np.uint8(ROOF), np.where(strips, np.uint8(GROUND), codes))


@dataclass(frozen=True)
class AnnexPass(RasterPass):
    """Pass that classifies ground that rises beside roofs as roofs, such as ramps and low annexes."""

    name: str = "annexes"
    title = "take out low parts of buildings"
    counted = (("annexes", GROUND, ROOF),)

    def block_codes(self, block: CellBlock, codes: UInt8) -> UInt8:
        """Subtract the ground's mean and find the cells near roofs that rise from it."""
        roofs = codes == ROOF
        if not roofs.any():
            return codes
        p = self.params
        annexes = block.lowest.annexes(codes == GROUND, roofs, p.objects, p.annex_width)
        return np.where(annexes, np.uint8(ROOF), codes)
