"""How high the water of a lake or river stands, from the terrain along its shore, and from that of the water itself.

Water stands at a low percentile of its shore, or at the median of the terrain within it where that is lower: there its
own returns made the terrain. A lake has one level, a river one at each place of its line, made to fall by isotonic
regression in whichever direction fits better.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.area import Area
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds, Lattice
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec
from tiler.core.water import RIVER, Counts, Water, lengths_along
from tiler.grid.course import course_of, mean_width, polygon_of
from tiler.store import TileStore, open_store

Floats = npt.NDArray[np.float64]

SHORE_PIXELS = 2
"""Width of the strip along the water whose heights are used."""
SHORE_PERCENT = 10
"""Percentile of the shore's heights at which the water stands: at or just below the bank."""
STATION_PIXELS = 10
"""Least distance between the places along a river where its level is estimated."""
LEAST_PIXELS = 5
"""Fewest heights of the shore, or of the water itself, from which a level is estimated."""
MOST_WITHIN = 50_000
"""About how many pixels of the water itself are used at most."""


@dataclass(frozen=True)
class LevelWater:
    """Work: estimate the level of a body of water.

    Attributes
    ----------
    body : Water
    others : tuple of Area
        Water beside it, which is no shore.
    heights : str
        The terrain.
    spec : RasterSpec
    """

    body: Water
    others: tuple[Area, ...]
    heights: str
    spec: RasterSpec

    def place(self, buckets: Lattice) -> Bounds | None:
        """Bounds of the water."""
        return self.body.area.bounds


def level_water(store_url: str, work: LevelWater) -> dict[str, Any]:
    """Find the level of a body of water; a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``shore``: pixels with a height along the water; ``body``: the water with its level (see `Water.to_json`), None
        where the shore has too few.
    """
    body = work.body
    shore, within = heights_of(open_store(store_url), work)
    found: Water | None = None
    if shore.shape[1] >= LEAST_PIXELS:
        flow = None
        if body.kind == RIVER:
            flow = _flow(body, shore, within, float(STATION_PIXELS * work.spec.lattice.size))
        level = math.floor(_level(shore[2], within[2])) if flow is None else None
        found = Water(body.number, body.kind, body.area, level, flow, body.sure)
    return {"shore": shore.shape[1], "body": None if found is None else found.to_json()}


def heights_of(store: TileStore, work: LevelWater) -> tuple[Counts, Counts]:
    """Absolute counts x, y, z of pixels with a height beside the water, and of some within it: int64 (3, n) each."""
    spec, area = work.spec, work.body.area
    pixels = polygon_of(area).area / float(spec.lattice.size) ** 2
    step = math.ceil(math.sqrt(max(pixels / MOST_WITHIN, 1.0)))
    shores, insides = [np.empty((3, 0), np.int64)], [np.empty((3, 0), np.int64)]
    pad = int(SHORE_PIXELS * spec.lattice.size) + 1
    for block in spec.blocks_within(area.bounds.pad(pad), BLOCK_PIXELS):
        wide = _padded(spec, block, SHORE_PIXELS)
        if not area.touches(spec.block_bounds(wide)):
            continue
        inside = spec.inside(wide, area)
        shore = scipy.ndimage.binary_dilation(inside, np.ones((3, 3), np.bool_), SHORE_PIXELS) & ~inside
        for other in work.others:
            shore &= ~spec.inside(wide, other)
        heights = store.read_block(work.heights, wide)
        known = np.zeros_like(shore)
        top, left = block.row - wide.row, block.col - wide.col
        known[top : top + block.height, left : left + block.width] = True
        known &= heights != np.float32(NODATA)
        some = np.zeros_like(known)
        some[(spec.north - 1 - wide.row) % step :: step, -(spec.west + wide.col) % step :: step] = True
        x, y = spec.centres(wide)
        xyz = np.stack((x, y, np.rint(heights.astype(np.float64) * COUNTS_PER_UNIT).astype(np.int64)))
        shores.append(xyz[:, shore & known])
        insides.append(xyz[:, inside & known & some])
    return np.concatenate(shores, axis=1), np.concatenate(insides, axis=1)


def _padded(spec: RasterSpec, block: Block, reach: int) -> Block:
    """A block and the pixels around it, as far as the raster reaches."""
    top, left = max(block.row - reach, 0), max(block.col - reach, 0)
    bottom = min(block.row + block.height + reach, spec.height)
    right = min(block.col + block.width + reach, spec.width)
    return Block(top, left, bottom - top, right - left)


def _level(shore: npt.NDArray[Any], within: npt.NDArray[Any]) -> float:
    """Where water stands, from heights of the terrain beside it and within it."""
    level = float(np.percentile(shore, SHORE_PERCENT))
    return min(level, float(np.median(within))) if len(within) >= LEAST_PIXELS else level


def _flow(body: Water, shore: Counts, within: Counts, least: float) -> Counts | None:
    """The line of a river with the heights of the water; None where the river is too small for a line."""
    shape = polygon_of(body.area)
    line = course_of(shape) if body.flow is None else body.flow[:, :2].astype(np.float64)
    if line is None or len(line) < 2:
        return None
    return falling_line(line, shore, within, max(least, mean_width(shape)))


def falling_line(line: Floats, shore: Counts, within: Counts, spacing: float) -> Counts:
    """A line with the heights of the water along it, which fall; int64 (n, 3), downstream.

    Parameters
    ----------
    line : float64 (n, 2)
        Absolute counts.
    shore, within : int64 (3, n)
        Heights of the terrain beside the water, and within it.
    spacing : float
        Counts between the places at which the level is looked for; each sees the terrain as far to both sides.
    """
    stations, levels = _levels_along(line, shore, within, spacing)
    falling, rising = (scipy.optimize.isotonic_regression(levels, increasing=up).x for up in (False, True))
    downstream = ((levels - falling) ** 2).sum() <= ((levels - rising) ** 2).sum()
    lengths = lengths_along(np.rint(line).astype(np.int64))
    places = np.unique(np.concatenate((lengths, stations.clip(0, lengths[-1]))))
    xy = [np.interp(places, lengths, line[:, axis]) for axis in (0, 1)]
    heights = np.interp(places, stations, falling if downstream else rising)
    found = np.rint(np.stack((*xy, heights), axis=1)).astype(np.int64)
    moved = np.concatenate(([True], (np.diff(found[:, :2], axis=0) != 0).any(axis=1)))
    flow: Counts = found[moved] if downstream else found[moved][::-1].copy()
    return flow


def _levels_along(line: Floats, shore: Counts, within: Counts, spacing: float) -> tuple[Floats, Floats]:
    """Stations along a line, counts from its start, and the level of the water at each."""
    import shapely

    shape = shapely.LineString(line)
    beside, inside = (
        shapely.line_locate_point(shape, shapely.points(xyz[0], xyz[1])) for xyz in (shore, within)
    )
    low, high = float(beside.min()), float(beside.max())
    stations = np.linspace(low, high, max(round((high - low) / spacing), 1) + 1)
    levels = np.full(len(stations), np.nan)
    for i, station in enumerate(stations):
        here = shore[2][np.abs(beside - station) <= spacing]
        if len(here) >= LEAST_PIXELS:
            levels[i] = _level(here, within[2][np.abs(inside - station) <= spacing])
    known = ~np.isnan(levels)
    if not known.any():
        return stations[:1], np.array([_level(shore[2], within[2])])
    return stations[known], levels[known]
