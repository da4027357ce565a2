"""Source of a cloud, laser scanning or dense image matching, and the density, noise and cell size of its places.

Figures per place are ``places`` of the state; a place is a square of 256 m (`ptd.places`).

Cells of photogrammetric clouds have a size of 1 m, or of 2 m where points are sparse. A point
gets the same label as if the whole survey had cells of the size of its place. So cells of both
sizes are made where places of both kinds are near each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple, TypedDict

import numpy as np

from ptd.frame import Scale, Window
from ptd.ground import noise_sums, roughness
from ptd.ground.noise_sums import Roughness
from ptd.matched import penetration
from ptd.matched.cells import CELL_M, SPARSE_CELL_M, SPARSE_M2, cell_size_m
from ptd.matched.evidence import (
    DIM,
    SEVERAL_SHARE,
    SURE,
    Evidence,
    Finding,
    Piece,
    concluded,
    decided_by,
    percent,
)
from ptd.passes import Partial, Pass, Points, RunHints, State, StatisticsModel, add_notes
from ptd.places import PLACES, Figures, Table, name_of, place_of

DENSITY, SIGMA, CELL_SIGMA, CELL_SIZE, BOTH = range(5)
"""Indices of the figures of a place.

- `DENSITY`: points per square metre.
- `SIGMA`: noise of planar patches in metres, or None if unknown.
- `CELL_SIGMA`: noise in metres from which the rules for photogrammetric clouds start.
- `CELL_SIZE`: size of the cells in metres.
- `BOTH`: 1 if cells of the other size are needed, too, else 0.
"""
CELL_SIZES_M = (CELL_M, SPARSE_CELL_M)
"""Possible sizes of cells."""
SIZES_AROUND = 8
"""Number of places around a place in which cells of its size are needed. This distance covers
the summed radii of all passes on cells."""


def known(figures: Figures, figure: int) -> float:
    """Return a figure of a place as a number, for figures that are never None."""
    return float(figures[figure] or 0.0)


def cell_sizes(table: Table) -> tuple[float, ...]:
    """Return the sizes of cells that the places of a table need."""
    needed_sizes = {known(figures, CELL_SIZE) for figures in table.values()}
    both = any(figures[BOTH] for figures in table.values())
    return CELL_SIZES_M if both else tuple(sorted(needed_sizes))


def with_cell_sizes(table: Mapping[str, list[float | None]]) -> dict[str, list[float | None]]:
    """Return a table with `CELL_SIZE` and `BOTH` appended to the figures from which they follow."""
    size_by_name = {
        name: cell_size_m(known(figures, DENSITY)) for name, figures in table.items()
    }
    sparse = {
        place_of(name) for name, size_m in size_by_name.items() if size_m == SPARSE_CELL_M
    }
    fine = {place_of(name) for name, size_m in size_by_name.items() if size_m == CELL_M}
    both = fine & _around(sparse, len(fine)) | sparse & _around(fine, len(sparse))
    return {
        name: [*figures, size_by_name[name], float(place_of(name) in both)]
        for name, figures in table.items()
    }


def _around(places: set[tuple[int, int]], others: int) -> set[tuple[int, int]]:
    """Return all places within `SIZES_AROUND` of given places, or none if the number of other places is 0."""
    steps = range(-SIZES_AROUND, SIZES_AROUND + 1)
    if others == 0:
        return set()
    wide = {(column + step, row) for column, row in places for step in steps}
    return {(column, row + step) for column, row in wide for step in steps}


SEEN_THROUGH_SHARE = 0.004
"""Penetration is evidence for LiDAR if at least this share of the cells is seen through.

The share is 0.006 to 0.28 in real LiDAR clouds of 4 points/m2 or more (0.0002 in a simulated
one without trees). It is 0 to 0.003 in photogrammetric clouds, and largest at wooded cliffs.
"""
WIDE_M2, MIN_DENSITY_M2 = 4.0, 1.0
"""Densities in points per square metre: wide cells are used below the first and are reliable
from the second on."""
WIDE_SHARE, STANDING = 0.05, 100
"""In a sparse cloud, penetration is evidence for LiDAR if at least this share of the wide cells
is seen through. Missing penetration is evidence against it only if at least this many wide
cells have a gap.

