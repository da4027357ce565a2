"""Text of the check of clouds: a table of the rows, then their remarks and places."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cli.output import print_table, write_line
from tiler.core.words import counted, listed

if TYPE_CHECKING:
    from tiler.apps.results import AcceptanceRow, AcceptanceSummary

_STATES = {"fail": "FAIL", "not measured": "NOT MEASURED", "not asked": "-"}
_MAX_WHERE = 5


def print_acceptance(summary: AcceptanceSummary) -> None:
    """Write the table of the rows, and for rows with more to say a line each."""
    title = f"{counted(len(summary['clouds']), 'cloud')}, {counted(summary['points'], 'point')}"
    if summary["cell_m"] is not None:
        title += f", cells of {summary['cell_m']:.3g} m"
    if summary["specification"] is not None:
        title += f", specification {summary['specification']}"
    rows = [
        (
            row["name"].replace("_", " "),
            _asked(row),
            _with_unit(row["found"], row["unit"]),
            _STATES.get(row["state"], row["state"]),
        )
        for row in summary["rows"]
    ]
    print_table(title, ("", "asked", "found", "result"), rows)
    for row in summary["rows"]:
        if line := _details(row):
            write_line(line)
    for path in (summary["difference"], summary["style"]):
        if path is not None:
            write_line(f"wrote   {path}")
    for note in summary["notes"]:
        write_line(f"note    {note}")
    if summary["specification"] is not None:
        write_line(_verdict(summary))


def _asked(row: AcceptanceRow) -> str:
    if row["asked"] is None:
        return "-"
    text = _with_unit(row["asked"], row["unit"])
    return text if row["limit"] == "only" else f"{row['limit']} {text}"


def _with_unit(value: Any, unit: str) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    number = f"{value:,}" if isinstance(value, int) else f"{value:.4g}"
    if isinstance(value, float) and abs(value) >= 1000:
        number = f"{value:,.0f}"
    # Units of numbers are plural nouns.
    return f"{number} {unit[:-1] if value == 1 and unit.endswith('s') else unit}".rstrip()


def _details(row: AcceptanceRow) -> str:
    """Return a line with the remark and the places of a row, without files of a number that nobody asks for."""
    is_shown = row["state"] == "fail" or row["unit"] in ("places", "%", "per m2", "m")
    parts = [row["remark"]] if row["remark"] else []
    parts += [listed(row["where"], _MAX_WHERE)] if row["where"] and is_shown else []
    return f"{row['name'].replace('_', ' ')}: {'; '.join(parts)}" if parts else ""


def _verdict(summary: AcceptanceSummary) -> str:
    asked = [row for row in summary["rows"] if row["state"] != "not asked"]
    bad = [row["name"].replace("_", " ") for row in asked if row["state"] != "pass"]
    if not bad:
        return f"met: all {counted(len(asked), 'row')} of {summary['specification']}"
    return f"NOT met: {len(bad)} of {counted(len(asked), 'row')} of {summary['specification']} ({', '.join(bad)})"
