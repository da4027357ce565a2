"""Parameters of `dong2018`. Its table in `method.py` gives the reasons for their defaults."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ptd.matched.robust_cells import RobustCells
from ptd.methods.classic import Classic
from ptd.methods.progressive import Progressive
from ptd.params import like, parameter


@dataclass(frozen=True)
class Dong2018Parameters(Progressive):
    """Settings of `dong2018`, to which `ptd.methods.dong2018.method.Dong2018` adds the passes."""

    edge_length_reduce_m: float = parameter(
        0.0, "L1: the iteration angle shrinks on facets with shorter edges; 0: never", unit="m", minimum=0.0,
        maximum=1000.0, source="Dong 2018, 2.3",
    )  # fmt: skip
    thin_cell_m: float = parameter(
        0.0, "stage one: only the lowest point of a cell of this size can become a vertex; 0: as DEN_thr requires",
        unit="m", minimum=0.0, maximum=100.0,
    )  # fmt: skip
    rounds: int = parameter(8, "rounds of stage one; 0: until no point passes", 0, 1000)
    density_k: float = parameter(
        0.2, "k: density coefficient of DEN_thr, the density of the TIN from which noise decides", minimum=0.001,
        maximum=1000.0, source="Dong 2018, eq. 3",
    )  # fmt: skip
    first_scale_m: float = parameter(
        4.0, "stage two: largest cells, each gives one vertex; halved from scale to scale", unit="m",
        minimum=1.0, maximum=64.0, source="Dong 2018, 2.5.3",
    )  # fmt: skip
    last_scale_m: float = parameter(
        1.0, "s_thr: smallest cells", 0.25, 1.0, "m", source="Dong 2018, 2.5.3"
    )
    min_joined: int = parameter(
        2000,
        "n: stage two ends when fewer points of the run join",
        0,
        10**9,
        source="Dong 2018, 2.5.3",
    )
    contour_share: float = parameter(
        0.01, "level of the outer contour as a share of the histogram's fullest bin", minimum=0.0001, maximum=0.9,
        source="Dong 2018, figure 5",
    )  # fmt: skip
    pit_sigmas: float = parameter(
        6.0, "stage one: points in pits narrower than 3 m and at least this many sigma deep cannot become vertices",
        minimum=1.0,
        maximum=1000.0,
    )  # fmt: skip
    robust_cells: bool = like(RobustCells, "robust_cells")

    @property
    def scales_m(self) -> tuple[float, ...]:
        """Sizes of the cells of stage two, beginning with the largest."""
        n = int(math.log2(self.first_scale_m / self.last_scale_m) + 1e-9)
        return tuple(self.first_scale_m / 2**k for k in range(n + 1))

    def classic(self) -> Classic:
        """`classic` with the same parameters."""
        shared = {
            field.name: getattr(self, field.name)
            for field in fields(Classic)
            if hasattr(self, field.name)
        }
        return Classic(**{**shared, "thin_cell_m": self.thin_cell_m or 1.0})

    def threshold_m2(self, sigma_m: float) -> float:
        """DEN_thr of equation 3: points per square metre of the TIN above which noise decides."""
        return (
            self.density_k
            * math.tan(math.radians(self.iteration_angle_deg)) ** 2
            / (3 * math.sqrt(3) * sigma_m**2)
        )
