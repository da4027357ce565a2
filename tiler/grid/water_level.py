"""Level of a lake or river, and pockets: low terrain beside a body of water that is water as well.

The level is estimated from the returns of the water if their heights differ little. Otherwise it is a low percentile
of the heights of the shore. A lake has one level. A river has a level at each position along its centreline
(`tiler.grid.river`).

The shore follows coarse cells. A cell with masonry or a steep bank counts as land, but its pixels next to the water
may be water. Such a pixel is water if it lies below the level and higher terrain closes off the pocket around it. Low
terrain that is not closed off within a few pixels stays terrain, and the run warns about it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy
import shapely

from ptd.arrays import Bool
from tiler.core.area import Area
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec, within
from tiler.core.water import RIVER, Counts, Water
from tiler.grid.coarse import padded, padded_within
from tiler.grid.records import LevelRecord
from tiler.grid.river import (
    MIN_PIXELS,
    SMOOTH_M,
    Profile,
    Scale,
    area_of,
    bank_level,
    centreline,
    mean_width,
    polygon_of,
    profile_along,
    water_level,
)
from tiler.grid.water_plants import REED, is_hidden
from tiler.store import TileStore

SHORE_PIXELS = 2
"""Pixels up to this distance from the water are its shore, in pixels."""
STATION_PIXELS = 10
"""The stations of a river are at least this far apart, in pixels."""
NOISE_M = 0.1
"""Ground of the shore may lie this far below the level because of noise, in metres."""
MAX_WATER_HEIGHTS = 50_000
"""About this many heights of the water are used, if there are more."""


def level_water(
    store: TileStore,
    *,
    body: Water,
    others: tuple[Area, ...],
    heights: str,
    spec: RasterSpec,
    cells: tuple[str, str, str] | None,
    coarse: RasterSpec,
    joins_pockets: bool,
) -> LevelRecord:
    """Estimate the level of a body of water.

    Parameters
    ----------
    store : TileStore
    body : Water
    others : tuple of Area
        Other water next to the body, which does not count as shore.
    heights : str
        Raster of the terrain.
    spec : RasterSpec
        Raster of the terrain's pixels.
    cells : (str, str, str) or None
        Rasters of coarse cells: the number of points, the height, and the plants over water. If this is None, the
        heights of the water are taken from the terrain instead of coarse cells.
    coarse : RasterSpec
        Raster of the coarse cells.
    joins_pockets : bool
        Whether pockets of low terrain next to the water become water. False if the user has drawn the shore.
    """
    frame = store.meta.frame
    scale = Scale(
        COUNTS_PER_UNIT / float(frame.units.horizontal),
        COUNTS_PER_UNIT / float(frame.units.vertical),
    )
    near_pixels, water = _heights_of(store, body.area, others, heights, spec)
    if cells is not None:
        water = heights_of_cells(store, body.area, coarse, *cells)
    shore = near_pixels.xyz[:, near_pixels.distance <= SHORE_PIXELS]
    levelled: Water | None = None
    if max(shore.shape[1], water.shape[1]) >= MIN_PIXELS:
        profile = None
        if body.kind == RIVER:
            profile = _profile(
                body, shore, water, float(STATION_PIXELS * spec.lattice.size), scale
            )
        if profile is not None and len(profile.stations) > 1:
            levelled = replace(body, level=None, flow=profile.flow, stations=profile.stations)
        else:
            level = water_level(water[2], scale)
            if level is None:
                level = bank_level(shore[2] if shore.shape[1] else water[2])
            levelled = replace(body, level=math.floor(level), flow=None)
    if levelled is not None and joins_pockets:
        in_pocket = pockets(levelled, near_pixels, NOISE_M * scale.z)
        if in_pocket.any():
            levelled = with_pixels(
                levelled, near_pixels.xyz[:2, in_pocket], float(spec.lattice.size)
            )
            shore = near_pixels.xyz[:, (near_pixels.distance <= SHORE_PIXELS) & ~in_pocket]
    low, high = np.percentile(water[2], (25, 75)) if water.shape[1] else (0.0, 0.0)
    return LevelRecord(
        shore=shore.shape[1],
        body=None if levelled is None else levelled.to_json(),
        floating=_floating(levelled, shore, NOISE_M * scale.z),
        uneven=levelled is not None
        and levelled.flow is None
        and bool(high - low > SMOOTH_M * scale.z),
    )


def _floating(
    body: Water | None, shore: Counts, noise: float
) -> tuple[float, list[int] | None]:
    """Return the share of the shore that lies more than ``noise`` counts below the level, and the deepest position.

    That is the position deepest below the level. It is None if the share is 0.
    """
    if body is None or not shore.shape[1]:
        return 0.0, None
    depth = body.heights(shore[0], shore[1]) - shore[2]
    share = float((depth > noise).mean())
    return share, shore[:2, int(depth.argmax())].tolist() if share else None


def _heights_of(
    store: TileStore, area: Area, others: tuple[Area, ...], raster: str, spec: RasterSpec
) -> tuple[Beside, Counts]:
    """Return the pixels next to the water, and a sample of the water in absolute counts x, y, z, int64 (3, n)."""
    pixels = polygon_of(area).area / float(spec.lattice.size) ** 2
    step = math.ceil(math.sqrt(max(pixels / MAX_WATER_HEIGHTS, 1.0)))
    beside_parts = [np.empty((6, 0), np.int64)]
    water_parts = [np.empty((3, 0), np.int64)]
    pad = int(POCKET_PIXELS * spec.lattice.size) + 1
    for block in spec.blocks_within(area.bounds.pad(pad), BLOCK_PIXELS):
        window = padded_within(block, POCKET_PIXELS, spec)
        if not area.touches(spec.block_bounds(window)):
            continue
        inside = spec.inside(window, area)
        if not inside.any():
            continue
        distance = scipy.ndimage.distance_transform_cdt(~inside, "chessboard")
        is_beside = ~inside & (distance <= POCKET_PIXELS)
        for other in others:
            is_beside &= ~spec.inside(window, other)
        heights = store.read_block(raster, window)
        # Windows overlap, so only the pixels of the block itself are used.
        known = np.zeros_like(is_beside)
        known[within(block, window)] = True
        known &= heights != np.float32(NODATA)
        x, y = spec.centres(window)
        xyz = np.stack(
            (x, y, np.rint(heights.astype(np.float64) * COUNTS_PER_UNIT).astype(np.int64))
        )
        is_beside &= known
        rows_and_columns = np.argwhere(is_beside).T + np.array([[window.row], [window.col]])
        beside_parts.append(
            np.concatenate((xyz[:, is_beside], rows_and_columns, distance[None, is_beside]))
        )
        water_parts.append(xyz[:, inside & known & _sample(spec, window, step)])
    columns = np.concatenate(beside_parts, axis=1)
    water = np.concatenate(water_parts, axis=1)
    return Beside(columns[:3], columns[3:5], columns[5]), water


def _sample(spec: RasterSpec, window: Block, step: int) -> Bool:
    """Return a mask of every ``step``-th pixel along rows and columns, on a lattice that is the same in all windows."""
    mask = np.zeros((window.height, window.width), np.bool_)
    # The rows and columns of these pixels in the lattice are multiples of ``step``.
    mask[
        (spec.north - 1 - window.row) % step :: step, -(spec.west + window.col) % step :: step
    ] = True
    return mask


def heights_of_cells(
    store: TileStore, area: Area, coarse: RasterSpec, points: str, ground: str, crowns: str
) -> Counts:
    """Return a sample of the coarse cells of the water in absolute counts x, y, z, int64 (3, n).

    The cells have returns, and are not at the shore, hidden beneath crowns or covered by reed.
    """
    xyz_parts = [np.empty((3, 0), np.int64)]
    cells = polygon_of(area).area / float(coarse.lattice.size) ** 2
    step = math.ceil(math.sqrt(max(cells / MAX_WATER_HEIGHTS, 1.0)))
    for block in coarse.blocks_within(area.bounds, BLOCK_PIXELS):
        part = coarse.part(block, area.bounds)
        # Cells at the shore are partly bank.
        inside = coarse.inside(padded(part, 1), area)
        used = scipy.ndimage.binary_erosion(inside, np.ones((3, 3), np.bool_))[1:-1, 1:-1]
        if not used.any():
            continue
        heights = store.read_block(ground, part)
        used &= _sample(coarse, part, step)
        used &= (store.read_block(points, part) != 0) & (heights != np.float32(NODATA))
        plants = store.read_block(crowns, part)
        used &= ~is_hidden(plants) & (plants < REED)
        x, y = coarse.centres(part)
        z = np.rint(heights.astype(np.float64) * COUNTS_PER_UNIT).astype(np.int64)
        xyz_parts.append(np.stack((x, y, z))[:, used])
    return np.concatenate(xyz_parts, axis=1)


def _profile(
    body: Water, shore: Counts, water: Counts, min_spacing: float, scale: Scale
) -> Profile | None:
    """Return the profile of a river, or None if the river is too small for a centreline."""
    shape = polygon_of(body.area)
    line = centreline(shape) if body.flow is None else body.flow[:, :2].astype(np.float64)
    if line is None or len(line) < 2:
        return None
    return profile_along(line, shore, water, max(min_spacing, mean_width(shape)), scale)


POCKET_PIXELS = 6
"""A pocket has to be closed off by terrain within this distance from the water, in pixels."""

OVERLAP = 0.9
"""Half the side of the square that is added to the water for a pixel, in pixels.

