"""Part of the report about standard errors: the expected RMSE of the terrain, and a histogram of the errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tiler.core.sigma_groups import COVERED, GROUPS, OPEN, WET
from tiler.core.units_text import short_unit
from tiler.report.document import Content, Node, el, table
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
BAR_WIDTH, BAR_HEIGHT = 300, 10


def expected(run: Run) -> list[Content]:
    """Return a table and a histogram, or an empty list if the run made no standard errors."""
    sigma = run.get("sigma")
    if not sigma:
        return []
    unit_m = float(run["plan"].get("metres_per_unit", {}).get("vertical", 1.0))
    unit = short_unit(unit_m)
    pixels = max(sum(sigma[name]["pixels"] for name in GROUPS), 1)
    rows = [
        (
            NAMES[name],
            f"{sigma[name]['pixels'] / pixels:.1%}",
            f"{sigma[name]['rmse_m'] / unit_m:.3f}",
        )
        for name in GROUPS
        if sigma[name]["pixels"]
    ]
    basis = CALIBRATED.get(sigma["kind"] or "", UNKNOWN)
    text = (
        f"Estimated without checkpoints, with constants fitted to {basis}. For scenes that were left out of the fit, "
        "the actual RMSE was within a factor of 2 in four of five LiDAR clouds and nine of ten photogrammetric clouds. "
        "The estimate does not include errors that all strips share. It can be too small where a smooth surface is "
        "wrong, such as a roof classified as ground."
    )
    return [
        el("h3", f"Expected RMSE of this terrain, {unit}"),
        table(("ground", "share of the pixels", "expected RMSE"), rows, (1, 2)),
        el("p", text),
        table((f"standard error, {unit}", "pixels", ""), _histogram(sigma, unit_m), (1,)),
    ]


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
        rows.append((text, f"{counts[i]:,}", _bar(counts[i] / most)))
    return rows


def _bar(share: float) -> Node:
    width = max(round(BAR_WIDTH * share), 1)
    bar = el("rect", width=width, height=BAR_HEIGHT, fill="#3b528b")
    return el("svg", bar, width=BAR_WIDTH, height=BAR_HEIGHT, aria_hidden="true")
