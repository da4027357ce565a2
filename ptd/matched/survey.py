"""What made a cloud, a laser scanner or the matching of images, and its density and noise."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ptd.frame import Scale, Window
from ptd.ground import roughness
from ptd.ground.roughness import Roughness
from ptd.matched import penetration
from ptd.matched.cells import SPARSE_M2
from ptd.passes import Measured, Pass, Points, State, noted

LIDAR, DIM = "lidar", "dim"
SEVERAL_SHARE = 0.001
"""Share of points that are one of several returns from which on the cloud is a laser scan."""
SEEN_THROUGH_SHARE = 0.004
"""Share of cells that are seen through from which on the cloud is a laser scan, whatever its returns are said to be:
0.006 to 0.28 in real laser scans of 4 points/m2 or more (0.0002 in a simulated one without trees), 0 to 0.003 in
matched clouds, of which those of wooded cliffs have most."""
WIDE_M2, LEAST_M2 = 4.0, 1.0
"""Points per square metre below which wide cells say what is seen through, too, and from which on they can."""
WIDE_SHARE, STANDING = 0.05, 100
"""The same for wide cells: 0.054 to 0.33 in laser scans with plants, thinned to 1 to 3 points/m2, 0 to 0.047 in matched
clouds but for wooded cliffs (0.06 to 0.12). So many wide cells must have a gap at all, as beside walls: sparse scans of
single returns are common, and where nothing stands nothing tells."""
SPARSE_LASER_SIGMA_M, FLAT = 0.04, 10
"""Noise of flat places up to which a sparse cloud is a laser's, and how many it must rest on. Thinned to 1 to 3
points/m2, laser scans with nothing to see through have 0.016 to 0.036 m, matched clouds 0.044 to 0.17 but for two from
near by (0.016 and 0.027), which lose no more in the way of laser scans than in their own."""
LEAST_CELL_SIGMA_M, MOST_CELL_SIGMA_M = 0.03, 0.25
"""Noise that the rules of matched clouds start from: errors of neighbours are alike, which planes do not see; and among
trees nothing is smooth."""


class Seen(NamedTuple):
    """Counts of a run.

    Attributes
    ----------
    told, several : int
        Points of which the number of returns is known; those that are one of several.
    looks, through : int
        Cells with points; those that are seen through (`ptd.matched.penetration`).
    wide_looks, wide_through, wide_gaps : int
        Of wide cells; and those with a gap.
    """

    told: int
    several: int
    looks: int
    through: int
    wide_looks: int = 0
    wide_through: int = 0
    wide_gaps: int = 0


def surveyed(found: Roughness, seen: Seen, run: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """What a run is, and a line that says so.

    Parameters
    ----------
    found : Roughness
        Density and noise.
    seen : Seen
    run : mapping
        `ptd.passes.RunFacts`.

    Returns
    -------
    survey : dict
        ``kind`` (`LIDAR`, `DIM`: image matching, which has single returns alone and does not see through plants),
        ``density_m2``, ``sigma_m`` (None: not known), ``cell_sigma_m`` (noise that the rules of matched clouds start
        from), ``several`` (share of points).
    note : str
    """
    share = seen.several / seen.told if seen.told else 0.0
    sparse = found.density_m2 < WIDE_M2
    through = seen.through / seen.looks if seen.looks else 0.0
    wide_through = seen.wide_through / seen.wide_looks if sparse and seen.wide_looks else 0.0
    if run.get("kind") is not None:
        kind, why = run["kind"], "as --kind or the preset says"
    elif _returns_tell(seen.several, seen.told):
        kind, why = LIDAR, f"{_percent(share)} % of the points are one of several returns"
    elif through >= SEEN_THROUGH_SHARE or wide_through >= WIDE_SHARE:
        kind, most = LIDAR, max(through, wide_through)
        why = f"pulses passed through plants in {_percent(most)} % of the area, though each point is a single return"
    elif found.density_m2 < LEAST_M2:
        kind, why = LIDAR, f"fewer than {LEAST_M2:g} points/m2, and no returns that say more"
    elif sparse and seen.wide_gaps < STANDING:
        kind, why = LIDAR, "sparse, and next to nothing stands there that a laser would see through"
    elif sparse and found.patches >= FLAT and (found.sigma_m or 1.0) <= SPARSE_LASER_SIGMA_M:
        kind, why = LIDAR, f"sparse, and flat places scatter by {found.sigma_m:.2g} m alone"
    else:
        kind, why = DIM, "no point is one of several returns, and nothing is seen through plants"
    given = run["sigma_m"]
    sigma = found.sigma_m if given is None else given
    few = found.density_m2 < SPARSE_M2 and found.sigma_m is not None  # for planes of quarters of patches
    smoothest = found.sigma_m if few else found.smoothest_m
    cell_sigma = smoothest if given is None else given
    cell_sigma = LEAST_CELL_SIGMA_M if cell_sigma is None else cell_sigma
    cell_sigma = min(max(cell_sigma, LEAST_CELL_SIGMA_M), MOST_CELL_SIGMA_M)
    survey = {
        "kind": kind, "density_m2": found.density_m2, "sigma_m": sigma, "cell_sigma_m": cell_sigma, "several": share,
    }  # fmt: skip
    noise = cell_sigma if kind == DIM else sigma
    told = "noise not measurable" if noise is None else f"noise {noise:.3g} m"
    named = "image matching" if kind == DIM else "laser scanning"
    return survey, f"decided: {named} ({why}); {found.density_m2:.3g} points/m2, {told}"


def _returns_tell(several: int, told: int) -> bool:
    """Whether returns alone say that a run is a laser scan."""
    return told > 0 and several / told >= SEVERAL_SHARE


def _percent(share: float) -> str:
    """In two digits, without an exponent."""
    return f"{float(f'{100 * share:.2g}'):g}"


@dataclass(frozen=True)
class SurveyPass(Pass):
    """Density, noise and returns, and what made the cloud."""

    name: str = "survey"
    title = "measure density and noise"
    columns: tuple[str, ...] = ("returns",)
    every_point: bool = True
    gives_labels: bool = False
    reach_m: float | None = max(roughness.REACH_M, penetration.REACH_M)

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Measured:
        """Count."""
        counts = dict.fromkeys(Seen._fields, 0)
        if points.returns is not None:
            of = points.returns[1, core.has(*points.xyz[:2])] if core.closed else points.returns[1]
            counts |= {"told": int(np.count_nonzero(of)), "several": int(np.count_nonzero(of > 1))}
        found = roughness.measure(points.xyz, window, core, scale)
        told = not core.closed and _returns_tell(counts["several"], counts["told"])
        if state["run"].get("kind") is None and not told:
            dense = not core.closed and roughness.merge([found]).density_m2 >= WIDE_M2
            counts |= penetration.seen_through(points.xyz, core, scale, wide_cells=not dense)
        found |= counts
        return Measured(found, {"points": found["points"]})

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """``survey``: see `surveyed`."""
        parts = list(partials)
        seen = Seen(*(sum(p[name] for p in parts) for name in Seen._fields))
        survey, notes = self.decided(roughness.merge(parts), seen, state["run"])
        return {**state, "survey": survey, "notes": noted(state, *notes)}

    def decided(
        self, found: Roughness, seen: Seen, run: Mapping[str, Any]
    ) -> tuple[dict[str, Any], list[str]]:
        """What the run is, and lines that say so."""
        survey, note = surveyed(found, seen, run)
        return survey, [note]
