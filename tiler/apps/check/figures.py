"""Drawings of a check: a histogram of the differences and a map of the checkpoints.

They are SVG, because the labels of axes need fonts, which every SVG viewer has. A plotting
library would be a dependency for only two drawings. The map contains the hillshade of the
report as a PNG.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from tiler.apps.check.accuracy import pixel_places
from tiler.apps.evaluate.rasters import files_of_raster, open_raster, raster_named
from tiler.apps.results import Accuracy
from tiler.errors import ConfigError
from tiler.io.atomic_files import atomic_path
from tiler.io.locations import as_path
from tiler.io.overwrite_check import Target, check_targets
from tiler.io.raster_files import raster_errors
from tiler.redaction import shown
from tiler.report.pictures import small_hillshade

WIDTH = 760
"""Width of the histogram and minimum width of the map, in pixels."""
HEIGHT = 420
"""Height of the histogram in pixels."""
MARGIN = 56
"""Width in pixels of the margin that contains the labels of the axes."""
BINS = 30
"""Number of bars of the histogram."""
MAP_PIXELS = 900
"""Number of pixels along the longer side of the map's hillshade."""

_STYLE = (
    "text{font:13px sans-serif;fill:#333}.axis{stroke:#888}.bar{fill:#4878a8}.out{stroke:#000;stroke-width:2}"
    ".zero{stroke:#c33;stroke-dasharray:4 3}"
)
_BELOW = (33, 102, 172)
"""Blue, for checkpoints where the DTM is too low."""
_ABOVE = (178, 24, 43)
"""Red, for checkpoints where the DTM is too high."""
_NONE = "#777"
"""Grey, for checkpoints without a height of the DTM."""

FILES = ("histogram.svg", "map.svg")


def validate_figure_files(
    folder: Path, dtm: Path, points: Path | None, strips: Sequence[str]
) -> None:
    """Raise ConfigError if `write_figures` would replace files that are not drawings of a check."""
    given = [] if points is None else [points]
    reads: list[str | Path] = [*files_of_raster(dtm), *given, *strips]
    targets = [folder / name for name in FILES]
    check_targets([Target("--figures", path) for path in targets], reads)
    for path in targets:
        if os.path.lexists(path) and not _is_drawing(path):
            raise ConfigError(
                f"{path}: already exists and is not a drawing of a check; give another folder with --figures"
            )


def _is_drawing(path: Path) -> bool:
    try:
        with open(path, "rb") as stream:
            return _STYLE.encode() in stream.read(4096)
    except OSError:
        return False


def write_figures(folder: Path | str, dtm: Path | str, accuracy: Accuracy) -> list[str]:
    """Write ``histogram.svg`` and ``map.svg`` of a result of `tiler.apps.check.check_dtm`.

    Parameters
    ----------
    folder : path
        Folder of the drawings, which is made if necessary.
    dtm : path
    accuracy : Accuracy
        Result of `tiler.apps.check.check_dtm` for this DTM.

    Returns
    -------
    list of str
        Paths of the drawings.

    Raises
    ------
    InputError
        The DTM cannot be read.
    ProcessingError
        The files cannot be written.
    """
    folder = Path(folder)
    drawings = dict(
        zip(FILES, (histogram(accuracy), point_map(as_path(dtm), accuracy)), strict=True)
    )
    with raster_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in drawings.items():
            with atomic_path(folder / name) as partial:
                partial.write_bytes(text.encode())
    return [str(folder / name) for name in drawings]


def _drawing(width: float, height: float, title: str, parts: Sequence[str]) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" '
        f'height="{height:.0f}"><title>{_escaped(title)}</title><style>{_STYLE}</style>'
        f'<rect width="100%" height="100%" fill="#fff"/>{"".join(parts)}</svg>\n'
    )


def _escaped(text: str) -> str:
    return escape(shown(text))


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{_escaped(text)}</text>'


