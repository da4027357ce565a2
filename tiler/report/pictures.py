"""Small pictures of the rasters of a run: decimated reads, whole-number shades, paletted PNGs of limited size.

The memory does not depend on the size of the rasters. Only one picture is in memory at a time,
its values are float32, and derived values are computed in strips of rows.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from fsspec.core import url_to_fs
from rasterio.enums import Resampling
from rasterio.errors import RasterioError

from ptd.arrays import Float32, UInt8
from ptd.gridding.shape import multidirectional_hillshade
from tiler.core.products import MASK_VALUES, OUTSIDE, PRODUCTS
from tiler.core.units import short_unit
from tiler.errors import ProcessingError
from tiler.io.locations import is_url, plain_scheme
from tiler.io.raster_files import palette_png_bytes
from tiler.report.runfile import units_of

LONGER_SIDE = 1600
"""Largest number of pixels of the longer side of a picture."""

MAX_BYTES = 3 << 20
"""Maximum size in bytes of all PNG files together, which take a third more in the page. If they
are larger, smaller pictures are drawn."""

SHADES = 63
"""Number of shades of a picture. More shades are not visible, and make the file larger."""

CLIPPED_PERCENT = 0.5
"""Percentage of pixels at either end that share one colour, so that a spike does not stretch
the range."""

LEGEND_STEPS = 5

CACHE_BYTES = 16 << 20
"""GDAL's cache while a raster is read. Two rows of blocks of an overview twice as wide as a
picture fit into it. rasterio takes bytes; with less than a block, GDAL decodes each block again for
every read."""

STRIP_ROWS = 128
"""Number of rows of a picture whose slopes or colours are computed together."""

Colour = tuple[int, int, int]
Extent = tuple[float, float, float, float]

TERRAIN: tuple[Colour, ...] = (
    (44, 110, 96),
    (126, 172, 108),
    (228, 216, 146),
    (198, 146, 94),
    (150, 96, 72),
    (246, 242, 238),
)
VIRIDIS: tuple[Colour, ...] = (
    (68, 1, 84),
    (59, 82, 139),
    (33, 145, 140),
    (94, 201, 98),
    (253, 231, 37),
)
"""The colour map of matplotlib (CC0), at every quarter."""
GREY: tuple[Colour, ...] = ((16, 16, 16), (255, 255, 255))


@dataclass(frozen=True)
class Picture:
    """One raster as a picture for the page.

    Attributes
    ----------
    name : str
        Name of the product.
    title : str
    uri : str
        PNG as a data URI.
    size : (int, int)
        Width and height, pixels.
    legend : tuple of (colour, str)
    """

    name: str
    title: str
    uri: str
    size: tuple[int, int]
    legend: tuple[tuple[Colour, str], ...]


@dataclass(frozen=True)
class Pictures:
    """All pictures of a run, on one extent.

    Attributes
    ----------
    extent : tuple of float
        West, south, east, north in units of the CRS.
    pictures : tuple of Picture
    """

    extent: Extent
    pictures: tuple[Picture, ...]


def draw(rasters: Mapping[str, str], run: Mapping[str, Any]) -> Pictures | None:
    """Return pictures of the rasters of a run, or None if there is no DTM.

    Parameters
    ----------
    rasters : mapping of str to str
        Path or URL of a GeoTIFF or a VRT, by product.
    run : mapping
        Content of run.json, whose units are needed for the slopes.

    Raises
    ------
    rasterio.errors.RasterioError
        A file cannot be read.
    """
    if "dtm" not in rasters:
        return None
    longer = LONGER_SIDE
    while True:
        with rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES):
            extent = raster_extent(rasters["dtm"])
            pictures = Pictures(extent, tuple(_each(rasters, extent, run, longer)))
        taken = sum(len(picture.uri) * 3 // 4 for picture in pictures.pictures)
        if taken <= MAX_BYTES:
            return pictures
        longer = min(int(longer * math.sqrt(MAX_BYTES / taken)), longer - 1)


@contextmanager
def reading_rasters(out: Path) -> Iterator[None]:
    """Raise ProcessingError that names a folder if one of its rasters cannot be read."""
    try:
        yield
    except (RasterioError, OSError) as error:
        raise ProcessingError(
            f"{out}: a raster cannot be read ({' '.join(str(error).split())}); run again"
        ) from error


def small_hillshade(dtm: str, run: Mapping[str, Any], longer: int) -> Picture:
    """Return a hillshade of the DTM at a path or URL, at most ``longer`` pixels wide or high.

    It raises the same errors as `draw`.
    """
    with rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES):
        heights = _read(dtm, longer, Resampling.average)
        return hillshade(heights, raster_extent(dtm), run)


def _each(
    rasters: Mapping[str, str], extent: Extent, run: Mapping[str, Any], longer: int
) -> Iterator[Picture]:
    """Yield the pictures one after another, so that only one is in memory."""
    heights = _read(rasters["dtm"], longer, Resampling.average)
    yield hillshade(heights, extent, run)
    yield _heights(heights, run)
    del heights
    if "density" in rasters:
        yield _density(_read(rasters["density"], longer, Resampling.average))
    if "sigma" in rasters:
        yield _sigma(_read(rasters["sigma"], longer, Resampling.average), run)
    if "mask" in rasters:
        yield _mask(_read(rasters["mask"], longer, Resampling.nearest))


def _picture(
    name: str,
    title: str,
    values: UInt8,
    colours: Mapping[int, Colour],
    legend: Sequence[tuple[Colour, str]],
) -> Picture:
    """Return a picture of values from 0 (no data) to `SHADES`."""
    height, width = values.shape
    data = base64.b64encode(palette_png_bytes(values, colours)).decode("ascii")
    return Picture(name, title, f"data:image/png;base64,{data}", (width, height), tuple(legend))


def open_raster(place: str) -> Any:
    """Open a raster. At a URL, only parts of the file are fetched, because the overviews are small."""
    return (
        rasterio.open(place, opener=url_to_fs(plain_scheme(place))[0])
        if is_url(place)
        else rasterio.open(place)
    )


def raster_extent(place: str) -> Extent:
    """Return west, south, east and north of a raster."""
    with open_raster(place) as raster:
        return tuple(raster.bounds)


def _read(place: str, longer: int, resampling: Resampling) -> Float32:
    """Read pixels, with NaN for nodata, from the overviews of a large raster, block by block."""
    with open_raster(place) as raster:
        shrink = max(max(raster.shape) / longer, 1.0)
        shape = tuple(max(round(side / shrink), 1) for side in raster.shape)
        if raster.driver == "VRT" and shrink > 1:
            return _read_sheets(raster, shape, resampling)
        return _values(raster, shape, resampling)


def _values(raster: Any, shape: tuple[int, ...], resampling: Resampling) -> Float32:
    values: Float32 = raster.read(1, out_shape=shape, resampling=resampling).astype(
        np.float32, copy=False
    )
    if raster.nodata is not None:
        values[values == np.float32(raster.nodata)] = np.nan
    return values


def _read_sheets(vrt: Any, shape: tuple[int, ...], resampling: Resampling) -> Float32:
    """Read a VRT from the overviews of its sheets, because GDAL would read all pixels between the sheets as well."""
    values = np.full(shape, np.nan, np.float32)
    down, across = (side / whole for side, whole in zip(shape, vrt.shape, strict=True))
    for path in vrt.files:
        if path == vrt.name:
            continue
        with rasterio.open(path) as sheet:
            transform, (left, bottom, right, top) = vrt.transform, sheet.bounds
            rows = [round((y - transform.f) / transform.e * down) for y in (top, bottom)]
            cols = [round((x - transform.c) / transform.a * across) for x in (left, right)]
            row, col = min(rows[0], shape[0] - 1), min(cols[0], shape[1] - 1)
            end_row, end_col = max(rows[1], row + 1), max(cols[1], col + 1)
            sheet_values = _values(sheet, (end_row - row, end_col - col), resampling)
        window = values[row:end_row, col:end_col]
        sheet_values = sheet_values[: window.shape[0], : window.shape[1]]
        window[np.isfinite(sheet_values)] = sheet_values[np.isfinite(sheet_values)]
    return values


def _strips(rows: int) -> Iterator[slice]:
    for first in range(0, rows, STRIP_ROWS):
        yield slice(first, min(first + STRIP_ROWS, rows))


def hillshade(
    heights: Float32, extent: Extent, run: Mapping[str, Any], like: Float32 | None = None
) -> Picture:
    """Draw a hillshade of the decimated heights, as details smaller than a pixel of the picture are not visible.

    Its scale of greys is that of a picture of the heights ``like`` in the same extent, by default its own.
    """
    shade = _shade(heights, extent, run)
    low, high = _range(shade if like is None else _shade(like, extent, run))
    return _ramp("hillshade", "Hillshade", shade, min(low, 120.0), max(high, 200.0), GREY, None)


def _shade(heights: Float32, extent: Extent, run: Mapping[str, Any]) -> Float32:
    west, south, east, north = extent
    wide_m, high_m = units_of(run)
    rows, columns = heights.shape
    across = (east - west) / columns * wide_m
    down = (north - south) / rows * wide_m
    shade = np.empty(heights.shape, np.float32)
    for strip in _strips(rows):
        # a row of neighbours on either side
        first, last = max(strip.start - 1, 0), min(strip.stop + 1, rows)
        part = heights[first:last] * np.float32(high_m)
        level = np.where(np.isfinite(part), np.float32(0.0), np.float32(np.nan))
        to_south = np.gradient(part, down, axis=0) if rows > 1 else level
        to_east = np.gradient(part, across, axis=1) if columns > 1 else level
        inner = slice(strip.start - first, strip.stop - first)
        shade[strip] = multidirectional_hillshade(to_east[inner], -to_south[inner])
    return shade


def _heights(heights: Float32, run: Mapping[str, Any]) -> Picture:
    unit = short_unit(units_of(run)[1])
    low, high = _range(heights)
    decimals = 0 if high - low >= 50 else 1 if high - low >= 5 else 2
    return _ramp(
        "dtm",
        "Terrain height",
        heights,
        low,
        high,
        TERRAIN,
        lambda v: f"{v:,.{decimals}f} {unit}",
    )


def _density(density: Float32) -> Picture:
    """Draw the density with logarithmic shades, so that forest clearings and overlaps of strips are both visible."""
    density[density <= 0] = np.nan
    logarithms = np.log10(density, out=density)
    low, high = _range(logarithms)
    return _ramp(
        "density",
        "Ground points per m2",
        logarithms,
        low,
        high,
        VIRIDIS,
        lambda v: f"{10**v:.3g}",
    )


def _sigma(sigma: Float32, run: Mapping[str, Any]) -> Picture:
    """Draw standard errors with logarithmic shades, so that errors of centimetres and of metres are both visible."""
    unit = short_unit(units_of(run)[1])
    logarithms = np.log10(sigma, out=sigma)
    low, high = _range(logarithms)
    return _ramp(
        "sigma",
        "Standard error",
        logarithms,
        low,
        high,
        VIRIDIS,
        lambda v: f"{10**v:.2g} {unit}",
    )


def _mask(mask: Float32) -> Picture:
    product = PRODUCTS["mask"]
    values = np.nan_to_num(mask, copy=False, nan=OUTSIDE).astype(np.uint8)
    legend = [(product.colours[v], text) for v, text in MASK_VALUES.items() if v != OUTSIDE]
    return _picture("mask", "Source of heights", values, product.colours, legend)


def _range(values: Float32) -> tuple[float, float]:
    there = values[np.isfinite(values)]
    if there.size == 0:
        return 0.0, 1.0
    low, high = np.percentile(there, (CLIPPED_PERCENT, 100 - CLIPPED_PERCENT))
    return float(low), float(high)


def _ramp(
    name: str,
    title: str,
    values: Float32,
    low: float,
    high: float,
    stops: tuple[Colour, ...],
    text: Callable[[float], str] | None,
) -> Picture:
    indexed = np.zeros(values.shape, np.uint8)
    for strip in _strips(len(values)):
        share = np.clip(
            (values[strip] - np.float32(low)) / np.float32(max(high - low, 1e-9)), 0.0, 1.0
        )
        there = np.isfinite(share)
        indexed[strip][there] = 1 + np.rint(share[there] * (SHADES - 1)).astype(np.uint8)
    colours = {i + 1: ramp_colour(stops, i / (SHADES - 1)) for i in range(SHADES)}
    shares = [i / (LEGEND_STEPS - 1) for i in range(LEGEND_STEPS)]
    legend = (
        [(ramp_colour(stops, s), text(low + s * (high - low))) for s in shares] if text else []
    )
    return _picture(name, title, indexed, colours, legend)


def css(colour: Colour) -> str:
    """Return a colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def ramp_colour(stops: tuple[Colour, ...], share: float) -> Colour:
    """Return the colour at a share, 0 to 1, of a ramp with equally spaced stops."""
    position = share * (len(stops) - 1)
    i = min(int(position), len(stops) - 2)
    red, green, blue = (
        round(a + (position - i) * (b - a)) for a, b in zip(stops[i], stops[i + 1], strict=True)
    )
    return red, green, blue
