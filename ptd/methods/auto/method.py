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
    (`ptd.ground.noise_sums`). The thresholds follow from the density (`label_thresholds`).
noise
    Find low noise: points below a dense layer of others (`ptd.ground.low_noise`). Elect the
    lowest other point of each cell.
seeds
    Remove low outliers that no layer covers. Cells that drop steeply in openings of growing radius (`cells`) are
    objects, and all other cells are seeds.
summits
    Put back ridges and summits that the openings cut off: smooth and steep cells, where the
    objects around continue the ground at most of their edges (`ptd.ground.cut_off_land`).
densify
    Add object cells to the TIN of the seeds if they fit it (`ptd.ground.densify`). They are
    edges and tops that the openings cut.
refine
    Subtract the mean of the ground and remove cells that rise from it: walls, cars, shrubs on
    slopes, and roofs onto which densification climbed. Do this again among the remaining
    ground. At the end remove single cells that stayed where most cells around at their height did not.
roofs
    Remove roofs: connected ground of at most 200 m width that lies above nearly all ground
    around it (`ptd.ground.plateaus`). Do this four times, because lower roofs lean on higher
    ones.
treetops
    Remove crowns on slopes by the same rule, after subtracting the plane of the ground around
    (`ptd.ground.treetops`).
annexes
    Remove ground that rises from the mean of the ground beside roofs and such crowns: ramps for loading, low annexes,
    remains of crowns. Roofs count as if they were at the mean.
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

