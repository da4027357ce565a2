"""What made a cloud, a laser scanner or the matching of images, and its density and noise."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ptd.frame import Scale, Window
from ptd.ground import noise_by_place, noise_sums, roughness
from ptd.ground.noise_sums import Roughness
from ptd.matched import penetration
from ptd.matched.cells import SPARSE_M2, cell_side_m
from ptd.matched.evidence import DIM, SEVERAL_SHARE, Evidence, Finding, Piece, concluded, decided_by, percent
from ptd.matched.place_figures import with_sides
from ptd.passes import Pass, Points, RunHints, State, StatisticsModel, noted
from ptd.places import PLACES, Figures, name_of

SEEN_THROUGH_SHARE = 0.004
"""Share of cells that are seen through from which on the cloud is a laser scan, whatever its returns are said to be:
0.006 to 0.28 in real laser scans of 4 points/m2 or more (0.0002 in a simulated one without trees), 0 to 0.003 in
matched clouds, of which those of wooded cliffs have most."""
WIDE_M2, MIN_DENSITY_M2 = 4.0, 1.0
"""Points per square metre below which wide cells say what is seen through, too, and from which on they can."""
WIDE_SHARE, STANDING = 0.05, 100
"""The same for wide cells: 0.054 to 0.33 in laser scans with plants, thinned to 1 to 3 points/m2, 0 to 0.047 in matched
clouds but for wooded cliffs (0.06 to 0.12). So many wide cells must have a gap at all, as beside walls: sparse scans of
single returns are common, and where nothing stands nothing tells."""
SPARSE_LASER_SIGMA_M, FLAT = 0.04, 10
"""Noise of flat places up to which a sparse cloud is a laser's, and how many it must rest on. Thinned to 1 to 3
points/m2, laser scans with nothing to see through have 0.016 to 0.036 m, matched clouds 0.044 to 0.17 but for two from
near by (0.016 and 0.027), which lose no more in the way of laser scans than in their own."""
MATCHED_LOOK, SPARSE_LOOK = 1.9, -1.5
"""Weights (`ptd.matched.evidence`) of nothing that a laser would have seen, and of sparse clouds of little relief."""
MIN_THROUGH, PER_DECADE = -1.0, -0.7
"""Weight of as little that is seen through as decides, and more for each ten times as much."""
NO_OVERHANGS, OVERHANG_WEIGHT, MAX_OVERHANG = 0.0966, 0.9, 0.95
"""Overhangs (and 0.01) at which the odds are even, weight of e times as many, and the largest weight, which is less
than those above: 0 to 0.19 of the cells in matched clouds, 0.3 or more in two laser scans of three."""
MIN_CELL_SIGMA_M, MAX_CELL_SIGMA_M = 0.03, 0.25
"""Noise that the rules of matched clouds start from: errors of neighbours are alike, which planes do not see; and among
trees nothing is smooth."""


class ReturnStatistics(NamedTuple):
    """Counts of a run.

    Attributes
    ----------
    told, several : int
        Points whose number of returns is known, and those of them that are one of several.
    looks, through : int
        Cells with points; those that are seen through (`ptd.matched.penetration`).
    wide_looks, wide_through, wide_gaps : int
        Of wide cells; and those with a gap.
    overhang_looks, overhangs : int
        Cells of the points' own size; those with an overhang.
    """

    told: int
    several: int
    looks: int
    through: int
    wide_looks: int = 0
    wide_through: int = 0
    wide_gaps: int = 0
    overhang_looks: int = 0
    overhangs: int = 0


def surveyed(found: Roughness, seen: ReturnStatistics, run: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """What a run is, and a line that says so.

    Parameters
    ----------
    found : Roughness
        Density and noise.
    seen : ReturnStatistics
    run : mapping
        `ptd.passes.RunHints`.

    Returns
    -------
    survey : dict
        ``kind`` (`LIDAR`, `DIM`: image matching), ``sure`` (probability; None where the user says it), ``density_m2``,
        ``sigma_m`` (None: not known), ``cell_sigma_m`` (noise that the rules of matched clouds start from), ``cell_m``
        (side of the cells of matched clouds), ``several`` (share of points): of the whole run.
    note : str
    """
    made = made_by(found, seen, run)
    share = seen.several / seen.told if seen.told else 0.0
    density, sigma, cell_sigma = figures(found, run)
    survey = {
        "kind": made.kind, "sure": made.sure, "density_m2": density, "sigma_m": sigma,
        "cell_sigma_m": cell_sigma, "cell_m": cell_side_m(density), "several": share,
    }  # fmt: skip
    noise = cell_sigma if made.kind == DIM else sigma
    told = "noise not measurable" if noise is None else f"noise {noise:.3g} m"
    return survey, f"decided: {in_words(made)}; {found.density_m2:.3g} points/m2, {told}"


def figures(found: Roughness, run: Mapping[str, Any]) -> tuple[float, float | None, float]:
    """Density, noise and noise of cells of a run or a place; noise as the user says it, else as it was measured."""
    if run["sigma_m"] is not None:
        sigma = cell_sigma = run["sigma_m"]
    else:
        few = found.density_m2 < SPARSE_M2 and found.sigma_m is not None  # for planes of quarters of patches
        sigma, cell_sigma = found.sigma_m, found.sigma_m if few else found.smoothest_m
    cell_sigma = MIN_CELL_SIGMA_M if cell_sigma is None else cell_sigma
    return found.density_m2, sigma, min(max(cell_sigma, MIN_CELL_SIGMA_M), MAX_CELL_SIGMA_M)


def run_facts(sigma_m: float | None, kind: str | None, evidence: Evidence | None) -> RunHints:
    """What is known before the first pass: ``kind`` as the user says it, else as the evidence shows it, if it does."""
    if kind is not None or evidence is None:
        return RunHints(sigma_m, kind)
    made = decided_by(evidence)
    if made is None:
        return RunHints(sigma_m, evidence=asdict(evidence))
    return RunHints(sigma_m, *made)


def in_words(made: Finding) -> str:
    """What made a cloud, how sure that is, and why."""
    named = "image matching" if made.kind == DIM else "laser scanning"
    sure = "" if made.sure is None else f"{100 * made.sure:.0f} % sure: "
    return f"{named} ({sure}{made.why})"


def made_by(found: Roughness, seen: ReturnStatistics, run: Mapping[str, Any]) -> Finding:
    """What made a run's clouds: as the user or the files say, else by all evidence together.

    See `surveyed` for the parameters.
    """
    if run.get("kind") is not None:
        return Finding(run["kind"], run.get("sure"), run.get("why") or "as --kind or the preset says")
    told = Evidence(**(run.get("evidence") or {}))
    if seen.told:
        told = replace(told, several=seen.several / seen.told)
    return concluded([*told.pieces(), *geometry(found, seen)])


def geometry(found: Roughness, seen: ReturnStatistics) -> list[Piece]:
    """What the places of the points say about what made them: the look of the surface, and what hangs over it."""
    sparse = found.density_m2 < WIDE_M2
    through = seen.through / seen.looks if seen.looks else 0.0
    wide_through = seen.wide_through / seen.wide_looks if sparse and seen.wide_looks else 0.0
    pieces = []
    if through >= SEEN_THROUGH_SHARE or wide_through >= WIDE_SHARE:
        most = max(through, wide_through)
        weight = MIN_THROUGH + PER_DECADE * max(math.log10(most / SEEN_THROUGH_SHARE), 0.0)
        pieces.append(Piece(weight, f"pulses passed through plants in {percent(most)} % of the area"))
    elif found.density_m2 < MIN_DENSITY_M2:
        pieces.append(Piece(SPARSE_LOOK, f"fewer than {MIN_DENSITY_M2:g} points/m2"))
    elif sparse and seen.wide_gaps < STANDING:
        pieces.append(
            Piece(SPARSE_LOOK, "sparse, and next to nothing stands there that a laser would see through")
        )
    elif sparse and found.patches >= FLAT and (found.sigma_m or 1.0) <= SPARSE_LASER_SIGMA_M:
        pieces.append(Piece(SPARSE_LOOK, f"sparse, and flat places scatter by {found.sigma_m:.2g} m alone"))
    else:
        pieces.append(Piece(MATCHED_LOOK, "nothing is seen through plants"))
    if seen.overhang_looks:
        pieces.append(_overhangs(seen.overhangs / seen.overhang_looks))
    return pieces


def _overhangs(share: float) -> Piece:
    weight = OVERHANG_WEIGHT * math.log(NO_OVERHANGS / (share + 0.01))
    weight = min(max(weight, -MAX_OVERHANG), MAX_OVERHANG)
    return Piece(weight, f"{percent(share)} % of the cells have overhangs")


@dataclass(frozen=True)
class SurveyPass(Pass):
    """Density, noise and returns, and what made the cloud."""

    name: str = "survey"
    title = "measure density and noise"
    columns: tuple[str, ...] = ("returns",)
    every_point: bool = True
    gives_labels: bool = False
    reach_m: float | None = max(roughness.REACH_M, penetration.REACH_M)

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> StatisticsModel:
        """Count."""
        counts = dict.fromkeys(ReturnStatistics._fields, 0)
        if points.returns is not None:
            of = points.returns[1, core.has(*points.xyz[:2])] if core.closed else points.returns[1]
            counts |= {"told": int(np.count_nonzero(of)), "several": int(np.count_nonzero(of > 1))}
        found = noise_by_place.measure_places(points.xyz, core, scale)
        told = not core.closed and counts["several"] >= SEVERAL_SHARE * max(counts["told"], 1)
        if state["run"].get("kind") is None and not told:
            dense = not core.closed and noise_sums.merge(found).density_m2 >= WIDE_M2
            counts |= penetration.seen_through(points.xyz, core, scale, wide_cells=not dense)
        return StatisticsModel(
            {"places": found, **counts}, {"points": sum(place["points"] for place in found)}
        )

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        """``survey``, see `surveyed`; and ``places``, the figures of each place (`ptd.places`)."""
        parts = list(partials)
        seen = ReturnStatistics(*(sum(p[name] for p in parts) for name in ReturnStatistics._fields))
        counted = [place for p in parts for place in p["places"]]
        measured = noise_by_place.by_place(counted).items()
        table = with_sides({name_of(*place): [*figures(found, state["run"])] for place, found in measured})
        held = [table[name] for name in dict.fromkeys(name_of(*place["place"]) for place in counted)]
        survey, notes = self.decided(noise_sums.merge(counted), seen, held, state["run"])
        return {**state, "survey": survey, PLACES: table, "notes": noted(state, *notes)}

    def decided(
        self, found: Roughness, seen: ReturnStatistics, held: Sequence[Figures], run: Mapping[str, Any]
    ) -> tuple[dict[str, Any], list[str]]:
        """What the run is, and lines that say so; ``held``: figures of the places that hold points."""
        survey, note = surveyed(found, seen, run)
        return survey, [note]
