"""Section of the report about water, bridges, edits, breaklines and contours, and the layers of the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tiler.core.units_text import length_text, short_unit, small_area_text
from tiler.core.words import counted
from tiler.report.document import Content, Node, el, section, table
from tiler.report.problems import MAX_ROWS, Run
from tiler.report.profiles import profile


def drawn(run: Run) -> list[Node]:
    """Return the section as the only item of a list, or an empty list if it would be empty."""
    lines, edits, water, contours = (
        run.get(name) for name in ("breaklines", "edits", "water", "contours")
    )
    wide = run.get("plan", {}).get("metres_per_unit", {}).get("horizontal", 1.0)
    high = run.get("plan", {}).get("metres_per_unit", {}).get("vertical", 1.0)
    unit = short_unit(high)
    content: list[Content] = []
    if "bridges" in run:
        content += _bridges(run["bridges"], wide)
    if edits:
        rows = [
            (
                str(e["number"]),
                e["action"],
                ", ".join(f"{v:,.1f}" for v in e["bounds"]),
                changed_text(e),
            )
            for e in edits[:MAX_ROWS]
        ]
        content += [
            el("h3", counted(len(edits), "edit")),
            table(("feature", "action", "west, south, east, north", "effect"), rows, (0,)),
        ]
    if lines:
        text = f"The terrain follows {counted(lines['lines'], 'line')}, by {lines['vertices']:,} vertices."
        content += [el("h3", "Breaklines"), el("p", text)]
    if water:
        bodies = [
            (
                str(b["number"]),
                b["kind"],
                _levels(b),
                small_area_text(b["area_m2"], wide),
                _sure(b),
            )
            for b in water[:MAX_ROWS]
        ]
        columns = ("number", "kind", f"level, {unit}", "area", "confidence")
        content += [el("h3", f"Water: {len(water):,}"), table(columns, bodies, (0, 3))]
        pictures = [profile(body, unit) for body in water[:MAX_ROWS]]
        content += [picture for picture in pictures if picture is not None]
    if contours:
        interval = length_text(contours["interval"] * high, high)
        text = f"{counted(contours['lines'], 'line')} of {contours['vertices']:,} vertices, every {interval}."
        content += [el("h3", "Contours"), el("p", text)]
    return [section("drawn", "Drawn", *content)] if content else []


LAYERS = {
    "outline": ("outline", "#3c4043", False),
    "canopy": ("closed canopy", "#1e5a46", True),
    "water": ("water", "#1f78d1", True),
    "bridges": ("bridges", "#8a3ffc", True),
    "breaklines": ("breaklines", "#0b7a75", False),
    "edits": ("edits", "#d1341f", False),
}
"""Layers of the map from the bottom up: title, colour, and whether the area inside is
tinted."""


def shapes(run: Run) -> list[dict[str, Any]]:
    """Return the layers of the map that can be switched off, with lines as x, y, x, y, ... in units of the CRS."""
    of_features = {name: run.get(name) or () for name in ("water", "bridges", "edits")}
    lines = {
        name: [r for f in features for r in f.get("rings", ())]
        for name, features in of_features.items()
    }
    lines["outline"] = (run.get("outline") or {}).get("rings", [])
    lines["canopy"] = (run.get("canopy") or {}).get("rings", [])
    lines["breaklines"] = (run.get("breaklines") or {}).get("drawn", [])
    return [
        {"name": name, "title": title, "colour": colour, "tinted": tinted, "lines": lines[name]}
        for name, (title, colour, tinted) in LAYERS.items()
        if lines[name]
    ]


def _bridges(bridges: Sequence[Mapping[str, Any]], unit: float) -> list[Content]:
    if not bridges:
        return [
            el("h3", "Bridges"),
            el("p", "No bridge was found that stands free of the ground."),
        ]
    names = ("length_m", "width_m", "clearance_m")
    rows = [
        (*(length_text(round(b[name], 1), unit) for name in names), str(b["below"]))
        for b in bridges[:MAX_ROWS]
    ]
    heads = ("length", "width", "clearance", "points below")
    return [
        el("h3", f"{counted(len(bridges), 'bridge')} left out of the terrain"),
        table(heads, rows, (0, 1, 2, 3)),
    ]


def _levels(body: Mapping[str, Any]) -> str:
    """Return the level of a lake, or the highest and lowest level of a river."""
    high, low = body["level"], body["level_end"]
    return f"{high:.2f}" if high == low else f"{high:.2f} to {low:.2f}"


def _sure(body: Mapping[str, Any]) -> str:
    return "drawn" if body["sure"] is None else f"{body['sure']:.0%}"


def changed_text(edit: Mapping[str, Any]) -> str:
    """Return the effect of an edit in words, as if it did not overlap with other edits."""
    holes = f"; {counted(edit['holes'], 'pixel')} without a height" if edit.get("holes") else ""
    if "pixels" in edit:
        return f"{counted(edit['pixels'], 'pixel')}{holes}"
    numbers = (edit.get(f"ground_{when}", 0) for when in ("before", "after"))
    before, after = (f"{number:,}" if number else "none" for number in numbers)
    points = counted(edit.get("points", 0), "point")
    by = f" ({edit['by']})" if edit["action"] == "ground" else ""
    return f"{before} of {points} were ground before, {after} after{by}{holes}"