`params` lists what cannot be set, with reasons. The ring of virtual seeds has cells of 20 m (`ptd.ground.densify`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32
from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.densify import (
    REFUSED,
    RING,
    VERTEX,
    WAITING,
    box_with_ring,
    choose_seeds,
    densify,
    tin_with_ring,
)
from ptd.ground.fine_surface import REACH_M, FineLabels, with_fine_surface
from ptd.ground.labelling import GROUND, Bands, LabelRule, TinLabels
from ptd.ground.noise_sums import Roughness
from ptd.ground.outliers import LowNoise
from ptd.ground.plateaus import ROOF_STEPS_M
from ptd.matched import passes as matched
from ptd.matched import survey
from ptd.matched.evidence import DIM
from ptd.matched.ground_model import GROUND_M
from ptd.matched.survey import (
    CELL_SIGMA,
    CELL_SIZE,
    DENSITY,
    ReturnStatistics,
    Survey,
    known,
    surveyed,
)
from ptd.methods.auto.cells import (
    ABOVE_NOISE,
    DENSIFIED,
    OUTLIER,
    ROOF,
    SEED,
    CellCodes,
    lowest_points,
)
from ptd.methods.auto.params import REGROWTH, RING_M, AutoParameters
from ptd.methods.auto.raster_passes import (
    AnnexPass,
    LidarPass,
    NoisePass,
    RasterPass,
    RefinePass,
    RoofPass,
    SeedPass,
    SummitPass,
    TreetopPass,
)
from ptd.passes import Method, Pass, Points, State
from ptd.places import PLACES, Figures, field, span
from ptd.tin.mesh import Tin

ROOF_PASSES = ("roofs", *(f"roofs{n}" for n in range(2, len(ROOF_STEPS_M) + 1)))


@dataclass(frozen=True)
class Auto(AutoParameters):
    """Parameters of `auto` (see the module's table), and the passes that follow from them."""

    @property
    def passes(self) -> tuple[Pass, ...]:
        """Passes on rasters (with a fixed radius) and on TINs in turn, so that uncertified regions do not add up."""
        return (
            SurveyPass(params=self),
            NoisePass(self, influence_radius_m=(self.noise_reach + 1) * self.thin_cell_m),
            self._raster_pass(SeedPass, self.seed_reach),
            self._raster_pass(SummitPass, self.summit_reach),
            DensifyPass(self),
            self._raster_pass(RefinePass, self.refine_reach),
            *(
                self._roof_pass(name, ROOF_STEPS_M[: n + 1])
                for n, name in enumerate(ROOF_PASSES)
            ),
            self._raster_pass(TreetopPass, self.treetop_reach),
            self._raster_pass(AnnexPass, self.annex_reach),
            LabelPass(self, label_margin_m=REACH_M if self.fine_surface else 0.0),
            *matched.PASSES[:-1],
            matched.SurfacePass(refine=self.refine),
        )

    def _raster_pass(
        self, kind: Callable[..., RasterPass], reach: int, **rest: Any
    ) -> RasterPass:
        return kind(self, reach, (reach + 1) * self.thin_cell_m, **rest)

    def _roof_pass(self, name: str, steps_m: Sequence[float]) -> RasterPass:
        """Return the pass for the last of some steps."""
        step_m, n_round = steps_m[-1], steps_m.count(steps_m[-1])
        title = f"take out roofs with edges of {step_m:g} m"
        if n_round > 1:
            title += f", round {n_round}"
        return self._raster_pass(
            RoofPass, self.roof_reach, again=n_round > 1, step_m=step_m, name=name, title=title
        )


@dataclass(frozen=True)
class SurveyPass(survey.SurveyPass):
    """Survey of density, noise and returns, and the thresholds that follow from them."""

    _: KW_ONLY
    params: Auto

    def decided(
        self,
        found: Roughness,
        seen: ReturnStatistics,
        held: Sequence[Figures],
        run: Mapping[str, Any],
    ) -> tuple[survey.Survey, list[str]]:
        """Return the survey and its notes (`decided`)."""
        return decided(self.params, found, seen, held, run)


SPARSE_M2 = 1.0
"""Density in points per square metre up to which the last pass uses the parameters
unchanged."""
DENSE_M2 = 2.0
"""Density in points per square metre from which on the last pass is as narrow as noise
allows."""
DENSE_FLOOR_M = 0.12
"""Floor of the last pass for dense clouds: four times the noise of airborne lasers. A wider
floor from the measured noise would classify low plants as ground, because meadows and fields
look planar too."""
GIVEN_BASE_M = 0.05
"""Constant part of the floor for dense clouds if the user gives the noise. The floor is this
plus `GIVEN_SIGMAS` times the noise, but at least `DENSE_FLOOR_M` and at most
`AutoParameters.label_floor_m`."""
GIVEN_SIGMAS = 3.0
"""Multiple of the noise given by the user that is added to `GIVEN_BASE_M`."""
DENSE_SLOPE = 0.5
"""Share of ``label_slope_m`` for dense clouds."""


class LabelThresholds(NamedTuple):
    """Thresholds at a place: floor in metres, and addition in metres per unit of slope."""

    floor_m: float
    slope_m: float


def label_thresholds(
    params: AutoParameters, density_m2: float, given_sigma_m: float | None
) -> LabelThresholds:
    """Return the thresholds for a density and the noise given by the user, if any."""
    dense = min(max((density_m2 - SPARSE_M2) / (DENSE_M2 - SPARSE_M2), 0.0), 1.0)
    floor = (
        DENSE_FLOOR_M
        if given_sigma_m is None
        else max(DENSE_FLOOR_M, GIVEN_BASE_M + GIVEN_SIGMAS * given_sigma_m)
    )
    floor = min(floor, params.label_floor_m)
    return LabelThresholds(
        params.label_floor_m + dense * (floor - params.label_floor_m),
        params.label_slope_m * (1.0 - dense * (1.0 - DENSE_SLOPE)),
    )


def label_bands(params: AutoParameters, state: State, scale: Scale) -> Bands:
    """Return the largest distances of ground from the TIN by place."""
    table: dict[str, LabelThresholds] = {
        name: label_thresholds(params, known(figures, DENSITY), state["run"]["sigma_m"])
        for name, figures in state[PLACES].items()
    }
    wide = LabelThresholds(params.label_floor_m, params.label_slope_m)
    floor, slope = (field(table, k, scale, wide[k]).times(scale.counts(1.0)) for k in range(2))
    return Bands(floor, slope)


def decided(
    params: AutoParameters,
    found: Roughness,
    seen: ReturnStatistics,
    held: Sequence[Figures],
    run: Mapping[str, Any],
) -> tuple[Survey, list[str]]:
    """Return the survey of the run and notes on it.

    Parameters
    ----------
    params : AutoParameters
    found : Roughness
        Density and noise of the run.
    seen : ReturnStatistics
    held : sequence of tuple
        Figures of the places that contain points.
    run : mapping
        Fields of `ptd.passes.RunHints`.

    Returns
    -------
    survey : Survey
        Result of `ptd.matched.survey.surveyed`.
    notes : list of str
    """
    survey, note = surveyed(found, seen, run)
    if not held:
        return survey, [note]
    if survey["kind"] == DIM:
        noise, size_m = (
            span([known(figures, figure) for figures in held], 2)
            for figure in (CELL_SIGMA, CELL_SIZE)
        )
        line = (
            f"decided: ground is up to {GROUND_M:g} m plus twice the local noise from the surface, "
            f"after neighbours voted; noise of the place {noise} m, cells of {size_m} m"
        )
        return survey, [note, line]
    densities = sorted(known(figures, DENSITY) for figures in held)
    chosen = [label_thresholds(params, density, run["sigma_m"]) for density in densities]
    floor, slope = (span([of_place[k] for of_place in chosen], 2) for k in range(2))
    line = f"decided: ground is up to {floor} m + {slope} m x slope from the surface"
    if len(set(chosen)) > 1:
        line += f", by density of the place ({span(densities, 2)} points/m2)"
    return survey, [note, line]


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
    return tin_with_ring(Xyz(x, y, z), chosen, ring, x.size + len(ring)), region


METHOD = Method(
    "auto",
    "our own, for all clouds: morphological seeds, few rounds, then removal of objects",
    Auto,
)
