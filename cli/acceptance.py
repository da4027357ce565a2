"""Text of the check of clouds: a table of the rows, then their remarks and places."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cli.output import print_table, write_line
from tiler.core.words import listed

if TYPE_CHECKING:
    from tiler.apps.results import AcceptanceRow, AcceptanceSummary

_STATES = {"fail": "FAIL", "not measured": "NOT MEASURED", "not asked": "-"}
_MAX_WHERE = 5


def print_acceptance(summary: AcceptanceSummary) -> None:
    """Write the table of the rows, and for rows with more to say a line each."""
    from tiler.apps.acceptance.words import asked_text, summary_text, value_text, verdict_text

    rows = [
        (
            row["name"].replace("_", " "),
            asked_text(row),
            value_text(row["found"], row["unit"]),
            _STATES.get(row["state"], row["state"]),
        )
        for row in summary["rows"]
    ]
    print_table(summary_text(summary), ("", "asked", "found", "result"), rows)
    for row in summary["rows"]:
        if line := _details(row):
            write_line(line)
    for path in (summary["difference"], summary["style"], summary["page"]):
        if path is not None:
            write_line(f"wrote   {path}")
    for note in summary["notes"]:
        write_line(f"note    {note}")
    if summary["specification"] is not None:
        write_line(verdict_text(summary))


def _details(row: AcceptanceRow) -> str:
    """Return a line with the remark and the places of a row, without files of a number that nobody asks for."""
    is_shown = row["state"] == "fail" or row["unit"] in ("places", "sheets", "%", "per m2", "m")
    parts = [row["remark"]] if row["remark"] else []
    parts += [listed(row["where"], _MAX_WHERE)] if row["where"] and is_shown else []
    return f"{row['name'].replace('_', ' ')}: {'; '.join(parts)}" if parts else ""
