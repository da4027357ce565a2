"""Map of the client's page: a hillshade with water, bridges, outline, voids and sheets, and a scale bar."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from tiler.core.units import short_unit
from tiler.report.document import Node, el, swatch
from tiler.report.drawn import LAYERS, round_steps
from tiler.report.pictures import Extent, Picture, raster_extent, small_hillshade
from tiler.report.places import units_of
from tiler.report.problems import Run

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


def client_map(run: Run, entries: Sequence[Mapping[str, Any]], terrain: str) -> Node:
    """Return the map as a figure.

    Parameters
    ----------
    run : mapping
        Content of run.json.
    entries : sequence of mapping
        Entries of the files in the manifest.
    terrain : str
        Path of the terrain.

    Raises
    ------
    rasterio.errors.RasterioError
        The terrain cannot be read.
    """
    picture, extent = small_hillshade(terrain, run, PIXELS), raster_extent(terrain)
    drawing = _Drawing(picture, extent)
    sheets = [e for e in entries if e.get("product") == "dtm" and "/" in e["path"]]
    width, height = picture.size
    shapes = [*_areas(run, drawing), *_voids(run, drawing), *_sheets(sheets, drawing)]
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
            "extents of the sheets" if is_drawn else f"{n_sheets:,} sheets are not drawn",
            SHEET_COLOUR,
        )


def _areas(run: Run, drawing: _Drawing) -> Iterator[Node]:
    for name in ("water", "bridges"):
        for body in run.get(name) or ():
            yield drawing.area(body.get("rings", ()), LAYERS[name][1], 0.3)
    if outline := run.get("outline"):
        yield drawing.area(outline.get("rings", ()), LAYERS["outline"][1], 0.0)


def _voids(run: Run, drawing: _Drawing) -> Iterator[Node]:
    for void in (run.get("voids") or {}).get("largest", ()):
        rings = void.get("rings") or [_corners(void["bounds"])]
        yield drawing.area(rings, VOID_COLOUR, 0.3)


def _sheets(sheets: Sequence[Mapping[str, Any]], drawing: _Drawing) -> Iterator[Node]:
    """Yield the extents of the sheets, and those names that fit into them."""
    if not 0 < len(sheets) <= MAX_SHEETS:
        return
    yield drawing.area([_corners(sheet["bounds"]) for sheet in sheets], SHEET_COLOUR, 0.0)
    for sheet in sheets:
        text = PurePosixPath(sheet["path"]).stem.removeprefix("dtm_")
        west, south, east, north = sheet["bounds"]
        (left, _), (right, _) = drawing.at(west, south), drawing.at(east, north)
        if LETTER_WIDTH * drawing.text_size * len(text) <= right - left:
            middle = drawing.at((west + east) / 2, (south + north) / 2)
            yield drawing.text(*middle, text, "middle", class_="on")


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
