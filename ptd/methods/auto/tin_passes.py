"""Passes of `auto` for laser scans that build a TIN of the ground: densification and the last label."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.densify import REFUSED, VERTEX, WAITING, densify
from ptd.ground.fine_surface import FineLabels, with_fine_surface
from ptd.ground.labelling import GROUND, LabelRule, TinLabels
from ptd.ground.morphology import Bool
from ptd.ground.outliers import LowNoise
from ptd.ground.seeds import RING, box_with_ring, choose_seeds
from ptd.methods.auto.cell_codes import (
    ABOVE_NOISE,
    DENSIFIED,
    OUTLIER,
    ROOF,
    SEED,
    CellCodes,
    lowest_points,
)
from ptd.methods.auto.label_thresholds import label_bands
from ptd.methods.auto.params import REGROWTH, RING_M, AutoParameters
from ptd.methods.auto.raster_passes import LidarPass
from ptd.passes import Int32, Points, State
from ptd.tin.mesh import Tin


@dataclass(frozen=True)
class DensifyPass(LidarPass):
    """Pass that adds object cells to the TIN of the seeds if they fit it."""

    params: AutoParameters
    name: str = "densify"
    title = "densify the ground"
    columns: tuple[str, ...] = ("labels",)

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CellCodes:
        """Densify the window's TIN."""
        p = self.params
        cells = CellLattice.of(p.thin_cell_m, scale)
        x, y, z, codes = lowest_points(points, cells)
        known, seed = window.inside(cells), codes == SEED
        uncertified, rounds = np.full(x.size, window.closed), 0
        if seed.any():
            tin, region = first_tin(x, y, z, seed, known, scale)
            rest = np.where(codes == OUTLIER, np.uint8(REFUSED), np.uint8(WAITING))
            todo = np.where(seed, np.uint8(VERTEX), rest)
            uncertified, rounds = densify(
                tin, Xyz(x, y, z), todo, p.limits(scale), p.rounds, region
            )
            codes = np.where((todo == VERTEX) & ~seed, np.uint8(DENSIFIED), codes)
        stats = {"rounds": rounds, "densified": int((codes == DENSIFIED).sum())}
        return CellCodes(x, y, codes, cells, known, stats, uncertified)


@dataclass(frozen=True)
class LabelPass(LidarPass):
    """Pass that labels all points by the TIN of the ground, or by a fine surface where points are dense."""

    params: AutoParameters
    name: str = "label"
    title = "label all points"
    columns: tuple[str, ...] = ("labels",)
    label_margin_m: float = 0.0
    by_place: bool = True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> TinLabels:
        """Build the TIN and restore edges that were removed together with objects."""
        p = self.params
        cells = CellLattice.of(p.thin_cell_m, scale)
        x, y, z, codes = lowest_points(points, cells)
        low, ground = codes == OUTLIER, codes == GROUND
        # The elected points above noise are no noise themselves.
        above = points.xyz[:, points.known_labels() & ABOVE_NOISE > 0] - [[0], [0], [1]]
        highest = np.concatenate([(x[low], y[low], z[low]), above], axis=1).astype(np.int32)
        noise = LowNoise(highest[0], highest[1], highest[2], cells)
        model = TinLabels(window.closed, {"vertices": 0}, noise)
        if p.fine_surface:
            model = FineLabels(window.closed, {"vertices": 0}, noise, scale)
        if not ground.any():
            return model
        tin, region = first_tin(x, y, z, ground, window.inside(cells), scale)
        todo = np.where(
            ground, VERTEX, np.where(low | (codes == ROOF), REFUSED, WAITING)
        ).astype(np.uint8)
        densify(tin, Xyz(x, y, z), todo, p.limits(scale, REGROWTH), 1, region)
        rule = LabelRule(p.limits(scale), scale.counts(p.label_floor_m), heights_only=True)
        rule = with_fine_surface(rule, scale) if p.fine_surface else rule
        model.finish(tin, region.triangles(tin), rule, label_bands(p, state, scale))
        return model


def first_tin(
    x: Int32, y: Int32, z: Int32, chosen: Bool, known: Window, scale: Scale
) -> tuple[Tin, UncertifiedRegion]:
    """Build the TIN of the chosen points (at least one) and a ring of virtual ones, with space for all points.

    The mask ``chosen`` is certified only within the known window.
    """
    cells = CellLattice.of(RING_M, scale)
    region = UncertifiedRegion(
        known, known.inside(cells, RING), box_with_ring(x, y, cells), scale
    )
    ring = choose_seeds(x, y, z, chosen, cells, region).virtual
    corners = [np.concatenate([c[chosen], r]) for c, r in zip((x, y, z), ring.T, strict=True)]
    return Tin.build(*corners, max_vertices=x.size + len(ring)), region
