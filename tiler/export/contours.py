"""Contours and spot heights of the terrain as GeoPackages, made block by block from the raster in the store."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np
import scipy
import shapely

from ptd.arrays import AnyArray, Bool, Float64, Int64
from tiler.core.area import Area
from tiler.core.drawn_sheets import StoredAreas
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.raster import NODATA, Block, RasterSpec, within
from tiler.core.records import NOT_IN_DIGEST
from tiler.core.units import METRE
from tiler.export.contour_lines import (
    SHORT,
    Joiner,
    contour_block,
    default_interval,
    is_short,
    smoothed,
    smoothing_reach,
    stays,
)
from tiler.export.output_files import ContoursRecord, OutFile, SpotsRecord, new_file
from tiler.export.polygons import sheet_shape
from tiler.export.rasters import in_sheet
from tiler.io.vector import GeoPackage, geopackage
from tiler.store import TileStore

Shapes = AnyArray

LINE = 1
"""Number of the geometry type LineString in shapely."""
BLOCK = 1024
"""Side in pixels of the blocks that are read one at a time. The lines do not depend on it."""
FLOOR_M, FLOOR_FEET = Fraction(1, 4), Fraction(1)
"""Minimum default interval, in metres and, for heights in feet, in feet."""
USUAL = (0.02, 0.98)
"""Quantiles of the heights whose difference is the relief, so that one tower does not change
the interval."""
BINS = 10_000
"""Number of bins of the histogram of the heights from which these quantiles are taken."""
NO_SPOT = 2
"""Distance from water in pixels within which no spot is written."""
INDEX_EVERY = 5
"""Number of levels from one index contour to the next."""
BATCH = 500_000
"""Number of vertices that are collected before they are written."""

HIGH, LOW = "high", "low"
BESIDE = 5
"""Side in pixels of the square around a spot in which every pixel has a height, since the edge
of data is not a top."""


@dataclass(frozen=True)
class Heights:
    """Raster of heights in the store, its pixels, and the keys of the requested area and of bodies of water.

    The digest of a task includes the bodies that may change its result.
    """

    raster: str
    spec: RasterSpec
    area: str | None
    waters: str | None = field(metadata=NOT_IN_DIGEST)


@dataclass(frozen=True)
class SheetPart:
    """Sheet of a file: its pixels, and for a drawn sheet its area and those before it that overlap it."""

    spec: RasterSpec
    clip: StoredAreas | None = None


def contours_reach(sigma: float) -> int:
    """Return the distance in pixels from which heights change the contours of a sheet."""
    return math.ceil(SHORT) + max(smoothing_reach(sigma), 1)


def spots_reach(reach: int) -> int:
    """Return the distance in pixels from which heights change the spots of a sheet."""
    return max(2 * reach, NO_SPOT)


@dataclass(frozen=True)
class _Terrain:
    """Heights of a raster of the store inside the area."""

    store: TileStore
    source: Heights
    area: Area | None

    @property
    def spec(self) -> RasterSpec:
        """Pixels of the raster."""
        return self.source.spec

    def window(self, sheet: SheetPart | None, margin: int) -> Block:
        """Return the pixels of a sheet and of a margin that are in the raster, or all pixels."""
        if sheet is None:
            return Block(0, 0, self.spec.height, self.spec.width)
        top = self.spec.north - sheet.spec.north
        left = sheet.spec.west - self.spec.west
        return self.around(Block(top, left, sheet.spec.height, sheet.spec.width), margin)

    def heights(self, block: Block) -> Float64:
        """Return the heights of a block in units of the CRS, NaN outside the area and for pixels without one."""
        values = self.store.read_block(self.source.raster, block)
        is_valid = (values != np.float32(NODATA)) & self.spec.inside(block, self.area)
        return np.where(is_valid, values.astype(np.float64), np.nan)

    def around(self, block: Block, reach: int) -> Block:
        """Return the pixels of a block and ``reach`` pixels around it that are in the raster."""
        top, left = max(block.row - reach, 0), max(block.col - reach, 0)
        bottom = min(block.row + block.height + reach, self.spec.height)
        right = min(block.col + block.width + reach, self.spec.width)
        return Block(top, left, max(bottom - top, 0), max(right - left, 0))

    def land_smoothed(self, block: Block, sigma: float) -> Float64:
        """Return the heights of a block, averaged on land, where heights of water have no weight.

        Water keeps the heights of its outermost pixels and is NaN inside. So lines run around
        water, and end at the shore of a river that falls through their level.
        """
        wide = self.around(block, max(smoothing_reach(sigma), 1))
        heights = self.heights(wide)
        waters = self.store.waters(self.source.waters, self.spec.block_bounds(wide))
        if waters is None:
            smooth_heights = smoothed(heights, sigma)
        else:
            wet = waters.inside(self.spec, wide)
            smooth_heights = np.where(
                wet, heights, smoothed(np.where(wet, np.nan, heights), sigma)
            )
            smooth_heights[scipy.ndimage.binary_erosion(wet, np.ones((3, 3), np.bool_))] = (
                np.nan
            )
        return smooth_heights[within(block, wide)]

    def relief(self) -> tuple[float, float]:
        """Return the two heights between which nearly all of the terrain lies (see `USUAL`), or NaN if it is empty."""
        low, high = np.inf, -np.inf
        for heights in self._known():
            low, high = min(low, heights.min()), max(high, heights.max())
        if low >= high:
            return (np.nan, np.nan) if low > high else (float(low), float(high))
        counts = np.zeros(BINS, np.int64)
        for heights in self._known():
            counts += np.histogram(heights, BINS, (low, high))[0]
        part = np.searchsorted(np.cumsum(counts), np.array(USUAL) * counts.sum()) / BINS
        first, last = (low + part * (high - low)).tolist()
        return first, last

    def _known(self) -> Iterator[Float64]:
        """Yield the heights of each block without NaN, if there are any."""
        for block in self.spec.blocks(BLOCK):
            heights = self.heights(block)
            heights = heights[~np.isnan(heights)]
            if len(heights):
                yield heights

    def wet(self, block: Block, reach: int) -> Bool:
        """Return a mask of the pixels of a block that are within ``reach`` pixels of water."""
        top, left = max(block.row - reach, 0), max(block.col - reach, 0)
        wide = Block(
            top,
            left,
            block.row + block.height + reach - top,
            block.col + block.width + reach - left,
        )
        waters = self.store.waters(self.source.waters, self.spec.block_bounds(wide))
        if waters is None:
            return np.zeros((block.height, block.width), np.bool_)
        size = 2 * reach + 1
        near = scipy.ndimage.binary_dilation(
            waters.inside(self.spec, wide), np.ones((size, size), np.bool_)
        )
        return near[within(block, wide)]

    @property
    def decimals(self) -> int:
        """Number of decimals of the written heights, for centimetres or tenths of a foot."""
        return 2 if self.store.meta.frame.units.vertical == METRE else 1

    def places(self, pixels: Float64) -> Float64:
        """Return the coordinates of positions (column, row), given in pixels from the centre of the first pixel."""
        size = float(self.spec.lattice.size / COUNTS_PER_UNIT)
        x, y = pixels.T + 0.5
        return np.stack(((self.spec.west + x) * size, (self.spec.north - y) * size), axis=1)


def write_contours(
    store: TileStore,
    *,
    to: OutFile,
    heights: Heights,
    interval: Fraction | None,
    noise: float,
    sigma: float,
    sheet: SheetPart | None = None,
) -> ContoursRecord:
    """Write contour lines of the terrain, or those in a sheet, which are the same lines.

    Parameters
    ----------
    store : TileStore
    to : OutFile
    heights : Heights
    interval : Fraction or None
        Interval in vertical units of the CRS, or None for a default by relief and noise.
    noise : float
        Standard deviation of the heights in these units, or 0 if it is not known.
    sigma : float
        Heights are smoothed by a Gaussian with this standard deviation, in pixels.
    sheet : SheetPart or None
        Sheet to which the lines are cut.

    Returns
    -------
    ContoursRecord
        Record of the file.
    """
    terrain = _Terrain(store, heights, store.area(heights.area))
    low = high = np.nan
    if interval is None:
        low, high = terrain.relief()
        interval = _interval(terrain, low, high, noise)
    # Short rings that a sheet divides are whole in the window.
    window = terrain.window(sheet, math.ceil(SHORT))
    shape = None if sheet is None else sheet_shape(store, sheet.spec, sheet.clip)
    joiner, lines, vertices, held, short = Joiner(), 0, 0, 0, 0
    waiting: list[tuple[int, Float64]] = []
    with new_file(to) as new, geopackage(new.path, store.meta.frame.crs_wkt) as file:

        def write() -> None:
            nonlocal lines, vertices
            shapes, levels = _cut(*_shapes(terrain, waiting), shape)
            _add_lines(file, shapes, levels, interval)
            lines += len(shapes)
            vertices += int(shapely.get_num_coordinates(shapes).sum())

        for line in _lines(terrain, window, interval, sigma, joiner):
            if not _stays(terrain, sigma, interval, *line):
                short += 1
                continue
            waiting.append(line)
            held += len(line[1])
            if held > BATCH:
                write()
                waiting, held = [], 0
        write()
    return ContoursRecord(
        **new.record.to_json(),
        interval=float(interval),
        lines=lines,
        vertices=vertices,
        cut=joiner.cut,
        short=short,
        low=None if np.isnan(low) else low,
        high=None if np.isnan(high) else high,
    )


def _interval(terrain: _Terrain, low: float, high: float, noise: float) -> Fraction:
    floor = FLOOR_M if terrain.store.meta.frame.units.vertical == METRE else FLOOR_FEET
    return default_interval(0.0 if np.isnan(low) else high - low, floor, noise)


def _stays(
    terrain: _Terrain, sigma: float, interval: Fraction, level: int, places: Float64
) -> bool:
    """Return whether a line is drawn. Only short rings are left out, unless `stays` keeps them."""
    if not is_short(places):
        return True
    first, last = (
        np.floor(places.min(axis=0)).astype(int),
        np.ceil(places.max(axis=0)).astype(int),
    )
    (col, row), (width, height) = first.tolist(), (last - first + 1).tolist()
    heights = terrain.land_smoothed(Block(row, col, height, width), sigma)
    return stays(places - first, heights, float(level * interval), float(interval))


def _lines(
    terrain: _Terrain, window: Block, interval: Fraction, sigma: float, joiner: Joiner
) -> Iterator[tuple[int, Float64]]:
    """Yield the lines joined across blocks: number of the level, and vertices in pixels."""
    bottom, right = window.row + window.height, window.col + window.width
    for row in range(window.row, bottom, BLOCK):
        for col in range(window.col, right, BLOCK):
            # The block includes the first row and column of the next blocks, since lines run
            # between pixel centres.
            block = Block(row, col, min(BLOCK + 1, bottom - row), min(BLOCK + 1, right - col))
            core = terrain.land_smoothed(block, sigma)
            for piece in contour_block(core, interval, row, col):
                yield from joiner.add(piece)
        yield from joiner.end_row(row + BLOCK)


def _shapes(terrain: _Terrain, lines: list[tuple[int, Float64]]) -> tuple[Shapes, Int64]:
    """Return lines in units of the CRS, and the numbers of their levels."""
    if not lines:
        return np.empty(0, object), np.empty(0, np.int64)
    levels = np.array([level for level, _ in lines], np.int64)
    numbers = np.repeat(np.arange(len(lines)), [len(vertices) for _, vertices in lines])
    vertices = np.concatenate([vertices for _, vertices in lines])
    return shapely.linestrings(terrain.places(vertices), indices=numbers), levels


def _cut(lines: Shapes, levels: Int64, shape: Any) -> tuple[Shapes, Int64]:
    """Return the parts of lines in a shape and their levels, or all lines without one."""
    if shape is None:
        return lines, levels
    # Few lines cross the edge, and the others need no intersection with an outline that may have many corners.
    shapely.prepare(shape)
    is_inside = shapely.contains_properly(shape, lines)
    across = np.flatnonzero(~is_inside & shapely.intersects(shape, lines))
    pieces, edge = shapely.intersection(lines[across], shape), _edge_of_others(shape)
    on_edge = shapely.length(shapely.intersection(pieces, edge)) > 0
    pieces[on_edge] = shapely.difference(pieces[on_edge], edge)
    # A ring that the shape divides has one part on both sides of its first vertex.
    merged = shapely.line_merge(pieces, directed=True)
    parts, numbers = shapely.get_parts(merged, return_index=True)
    is_line = (shapely.get_type_id(parts) == LINE) & ~shapely.is_empty(parts)
    numbers = np.concatenate((np.flatnonzero(is_inside), across[numbers[is_line]]))
    order = np.argsort(numbers, kind="stable")
    return np.concatenate((lines[is_inside], parts[is_line]))[order], levels[numbers[order]]


def _edge_of_others(shape: Any) -> Any:
    """Return the sides of a sheet to its east and north, which are not part of it, as pixels on them are not."""
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(shape)))
    vertices, numbers = shapely.get_coordinates(rings, return_index=True)
    (dx, dy), is_side = np.diff(vertices, axis=0).T, np.diff(numbers) == 0
    is_side &= (dy > 0) | ((dy == 0) & (dx < 0))  # The sheet is to the left.
    starts = np.flatnonzero(is_side)
    sides = shapely.linestrings(np.stack((vertices[starts], vertices[starts + 1]), axis=1))
    return shapely.multilinestrings(sides)


def _add_lines(file: GeoPackage, lines: Shapes, levels: Int64, interval: Fraction) -> None:
    heights = levels * float(interval)
    labels = np.array([f"{height:.{_decimals(interval)}f}" for height in heights], object)
    columns = {"elevation": heights, "index": levels % INDEX_EVERY == 0, "label": labels}
    file.add("contours", "LineString", list(lines), columns)


def _decimals(interval: Fraction) -> int:
    """Return the smallest number of decimals that writes every level exactly, at most three."""
    return next((n for n in range(3) if (interval * 10**n).denominator == 1), 3)


def write_spots(
    store: TileStore,
    *,
    to: OutFile,
    heights: Heights,
    interval: Fraction | None,
    noise: float,
    reach: int,
    sheet: SheetPart | None = None,
) -> SpotsRecord:
    """Write the tops and bottoms of the terrain as points, the highest or lowest within ``reach`` pixels to each side.

    A spot belongs to the sheet that its pixel belongs to.

    The other parameters are those of `write_contours`.

    Returns
    -------
    SpotsRecord
        Record of the file.
    """
    terrain = _Terrain(store, heights, store.area(heights.area))
    interval = interval or _interval(terrain, *terrain.relief(), noise)
    window, clip = terrain.window(sheet, 0), None if sheet is None else sheet.clip
    counts = {HIGH: 0, LOW: 0}
    with new_file(to) as new, geopackage(new.path, store.meta.frame.crs_wkt) as file:
        for part in terrain.spec.window(window).blocks(BLOCK):
            block = replace(part, row=part.row + window.row, col=part.col + window.col)
            wide = terrain.around(block, 2 * reach)
            around = terrain.heights(wide)
            inner = within(block, wide)
            here = in_sheet(store, terrain.spec, clip, block)
            here &= ~terrain.wet(block, NO_SPOT)
            for kind in counts:
                is_spot = here & _spots_of_block(around, kind, reach, float(interval))[inner]
                rows, cols = np.nonzero(is_spot)
                counts[kind] += len(rows)
                pixels = np.stack((cols + block.col, rows + block.row), axis=1)
                columns = _columns_of_spots(around[inner][is_spot], kind, terrain.decimals)
                coordinates = terrain.places(pixels.astype(np.float64))
                file.add("spots", "Point", shapely.points(coordinates), columns)
    return SpotsRecord(
        **new.record.to_json(), interval=float(interval), highs=counts[HIGH], lows=counts[LOW]
    )


def _columns_of_spots(heights: Float64, kind: str, decimals: int) -> dict[str, AnyArray]:
    """Return the columns of spots of one kind, with all heights rounded to the same number of decimals."""
    labels = np.array([f"{height:.{decimals}f}" for height in heights], object)
    return {
        "elevation": np.round(heights, decimals),
        "kind": np.full(len(heights), kind, object),
        "label": labels,
    }


def _spots_of_block(heights: Float64, kind: str, reach: int, least: float) -> Bool:
    """Return a mask of the pixels that are the highest or lowest in the square around them.

    Of a flat top, it has only one pixel.

    Parameters
    ----------
    heights : float64 (h, w)
        Heights, NaN for pixels without one. A result depends on the ``2 * reach`` pixels around it.
    kind : str
        `HIGH` or `LOW`.
    reach : int
        Number of pixels from a spot to each side of its square.
    least : float
        Minimum difference between the highest and lowest height in the square, in the unit of the heights.
    """
    size, sign = 2 * reach + 1, 1.0 if kind == HIGH else -1.0
    known = ~np.isnan(heights)
    height = sign * heights
    top = scipy.ndimage.maximum_filter(np.where(known, height, -np.inf), size, mode="nearest")
    bottom = scipy.ndimage.minimum_filter(np.where(known, height, np.inf), size, mode="nearest")
    chosen = known & (height == top) & (top - bottom >= least)
    chosen &= scipy.ndimage.binary_erosion(known, np.ones((BESIDE, BESIDE), np.bool_))
    # Chosen pixels near each other have the same height, and only the first of them in the
    # raster is kept.
    number = np.where(chosen, np.arange(heights.size).reshape(heights.shape), heights.size)
    first = scipy.ndimage.minimum_filter(number, size, mode="nearest") == number
    return np.asarray(chosen & first)
