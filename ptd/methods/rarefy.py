"""``rarefy``: thin the cloud, densify progressively, and label points near the DTM as ground.

This is the practice that Dong et al. (2018) argue against (paper 000, section 1). It is kept
for comparison. Others "rarefied the point clouds", "used the PTD algorithm to obtain the ground
points and construct the digital terrain model", and labelled points below a height threshold as
ground. Dong et al. say that thinning loses terrain features, and that the threshold is hard to
choose. The method is composed of the parts of `classic`.

===================  ==============================  =======  ====================================================
parameter            paper's name and value          default  reason
===================  ==============================  =======  ====================================================
thin_cell            rarefied to the density of      1 m      one point per m2, as in sparse laser scanning
                     its laser scan; no value
label_floor          a given threshold, no value     0.5 m    above the noise of image matching (three to five times
                                                              0.1 m), below most objects
max_building_size,   those of PTD: grid 30, terrain  as       the TIN is that of `classic`
angles, distances    angle 88, angle 6, distance     classic
                     1.4 or 0.8
===================  ==============================  =======  ====================================================

Thinning keeps the lowest point of a cell (the paper does not say which). The DTM is the TIN of
the ground found. The vertical distance to the DTM counts, above and below. Without
``label_pass`` the last step is omitted.
"""

from __future__ import annotations

from dataclasses import dataclass

from ptd.methods.classic import Classic, ClassicPass
from ptd.params import parameter
from ptd.passes import Method, Pass


@dataclass(frozen=True)
class Rarefy(Classic):
    """Parameters of `rarefy` (see the module's table), and the pass that follows from them."""

    label_floor_m: float = parameter(
        0.5,
        "largest height of ground above or below the DTM",
        unit="m",
        minimum=0.0,
        maximum=10.0,
        source="Dong 2018, 1",
    )

    heights_only = True

    @property
    def passes(self) -> tuple[Pass, ...]:
        """The TIN of `classic` on the thinned cloud, with another label rule."""
        return (ClassicPass(self, "rarefy", "thin, densify, label all points"),)


METHOD = Method(
    "rarefy",
    "thinning, classic's TIN, then a height above it; for comparison (Dong 2018, section 1)",
    Rarefy,
)
