"""A table of places that are all alike."""

from __future__ import annotations

from ptd.matched.survey import with_cell_sizes
from ptd.places import name_of


def alike(
    density_m2: float = 20.0, sigma_m: float | None = None, cell_sigma_m: float = 0.05
) -> dict[str, list[float | None]]:
    """Figures of the places around coordinate 0."""
    figures = [density_m2, sigma_m, cell_sigma_m]
    return with_cell_sizes({name_of(c, r): figures for r in range(-3, 4) for c in range(-3, 4)})
