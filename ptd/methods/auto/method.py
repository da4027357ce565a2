"""``auto``: decides the source of the cloud, and finds the ground of LiDAR and photogrammetric clouds differently.

This is our own method and the default. The same settings serve all clouds, and the method
derives all differences from the cloud itself. In photogrammetric clouds heights scatter to both
sides and blunders lie below. So ground is found from a robust height per cell, by classifying
large objects as a whole, and by a surface of limited curvature (`ptd.matched`).

The passes below are for LiDAR clouds and work on the lowest point of each cell of 1 m. They
find morphological seeds, densify in a few rounds, and remove what still rises like an object.
``docs/filters.md`` has figures, the reasons for the passes, and their radii.

survey
    Decide between laser scanning and image matching by returns and penetration
    (`ptd.matched.survey`). Measure density and noise of each place
    (`ptd.ground.noise_by_place`). The thresholds follow from the density (`label_thresholds`).
seeds
    Remove low outliers. Cells that drop steeply in openings of growing radius (`objects`) are
    objects, and all other cells are seeds.
densify
    Add object cells to the TIN of the seeds if they fit it (`ptd.ground.densify`). They are
    edges and tops that the openings cut.
refine
    Subtract the mean of the ground and remove cells that rise from it: walls, cars, shrubs on
    slopes, and roofs onto which densification climbed. Do this again among the remaining
    ground.
roofs
    Remove roofs: connected ground of at most 200 m width that lies above nearly all ground
    around it (`ptd.ground.plateaus`). Do this four times, because lower roofs lean on higher
    ones.
label
    Add cells within half the distance and half the angle of `densify` to the TIN of the
    remaining ground, once. Then classify each point by its height above the TIN, or above a
    finer surface where points are dense.

====================  ==========================  ========  ============================================================
parameter             origin                      default   reason
====================  ==========================  ========  ============================================================
max_building_size     Chen 2023; Zhang 2003       36 m      wide enough for most large buildings in towns; wider
                                                            openings cut hill tops
thin_cell             as `classic`                1 m       fine enough for terrain detail; in every cell the lowest of
                                                            many points lies at the lower edge of the noise, so the
                                                            surface stays smooth
low_radius, _depth,   as `classic`                5 m, 4 m, larger groups are not noise of a laser
low_group                                         5
seed_rise, _slope     Pingel 2013 (slope, scale)  0.06, 0.2 keeps ground that rises by 0.06 m per m next to flat
                                                            ground, and by a fifth of the slope more on slopes
rounds                ours                        4         more rounds change little and need wider halos
iteration_distance,   as `classic`                1.4 m,    the seeds are dense already, and `edge_length_reduce`
_angle, edge_length_                              28 deg,   (L1) keeps the angle small there
reduce                                            5 m
object_size, _rise    ours                        12 m, 0.1 wider objects were found before; in clouds up to 1 point/m2
                                                            lower ones are within the floor of the last pass
roof_size             ours                        200 m     the largest halls, except those of industry
label_floor           as `classic`                0.24 m    up to 1 point/m2, a compromise: higher values keep rough
                                                            ground between sparse points, lower ones remove low
                                                            plants; from 2 points/m2 on the floor is 0.12 m, or
                                                            0.05 m plus three times the user's noise if that is
                                                            more, but at most this value
label_slope           ours                        1 m       the spacing of the points on a slope; half of it from 2
                                                            points/m2 on
refine                ours                        yes       photogrammetric clouds: `ptd.matched.last_look`
fine_surface          ours                        yes       the TIN of each metre's lowest point runs below the fine
                                                            relief (`ptd.ground.fine_surface`)
====================  ==========================  ========  ============================================================

`params` lists what cannot be set, with reasons. The ring of virtual seeds has cells of 20 m (`ptd.ground.seeds`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.blocks import blocks
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.densify import REFUSED, VERTEX, WAITING, densify
from ptd.ground.fine_surface import REACH_M, FineLabels, with_fine_surface
from ptd.ground.labelling import GROUND, LOW_NOISE, UNCLASSIFIED, LabelRule, TinLabels
from ptd.ground.morphology import Bool, CellRaster
from ptd.ground.noise_sums import Roughness
from ptd.ground.outliers import LowNoise, low_outliers
from ptd.ground.plateaus import ROOF_CELL_M, ROOF_STEPS_M, Plateaus, on_plateaus
from ptd.ground.seeds import RING, box_with_ring, choose_seeds
from ptd.matched import passes as matched
from ptd.matched import survey
from ptd.matched.step import is_matched
from ptd.matched.survey import ReturnStatistics
from ptd.methods.auto.cell_codes import CellCodes, lowest_points
from ptd.methods.auto.label_thresholds import decided, label_bands
from ptd.methods.auto.objects import Lowest
from ptd.methods.auto.params import REGROWTH, RING_M, AutoParameters
from ptd.passes import Int32, Method, Pass, Points, State, UInt8
from ptd.places import Figures
from ptd.tin.mesh import Tin

ROOF_PASSES = ("roofs", *(f"roofs{n}" for n in range(2, len(ROOF_STEPS_M) + 1)))

OBJECT, OUTLIER, SEED, DENSIFIED, ROOF = UNCLASSIFIED, LOW_NOISE, 3, 4, 6
"""Codes of cells between passes. Cells that stay ground after `refine` have the code
`GROUND`."""


@dataclass(frozen=True)
class Auto(AutoParameters):
    """Parameters of `auto` (see the module's table), and the passes that follow from them."""

    @property
    def passes(self) -> tuple[Pass, ...]:
        """Passes on rasters (with a fixed radius) and on TINs in turn, so that uncertified regions do not add up."""
        cell = self.thin_cell_m
        return (
            SurveyPass(params=self),
            SeedPass(self, influence_radius_m=(self.seed_reach + 1) * cell),
            DensifyPass(self),
            RefinePass(self, influence_radius_m=(self.refine_reach + 1) * cell),
            *(
                self._roof_pass(*steps)
                for steps in zip(ROOF_PASSES, (0.0, *ROOF_STEPS_M), ROOF_STEPS_M, strict=False)
            ),
            LabelPass(self, label_margin_m=REACH_M if self.fine_surface else 0.0),
            *matched.PASSES[:-1],
            matched.SurfacePass(refine=self.refine),
        )

    def _roof_pass(self, name: str, before_m: float, step_m: float) -> RoofPass:
        again, title = step_m == before_m, f"take out roofs with edges of {step_m:g} m"
        reach_m = (self.roof_reach + 1) * self.thin_cell_m
        return RoofPass(self, again, step_m, name, title + ", again" * again, reach_m)


@dataclass(frozen=True)
class SurveyPass(survey.SurveyPass):
    """Survey of density, noise and returns, and the thresholds that follow from them."""

    params: Auto = field(kw_only=True)

    def decided(
        self,
        found: Roughness,
        seen: ReturnStatistics,
        held: Sequence[Figures],
        run: Mapping[str, Any],
    ) -> tuple[survey.Survey, list[str]]:
        """Return the survey and its notes (`label_thresholds.decided`)."""
        return decided(self.params, found, seen, held, run)


@dataclass(frozen=True)
class LidarPass(Pass):
    """A pass that only LiDAR clouds need."""

    kind = "lidar"

    def applies(self, state: State) -> bool:
        """Return whether the run is LiDAR, or was not surveyed."""
        return "survey" not in state or not is_matched(state)


@dataclass(frozen=True)
class SeedPass(LidarPass):
    """Pass that classifies cells as low outliers, objects or seeds."""

    params: Auto
    name: str = "seeds"
    title = "find the first ground"
    influence_radius_m: float | None = None

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CellCodes:
        """Open the minimum raster with growing disks."""
        p = self.params
        cells = CellLattice.of(p.thin_cell_m, scale)
        x, y, z, _ = lowest_points(points, cells)
        outlier = low_outliers(x, y, z, scale, p.low_radius_m, p.low_depth_m, p.low_group)
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
class DensifyPass(LidarPass):
    """Pass that adds object cells to the TIN of the seeds if they fit it."""

    params: Auto
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
class RefinePass(LidarPass):
    """Pass that removes ground cells that rise from the mean of the ground."""

    params: Auto
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
    ground = (codes == SEED) | (codes == DENSIFIED)
    ground &= ~low.residual_objects(ground, codes != OUTLIER, p.objects)
    stays: Bool = ground & ~low.residual_objects(ground, ground, p.bumps)
    return stays


@dataclass(frozen=True)
class RoofPass(LidarPass):
    """Pass that classifies surfaces of ground above their surroundings as roofs."""

    params: Auto
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
class LabelPass(LidarPass):
    """Pass that labels all points by the TIN of the ground, or by a fine surface where points are dense."""

    params: Auto
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
        noise = LowNoise(x[low], y[low], z[low], cells)
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


METHOD = Method(
    "auto",
    "our own, for all clouds: morphological seeds, few rounds, then removal of objects",
    Auto,
)
