"""Texts about the check of clouds, and its page: rows with what was asked and found, pairs of swaths, clouds, notes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tiler.apps.results import AcceptanceRow, AcceptanceSummary, SwathPair
from tiler.core.words import counted, listed
from tiler.report.document import Node, el, more, page, section, table

MAKER = "tiler check"
MAX_ROWS = 1000
"""Largest number of pairs of swaths, and of clouds, on the page."""
MAX_PLACES = 50
"""Largest number of places on the page for a row of the specification."""
IN_JSON = "the output of --json"
BAD = ("fail", "not measured")
"""States in which a row does not meet the specification."""


def acceptance_page(summary: AcceptanceSummary) -> bytes:
    """Return the page as UTF-8."""
    header = [el("h1", "Check of clouds"), el("p", summary_text(summary), class_="lead")]
    if summary["specification"] is not None:
        state = "good" if summary["met"] else "bad"
        header.insert(0, el("p", verdict_text(summary), class_=f"state {state}"))
    worst_first = sorted(
        summary["rows"], key=lambda row: (row["state"] not in BAD, row["state"] == "not asked")
    )
    columns = ("row", "asked", "found", "result", "remarks and places")
    sections = [section("rows", "Rows", table(columns, [_row(row) for row in worst_first]))]
    if summary["swath_pairs"]:
        sections.append(_pairs(summary["swath_pairs"]))
    if summary["notes"]:
        notes = el("ul", *(el("li", note) for note in summary["notes"]))
        sections.append(section("notes", "Notes", notes))
    clouds = [(path,) for path in summary["clouds"][:MAX_ROWS]]
    listing = table(("path",), clouds)
    sections.append(
        section("clouds", "Clouds", listing, more(len(summary["clouds"]), MAX_ROWS, IN_JSON))
    )
    return page("Check of clouds", el("header", *header), sections, maker=MAKER)


def _row(row: AcceptanceRow) -> tuple[Node | str, ...]:
    state: Node | str = "" if row["state"] == "not asked" else row["state"]
    if row["state"] in BAD:
        state = el("strong", row["state"], class_="bad")
    told = [row["remark"]] if row["remark"] else []
    told += [listed(row["where"], MAX_PLACES)] if row["where"] else []
    return (
        row["name"].replace("_", " "),
        asked_text(row),
        value_text(row["found"], row["unit"]),
        state,
        "; ".join(told),
    )


def _pairs(pairs: Sequence[SwathPair]) -> Node:
    rows = [
        (
            f"{pair['second']} - {pair['first']}",
            f"{pair['cells']:,} of {pair['shared_cells']:,}",
            *(
                "-" if metres is None else f"{round(metres, 3) + 0.0:.3f}"
                for metres in (pair["mean_m"], pair["rms_m"], pair["p95_m"])
            ),
            f"{pair['x']:.1f} {pair['y']:.1f}",
        )
        for pair in pairs[:MAX_ROWS]
    ]
    columns = ("swaths", "cells compared", "mean, m", "RMS, m", "95 % within, m", "middle")
    found = table(columns, rows, (1, 2, 3, 4))
    return section("pairs", "Differences of swaths", found, more(len(pairs), MAX_ROWS, IN_JSON))


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
