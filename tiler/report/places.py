"""Reading of what the cards of places to review show: heights of the terrain, the suggested edit, and points."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import shapely
from rasterio.enums import Resampling
from rasterio.transform import rowcol

from ptd.arrays import Bool, Float32, Float64
from tiler.core.crs import crs_in_file
from tiler.core.edits import FLAT, NOT_GROUND, VOID
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.points import GROUND, LABELS, UNCERTIFIED_BIT
from tiler.core.review import FIXED, NUMBERS, OPEN, TEXTS, is_place
from tiler.errors import StoreError
from tiler.io.locations import storage_errors
from tiler.io.vector import POLYGONS, Feature, read_in_crs
from tiler.io.vector.reading import read_features
from tiler.report.cards import Card, Section
from tiler.report.pictures import CACHE_BYTES, Extent
from tiler.report.runfile import units_of
from tiler.store import TileStore, open_store

MARGIN = 0.75
"""Width of the land around a place in a picture, as a share of the longer side of the place."""
LEAST_MARGIN_M = 15.0
LONGEST_SECTION_M = 400.0
"""Length to which the section of a wide place is shortened."""
STRIP_M = 1.0
"""Width of the strip whose points a section shows. It is wider if the pixels of the terrain are."""
PIECE_M = 20.0
"""Length of the pieces in which the points of a section are read, so that a slanted section reads few others."""
SAMPLES = 400
"""Number of positions of the terrain in a section."""
PIECES = 4
"""Number of windows in which the terrain of a section is read."""
CERTIFIED = np.uint8(~UNCERTIFIED_BIT & 0xFF)
"""Bits of a label that are its class."""
MOST_CORNERS = 20_000
"""Largest number of corners of a place on which the user can decide in the page."""


@dataclass(frozen=True)
class Detail:
    """Largest numbers of places, of pixels of a side of a picture, and of points of a section (ground and others each).

    Of more points, every n-th is shown.
    """

    places: int
    pixels: int = 256
    points: int = 1500


@dataclass(frozen=True)
class OpenPlaces:
    """Cards of the first open places of a run, number of all open places, and CRS of the outlines.

    ``kept`` has the columns and outlines, as GeoJSON, of what the user decided before: a later file of decisions has to
    contain it.
    """

    cards: list[Card]
    number: int
    crs: str | None
    kept: list[tuple[dict[str, Any], str]]


def read_open_places(
    path: Path,
    dtm: str,
    run: Mapping[str, Any],
    store_url: str,
    detail: Detail,
    edits: Path | None = None,
) -> OpenPlaces:
    """Read what the cards of the first open places show.

    Parameters
    ----------
    path : Path
        File of the places.
    dtm : str
        Path of the terrain.
    run : mapping
        Content of run.json.
    store_url : str
        Location of the store. Without a store, sections have no points.
    detail : Detail
    edits : Path, optional
        Another file of edits that the run used.

    Raises
    ------
    InputError
        A file of places or edits cannot be read.
    rasterio.errors.RasterioError
        The terrain cannot be read.
    """
    found = read_features(path, POLYGONS, every_layer=True, may_be_empty=True)
    rows = [row for row in found.features if is_place(row.layer, row.attributes)]
    features = sorted((row for row in rows if _status(row) == OPEN), key=_rank)
    kept = [_kept(row, status=_status(row)) for row in rows if _status(row) != OPEN]
    if edits is not None:
        wkt = None if found.crs is None else crs_in_file(found.crs).to_wkt()
        drawn = read_in_crs(edits, POLYGONS, wkt, may_be_empty=True).features
        own = [row for row in drawn if not is_place(row.layer, row.attributes)]
        # Of overlapping edits the last one counts.
        kept = [*(_kept(row, status=FIXED, z=row.height()) for row in own), *kept]
    with open_survey(dtm, run, store_url, detail) as survey:
        cards = [place_card(feature, survey) for feature in features[: detail.places]]
    return OpenPlaces(cards, len(features), found.crs, kept)


def _opened(store_url: str) -> TileStore | None:
    """Return the store, or None if it is not there or cannot be read."""
    try:
        with storage_errors():
            return open_store(store_url)
    except (StoreError, OSError):
        return None


def _status(row: Feature) -> str:
    return str(row.attributes.get("status") or FIXED).strip().lower()


def _number(row: Feature, name: str) -> float | None:
    value = row.attributes.get(name)
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _rank(row: Feature) -> float:
    rank = _number(row, "rank")
    return math.inf if rank is None else rank


def _columns(row: Feature) -> dict[str, Any]:
    """Return the columns of a place. Values of another type, which a user may have given, are empty."""
    texts = {name: row.attributes.get(name) for name in TEXTS}
    rank = _number(row, "rank")
    return {
        **{name: text if isinstance(text, str) else "" for name, text in texts.items()},
        **{name: _number(row, name) for name in NUMBERS},
        "rank": None if rank is None else int(rank),
    }


def _kept(row: Feature, **changed: Any) -> tuple[dict[str, Any], str]:
    return {**_columns(row), **changed}, str(shapely.to_geojson(row.geometry))


@dataclass(frozen=True)
class Survey:
    """Open terrain of a run, its store, the classes that are ground if the run keeps them, metres per unit, detail."""

    terrain: Any
    store: TileStore | None
    kept: Sequence[int] | None
    metres: float
    detail: Detail


@contextmanager
def open_survey(
    dtm: str, run: Mapping[str, Any], store_url: str, detail: Detail
) -> Iterator[Survey]:
    """Open the terrain and the store of a run, see `read_open_places`."""
    settings = run.get("configuration") or {}
    classes = settings.get("ground_classes") if settings.get("method") == "keep" else None
    with rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES), rasterio.open(dtm) as raster:
        yield Survey(raster, _opened(store_url), classes, units_of(run)[0], detail)


def place_card(
    feature: Feature, survey: Survey, around: tuple[float, float, float, float] | None = None
) -> Card:
    """Return what the card of a place shows. Its picture has the bounds ``around``, by default those of the place."""
    shape, columns = feature.geometry, _columns(feature)
    extent, before = _heights_around(survey, around or shape.bounds)
    west, south, east, north = extent
    rows, cols = before.shape
    x = west + (np.arange(cols) + 0.5) * (east - west) / cols
    y = north - (np.arange(rows) + 0.5) * (north - south) / rows
    inside = shapely.contains_xy(shape, *np.meshgrid(x, y))
    after = _edited(before, inside, columns)
    ends = _within(section_ends(shape, survey.metres), extent)
    pixel = abs(survey.terrain.transform.a)
    rings = [ring for part in shapely.get_parts(shape) for ring in shapely.get_rings(part)]
    outline = tuple(
        shapely.get_coordinates(ring) for ring in shapely.simplify(rings, pixel / 2)
    )
    is_small = shapely.get_num_coordinates(shape) <= MOST_CORNERS
    west_of, south_of, east_of, north_of = shape.bounds
    return Card(
        columns=columns,
        middle=((west_of + east_of) / 2, (south_of + north_of) / 2),
        outline=outline,
        ends=ends,
        geometry=shapely.to_geojson(shape) if is_small else None,
        extent=extent,
        before=before,
        after=after,
        section=_section(shape, ends, extent, after, columns, survey),
    )


def _heights_around(
    survey: Survey, bounds: tuple[float, float, float, float]
) -> tuple[Extent, Float32]:
    """Return the extent of the picture of a place, and the heights in it, NaN where there is none."""
    raster, (west, south, east, north) = survey.terrain, bounds
    margin = max(MARGIN * max(east - west, north - south), LEAST_MARGIN_M / survey.metres)
    transform, pixel_x, pixel_y = raster.transform, raster.transform.a, -raster.transform.e
    left = max(math.floor((west - margin - transform.c) / pixel_x), 0)
    left = min(left, raster.width - 1)
    right = min(math.ceil((east + margin - transform.c) / pixel_x), raster.width)
    top = max(math.floor((transform.f - north - margin) / pixel_y), 0)
    top = min(top, raster.height - 1)
    bottom = min(math.ceil((transform.f - south + margin) / pixel_y), raster.height)
    right, bottom = max(right, left + 1), max(bottom, top + 1)
    shrink = max(
        (right - left) / survey.detail.pixels, (bottom - top) / survey.detail.pixels, 1.0
    )
    shape = tuple(max(round(side / shrink), 1) for side in (bottom - top, right - left))
    part = raster.read(
        1,
        window=((top, bottom), (left, right)),
        out_shape=shape,
        masked=True,
        resampling=Resampling.average,
    )
    extent = (
        transform.c + left * pixel_x,
        transform.f - bottom * pixel_y,
        transform.c + right * pixel_x,
        transform.f - top * pixel_y,
    )
    return extent, part.astype(np.float32).filled(np.nan)


def _edited(before: Float32, inside: Bool, columns: Mapping[str, Any]) -> Float32 | None:
    """Return the heights after the suggested edit, or None if there is none, or the page cannot show it."""
    action, z = columns.get("action"), columns.get("z")
    if action == VOID:
        return np.where(inside, np.float32(np.nan), before)
    if action == FLAT and isinstance(z, int | float):
        return np.where(inside, np.float32(z), before)
    if action == NOT_GROUND:
        return bridged(before, inside)
    return None


def bridged(heights: Float32, inside: Bool) -> Float32 | None:
    """Return heights that are interpolated from the rim across the pixels ``inside``, or None without a rim.

    A run interpolates from the ground points around, so its heights differ a little.
    """
    # Every command that writes a report would import these, which takes a fifth of its start.
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
    from scipy.ndimage import binary_dilation

    rim = binary_dilation(inside, iterations=2) & ~inside & np.isfinite(heights)
    rows, cols = np.nonzero(rim)
    if not rows.size:
        return None
    at, wanted = np.stack((rows, cols), axis=1), np.argwhere(inside)
    filled = NearestNDInterpolator(at, heights[rim])(wanted)
    if np.ptp(rows) and np.ptp(cols):
        linear = LinearNDInterpolator(at, heights[rim])(wanted)
        filled = np.where(np.isfinite(linear), linear, filled)
    after = heights.copy()
    after[inside] = filled
    return after


def section_ends(shape: Any, metres: float) -> Float64:
    """Return both ends of the section of a place: across its shorter side, with land on both sides.

    Parameters
    ----------
    shape : shapely polygon or multipolygon
    metres : float
        Metres in a unit of the coordinates.

    Returns
    -------
    float64, shape (2, 2)
        x and y of each end.
    """
    if not shape.area:
        shape = shape.buffer(0.5 / metres)
    corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(shape))[:4]
    sides = np.diff(corners[:3], axis=0)
    lengths = np.hypot(*sides.T)
    short = int(np.argmin(lengths))
    direction = sides[short] / lengths[short]
    middle = shape.centroid if shape.contains(shape.centroid) else shape.representative_point()
    margin = max(MARGIN * lengths[short], LEAST_MARGIN_M / metres)
    length = min(lengths[short] + 2 * margin, LONGEST_SECTION_M / metres)
    centre = shapely.get_coordinates(middle)[0]
    return np.stack((centre - direction * length / 2, centre + direction * length / 2))


def _within(ends: Float64, extent: Extent) -> Float64:
    """Return the ends of the part of a section that lies in the picture."""
    part = shapely.intersection(shapely.LineString(ends), shapely.box(*extent))
    corners = shapely.get_coordinates(part)
    return ends if len(corners) < 2 else corners[[0, -1]]


def _section(
    shape: Any,
    ends: Float64,
    extent: Extent,
    after: Float32 | None,
    columns: Mapping[str, Any],
    survey: Survey,
) -> Section:
    length = float(np.hypot(*(ends[1] - ends[0])))
    at = (np.arange(SAMPLES) + 0.5) * length / SAMPLES
    positions = ends[0] + np.outer(at / length, ends[1] - ends[0])
    inside = shapely.contains_xy(shape, *positions.T)
    # Pictures of wide places have large pixels, so the heights come from the raster.
    line = terrain_at(survey.terrain, positions)
    edited = None
    if after is not None and columns["action"] != VOID:
        edited = np.where(inside, _sampled(after, extent, positions), np.nan)
    width = max(STRIP_M / survey.metres, abs(survey.terrain.transform.a))
    points = _points(survey, ends, width)
    return Section(
        length=length,
        at=at,
        before=line,
        after=edited if edited is not None and np.isfinite(edited).any() else None,
        inside=inside,
        ground=points[0],
        others=points[1],
        width=width if survey.store is not None and points[0].size + points[1].size else 0.0,
    )


def terrain_at(raster: Any, positions: Float64) -> Float64:
    """Return the height of the pixel at each position along a line, NaN where there is none.

    Parameters
    ----------
    raster : rasterio.DatasetReader
    positions : float64, shape (n, 2)
        x and y. Each window that is read contains a quarter of them.

    Returns
    -------
    float64, shape (n,)
    """
    # Older versions of rasterio return whole numbers as floats.
    rows, cols = (np.asarray(n, np.int64) for n in rowcol(raster.transform, *positions.T))
    heights = np.full(len(positions), np.nan)
    is_there = (rows >= 0) & (rows < raster.height) & (cols >= 0) & (cols < raster.width)
    # The windows of pieces hold far fewer pixels than one around a whole slanted line.
    for piece in np.array_split(np.flatnonzero(is_there), PIECES):
        if piece.size:
            top, left = rows[piece].min(), cols[piece].min()
            window = (top, rows[piece].max() + 1), (left, cols[piece].max() + 1)
            part = raster.read(1, window=window, masked=True)
            found = part[rows[piece] - top, cols[piece] - left]
            heights[piece] = found.astype(np.float64).filled(np.nan)
    return heights


def _points(survey: Survey, ends: Float64, width: float) -> tuple[Float64, Float64]:
    """Return the points of a section, or none if the store is not there or is damaged."""
    none = np.empty((2, 0))
    if survey.store is None:
        return none, none
    try:
        ground, others = points_near(survey.store, ends, width, survey.kept)
    except StoreError:
        return none, none
    most = survey.detail.points
    return _thinned(ground, most), _thinned(others, most)


def _sampled(heights: Float32, extent: Extent, positions: Float64) -> Float64:
    """Return the height of the pixel at each position, NaN beyond the picture."""
    west, south, east, north = extent
    rows, cols = heights.shape
    col = np.floor((positions[:, 0] - west) / (east - west) * cols).astype(np.int64)
    row = np.floor((north - positions[:, 1]) / (north - south) * rows).astype(np.int64)
    is_there = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
    found = np.full(len(positions), np.nan)
    found[is_there] = heights[row[is_there], col[is_there]]
    return found


def points_near(
    store: TileStore, ends: Float64, width: float, kept: Sequence[int] | None = None
) -> tuple[Float64, Float64]:
    """Return positions and heights of the ground points and of the other points in a strip along a section.

    Parameters
    ----------
    store : TileStore
    ends : float64, shape (2, 2)
        x and y of both ends of the section.
    width : float
        Width of the strip, in units of the CRS.
    kept : sequence of int, optional
        Classes of the input that are ground, for a run that keeps them. By default the labels of the filter say it.

    Returns
    -------
    ground, others : float64, shape (2, n)
        Distance from the first end and height, each point once.
    """
    frame = store.meta.frame
    columns = ("xyz",) if kept is None else ("xyz", "classification")
    labels, ground_classes = (LABELS, (GROUND,)) if kept is None else (None, kept)
    whole = ends[1] - ends[0]
    length = float(np.hypot(*whole))
    along_x, along_y = whole / length
    number = max(math.ceil(length * float(frame.units.horizontal) / PIECE_M), 1)
    edges = np.linspace(0.0, length, number + 1)
    found = []
    for first, last in itertools.pairwise(edges.tolist()):
        corners = ends[0] + np.outer((first, last), (along_x, along_y))
        low = np.floor((corners.min(axis=0) - width) * COUNTS_PER_UNIT).astype(int).tolist()
        high = np.ceil((corners.max(axis=0) + width) * COUNTS_PER_UNIT).astype(int).tolist()
        block = store.window(Bounds(*low, *high), columns, labels=labels)
        classes = block.classification if block.labels is None else block.labels & CERTIFIED
        is_ground = np.isin(np.asarray(classes), ground_classes)
        x, y, z = frame.coordinates(block.xyz).T
        along = (x - ends[0, 0]) * along_x + (y - ends[0, 1]) * along_y
        aside = (x - ends[0, 0]) * along_y - (y - ends[0, 1]) * along_x
        near = (along >= first) & (along < last) & (np.abs(aside) <= width / 2)
        found.append(np.stack((along, z, is_ground))[:, near])
    points = np.concatenate(found, axis=1)
    is_ground = points[2] > 0
    return points[:2, is_ground], points[:2, ~is_ground]


def _thinned(points: Float64, most: int) -> Float64:
    return points[:, :: max(math.ceil(points.shape[1] / most), 1)]