def histogram(accuracy: Accuracy) -> str:
    """Return a histogram of the differences as SVG."""
    unit = accuracy["unit"]
    title = f"DTM minus checkpoint, {unit}"
    values = np.array(
        [p["difference"] for p in accuracy["differences"] if p["difference"] is not None]
    )
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 0.0)
    if low >= high:
        low, high = -0.5, 0.5
    counts, bounds = np.histogram(values, bins=BINS, range=(low, high))
    across = (WIDTH - 2 * MARGIN) / (bounds[-1] - bounds[0])
    up = (HEIGHT - 2 * MARGIN) / counts.max()
    base = HEIGHT - MARGIN
    parts = [
        f'<rect class="bar" x="{MARGIN + (a - bounds[0]) * across:.1f}" y="{base - n * up:.1f}" '
        f'width="{(b - a) * across - 1:.1f}" height="{n * up:.1f}"><title>{a:.3f} to {b:.3f}: {n}</title></rect>'
        for n, a, b in zip(counts, bounds[:-1], bounds[1:], strict=True)
        if n
    ]
    figures = accuracy["all"]
    caption = (
        f"{figures['points']} points, RMSE {figures['rmse']:.3f} {unit}, mean {figures['bias']:+.3f}, "
        f"median {figures['median']:+.3f}, NMAD {figures['nmad']:.3f}"
    )
    zero = MARGIN - bounds[0] * across
    parts += [
        f'<line class="axis" x1="{MARGIN}" y1="{base}" x2="{WIDTH - MARGIN}" y2="{base}"/>',
        f'<line class="zero" x1="{zero:.1f}" y1="{MARGIN / 2}" x2="{zero:.1f}" y2="{base}"/>',
        *(
            _text(MARGIN + (t - bounds[0]) * across, base + 18, f"{t:g}")
            for t in ticks(bounds[0], bounds[-1])
        ),
        *(
            _text(MARGIN - 6, base - t * up + 4, f"{t:g}", "end")
            for t in ticks(0, float(counts.max()))
            if t % 1 == 0
        ),
        _text(WIDTH / 2, HEIGHT - 12, title),
        _text(MARGIN, 22, caption, "start"),
    ]
    return _drawing(WIDTH, HEIGHT, title, parts)


def ticks(low: float, high: float) -> list[float]:
    """Return up to seven round numbers in an interval, at even distances."""
    if not high > low:
        return [low]
    rough = (high - low) / 6
    power = 10 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1, 2, 5, 10) if m * power >= rough)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(k * step, 12) for k in range(first, last + 1)]


def point_map(dtm: Path, accuracy: Accuracy) -> str:
    """Return a map of the checkpoints over a hillshade, coloured by their differences, as SVG."""
    with open_raster(dtm) as raster:
        transform, shape = raster.transform, raster.shape
    with raster_named(dtm):
        picture = small_hillshade(str(dtm), {"plan": {}}, MAP_PIXELS)
    width, height = picture.size
    parts = [f'<image width="{width}" height="{height}" href="{picture.uri}"/>']
    points = accuracy["differences"]
    x, y = np.array([(point["x"], point["y"]) for point in points]).reshape(-1, 2).T
    columns, rows = pixel_places(transform, x, y)
    largest = accuracy["all"]["p95_abs"] or 1.0
    for point, column, row in zip(
        points, columns * width / shape[1], rows * height / shape[0], strict=True
    ):
        difference = point["difference"]
        outline = ' class="out"' if point["outlier"] else ' stroke="#fff"'
        caption = "no height"
        if difference is not None:
            caption = f"{difference:+.3f} {accuracy['unit']}"
        kind = " ".join(text for text in (point["kind"], point["cover"]) if text)
        parts.append(
            f'<circle cx="{column:.1f}" cy="{row:.1f}" r="6" fill="{_colour(difference, largest)}"{outline}>'
            f"<title>{_escaped(point['name'])} ({_escaped(kind)}): {caption}</title></circle>"
        )
    legend = f"DTM minus checkpoint: blue below, red above, full at {largest:.3f} {accuracy['unit']}; outliers ringed"
    parts.append(_text(8, height + 20, legend, "start"))
    return _drawing(max(width, WIDTH), height + 32, "checkpoints", parts)


def _colour(difference: float | None, largest: float) -> str:
    if difference is None:
        return _NONE
    share = min(abs(difference) / largest, 1.0)
    end = _ABOVE if difference > 0 else _BELOW
    return "rgb({},{},{})".format(*(round(247 + (c - 247) * share) for c in end))