The share is 0.054 to 0.33 in LiDAR clouds with plants, thinned to 1 to 3 points/m2, and 0 to
0.047 in photogrammetric clouds except wooded cliffs (0.06 to 0.12). Fewer gaps may come from
walls alone, without any plants to penetrate. Sparse LiDAR clouds of single returns are common,
so a lack of gaps is weak evidence for LiDAR.
"""
SPARSE_LASER_SIGMA_M, FLAT = 0.04, 10
"""Low noise is evidence for LiDAR in a sparse cloud: flat patches have at most this noise, and there are this many.

Thinned to 1 to 3 points/m2, LiDAR clouds without penetrated plants have 0.016 to 0.036 m,
photogrammetric clouds 0.044 to 0.17 m. Two clouds matched from close range have 0.016 and 0.027
m. For these two, the passes for LiDAR clouds are as accurate as those for photogrammetric
clouds.
"""
MATCHED_LOOK, SPARSE_LOOK = 1.9, -1.5
"""Weights (`ptd.matched.evidence`) of a cloud without penetrated plants, and of a cloud that is
too sparse, too bare or too smooth for missing penetration to be evidence."""
MIN_THROUGH, PER_DECADE = -1.0, -0.7
"""Weight of the smallest share of penetrated cells that decides, and additional weight per
factor of ten."""
EVEN_OVERHANG_SHARE, OVERHANG_WEIGHT, MAX_OVERHANG = 0.0966, 0.9, 0.95
"""Weights of overhangs.

Share of cells with overhangs, plus 0.01, at which the odds are even; weight per factor of e;
largest weight, which is less than those above. The share is 0 to 0.19 in photogrammetric
clouds, and 0.3 or more in two of three LiDAR clouds.
"""
MIN_CELL_SIGMA_M, MAX_CELL_SIGMA_M = 0.03, 0.25
"""Limits of the noise from which the rules for photogrammetric clouds start. Errors of
neighbours are alike, which residuals of planes do not show, and among trees no patch is
smooth."""


class ReturnStatistics(NamedTuple):
    """Counts of the points and cells of a run.

    Attributes
    ----------
    told, several : int
        Number of points whose number of returns is known, and number of these that are one of several returns.
    looks, through : int
        Number of cells with points, and of those that are seen through (`ptd.matched.penetration`).
    wide_looks, wide_through, wide_gaps : int
        Number of wide cells, of those that are seen through, and of those with a gap.
    overhang_looks, overhangs : int
        Number of cells about eight points wide, and of those with an overhang.
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


class Survey(TypedDict):
    """Figures of a whole run.

    ``kind`` is `LIDAR`, or `DIM` for image matching, and ``sure`` the probability that the kind is right (None if the
    user gives it). A ``sigma_m`` of None is unknown. ``cell_sigma_m`` is the noise from which the rules for
    photogrammetric clouds start, ``cell_m`` the size of their cells, and ``several`` the share of the points that are
    one of several returns. ``looks_like`` describes the other kind and its evidence if the points show it against the
    kind that the user gives, with a confidence of at least `SURE`; otherwise it is None.
    """

    kind: str
    sure: float | None
    looks_like: str | None
    density_m2: float
    sigma_m: float | None
    cell_sigma_m: float
    cell_m: float
    several: float


def surveyed(
    found: Roughness, seen: ReturnStatistics, run: Mapping[str, Any]
) -> tuple[Survey, str]:
    """Return the survey of a run, and a note on it.

    Parameters
    ----------
    found : Roughness
        Density and noise of the run.
    seen : ReturnStatistics
    run : mapping
        Fields of `ptd.passes.RunHints`.

    Returns
    -------
    survey : Survey
    note : str
    """
    finding = source_of(found, seen, run)
    share = seen.several / seen.told if seen.told else 0.0
    density, sigma, cell_sigma = figures(found, run)
    survey: Survey = {
        "kind": finding.kind, "sure": finding.sure, "looks_like": looks_like(found, seen, run),
        "density_m2": density, "sigma_m": sigma, "cell_sigma_m": cell_sigma,
        "cell_m": cell_size_m(density), "several": share,
    }  # fmt: skip
    noise = cell_sigma if finding.kind == DIM else sigma
    noise_text = "noise not measurable" if noise is None else f"noise {noise:.3g} m"
    return (
        survey,
        f"decided: {in_words(finding)}; {found.density_m2:.3g} points/m2, {noise_text}",
    )


