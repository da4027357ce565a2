"""Parameters of `dong2017`. Its table in `method.py` gives the reasons for their defaults."""

from __future__ import annotations

from dataclasses import dataclass

from ptd.matched.robust_cells import RobustCells
from ptd.params import check, like, parameter


@dataclass(frozen=True)
class Dong2017Parameters:
    """Settings of `dong2017`, to which `ptd.methods.dong2017.method.Dong2017` adds the passes."""

    facade_cell_m: float = parameter(
        1.0, "size of the cells in which projected points are counted", unit="m", minimum=0.25, maximum=10.0,
        source="Dong 2017, 3.3.2: GRIDESIZE",
    )  # fmt: skip
    facade_height_m: float = parameter(
        3.0,
        "height of the lowest building; lower steps are not facades",
        unit="m",
        minimum=0.5,
        maximum=100.0,
        source="Dong 2017, 3.3.2: H",
    )
    glass_factor: float = parameter(
        0.5,
        "share of a facade that image matching can see; the rest is glass",
        0.01,
        1.0,
        source="Dong 2017, 3.3.2",
    )
    seed_distance_m: float = parameter(
        4.0, "distance of a seed from the facade", 1.0, 30.0, "m", source="Dong 2017, 3.1: d"
    )
    seed_variation: float = parameter(
        2.0,
        "largest noise around a seed, in multiples of sigma",
        0.5,
        10.0,
        source="Dong 2017, 3.1: 2 sigma",
    )
    podium_radius_m: float = parameter(
        15.0, "a seed is dropped if a much lower one lies within this distance", unit="m", minimum=1.0,
        maximum=100.0, source="Dong 2017, 3.1: neighbourhood of a seed",
    )  # fmt: skip
    terrain_slope: float = parameter(
        0.3, "steepest slope between two seeds that are both ground", minimum=0.0, maximum=5.0,
        source="Dong 2017, equation 1: 0.3",
    )  # fmt: skip
    seed_cell_m: float = parameter(
        15.0, "one seed, the lowest, per cell of this size", 2.0, 200.0, "m"
    )
    first_spacing_m: float = parameter(
        4.0, "size of the cells of the first TIN of ground, halved until the last", unit="m", minimum=0.5,
        maximum=50.0, source="Dong 2017, table 4: 4 m",
    )  # fmt: skip
    last_spacing_m: float = parameter(
        1.0,
        "size of the cells of the last TIN of ground",
        0.25,
        50.0,
        "m",
        source="Dong 2017, table 4: 2 m",
    )
    tins: int = parameter(
        8,
        "number of TINs of each density; ground grows by two cells with each",
        minimum=1,
        maximum=20,
        source="Dong 2017, 3.2: several TINs",
    )
    contour_level: float = parameter(
        0.01, "height of the contour that gives the thresholds, in parts of the histogram's peak", minimum=0.0001,
        maximum=0.9, source="Dong 2017, 3.3.4",
    )  # fmt: skip
    robust_cells: bool = like(RobustCells, "robust_cells")

    def __post_init__(self) -> None:
        check(self)
        if self.last_spacing_m > self.first_spacing_m:
            raise ValueError(
                f"last_spacing_m {self.last_spacing_m:g}: use at most first_spacing_m, {self.first_spacing_m:g} m"
            )

    @property
    def spacings_m(self) -> tuple[float, ...]:
        """Sizes of the cells of the TINs of ground, halved from the first down to the last."""
        spacings_m = [self.first_spacing_m]
        while spacings_m[-1] > self.last_spacing_m:
            spacings_m.append(max(spacings_m[-1] / 2, self.last_spacing_m))
        return tuple(spacings_m)
