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
noise
    Find low noise: points below a dense layer of others (`ptd.ground.low_noise`). Elect the
    lowest other point of each cell.
seeds
    Remove low outliers that no layer covers. Cells that drop steeply in openings of growing radius (`objects`) are
    objects, and all other cells are seeds.
summits
    Put back ridges and summits that the openings cut off: smooth and steep cells, where the
    objects around continue the ground at most of their edges (`ptd.ground.summits`).
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
treetops
    Remove crowns on slopes by the same rule, after subtracting the plane of the ground around
    (`ptd.ground.treetops`).
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

from ptd.ground.fine_surface import REACH_M
from ptd.ground.noise_sums import Roughness
from ptd.ground.plateaus import ROOF_STEPS_M
from ptd.matched import passes as matched
from ptd.matched import survey
from ptd.matched.survey import ReturnStatistics
from ptd.methods.auto.label_thresholds import decided
from ptd.methods.auto.params import AutoParameters
from ptd.methods.auto.raster_passes import (
    NoisePass,
    RefinePass,
    RoofPass,
    SeedPass,
    SummitPass,
    TreetopPass,
)
from ptd.methods.auto.tin_passes import DensifyPass, LabelPass
from ptd.passes import Method, Pass
from ptd.places import Figures

ROOF_PASSES = ("roofs", *(f"roofs{n}" for n in range(2, len(ROOF_STEPS_M) + 1)))


@dataclass(frozen=True)
class Auto(AutoParameters):
    """Parameters of `auto` (see the module's table), and the passes that follow from them."""

    @property
    def passes(self) -> tuple[Pass, ...]:
        """Passes on rasters (with a fixed radius) and on TINs in turn, so that uncertified regions do not add up."""
        cell = self.thin_cell_m
        return (
            SurveyPass(params=self),
            NoisePass(self, influence_radius_m=(self.noise_reach + 1) * cell),
            SeedPass(self, influence_radius_m=(self.seed_reach + 1) * cell),
            SummitPass(self, influence_radius_m=(self.summit_reach + 1) * cell),
            DensifyPass(self),
            RefinePass(self, influence_radius_m=(self.refine_reach + 1) * cell),
            *(
                self._roof_pass(name, ROOF_STEPS_M[: n + 1])
                for n, name in enumerate(ROOF_PASSES)
            ),
            TreetopPass(self, influence_radius_m=(self.treetop_reach + 1) * cell),
            LabelPass(self, label_margin_m=REACH_M if self.fine_surface else 0.0),
            *matched.PASSES[:-1],
            matched.SurfacePass(refine=self.refine),
        )

    def _roof_pass(self, name: str, steps_m: Sequence[float]) -> RoofPass:
        """Return the pass for the last of some steps."""
        step_m, n_round = steps_m[-1], steps_m.count(steps_m[-1])
        title = f"take out roofs with edges of {step_m:g} m"
        if n_round > 1:
            title += f", round {n_round}"
        reach_m = (self.roof_reach + 1) * self.thin_cell_m
        return RoofPass(self, n_round > 1, step_m, name, title, reach_m)


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


METHOD = Method(
    "auto",
    "our own, for all clouds: morphological seeds, few rounds, then removal of objects",
    Auto,
)