The squares are larger than the pixels, because the shore may lie anywhere between the centres
of two pixels.
"""


class Beside(NamedTuple):
    """Pixels within `POCKET_PIXELS` of a body of water that have a height.

    Attributes
    ----------
    xyz : int64 (3, n)
        Centres and heights in absolute counts.
    pixels : int64 (2, n)
        Rows and columns in the raster.
    distance : int64 (n,)
        Number of straight or diagonal steps to the water, at least 1.
    """

    xyz: Counts
    pixels: Counts
    distance: Counts


def pockets(body: Water, beside: Beside, noise: float) -> Bool:
    """Return the mask of the pixels in pockets, bool (n,).

    Parameters
    ----------
    body : Water
        Body with its level.
    beside : Beside
    noise : float
        The deepest pixel of a pocket is deeper than this below the level, in counts.
    """
    x, y, z = beside.xyz
    depth = body.heights(x, y) - z
    low = np.flatnonzero(depth > 0)
    is_pocket = np.zeros(len(x), np.bool_)
    if not len(low):
        return is_pocket
    pairs = scipy.spatial.cKDTree(beside.pixels[:, low].T).query_pairs(
        1, p=np.inf, output_type="ndarray"
    )
    links = scipy.sparse.coo_array((np.ones(len(pairs)), pairs.T), (len(low), len(low)))
    count, label = scipy.sparse.csgraph.connected_components(links, directed=False)
    distance = beside.distance[low]
    is_at_water = np.bincount(label, distance == 1, count) > 0
    is_open = np.bincount(label, distance >= POCKET_PIXELS, count) > 0
    is_deep = np.bincount(label, depth[low] > noise, count) > 0
    is_pocket[low] = (is_at_water & ~is_open & is_deep)[label]
    return is_pocket


def with_pixels(body: Water, centres: Counts, pixel: float) -> Water:
    """Return a body with additional pixels. ``centres`` (2, n) and the side ``pixel`` of a pixel are in counts."""
    x, y = centres
    half_side = OVERLAP * pixel
    joined = shapely.box(x - half_side, y - half_side, x + half_side, y + half_side)
    return replace(body, area=area_of(shapely.union_all([polygon_of(body.area), *joined])))
