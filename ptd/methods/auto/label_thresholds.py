"""How far from the surface the last pass of `auto` takes points for ground, as the survey of a run decides it.

Also whether the cloud is of a laser or matched; what was decided is told in notes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ptd.ground.roughness import Roughness
from ptd.matched.passes import GROUND_M
from ptd.matched.survey import DIM, Seen, surveyed
from ptd.methods.auto.params import AutoParameters

SPARSE_M2, DENSE_M2 = 1.0, 2.0
"""Points per square metre up to which the last pass is as the parameters say, and from which it is as narrow as noise
allows."""
DENSE_FLOOR_M = 0.12
"""Floor of the last pass for dense clouds: four times the noise of airborne lasers. A wider one, from what is measured,
takes low plants for noise: meadows and fields look planar too."""
SAID_BASE_M, SAID_SIGMAS = 0.05, 3.0
"""Where the user says the noise the floor is this and so many times the noise, and no less than for others."""
DENSE_SLOPE = 0.5
"""Share of ``label_slope_m`` for dense clouds."""


@dataclass(frozen=True)
class LabelThresholds:
    """What the parameters come to in a run."""

    label_floor_m: float
    label_slope_m: float


def label_thresholds(params: AutoParameters, survey: Mapping[str, Any]) -> LabelThresholds:
    """Thresholds for a run, from what `decided` says of it."""
    said = survey["label_sigma_m"]
    dense = min(max((survey["density_m2"] - SPARSE_M2) / (DENSE_M2 - SPARSE_M2), 0.0), 1.0)
    floor = DENSE_FLOOR_M if said is None else max(DENSE_FLOOR_M, SAID_BASE_M + SAID_SIGMAS * said)
    floor = min(floor, params.label_floor_m)
    return LabelThresholds(
        label_floor_m=params.label_floor_m + dense * (floor - params.label_floor_m),
        label_slope_m=params.label_slope_m * (1.0 - dense * (1.0 - DENSE_SLOPE)),
    )


def decided(
    params: AutoParameters, found: Roughness, seen: Seen, run: Mapping[str, Any]
) -> tuple[dict[str, Any], list[str]]:
    """What the run is, and lines that say so.

    Parameters
    ----------
    params : AutoParameters
    found : Roughness
        Density and noise.
    seen : Seen
    run : mapping
        `ptd.passes.RunFacts`.

    Returns
    -------
    survey : dict
        See `ptd.matched.survey.surveyed`; and ``label_sigma_m``: the noise that the last pass of a laser scan allows
        for, which is what the user says, or None.
    notes : list of str
    """
    survey, note = surveyed(found, seen, run)
    survey["label_sigma_m"] = run["sigma_m"]
    notes = [note]
    if survey["kind"] == DIM:
        notes.append(
            f"decided: ground is up to {GROUND_M:g} m and twice the local noise from the surface, "
            "after a vote of neighbours"
        )
        return survey, notes
    chosen = label_thresholds(params, survey)
    notes.append(
        f"decided: ground is up to {chosen.label_floor_m:.2f} m + {chosen.label_slope_m:.2g} m x slope from the surface"
    )
    return survey, notes
