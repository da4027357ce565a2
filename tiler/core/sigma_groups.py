"""Groups of ground and classes of the standard error in run.json and the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import sqrt
from typing import Any

OPEN, COVERED, WET = "open", "covered", "water"
GROUPS = (OPEN, COVERED, WET)
COVERED_SHARE = 0.5
"""Minimum share of objects among the points around covered ground. Filled pixels and canopy are covered, too."""
EDGES_M = (0.0, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0)
"""Edges of the classes of the standard error, in metres."""


def sigma_facts(kind: str | None, records: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the summary of the standard error for run.json, from the records of its blocks.

    Returns
    -------
    dict
        ``kind``: kind of cloud whose constants were used, or None for the larger of both. ``edges_m``: `EDGES_M`. For
        each of `GROUPS` a dict of ``pixels``, ``rmse_m`` (expected RMSE, None without pixels) and ``histogram``
        (pixels by `EDGES_M`).
    """
    summary: dict[str, Any] = {"kind": kind, "edges_m": list(EDGES_M)}
    made = list(records)
    for name in GROUPS:
        pixels, squares, histogram = 0, 0, [0] * (len(EDGES_M) - 1)
        for record in made:
            if name not in record["groups"]:
                continue
            n, sum_mm2 = record["groups"][name]
            pixels, squares = pixels + n, squares + sum_mm2
            histogram = [a + b for a, b in zip(histogram, record["histogram"][name], strict=True)]
        rmse_m = None
        if pixels:
            rmse_m = round(sqrt(squares / pixels) / 1000, 4)
        summary[name] = {"pixels": pixels, "rmse_m": rmse_m, "histogram": histogram}
    return summary
