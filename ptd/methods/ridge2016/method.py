"""``ridge2016``: progressive TIN densification for steep mountains beside settlements.

Remote Sensing 8(1):71 (2016); file 003. Parameters that are not in the table are those of
`classic`.

====================  =============================  ========  =======================================================
parameter             paper's name and value         default   reason
====================  =============================  ========  =======================================================
max_building_size     grid cell size w: 20           20 m      the paper's value. "Half of the classic's" would be 10:
                                                               more ridges, but type II doubles (``docs/filters.md``)
terrain_angle         maximum terrain angle t: 88    88 deg    the paper's value
iteration_angle       maximum angle theta: 6         25 deg    `classic`'s: 6 loses the ground of sparse clouds
iteration_distance    maximum distance d: 1.4        1.4 m     the paper's value
edge_length_stop      minimum edge length l: 1       1 m       the paper's value
ridge_side            m_r: 1.5                       1.5       the paper's value
ridge_angle           theta_r: 25                    25 deg    the paper's value
ridge_radius          "within a radius of 2 m"       2 m       the paper's value
seed_confidence       1 - alpha: 98 %                0.98      the paper's value
seed_residual         none                           0 (off)   the test alone decides, as in the paper
thin_cell             m: "the resolution of the      1 m       the DTM's default resolution
                      final acquired DTM"
growth                p_min: 0.001                   0.001     the paper's value
rounds                none                           12        a bound for the halo: few runs need as many
label_floor           none                           0.3 m     `classic`'s; 0 is the paper's rule
robust_cells          none                           on        ours, for photogrammetric clouds like the paper's data:
                                                               `ptd.matched.robust_cells`; off: the paper's rule
====================  =============================  ========  =======================================================

Steps: seeds per cell (2.1); ridge points (2.1, equation 1, `ridges`); seed refinement (2.2, equations 2-10,
`conicoid`); densification (2.3, equations 11 and 12, `thinned_densification`).

Equation 11 ends the rounds when the terrain class grows by at most p_min of all points. Both
numbers belong to the run and are unknown in a tile. So a first pass runs all rounds and counts,
in each, the points of its tile's core that join the class. The sums over all tiles determine
the last round. The labels of the first pass say in which round a point became a vertex. A
vertex is replaced only by a lower one of its cell, and never returns, so these labels give the
second pass the TIN of the last round. No tile ends earlier than its neighbour. A tile with an
uncertified count is repeated with a wider halo. The remaining uncertified points are summed as
well. If they could change the last round, a note reports it.

Deviations:

- Seeds are judged against one TIN and dropped together, because judging one after the other
  depends on their order.
- Virtual seeds around the data (`ptd.ground.seeds`) neither make ridges nor take part in fits.
- Growth is the number of points that join the class. Points that leave it are not subtracted,
  because the facet test gets stricter next to new vertices: in the second round the class often
  shrinks while the TIN grows. The class is that of the last pass, with its floor.
- Low outliers are removed first; the paper does not mention them.
"""

from __future__ import annotations

from dataclasses import dataclass

from ptd.matched.robust_cells import for_both_kinds
from ptd.methods.ridge2016.params import Ridge2016Parameters
from ptd.methods.ridge2016.passes import GrowthPass, RidgePass, TerrainPass
from ptd.passes import Method, Pass


@dataclass(frozen=True)
class Ridge2016(Ridge2016Parameters):
    """Parameters of `ridge2016` (see the module's table), and the passes that follow from them."""

    @property
    def passes(self) -> tuple[Pass, ...]:
        """One pass, or two if the growth of the terrain decides on the number of rounds.

        The first of two passes counts.
        """
        method_passes: tuple[Pass, ...] = (RidgePass(self),)
        if self.growth:
            method_passes = (GrowthPass(self), TerrainPass(self))
        if self.robust_cells:
            return for_both_kinds(method_passes)
        return method_passes

    @property
    def halo_m(self) -> float:
        """Halo in metres: seven seed cells for ridges and seeds, and 30 m for the rounds.

        It was measured on the edge of a city.
        """
        return 7.0 * self.max_building_size_m + 30.0

    @property
    def candidate_cell_m(self) -> float:
        """0: every point is a candidate, which is the purpose of the paper's densification."""
        return 0.0


METHOD = Method(
    "ridge2016",
    "densification with ridge points and tested seeds, for steep mountains beside settlements",
    Ridge2016,
)
