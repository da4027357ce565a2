"""Cards of places to review: what the terrain is there, what it would be after the suggested edit, a section of points.

`tiler.apps.review` reads the values of a card. Pictures are PNGs in the page, sections and outlines are SVGs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ptd.arrays import Bool, Float32, Float64
from tiler.core.edits import ACTIONS, FLAT
from tiler.core.review import FIXED, OK, OPEN
from tiler.core.units import length_text, short_unit, small_area_text
from tiler.report.document import Content, Node, el, facts
from tiler.report.drawn import (
    BOTTOM,
    HEIGHT,
    LEFT,
    RIGHT,
    TOP,
    WIDTH,
    height_lines,
    height_range,
    length_marks,
)
from tiler.report.pictures import Extent, hillshade

GROUND_COLOUR, OTHER_COLOUR, AFTER_COLOUR = "#b0722a", "#2f7fd0", "#d1341f"
TITLES = {OPEN: "open (u)", OK: "right as it is (o)", FIXED: "change it with the edit (f)"}
"""Texts of the decisions, with their keys."""
CLIPPED_PERCENT = 1.0
"""Percentage of the points at either end of the heights that a section may leave out."""
BEYOND_M = 10.0
"""Height above and below the terrain beyond which a section shows no points. The top of a tree would flatten the
terrain."""


@dataclass(frozen=True)
class Section:
    """Section through a place, with positions along it in units of the CRS and heights in those of the terrain.

    Attributes
    ----------
    length : float
    at : float64, shape (n,)
        Positions at which the terrain is known.
    before, after : float64, shape (n,)
        Heights of the terrain and those that the suggested edit changes, NaN where there is none. ``after`` is None if
        it changes none.
    inside : bool, shape (n,)
        Whether the position lies in the place.
    ground, others : float64, shape (2, m)
        Position and height of the points near the section.
    width : float
        Width of the strip of these points, 0 if no points are known.
    """

    length: float
    at: Float64
    before: Float64
    after: Float64 | None
    inside: Bool
    ground: Float64
    others: Float64
    width: float


@dataclass(frozen=True)
class Card:
    """Place to review, with what its card shows.

    Attributes
    ----------
    columns : mapping
        Columns of `review.gpkg`.
    middle : (float, float)
        x and y of the middle of its bounds.
    outline : tuple of float64, shape (n, 2)
        Rings in units of the CRS.
    ends : float64, shape (2, 2)
        Both ends of the section in units of the CRS.
    geometry : str or None
        Polygons as GeoJSON, or None if they have too many corners for a page.
    extent : tuple of float
        West, south, east and north of the pictures.
    before, after : float32, shape (rows, columns)
        Heights, NaN where there is none. ``after`` is None without a suggested edit that can be shown.
    section : Section
    """

    columns: Mapping[str, Any]
    middle: tuple[float, float]
    outline: tuple[Float64, ...]
    ends: Float64
    geometry: str | None
    extent: Extent
    before: Float32
    after: Float32 | None
    section: Section


def card(
    number: int,
    place: Card,
    run: Mapping[str, Any],
    units: tuple[float, float],
    can_save: bool,
) -> Node:
    """Return the card of a place as an element of a page, without controls if the page cannot save decisions.

    ``number`` distinguishes the elements of the page.
    """
    columns, (wide, high) = place.columns, units
    stake, area = columns["stake_m"], columns["area_m2"]
    known = facts(
        {
            "possible height error": None
            if stake is None
            else length_text(round(stake, 2), high),
            "area": None if area is None else small_area_text(area, wide),
            "chance that it is wrong": _likely(columns),
            "middle": f"{place.middle[0]:.1f}, {place.middle[1]:.1f}",
            "sheet": columns["sheet"] or None,
        }
    )
    remedy = columns["remedy"]
    return el(
        "article",
        el("h3", _title(columns)),
        el("p", columns["why"]),
        el("p", remedy, class_="quiet") if remedy else None,
        known,
        views(place, run, units),
        _form(number, place, short_unit(high)) if can_save else None,
        class_="place",
        id=f"place-{number}",
        tabindex=-1,
    )


def views(place: Card, run: Mapping[str, Any], units: tuple[float, float]) -> Node:
    """Return the pictures of a place, before and after the suggested edit, and the section."""
    figures = [_picture(place, place.before, run, "terrain")]
    if place.after is not None:
        action = place.columns["action"]
        figures.append(_picture(place, place.after, run, f"with the edit {action}"))
    return el("div", *figures, _section(place.section, units), class_="views")


def _title(columns: Mapping[str, Any]) -> str:
    reason = columns["reason"] or "place"
    return reason if columns["rank"] is None else f"{columns['rank']}. {reason}"


def _likely(columns: Mapping[str, Any]) -> str | None:
    chance = columns["chance"]
    return None if chance is None else f"{100 * chance:.0f} %"


def small_card(place: Card, run: Mapping[str, Any], units: tuple[float, float]) -> Node:
    """Return what a report shows of a place: a picture of the terrain and the section."""
    columns = place.columns
    likely = _likely(columns)
    return el(
        "article",
        el("h3", _title(columns)),
        el("p", columns["why"]),
        el("p", f"wrong with a chance of {likely}", class_="quiet") if likely else None,
        el(
            "div",
            _picture(place, place.before, run, "terrain"),
            _section(place.section, units),
            class_="views",
        ),
        class_="place small",
    )


def _form(number: int, place: Card, unit: str) -> Node:
    if place.geometry is None:
        text = "This outline has too many corners for a page: decide in review.gpkg."
        return el("p", text, class_="warning")
    columns = place.columns
    choices: list[Content] = [
        el(
            "label",
            el("input", type="radio", name=f"status-{number}", value=status),
            f" {title}",
        )
        for status, title in TITLES.items()
    ]
    selected = {columns["action"]: {"selected": "selected"}}
    options = [
        el("option", action or "(none)", value=action, **selected.get(action, {}))
        for action in ("", *ACTIONS)
    ]
    z = "" if columns["z"] is None else repr(columns["z"])
    return el(
        "fieldset",
        el("legend", "Decision"),
        *choices,
        el("label", "edit ", el("select", *options, name="action")),
        el(
            "label",
            f"height for {FLAT}, {unit} ",
            el("input", type="text", inputmode="decimal", name="z", size=8, value=z),
        ),
        el("label", "note ", el("input", type="text", name="note", value=columns["note"])),
        el("output", "", class_="bad"),
    )


def _picture(place: Card, heights: Float32, run: Mapping[str, Any], title: str) -> Node:
    """Return a hillshade with the outline of the place and the line of the section."""
    rows, columns = heights.shape
    west, south, east, north = place.extent
    across, down = columns / (east - west), rows / (north - south)
    shade = hillshade(heights, place.extent, run, like=place.before)

    def text(corners: Float64) -> str:
        at = np.stack(((corners[:, 0] - west) * across, (north - corners[:, 1]) * down), axis=1)
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in at)

    drawn = [
        el("polygon", points=text(ring), fill="none", stroke=AFTER_COLOUR, stroke_width=1.5)
        for ring in place.outline
    ]
    line = el(
        "polyline",
        points=text(place.ends),
        fill="none",
        stroke=OTHER_COLOUR,
        stroke_dasharray="4 3",
    )
    picture = el(
        "svg",
        el("title", f"{title} around the place"),
        el("image", href=shade.uri, width=columns, height=rows),
        *drawn,
        line,
        viewBox=f"0 0 {columns} {rows}",
        role="img",
        class_="view",
    )
    return el("figure", picture, el("figcaption", title))


def _section(section: Section, units: tuple[float, float]) -> Node:
    """Return the section: points of a strip, the terrain, and the terrain after the suggested edit."""
    if not np.isfinite(section.before).any() and not _heights_of_points(section).size:
        return el("p", "Nothing is known along the dashed line.", class_="quiet")
    low, high = _height_range(section, BEYOND_M / units[1])

    def across(along: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * along / max(section.length, 1e-9)

    def down(z: float) -> float:
        return TOP + (HEIGHT - TOP - BOTTOM) * (high - z) / (high - low)

    parts: list[Content] = [
        *(
            el(
                "rect",
                x=f"{across(first):.1f}",
                y=TOP,
                width=f"{across(last) - across(first):.1f}",
                height=HEIGHT - TOP - BOTTOM,
                class_="inside",
            )
            for first, last in _runs(section)
        ),
        *height_lines(low, high, down),
        *length_marks(section.length, across),
    ]
    for points, colour in ((section.others, OTHER_COLOUR), (section.ground, GROUND_COLOUR)):
        seen = points[:, (points[1] >= low) & (points[1] <= high)]
        dots = "".join(f"M{across(a):.1f} {down(z):.1f}h0" for a, z in seen.T.tolist())
        if dots:
            parts.append(el("path", d=dots, stroke=colour, stroke_width=2.2, class_="dots"))
    if section.after is not None:
        parts.append(_line(section.at, section.after, across, down, AFTER_COLOUR))
    parts.append(_line(section.at, section.before, across, down, "currentColor"))
    picture = el(
        "svg",
        el("title", "Section through the place"),
        *parts,
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        role="img",
        class_="section",
    )
    caption = el("figcaption", _caption(section, units, low, high))
    return el("figure", picture, caption, class_="across")


def _height_range(section: Section, beyond: float) -> tuple[float, float]:
    """Return the lowest and highest height of the picture, at most ``beyond`` the terrain for points."""
    lines = np.concatenate((section.before, () if section.after is None else section.after))
    heights, points = lines[np.isfinite(lines)], _heights_of_points(section)
    if points.size:
        ends = np.percentile(points, (CLIPPED_PERCENT, 100 - CLIPPED_PERCENT))
        if heights.size:
            ends = np.clip(ends, heights.min() - beyond, heights.max() + beyond)
        heights = np.concatenate((heights, ends))
    return height_range(heights.tolist() or [0.0], [])


def _heights_of_points(section: Section) -> Float64:
    return np.concatenate((section.ground[1], section.others[1]))


def _caption(section: Section, units: tuple[float, float], low: float, high: float) -> str:
    metres, unit, points = units[0], short_unit(units[1]), _heights_of_points(section)
    text = f"Section along the dashed line, heights in {unit}: terrain (line)"
    if section.after is not None:
        text += ", terrain with the edit (red)"
    if not section.width:
        return f"{text}. Points are not shown, because the store of the run is not there or cannot be read."
    width = length_text(round(section.width * metres, 2), metres)
    text += f", points of a strip of {width}: ground (brown), others (blue)."
    if (points > high).any():
        text += f" Points above {high:,.1f} {unit} are not shown."
    if (points < low).any():
        text += f" Points below {low:,.1f} {unit} are not shown."
    return text


def _runs(section: Section) -> list[tuple[float, float]]:
    """Return where the section enters and leaves the place."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], section.inside, [False]))))
    ends = np.append(section.at, section.length)
    return [(float(ends[a]), float(ends[b])) for a, b in edges.reshape(-1, 2).tolist()]


def _line(at: Float64, heights: Float64, across: Any, down: Any, colour: str) -> Node:
    """Return a line through the heights, with gaps where there is none."""
    text, pen_is_down = [], False
    for along, z in zip(at.tolist(), heights.tolist(), strict=True):
        if np.isfinite(z):
            text.append(f"{'L' if pen_is_down else 'M'}{across(along):.1f} {down(z):.1f}")
        pen_is_down = bool(np.isfinite(z))
    return el("path", d="".join(text), fill="none", stroke=colour, stroke_width=1.6)


def decisions(
    found: Sequence[Card], kept: Sequence[tuple[dict[str, Any], str]], crs: str | None
) -> dict[str, Any]:
    """Return the data with which the page writes a file of decisions: the places, and what was decided before."""
    names = ("rank", "reason", "why", "stake_m", "area_m2", "chance", "sheet", "remedy")
    return {
        "crs": crs,
        "places": [
            {
                "geometry": place.geometry,
                "columns": {name: place.columns[name] for name in names},
            }
            for place in found
        ],
        "kept": [{"geometry": geometry, "columns": columns} for columns, geometry in kept],
    }
