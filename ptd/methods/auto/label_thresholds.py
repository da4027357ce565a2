"""Thresholds of the last pass of `auto`: distances from the surface up to which points are ground.

They follow from the density of the place. The module also decides the source of the cloud.
Notes report the decisions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ptd.frame import Scale
from ptd.ground.labelling import Bands
from ptd.ground.noise_sums import Roughness
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
from ptd.methods.auto.params import AutoParameters
from ptd.passes import State
from ptd.places import PLACES, Figures, field, span

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
