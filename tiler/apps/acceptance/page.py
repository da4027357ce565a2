"""Page of the check of clouds: the rows with what was asked and found, the pairs of swaths, the clouds, the notes."""

from __future__ import annotations

from collections.abc import Sequence

from tiler.apps.acceptance.words import asked_text, summary_text, value_text, verdict_text
from tiler.apps.results import AcceptanceRow, AcceptanceSummary, SwathPair
from tiler.core.words import listed
from tiler.report.document import Node, el, page, section, table

MAKER = "tiler check"
MAX_ROWS = 1000
"""Largest number of pairs of swaths, of clouds, and of places of a row."""
BAD = ("fail", "not measured")
"""States in which a row does not meet the specification."""


def acceptance_page(summary: AcceptanceSummary) -> bytes:
    """Return the page as UTF-8."""
    header = [el("h1", "Check of clouds"), el("p", summary_text(summary), class_="lead")]
    if summary["specification"] is not None:
        state = "good" if summary["met"] else "bad"
        header.insert(0, el("p", verdict_text(summary), class_=f"state {state}"))
    rows = [_row(row) for row in _worst_first(summary["rows"])]
    columns = ("row", "asked", "found", "result", "remarks and places")
    sections = [section("rows", "Rows", table(columns, rows))]
    if summary["swath_pairs"]:
        sections.append(_pairs(summary["swath_pairs"]))
    if summary["notes"]:
        notes = el("ul", *(el("li", note) for note in summary["notes"]))
        sections.append(section("notes", "Notes", notes))
    clouds = [(path,) for path in summary["clouds"][:MAX_ROWS]]
    listing = table(("path",), clouds)
    sections.append(section("clouds", "Clouds", listing, _more(len(summary["clouds"]))))
    return page("Check of clouds", el("header", *header), sections, maker=MAKER)


def _worst_first(rows: Sequence[AcceptanceRow]) -> list[AcceptanceRow]:
    """Return the rows that are asked and not met, then the others that are asked, then the rest."""
    return sorted(rows, key=lambda row: (row["state"] not in BAD, row["state"] == "not asked"))


def _row(row: AcceptanceRow) -> tuple[Node | str, ...]:
    state: Node | str = "" if row["state"] == "not asked" else row["state"]
    if row["state"] in BAD:
        state = el("strong", row["state"], class_="bad")
    told = [row["remark"]] if row["remark"] else []
    told += [listed(row["where"], MAX_ROWS)] if row["where"] else []
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
            *(_metres(pair[name]) for name in ("mean_m", "rms_m", "p95_m")),
            f"{pair['x']:.1f} {pair['y']:.1f}",
        )
        for pair in pairs[:MAX_ROWS]
    ]
    columns = ("swaths", "cells compared", "mean, m", "RMS, m", "95 % within, m", "middle")
    found = table(columns, rows, (1, 2, 3, 4))
    return section("pairs", "Differences of swaths", found, _more(len(pairs)))


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{round(value, 3) + 0.0:.3f}"


def _more(number: int) -> Node | None:
    if number <= MAX_ROWS:
        return None
    return el("p", f"{number - MAX_ROWS:,} more are in the output of --json.")
