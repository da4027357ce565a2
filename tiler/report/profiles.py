"""Profiles of rivers: the level of the water along the flow, and the heights that determine it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tiler.report.document import Node, el

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
    low, high = _span([s["level"] for s in stations], [z for _, z in banks])
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
    frame = [*_heights(low, high, down), *_lengths(length, across)]
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


def _span(levels: Sequence[float], banks: Sequence[float]) -> tuple[float, float]:
    """Return the lowest and highest height of a picture."""
    low, high = min(levels), max(levels)
    margin = max(high - low, MIN_RANGE)
    near = [z for z in banks if low - margin <= z <= high + margin]
    low, high = min([low, *near]), max([high, *near])
    pad = max(MIN_RANGE - (high - low), 0.1 * (high - low)) / 2
    return low - pad, high + pad


def _heights(low: float, high: float, down: Scale) -> list[Node]:
    """Draw lines across the picture at round heights."""
    nodes, digits = [], 2 if high - low < LINES_ACROSS else 0
    for z in round_steps(low, high, LINES_ACROSS):
        y = f"{down(z):.1f}"
        nodes.append(_line(x1=LEFT, y1=y, x2=WIDTH - RIGHT, y2=y))
        nodes.append(_text(LEFT - 8, f"{down(z) + 4:.1f}", f"{z:,.{digits}f}", "end"))
    return nodes


def _lengths(length: float, across: Scale) -> list[Node]:
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
