"""Text of `tiler check`: the rows of clouds with their remarks and places, and what was measured of a DTM."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cli.output import print_table, write_line, write_lines
from tiler.apps.acceptance.page import asked_text, summary_text, value_text, verdict_text
from tiler.apps.results import AcceptanceRow, AcceptanceSummary
from tiler.core.units import length_text
from tiler.core.words import counted, listed
from tiler.report.accuracy import (
    CHANGE_HEADINGS,
    FIGURES,
    SPREAD,
    changes_text,
    groups_at,
    groups_of,
    places_of,
    seams_text,
    statement_text,
)

_STATES = {"fail": "FAIL", "not measured": "NOT MEASURED", "not asked": "-"}
_MAX_WHERE = 5


def print_acceptance(summary: AcceptanceSummary) -> None:
    """Write the table of the rows, and for rows with more to say a line each."""
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
    write_lines(filter(None, map(_details, summary["rows"])))
    paths = (summary["difference"], summary["style"], summary["page"])
    write_lines(f"wrote   {path}" for path in paths if path is not None)
    write_lines(f"note    {note}" for note in summary["notes"])
    if summary["specification"] is not None:
        write_line(verdict_text(summary))


def _details(row: AcceptanceRow) -> str:
    """Return a line with the remark and the places of a row, without files of a number that nobody asks for."""
    is_shown = row["state"] == "fail" or row["unit"] in ("places", "sheets", "%", "per m2", "m")
    parts = [row["remark"]] if row["remark"] else []
    parts += [listed(row["where"], _MAX_WHERE)] if row["where"] and is_shown else []
    return f"{row['name'].replace('_', ' ')}: {'; '.join(parts)}" if parts else ""


def print_report(report: Mapping[str, Any]) -> None:
    """Write what was measured of a DTM, and which requirements it meets."""
    printers = {
        "accuracy": _print_accuracy,
        "seams": _print_seams,
        "strips": _print_strips,
        "against": _print_changes,
    }
    for name, print_part in printers.items():
        if name in report:
            print_part(report[name])
    for requirement in report["requirements"]:
        unit = f" {requirement['unit']}".rstrip()
        value = (
            "not measured"
            if requirement["value"] is None
            else f"{requirement['value']:.4g}{unit}"
        )
        state = "met" if requirement["met"] else "NOT met"
        write_line(
            f"required {requirement['name']} {requirement['limit']:g}{unit}: {value}, {state}"
        )
    write_lines(f"drawn   {path}" for path in report["figures"])


def _print_accuracy(accuracy: Mapping[str, Any]) -> None:
    rows = [(name, *_figures(found)) for name, found in groups_at(accuracy)]
    print_table(f"DTM minus checkpoint, {accuracy['unit']}", ("", *FIGURES.values()), rows)
    outside, none = accuracy["outside"], accuracy["no_height"]
    if outside or none:
        write_line(f"without a DTM height: {outside} outside the DTM, {none} at nodata pixels")
    if accuracy["constant_offset"]:
        write_line(accuracy["constant_offset"])
    write_line(statement_text(accuracy["asprs"]))
    write_lines(f"note    {note}" for note in accuracy["notes"])


def _figures(figures: Mapping[str, Any]) -> tuple[str, ...]:
    forms = {"points": "d", "outliers": "d", "bias": "+.3f", "median": "+.3f"}
    values = {name: figures[name] for name in FIGURES}
    return tuple(
        "-" if value is None else format(value, forms.get(name, ".3f"))
        for name, value in values.items()
    )


def _print_seams(seams: Mapping[str, Any]) -> None:
    keys = ("mean_step", "largest_step", "mean_jump", "largest_jump")
    rows = [
        (
            name.replace("_", " "),
            f"{seams[name]['pairs']:,}",
            *(_number(seams[name][key]) for key in keys),
        )
        for name in ("tiles", "beside_tiles", "blocks", "beside_blocks", "interior")
        if name in seams
    ]
    columns = ("position", "pairs", "mean step", "largest step", "mean jump", "largest jump")
    unit = seams["horizontal_metres_per_unit"]
    edges = f"across edges of tiles of {length_text(seams['tile'] * unit, unit)}"
    print_table(f"steps between pixels, {seams['unit']}, {edges}", columns, rows)
    write_line(seams_text(seams))


def _print_strips(strips: Mapping[str, Any]) -> None:
    if not strips["pairs"]:
        write_line(
            f"strips  none to compare: the points have {counted(len(strips['strips']), 'flight line')} (by point "
            "source id), and no cell has points of two"
        )
        return
    rows = [
        (
            f"{p['second']} - {p['first']}",
            f"{p['cells']:,}",
            *(_number(p[key]) for key in SPREAD),
        )
        for p in strips["pairs"]
    ]
    rows.append(
        ("all", f"{strips['cells']:,}", *(_number(strips["all"][key]) for key in SPREAD))
    )
    columns = ("strips", "cells", *SPREAD.values())
    print_table(f"strips in cells of {strips['cell_m']:g} m, {strips['unit']}", columns, rows)


def _print_changes(against: Mapping[str, Any]) -> None:
    rows = [
        (name, f"{found['pixels']:,}", *(_number(found[key]) for key in SPREAD))
        for name, found in groups_of(against).items()
    ]
    columns = ("pixels of", "number", *SPREAD.values())
    print_table(f"DTM minus {against['old']}, {against['unit']}", columns, rows)
    write_line(changes_text(against))
    if against["places"]:
        print_table("largest places", CHANGE_HEADINGS, places_of(against, 5))
    write_lines(f"note    {note}" for note in against["notes"])
    if against["difference"]:
        write_line(f"wrote   {against['difference']}")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
