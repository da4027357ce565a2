"""Part of the report about standard errors: a rule of thumb for the RMSE of the terrain, and a histogram."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from tiler.core.sigma_groups import COVERED, GROUPS, OPEN, WET
from tiler.core.units_text import short_unit
from tiler.core.words import counted
from tiler.report.document import Content, bar, el, table
from tiler.report.pictures import open_raster
from tiler.report.problems import Run

CALIBRATED = {
    "lidar": "27 LiDAR clouds whose terrain is known, 14 simulated and 13 real ones with classified ground",
    "dim": "21 photogrammetric clouds whose terrain is known, 14 simulated and 7 made from real surfaces",
}
"""Scenes to which the constants of each kind of cloud were fitted."""
UNKNOWN = "both LiDAR and photogrammetric clouds (the larger error counts, because the kind of this cloud is unknown)"
NAMES = {
    OPEN: "open ground",
    COVERED: "covered ground: half of the nearby points are objects, or the terrain is bridged or filled",
    WET: "water",
}
BAR_WIDTH = 300
FEW = 20
"""Number of checkpoints below which their scale is uncertain by more than a sixth."""


class AtCheckpoints(NamedTuple):
    """RMSE at checkpoints, measured and by the rule of thumb, in units of the heights. ``expected`` may be unknown."""

    points: int
    measured: float
    expected: float | None


def at_checkpoints(
    check: Mapping[str, Any], rasters: Mapping[str, str]
) -> AtCheckpoints | None:
    """Return the RMSE at the checkpoints of check.json, or None if it has none on this terrain.

    Parameters
    ----------
    check : mapping
        Result of `read_measured`.
    rasters : mapping of str to str
        Path or URL of each raster by product. The rule of thumb is known where ``sigma`` has values.
    """
    accuracy = {} if check.get("older") else check.get("accuracy") or {}
    measured = [p for p in accuracy.get("differences", ()) if p["difference"] is not None]
    if not measured:
        return None
    both = []
    if "sigma" in rasters:
        with open_raster(rasters["sigma"]) as raster:
            sampled = raster.sample([(p["x"], p["y"]) for p in measured], masked=True)
            values = [None if v.mask.any() else float(v[0]) for v in sampled]
        both = [
            (p["difference"], v)
            for p, v in zip(measured, values, strict=True)
            if v is not None and 0 < v < math.inf
        ]
    if not both:
        return AtCheckpoints(
            len(measured), _root_mean_square([p["difference"] for p in measured]), None
        )
    differences, errors = zip(*both, strict=True)
    return AtCheckpoints(len(both), _root_mean_square(differences), _root_mean_square(errors))


def _root_mean_square(values: Sequence[float]) -> float:
    return math.sqrt(sum(v * v for v in values) / len(values))


def expected(run: Run, checked: AtCheckpoints | None = None) -> list[Content]:
    """Return a table and a histogram, or an empty list if the run made no standard errors.

    With checkpoints, the rule of thumb is also given multiplied by the ratio of their RMSE to it.
    """
    sigma = run.get("sigma")
    if not sigma:
        return []
    unit_m = float(run["plan"].get("metres_per_unit", {}).get("vertical", 1.0))
    unit = short_unit(unit_m)
    pixels = max(sum(sigma[name]["pixels"] for name in GROUPS), 1)
    ratio = checked.measured / checked.expected if checked and checked.expected else None
    rows = [
        (
            NAMES[name],
            f"{sigma[name]['pixels'] / pixels:.1%}",
            f"{sigma[name]['rmse_m'] / unit_m:.3f}",
            *(() if ratio is None else (f"{ratio * sigma[name]['rmse_m'] / unit_m:.3f}",)),
        )
        for name in GROUPS
        if sigma[name]["pixels"]
    ]
    scaled = () if ratio is None else ("scaled by checkpoints",)
    basis = CALIBRATED.get(sigma["kind"] or "", UNKNOWN)
    text = (
        "A rule of thumb, not a measurement: it is estimated without checkpoints, with constants fitted to "
        f"{basis}. For scenes that were left out of the fit, "
        "the actual RMSE was within a factor of 2 in four of five LiDAR clouds and nine of ten photogrammetric clouds. "
        "The estimate does not include errors that all strips share. It can be too small where a smooth surface is "
        "wrong, such as a roof classified as ground."
    )
    return [
        el("h3", f"Rule of thumb for the RMSE of this terrain, {unit}"),
        table(("ground", "share of the pixels", "rule of thumb", *scaled), rows, (1, 2, 3)),
        *([] if checked is None else [el("p", _checked_text(checked, ratio, unit))]),
        el("p", text),
        table((f"standard error, {unit}", "pixels", ""), _histogram(sigma, unit_m), (1,)),
    ]


def _checked_text(checked: AtCheckpoints, ratio: float | None, unit: str) -> str:
    at = f"At {counted(checked.points, 'checkpoint')} the measured RMSE is {checked.measured:.3f} {unit}"
    if ratio is None:
        return f"{at}. The rule of thumb is not known there, so it is not scaled."
    few = " The ratio of so few checkpoints is uncertain." if checked.points < FEW else ""
    return (
        f"{at}, and the rule of thumb gives {checked.expected:.3f} {unit}: the last column is the rule of thumb "
        f"times {ratio:.2f}.{few} Checkpoints on open ground say little about covered ground."
    )


def _histogram(found: Mapping[str, Any], unit_m: float) -> list[tuple[Content, ...]]:
    """Return a row with a bar for each class of standard errors, without empty classes at either end."""
    counts = [
        sum(both) for both in zip(*(found[name]["histogram"] for name in GROUPS), strict=True)
    ]
    there = [i for i, n in enumerate(counts) if n]
    if not there:
        return []
    edges, most = found["edges_m"], max(counts)
    rows: list[tuple[Content, ...]] = []
    for i in range(there[0], there[-1] + 1):
        text = f"{edges[i] / unit_m:.2f} to {edges[i + 1] / unit_m:.2f}"
        if i == len(counts) - 1:
            text = f"{edges[i] / unit_m:.2f} and more"
        rows.append((text, f"{counts[i]:,}", bar(counts[i] / most, BAR_WIDTH)))
    return rows
