"""The client's page of a delivery: specification, map, accuracy, completeness and files, on two screens.

The map is a hillshade with water, bridges, outline, voids and sheets, and a scale bar.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import shapely

from tiler.core.products import MASK_VALUES, OUTSIDE
from tiler.core.units import area_text, short_unit, small_area_text
from tiler.core.words import counted
from tiler.io.result_folder import SHEETS, results_name, written_rasters
from tiler.io.vector import POLYGONS
from tiler.io.vector.reading import read_features
from tiler.observe.progress import size_text
from tiler.report.accuracy import (
    AtCheckpoints,
    accuracy_content,
    at_checkpoints,
    rule_of_thumb,
    seams_text,
)
from tiler.report.document import (
    Content,
    Node,
    el,
    facts,
    link,
    more,
    page,
    section,
    swatch,
    table,
)
from tiler.report.drawn import LAYERS, round_steps
from tiler.report.pictures import (
    Extent,
    Picture,
    raster_extent,
    reading_rasters,
    small_hillshade,
)
from tiler.report.problems import MAX_ROWS, Run
from tiler.report.runfile import units_of
from tiler.report.sections import (
    is_good,
    left_out,
    made_text,
    share_with_height,
    state_text,
    surveyed_text,
)
from tiler.report.tables import specification

KINDS = ("raster", "vector", "page", "description", "cloud")
"""Kinds of files in the order of the list."""


PIXELS = 1000
"""Pixels of the longer side of the map."""
SHEET_COLOUR, VOID_COLOUR = "#a3341c", "#d100a0"
MAX_SHEETS = 400
"""Largest number of sheets on the map. More would hide the terrain."""
LETTER_WIDTH = 0.6
"""Width of a letter as a share of the size of the text."""
BAR_STEPS = 6
"""Largest number of steps in the longer side of the map. The scale bar is one step long."""
Rings = Iterable[Sequence[float]]


def client_page(out: Path, run: Run, entries: Sequence[Mapping[str, Any]]) -> bytes:
    """Return the page.

    Parameters
    ----------
    out : Path
        Folder of the run.
    run : mapping
        Content of run.json, with the measurements of `tiler check` under ``check``.
    entries : sequence of mapping
        Entries of the files in the manifest.

    Returns
    -------
    bytes
        UTF-8.

    Raises
    ------
    InputError
        The index of sheets cannot be read.
    ProcessingError
        A raster cannot be read.
    """
    rasters = {product: str(out / name) for product, name in written_rasters(run).items()}
    title = run.get("report_title") or f"Terrain of {results_name(out)}"
    with reading_rasters(out):
        checked = at_checkpoints(run["check"], rasters)
        drawn = el("p", "No terrain model is delivered, so there is no map.")
        if terrain := rasters.get("dtm"):
            drawn = client_map(out, run, entries, terrain)
    header = el(
        "header",
        el("p", state_text(run), class_=f"state {'good' if is_good(run) else 'bad'}"),
        el("h1", title),
        el("p", f"{made_text(run)}.", class_="lead") if "dtm" in rasters else None,
        class_="screens",
    )
    sections = [
        specification(run),
        section("map", "Map", drawn),
        section("accuracy", "Accuracy", *_accuracy(run, checked)),
        section("completeness", "Completeness", *_completeness(run)),
        section("files", "Files", *_files(entries)),
    ]
    return page(title, header, sections, maker="tiler deliver")


def _accuracy(run: Run, checked: AtCheckpoints | None) -> Iterator[Content]:
    check = {} if run["check"].get("older") else run["check"]
    if "unreadable" in check:
        text = "The measurements of this terrain cannot be read, so its accuracy is not stated."
        yield el("p", text, class_="warning")
        return
    measured = {name: check[name] for name in ("accuracy", "requirements") if check.get(name)}
    if "accuracy" in measured:
        # Notes are advice to those who measured.
        measured["accuracy"] = {**measured["accuracy"], "notes": ()}
    else:
        yield el("p", "This terrain was not measured at checkpoints.")
    if measured:
        yield from accuracy_content(measured, {})
    yield from rule_of_thumb(run, checked)
    seams = check.get("seams")
    yield el("p", seams_text(seams) if seams else "Seams between tiles were not checked.")


def _completeness(run: Run) -> Iterator[Node]:
    water, edits = run.get("water") or (), run.get("edits") or ()
    yield facts(
        {
            **_voids(run),
            "water": counted(len(water), "body", "bodies") if water else None,
            "edits": counted(len(edits), "edit") if edits else None,
            "left out": left_out(run) or "nothing",
            "places to review": _review_text(run.get("review")),
        }
    )
    sources = {
        text: number
        for text, number in run.get("mask", {}).items()
        if number and text != MASK_VALUES[OUTSIDE]
    }
    if sources:
        yield el("h3", "Sources of heights, shares of the survey")
        pixels = sum(sources.values())
        yield facts(
            {
                text: "less than 0.1 %"
                if number / pixels < 0.001
                else f"{100 * (number / pixels):.1f} %"
                for text, number in sources.items()
            }
        )


def _voids(run: Run) -> dict[str, Content]:
    """Return facts about the pixels with a height and without one."""
    voids, metres = run.get("voids"), units_of(run)[0]
    if not voids or not run.get("dtm"):
        return {}
    pixel_m2 = run["dtm"]["resolution_m"] ** 2

    def area(pixels: int) -> str | None:
        return small_area_text(pixels * pixel_m2, metres) if pixels else None

    text = "none"
    if voids["number"]:
        largest = max(void["area_m2"] for void in voids["largest"])
        text = f"{voids['number']:,}, together {area(voids['pixels'])}; the largest has "
        text += small_area_text(largest, metres)
    empty = run.get("without_returns", ())
    empty_m2 = sum(place["area_m2"] for place in empty)
    at_least = "at least " if len(empty) >= MAX_ROWS else ""
    return {
        "surveyed": area_text(voids["surveyed_pixels"] * pixel_m2, metres),
        "with a height": f"{share_with_height(voids)} of {surveyed_text(run)}",
        "voids": text,
        "left without heights by edits": area(voids["asked_pixels"]),
        "interpolated where no return lies": (
            f"{at_least}{small_area_text(empty_m2, metres)}" if empty_m2 else None
        ),
    }


def _review_text(review: Mapping[str, int] | None) -> str | None:
    if not review:
        return None
    return f"{review['open']:,} open, {review['ok']:,} found right, {review['fixed']:,} changed"


def _files(entries: Sequence[Mapping[str, Any]]) -> Iterator[Content]:
    rows = [
        (
            link(entry["path"]),
            _content(entry),
            ", ".join(f"{edge:.12g}" for edge in entry.get("bounds", ())),
            size_text(entry["bytes"]),
        )
        for entry in sorted(entries, key=lambda entry: KINDS.index(entry["kind"]))[:MAX_ROWS]
    ]
    yield table(("file", "content", "west, south, east, north", "size"), rows, (3,))
    yield more(len(entries), MAX_ROWS, "manifest.json")
    yield el(
        "p",
        "manifest.json has the SHA-256 of each file, the settings and the versions of the software. ",
        el("code", "tiler verify FOLDER"),
        " reports missing and changed files.",
    )


def _content(entry: Mapping[str, Any]) -> str:
    if entry["kind"] == "cloud":
        return counted(entry["points"], "point")
    if entry["kind"] == "raster":
        return f"{entry['product']}, {entry['columns']:,} x {entry['rows']:,} pixels"
    return str(entry["kind"])


def client_map(out: Path, run: Run, entries: Sequence[Mapping[str, Any]], terrain: str) -> Node:
    """Return the map as a figure.

    Parameters
    ----------
    out : Path
        Folder of the run, whose index of sheets has their polygons.
    run : mapping
        Content of run.json.
    entries : sequence of mapping
        Entries of the files in the manifest.
    terrain : str
        Path of the terrain.

    Raises
    ------
    InputError
        The index of sheets cannot be read.
    rasterio.errors.RasterioError
        The terrain cannot be read.
    """
    picture, extent = small_hillshade(terrain, run, PIXELS), raster_extent(terrain)
    drawing = _Drawing(picture, extent)
    sheets = [e for e in entries if e.get("product") == "dtm" and "/" in e["path"]]
    width, height = picture.size
    shapes = [*_areas(run, drawing), *_drawn_voids(run, drawing)]
    shapes += _sheets(sheets, _sheet_shapes(out, len(sheets)), drawing)
    # A picture inside the picture cuts off what lies beyond the terrain.
    inside = el(
        "svg",
        el("image", href=picture.uri, width=width, height=height),
        *shapes,
        width=width,
        height=height,
        viewBox=f"0 0 {width} {height}",
    )
    bar, bar_width = drawing.scale_bar(short_unit(units_of(run)[0]))
    whole = el(
        "svg",
        el("title", "Hillshade of the terrain. North is up."),
        inside,
        *bar,
        viewBox=f"0 0 {max(width, bar_width):.5g} {height + 2 * drawing.text_size:.5g}",
        role="img",
        class_="whole",
    )
    legend = (swatch(colour, text) for text, colour in _legend(run, len(sheets)))
    return el("figure", whole, el("figcaption", "North is up.", *legend))


def _legend(run: Run, n_sheets: int) -> Iterator[tuple[str, str]]:
    """Yield text and colour of each kind of shape on the map."""
    for name in ("water", "bridges", "outline"):
        if run.get(name):
            yield LAYERS[name][:2]
    voids = run.get("voids") or {"number": 0, "largest": ()}
    if voids["largest"]:
        is_cut = voids["number"] > len(voids["largest"])
        yield "largest voids" if is_cut else "voids", VOID_COLOUR
    if n_sheets:
        is_drawn = n_sheets <= MAX_SHEETS
        yield (
            "sheets" if is_drawn else f"{n_sheets:,} sheets are not drawn",
            SHEET_COLOUR,
        )


def _areas(run: Run, drawing: _Drawing) -> Iterator[Node]:
    for name in ("water", "bridges"):
        for body in run.get(name) or ():
            yield drawing.area(body.get("rings", ()), LAYERS[name][1], 0.3)
    if outline := run.get("outline"):
        yield drawing.area(outline.get("rings", ()), LAYERS["outline"][1], 0.0)


def _drawn_voids(run: Run, drawing: _Drawing) -> Iterator[Node]:
    for void in (run.get("voids") or {}).get("largest", ()):
        rings = void.get("rings") or [_corners(void["bounds"])]
        yield drawing.area(rings, VOID_COLOUR, 0.3)


def _sheet_shapes(out: Path, number: int) -> dict[Any, Any]:
    """Return the polygons of the sheets by path, or none if the run wrote no index or the map does not draw them."""
    if not (0 < number <= MAX_SHEETS and (out / SHEETS).is_file()):
        return {}
    rows = read_features(out / SHEETS, POLYGONS, every_layer=True, may_be_empty=True).features
    return {row.attributes.get("location"): row.geometry for row in rows}


def _sheets(
    sheets: Sequence[Mapping[str, Any]], shapes: Mapping[Any, Any], drawing: _Drawing
) -> Iterator[Node]:
    """Yield the outlines of the sheets, and those names that fit into them."""
    if not 0 < len(sheets) <= MAX_SHEETS:
        return
    drawn = [shapes.get(sheet["path"]) or shapely.box(*sheet["bounds"]) for sheet in sheets]
    parts = shapely.get_parts(drawn)
    rings = [shapely.get_coordinates(r).ravel().tolist() for r in shapely.get_rings(parts)]
    yield drawing.area(rings, SHEET_COLOUR, 0.0)
    for sheet, shape in zip(sheets, drawn, strict=True):
        text = PurePosixPath(sheet["path"]).stem.removeprefix("dtm_")
        west, south, east, north = shape.bounds
        (left, _), (right, _) = drawing.at(west, south), drawing.at(east, north)
        if LETTER_WIDTH * drawing.text_size * len(text) <= right - left:
            middle = shape.representative_point()
            yield drawing.text(*drawing.at(middle.x, middle.y), text, "middle", class_="on")


def _corners(bounds: Sequence[float]) -> list[float]:
    west, south, east, north = bounds
    return [west, south, east, south, east, north, west, north, west, south]


@dataclass(frozen=True)
class _Drawing:
    """Shapes on a picture, from coordinates of the CRS. Widths of lines follow from the size of the text."""

    picture: Picture
    extent: Extent

    @property
    def text_size(self) -> float:
        return max(self.picture.size) / 45

    def at(self, x: float, y: float) -> tuple[float, float]:
        (west, south, east, north), (width, height) = self.extent, self.picture.size
        return (x - west) / (east - west) * width, (north - y) / (north - south) * height

    def area(self, rings: Rings, colour: str, opacity: float) -> Node:
        """Return rings (x, y, x, y, ...) as one path. Vertices nearer than half a pixel are one vertex."""
        parts = []
        for ring in rings:
            points = [self.at(x, y) for x, y in zip(ring[::2], ring[1::2], strict=True)]
            texts = (f"{round(2 * x) / 2:g} {round(2 * y) / 2:g}" for x, y in points)
            parts.append("M" + "L".join(text for text, _ in itertools.groupby(texts)) + "Z")
        return el(
            "path",
            d="".join(parts),
            stroke=colour,
            stroke_width=f"{self.text_size / 12:.3g}",
            fill=colour,
            fill_opacity=opacity,
            fill_rule="evenodd",
        )

    def scale_bar(self, unit: str) -> tuple[list[Node], float]:
        """Return a line of a round length below the picture with its length as text, and the width of both."""
        (west, south, east, north), (width, height) = self.extent, self.picture.size
        length = round_steps(0.0, max(east - west, north - south), BAR_STEPS)[1]
        end, y = length / (east - west) * width, height + 1.2 * self.text_size
        thickness = f"{self.text_size / 4:.3g}"
        bar = el(
            "path",
            d=f"M0 {y:.5g}H{end:.5g}",
            stroke="currentColor",
            stroke_width=thickness,
        )
        text = f"{length:,.10g} {unit}"
        start = end + self.text_size / 2
        label = self.text(start, y, text, "start", class_="beside")
        return [bar, label], start + LETTER_WIDTH * self.text_size * len(text)

    def text(self, x: float, y: float, text: str, anchor: str, class_: str) -> Node:
        size = f"{self.text_size:.3g}"
        return el(
            "text",
            text,
            x=f"{x:.5g}",
            y=f"{y:.5g}",
            font_size=size,
            text_anchor=anchor,
            class_=class_,
        )