def figures(found: Roughness, run: Mapping[str, Any]) -> tuple[float, float | None, float]:
    """Return density, noise and noise of cells of a run or a place.

    Both noises are that given by the user, or else the measured one. The noise of cells is also limited to
    `MIN_CELL_SIGMA_M` and `MAX_CELL_SIGMA_M`.
    """
    if run["sigma_m"] is not None:
        sigma = cell_sigma = run["sigma_m"]
    else:
        # The smoothest noise is measured on quarters of patches. In sparse clouds these contain
        # too few points for planes.
        few = found.density_m2 < SPARSE_M2 and found.sigma_m is not None
        sigma, cell_sigma = found.sigma_m, found.sigma_m if few else found.smoothest_m
    cell_sigma = MIN_CELL_SIGMA_M if cell_sigma is None else cell_sigma
    return found.density_m2, sigma, min(max(cell_sigma, MIN_CELL_SIGMA_M), MAX_CELL_SIGMA_M)


def run_facts(sigma_m: float | None, kind: str | None, evidence: Evidence | None) -> RunHints:
    """Return the facts known before the first pass.

    The kind is that given by the user, or else that decided by the evidence if it is
    sufficient. Insufficient evidence is kept for the survey, also to check the kind of the user.
    """
    finding = None if evidence is None else decided_by(evidence)
    if evidence is not None and finding is None:
        return RunHints(sigma_m, kind, evidence=asdict(evidence), checks_kind=kind is not None)
    if kind is not None or finding is None:
        return RunHints(sigma_m, kind)
    return RunHints(sigma_m, *finding)


def in_words(finding: Finding) -> str:
    """Describe the source of a cloud, its confidence and the evidence in words."""
    named = "image matching" if finding.kind == DIM else "laser scanning"
    sure = "" if finding.sure is None else f"{100 * finding.sure:.0f} % sure: "
    return f"{named} ({sure}{finding.why})"


def source_of(found: Roughness, seen: ReturnStatistics, run: Mapping[str, Any]) -> Finding:
    """Return the source of a run's clouds, given by the user or the files, or else decided by all evidence.

    `surveyed` describes the parameters.
    """
    if run.get("kind") is None:
        return by_all_evidence(found, seen, run)
    return Finding(
        run["kind"], run.get("sure"), run.get("why") or "given by --kind or the preset"
    )


def looks_like(found: Roughness, seen: ReturnStatistics, run: Mapping[str, Any]) -> str | None:
    """Describe the source that the points show against the kind given by the user, or return None.

    If the fields of the points decide, the plan knows it before the survey.
    """
    if not run.get("checks_kind"):
        return None
    finding = by_all_evidence(found, seen, run)
    is_other = finding.kind != run["kind"] and (finding.sure or 0.0) >= SURE
    return in_words(finding) if is_other else None


def by_all_evidence(
    found: Roughness, seen: ReturnStatistics, run: Mapping[str, Any]
) -> Finding:
    """Decide the source of a run's clouds by the fields of the points and by their positions."""
    evidence = Evidence(**(run.get("evidence") or {}))
    if seen.told:
        evidence = replace(evidence, several=seen.several / seen.told)
    return concluded([*evidence.pieces(), *geometry(found, seen)])


