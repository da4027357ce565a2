"""Texts about the check of clouds, for the command and for its page."""

from __future__ import annotations

from typing import Any

from tiler.apps.results import AcceptanceRow, AcceptanceSummary
from tiler.core.words import counted


def summary_text(summary: AcceptanceSummary) -> str:
    """Return numbers of clouds and points, the side of the cells, and the specification."""
    text = f"{counted(len(summary['clouds']), 'cloud')}, {counted(summary['points'], 'point')}"
    if summary["cell_m"] is not None:
        text += f", cells of {summary['cell_m']:.3g} m"
    if summary["specification"] is not None:
        text += f", specification {summary['specification']}"
    return text


def asked_text(row: AcceptanceRow) -> str:
    """Return what a row asks for: a limit or a list of values, or a dash."""
    if row["asked"] is None:
        return "-"
    text = value_text(row["asked"], row["unit"])
    return text if row["limit"] == "only" else f"{row['limit']} {text}"


def value_text(value: Any, unit: str) -> str:
    """Return a value of a row with its unit, or a dash if there is none."""
    if value is None:
        return "-"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    number = f"{value:,}" if isinstance(value, int) else f"{value:.4g}"
    if isinstance(value, float) and abs(value) >= 1000:
        number = f"{value:,.0f}"
    # Units of numbers are plural nouns.
    return f"{number} {unit[:-1] if value == 1 and unit.endswith('s') else unit}".rstrip()


def verdict_text(summary: AcceptanceSummary) -> str:
    """Return whether the specification is met, and which rows do not meet it."""
    asked = [row for row in summary["rows"] if row["state"] != "not asked"]
    bad = [row["name"].replace("_", " ") for row in asked if row["state"] != "pass"]
    if not bad:
        return f"met: all {counted(len(asked), 'row')} of {summary['specification']}"
    return f"NOT met: {len(bad)} of {counted(len(asked), 'row')} of {summary['specification']} ({', '.join(bad)})"
