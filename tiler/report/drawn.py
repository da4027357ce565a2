"""Section of the report about water, bridges, edits, breaklines and contours, and the layers of the map.

A river has a profile: the level of the water along the flow, and the heights that determine it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tiler.core.edits import VOID
from tiler.core.units import length_text, short_unit, small_area_text
from tiler.core.words import counted
from tiler.report.document import Content, Node, el, section, table
from tiler.report.problems import MAX_ROWS, Run
from tiler.report.runfile import units_of


def drawn(run: Run) -> list[Node]:
    """Return the section as the only item of a list, or an empty list if it would be empty."""
    lines, edits, water, contours = (
        run.get(name) for name in ("breaklines", "edits", "water", "contours")
    )
    wide, high = units_of(run)
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
                "drawn" if b["sure"] is None else f"{b['sure']:.0%}",
            )
            for b in water[:MAX_ROWS]
        ]
        columns = ("number", "kind", f"level, {unit}", "area", "confidence")
        content += [el("h3", f"Water: {len(water):,}"), table(columns, bodies, (0, 3))]
        content += [profile(body, unit) for body in water[:MAX_ROWS]]
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
    lines = {
        name: [r for feature in run.get(name) or () for r in feature.get("rings", ())]
        for name in ("water", "bridges", "edits")
    }
    for name, part in (("outline", "rings"), ("canopy", "rings"), ("breaklines", "drawn")):
        lines[name] = (run.get(name) or {}).get(part, [])
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


def changed_text(edit: Mapping[str, Any]) -> str:
    """Return the effect of an edit in words, as if it did not overlap with other edits."""
    if edit["action"] == VOID:
        # At the border of the survey they are outside now, elsewhere they are holes.
        return f"{counted(edit.get('pixels', 0), 'pixel')} set to nodata"
    holes = f"; {counted(edit['holes'], 'pixel')} without a height" if edit.get("holes") else ""
    if "pixels" in edit:
        return f"{counted(edit['pixels'], 'pixel')}{holes}"
    numbers = (edit.get(f"ground_{when}", 0) for when in ("before", "after"))
    before, after = (f"{number:,}" if number else "none" for number in numbers)
    points = counted(edit.get("points", 0), "point")
    by = f" ({edit['by']})" if edit["action"] == "ground" else ""
    return f"{before} of {points} were ground before, {after} after{by}{holes}"


WIDTH, HEIGHT = 640, 190
LEFT, RIGHT, TOP, BOTTOM = 64, 16, 12, 26
"""Margins of a picture, pixels."""
WATER, BANKS = "#1f78d1", "#b0722a"
MIN_RANGE = 0.5
"""Smallest range of heights of a picture, so that noise does not look like a waterfall."""
LINES_ACROSS, LINES_ALONG = 4, 6
"""Largest number of grid lines of a picture, at round heights and at round lengths."""

Scale = Callable[[float], float]
Station = Mapping[str, Any]


def profile(body: Mapping[str, Any], unit: str) -> Node | None:
    """Return the profile of a river of run.json, or None if its level has fewer than two stations.

    Parameters
    ----------
    body : mapping
    unit : str
        Unit of the heights.
    """
    stations: Sequence[Station] = body.get("stations") or ()
    if len(stations) < 2:
        return None
    banks = [
        (s["along"], s[side])
        for s in stations
        for side in ("left", "right")
        if s[side] is not None
    ]
    # Banks may be cliffs, and land next to a raised canal lies below its water. So heights far
    # from the water are not drawn.
    low, high = height_range([s["level"] for s in stations], [z for _, z in banks])
    length = max(float(stations[-1]["along"]), 1e-9)

    def across(along: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * (along / length)

    def down(z: float) -> float:
        return TOP + (HEIGHT - TOP - BOTTOM) * ((high - z) / (high - low))

    vertices = [(across(s["along"]), down(s["level"])) for s in stations]
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in vertices)
    line = el("polyline", points=points, fill="none", stroke=WATER, stroke_width=2)
    marks = [
        _mark(across(along), down(z), BANKS, 2.5) for along, z in banks if low <= z <= high
    ]
    marks += [
        _mark(x, y, WATER, 3.5)
        for (x, y), s in zip(vertices, stations, strict=True)
        if s["seen"]
    ]
    title = el("title", f"Level of {body['kind']} {body['number']} along its flow")
    frame = [*height_lines(low, high, down), *length_marks(length, across)]
    box = f"0 0 {WIDTH} {HEIGHT}"
    picture = el(
        "svg",
        title,
        *frame,
        line,
        *marks,
        width=WIDTH,
        height=HEIGHT,
        viewBox=box,
        role="img",
        class_="profile",
    )
    return el("figure", picture, el("figcaption", _caption(body, stations, unit)))


def round_steps(low: float, high: float, most: int) -> list[float]:
    """Return multiples of 1, 2 or 5 times a power of ten from ``low`` to ``high``, as many as ``most`` allows."""
    power = 10.0 ** math.floor(math.log10((high - low) / most))
    for step in (power * factor for factor in (1, 2, 5, 10, 20)):
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if last - first < most:
            break
    return [number * step for number in range(first, last + 1)]


def _caption(body: Mapping[str, Any], stations: Sequence[Station], unit: str) -> str:
    seen = sum(bool(station["seen"]) for station in stations)
    return (
        f"{body['kind'].capitalize()} {body['number']}: level of the water along its flow (line), in {unit}. Lengths "
        f"are in the unit of the CRS. At {seen} of {len(stations)} stations the level comes from returns of the water "
        "(blue), at the others from the banks (brown: the level estimated from each bank)."
    )


def height_range(levels: Sequence[float], banks: Sequence[float]) -> tuple[float, float]:
    """Return the lowest and highest height of a picture."""
    low, high = min(levels), max(levels)
    margin = max(high - low, MIN_RANGE)
    near = [z for z in banks if low - margin <= z <= high + margin]
    low, high = min([low, *near]), max([high, *near])
    pad = max(MIN_RANGE - (high - low), 0.1 * (high - low)) / 2
    return low - pad, high + pad


def height_lines(low: float, high: float, down: Scale) -> list[Node]:
    """Draw lines across the picture at round heights."""
    nodes, digits = [], 2 if high - low < LINES_ACROSS else 0
    for z in round_steps(low, high, LINES_ACROSS):
        y = f"{down(z):.1f}"
        nodes.append(_line(x1=LEFT, y1=y, x2=WIDTH - RIGHT, y2=y))
        nodes.append(_text(LEFT - 8, f"{down(z) + 4:.1f}", f"{z:,.{digits}f}", "end"))
    return nodes


def length_marks(length: float, across: Scale) -> list[Node]:
    """Draw short lines below the picture at round lengths."""
    nodes = []
    for along in round_steps(0.0, length, LINES_ALONG):
        x = f"{across(along):.1f}"
        nodes.append(_line(x1=x, y1=HEIGHT - BOTTOM, x2=x, y2=HEIGHT - BOTTOM + 4))
        nodes.append(_text(x, HEIGHT - 8, f"{along:,.0f}", "middle"))
    return [_line(x1=LEFT, y1=HEIGHT - BOTTOM, x2=WIDTH - RIGHT, y2=HEIGHT - BOTTOM), *nodes]


def _line(**ends: str | int) -> Node:
    return el("line", stroke="currentColor", stroke_opacity=0.25, **ends)


def _mark(x: float, y: float, colour: str, radius: float) -> Node:
    return el("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=radius, fill=colour)


def _text(x: str | int, y: str | int, text: str, anchor: str) -> Node:
    return el("text", text, x=x, y=y, text_anchor=anchor, fill="currentColor", font_size=11)