def geometry(found: Roughness, seen: ReturnStatistics) -> list[Piece]:
    """Return the evidence in the positions of the points: penetration of plants, noise and overhangs."""
    sparse = found.density_m2 < WIDE_M2
    through = seen.through / seen.looks if seen.looks else 0.0
    wide_through = seen.wide_through / seen.wide_looks if sparse and seen.wide_looks else 0.0
    pieces = []
    if through >= SEEN_THROUGH_SHARE or wide_through >= WIDE_SHARE:
        most = max(through, wide_through)
        weight = MIN_THROUGH + PER_DECADE * max(math.log10(most / SEEN_THROUGH_SHARE), 0.0)
        pieces.append(
            Piece(weight, f"pulses passed through plants in {percent(most)} % of the area")
        )
    elif found.density_m2 < MIN_DENSITY_M2:
        pieces.append(Piece(SPARSE_LOOK, f"fewer than {MIN_DENSITY_M2:g} points/m2"))
    elif sparse and seen.wide_gaps < STANDING:
        pieces.append(
            Piece(
                SPARSE_LOOK, "sparse, and there are too few plants or walls to show penetration"
            )
        )
    elif sparse and found.patches >= FLAT and (found.sigma_m or 1.0) <= SPARSE_LASER_SIGMA_M:
        pieces.append(
            Piece(
                SPARSE_LOOK, f"sparse, and flat patches scatter by only {found.sigma_m:.2g} m"
            )
        )
    else:
        pieces.append(Piece(MATCHED_LOOK, "no pulses passed through plants"))
    if seen.overhang_looks:
        share = seen.overhangs / seen.overhang_looks
        weight = OVERHANG_WEIGHT * math.log(EVEN_OVERHANG_SHARE / (share + 0.01))
        weight = min(max(weight, -MAX_OVERHANG), MAX_OVERHANG)
        pieces.append(Piece(weight, f"{percent(share)} % of the cells have overhangs"))
    return pieces


@dataclass(frozen=True)
class SurveyPass(Pass):
    """Pass that measures density, noise and returns, and decides the source of the cloud."""

    name: str = "survey"
    title = "measure density and noise"
    columns: tuple[str, ...] = ("returns",)
    every_point: bool = True
    gives_labels: bool = False
    influence_radius_m: float | None = max(roughness.REACH_M, penetration.REACH_M)

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> StatisticsModel:
        """Measure the places of the core, and count its returns and penetrated cells."""
        counts = dict.fromkeys(ReturnStatistics._fields, 0)
        if points.returns is not None:
            n_returns = (
                points.returns[1, core.contains(*points.xyz[:2])]
                if core.closed
                else points.returns[1]
            )
            counts |= {
                "told": int(np.count_nonzero(n_returns)),
                "several": int(np.count_nonzero(n_returns > 1)),
            }
        measured_places = roughness.measure_places(points.xyz, core, scale)
        returns_decide = not core.closed and counts["several"] >= SEVERAL_SHARE * max(
            counts["told"], 1
        )
        run = state["run"]
        needed = run.get("kind") is None or run.get("checks_kind")
        if needed and not returns_decide:
            dense = not core.closed and noise_sums.merge(measured_places).density_m2 >= WIDE_M2
            counts |= penetration.seen_through(points.xyz, core, scale, wide_cells=not dense)
        return StatisticsModel(
            {"places": measured_places, **counts},
            {"points": sum(place["points"] for place in measured_places)},
        )

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Add to the state ``survey`` (see `surveyed`) and ``places``, the figures of each place (`ptd.places`)."""
        parts = list(partials)
        seen = ReturnStatistics(
            *(sum(p[name] for p in parts) for name in ReturnStatistics._fields)
        )
        counted = [place for p in parts for place in p["places"]]
        measured = noise_sums.by_place(counted).items()
        table = with_cell_sizes(
            {
                name_of(*place): [*figures(place_roughness, state["run"])]
                for place, place_roughness in measured
            }
        )
        held = [
            table[name] for name in dict.fromkeys(name_of(*place["place"]) for place in counted)
        ]
        survey, notes = self.decided(noise_sums.merge(counted), seen, held, state["run"])
        return {**state, "survey": survey, PLACES: table, "notes": add_notes(state, *notes)}

    def decided(
        self,
        found: Roughness,
        seen: ReturnStatistics,
        held: Sequence[Figures],
        run: Mapping[str, Any],
    ) -> tuple[Survey, list[str]]:
        """Return the survey of the run and notes on it. ``held`` are the figures of the places that contain points."""
        survey, note = surveyed(found, seen, run)
        return survey, [note]
