"""Parameters of `ridge2016`. Its table in `method.py` gives the reasons for their defaults."""

from __future__ import annotations

from dataclasses import dataclass

from ptd.matched.robust_cells import RobustCells
from ptd.methods.progressive import Progressive
from ptd.params import like, parameter


@dataclass(frozen=True)
class Ridge2016Parameters(Progressive):
    """Settings of `ridge2016`, to which `ptd.methods.ridge2016.method.Ridge2016` adds the passes."""

    max_building_size_m: float = parameter(
        20.0, "w: size of the cells whose lowest point is a seed", unit="m", minimum=5.0, maximum=1000.0,
        source="Ridge 2016, table 1",
    )  # fmt: skip
    edge_length_stop_m: float = parameter(
        1.0, "l: facets with shorter edges take no more vertices; 0: all do", unit="m", minimum=0.0,
        maximum=1000.0, source="Ridge 2016, table 1",
    )  # fmt: skip
    thin_cell_m: float = parameter(
        1.0, "m: only the lowest terrain point of a cell of this size stays in the TIN; about the DTM's resolution",
        unit="m", minimum=0.1, maximum=100.0, source="Ridge 2016, 2.3",
    )  # fmt: skip
    ridge_side: float = parameter(
        1.5, "m_r: a facet on a ridge has a side longer than this many cells, in x or in y", minimum=0.0,
        maximum=100.0, source="Ridge 2016, 2.1",
    )  # fmt: skip
    ridge_angle_deg: float = parameter(
        25.0, "theta_r: smallest angle at which facets fall away from it on two sides", unit="deg",
        minimum=0.0,
        maximum=90.0, source="Ridge 2016, 2.1",
    )  # fmt: skip
    ridge_radius_m: float = parameter(
        2.0, "radius around the centre of such a facet within which the lowest point becomes a seed", unit="m",
        minimum=0.1, maximum=5.0,
        source="Ridge 2016, 2.1",
    )  # fmt: skip
    seed_confidence: float = parameter(
        0.98, "1 - alpha: seeds whose residual from a conicoid through their neighbours is less probable than alpha "
        "are dropped; 1: none", minimum=0.5, maximum=1.0, source="Ridge 2016, 2.2",
    )  # fmt: skip
    seed_residual_m: float = parameter(
        0.0, "seeds with a smaller residual are always kept", 0.0, 100.0, "m"
    )
    growth: float = parameter(
        0.001, "p_min: rounds end when the terrain grows by at most this share of the run's points; 0: never",
        minimum=0.0, maximum=1.0, source="Ridge 2016, equation 11",
    )  # fmt: skip
    rounds: int = parameter(12, "largest number of rounds of densification", 1, 100)
    robust_cells: bool = like(RobustCells, "robust_cells")
