"""``dong2018``: two stages, the second from the noise of the points (Dong et al. 2018, paper 000).

In a dense TIN the noise of heights makes larger angles than the iteration angle, and Axelsson's
test loses ground. So densification stops at the density at which noise decides, and continues
with thresholds read from the ground points themselves, scale by scale.

1. Noise sigma from planar patches (`ptd.ground.roughness`, eq. 1), or ``--sigma``.
2. ``DEN_thr = k tan^2(alpha) / (3 sqrt(3) sigma^2)`` (eq. 3): in a denser TIN, noise decides.
3. Stage one is `classic`; a facet denser than DEN_thr takes no more vertices. A cloud sparser than DEN_thr ends here,
   with exactly the labels that `classic` gives with the same parameters.
4. Stage two, for scales s = 4, 2, 1 m: one random ground point per cell of size s makes an even TIN. The distances and
   angles of all other ground points to it make a 2-D histogram, and the reach of its outer contour gives a new pair of
   thresholds. Every unclassified point below both joins the ground.

==================  ========================  =======  ===========================================================
parameter           paper's name and value    default  reason
==================  ========================  =======  ===========================================================
max_building_size   grid size: 30             20 m     that of `classic`
terrain_angle       terrain angle: 88         88 deg   the paper's
iteration_angle     max angle: 6              25 deg   that of `classic`: sparse clouds end in stage one
iteration_distance  max distance: 1.4         1.4 m    the paper's on slopes
                    (slopes), 0.8 (flat)
edge_length_reduce  L1: none (table 3)        0 (off)  the paper's
edge_length_stop    L2: none (table 3)        0 (off)  the paper's; DEN_thr sets one in dense clouds
density_k           k: 10 (2..100)            0.2      gives k tan^2(alpha) of k = 4 at the paper's 6 degrees;
                                                       a denser stage one takes more low objects
first_scale         starting scale: none      4 m      larger cells blur the relief into the distances
last_scale          s_thr: 1                  1 m      the paper's
min_joined          n: 2000                   2000     the paper's; counted over the run, not per tile (below)
contour_share       outer contour: none       0.01     of the fullest bin: about 2.5 standard deviations
pit_sigmas          none (seeds by hand)      6        beyond any noise
thin_cell           none                      0        as fine as DEN_thr requires; 1 m in sparse clouds
rounds, low_*,      as `classic`
label_floor
robust_cells        none                      on       ours, for photogrammetric clouds, see below; off: the
                                                       paper's rule
==================  ========================  =======  ===========================================================

**Photogrammetric clouds**, the paper's subject, are filtered differently by default (`ptd.matched.robust_cells`).
Stage one gets one robust height per cell of 1 m. The last pass classifies points on both sides of its TIN by the noise
around them. These heights are sparse means of many points, so by equation 3 noise does not end stage one. Stage two is
omitted, because the last pass recovers the ground that noise would lose. ``--set robust_cells=no`` gives the steps
above, which are also those for LiDAR clouds.

Figures are in ``docs/filters.md``. Deviations, and answers to questions that the paper leaves
open:

- The paper's seeds were picked by hand. Ours are the lowest points per cell that do not lie in
  a pit (`pits`), because photogrammetric clouds have a blunder below the ground under nearly
  every cell.
- "Until the TIN's density passes DEN_thr" is decided facet by facet. In batches, the mean
  density of a run would pass it in the first round, before slopes and corners are reached.
- If densification ends before the TIN reaches DEN_thr, stage two follows as well, because noise
  ended stage one.
- Points are thinned in stage one, so that the TIN can just pass DEN_thr. A thinning cell that
  cannot reach it is refused.
- A random choice is a hash of the point's absolute position. Facets of a circumradius above 20
  m test no points in stage two.
- n is counted over all tiles between two passes. On a city it never stops a run; per tile it
  would stop some tiles and not their neighbours, and so show the edges of tiles.
- Both thresholds are reported for each scale, with a warning if the angle does not grow or the
  distance does not shrink. The thresholds are used as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

from ptd.ground import roughness
from ptd.matched.robust_cells import for_both_kinds
from ptd.methods.dong2018 import pits
from ptd.methods.dong2018.even_tin import reach_m
from ptd.methods.dong2018.params import Dong2018Parameters
from ptd.methods.dong2018.stage_one import NoisePass, StageOnePass
from ptd.methods.dong2018.stage_two import JoinPass, MeasurePass
from ptd.passes import Method, Pass

STAGE_ONE_ALONE = (
    "dong2018: robust heights of cells are too sparse and too accurate for noise to matter, so there is no "
    "stage two"
)
"""Note for runs on a photogrammetric cloud."""


@dataclass(frozen=True)
class Dong2018(Dong2018Parameters):
    """Parameters of `dong2018` (see the module's table), and the passes and reaches that follow from them."""

    @property
    def passes(self) -> tuple[Pass, ...]:
        """The measurement of noise and density, stage one, then a measurement and a labelling for each scale."""
        method_passes: list[Pass] = [NoisePass(self), StageOnePass(self)]
        for m in self.scales_m:
            method_passes.append(
                MeasurePass(self, m, f"measure-{m:g}", f"measure distances to a TIN of {m:g} m")
            )
            last = m == self.scales_m[-1]
            method_passes.append(JoinPass(m, last, f"join-{m:g}", f"densify a TIN of {m:g} m"))
        if self.robust_cells:
            return for_both_kinds(method_passes, self.classic().passes, STAGE_ONE_ALONE)
        return tuple(method_passes)

    @property
    def halo_m(self) -> float:
        """Two seed cells and 8 m for each round of stage one, as in `classic`, without the margin."""
        return max(
            2.0 * self.max_building_size_m + 8.0 * min(self.rounds or 30, 30) - self.margin_m,
            0.0,
        )

    @property
    def margin_m(self) -> float:
        """Margin of the measuring passes and the scales, with which all points of a core are certified."""
        pit = pits.CELL_M * (pits.REACH_CELLS + 1)
        return max(super().margin_m, pit, roughness.REACH_M, reach_m(self.first_scale_m))

    @property
    def candidate_cell_m(self) -> float:
        """0: all passes read all points."""
        return 0.0


METHOD = Method(
    "dong2018",
    "two stages, the second with thresholds from the noise (Dong 2018), for image matching",
    Dong2018,
)
