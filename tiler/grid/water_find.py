"""Finds the water of a run from the points in coarse cells and the terrain there, as polygons."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.area import Area
from tiler.core.products import BEYOND
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec
from tiler.core.water import LAKE, RIVER, Water
from tiler.grid.survey import Bools, coarse_cells, survey_of
from tiler.grid.water_cells import Cells, dense_enough, find_water, under_bridges, without_narrows
from tiler.store import TileStore, open_store

ROUND = 0.25
"""4 pi area / length of the shore squared, 1 for a disk: what has less is long, and so a river."""
LEAST_LENGTH = 3
"""A river is at least so many times as long as it is wide."""
SIMPLER = 0.75
"""Cells by which a polygon may differ from its cells, so that its shore is smooth."""


@dataclass(frozen=True)
class FindWater:
    """Work: find the water of a whole run.

    Attributes
    ----------
    heights : str
        The terrain.
    spec : RasterSpec
        Of its pixels.
    blocks : tuple of str
        Names of its blocks.
    occupancy : str
    coarse : RasterSpec
        Of the coarse cells.
    gap : float
        Cells: a gap between points up to this width may be water.
    trusted : bool
        Whether few returns are a sign of water; False: only the input's class is.
    lake_m2, river_width_m, island_m2 : float
        The smallest that are kept.
    """

    heights: str
    spec: RasterSpec
    blocks: tuple[str, ...]
    occupancy: str
    coarse: RasterSpec
    gap: float
    trusted: bool
    lake_m2: float
    river_width_m: float
    island_m2: float


def find_bodies(store_url: str, work: FindWater) -> dict[str, Any]:
    """Find bodies of water in the whole run; a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``bodies``: of each what `Water.to_json` gives, without a level.
    """
    store = open_store(store_url)
    metres = float(store.meta.frame.metres_xy)
    cells = dense_enough(_cells(store, work, float(work.coarse.lattice.size) * metres))
    times = round(cells.size / (float(work.coarse.lattice.size) * metres))
    sure = np.zeros(cells.returns.shape, np.float32)
    for found in find_water(cells, work.trusted):
        part = sure[found.window]
        part[found.cells] = np.maximum(part[found.cells], found.sure)
    water = under_bridges(cells, sure > 0) if sure.any() else sure > 0
    water = _without_islands(
        without_narrows(water, work.river_width_m / cells.size), work.island_m2 / cells.size**2
    )
    side = work.coarse.lattice.size * times
    corner = (
        float(work.coarse.west * work.coarse.lattice.size),
        float(work.coarse.north * work.coarse.lattice.size),
    )
    bodies = _bodies(work, water, sure, cells, (*corner, float(side)))
    return {"bodies": [body.to_json() for body in bodies]}


def _cells(store: TileStore, work: FindWater, size_m: float) -> Cells:
    """Returns, classes and ground of the coarse cells of a run."""
    coarse, spec = work.coarse, work.spec
    points = store.read_block(work.occupancy, Block(0, 0, coarse.height, coarse.width))
    total, number = np.zeros(points.shape), np.zeros(points.shape, np.int32)
    for key in work.blocks:
        block = spec.block_named(key, BLOCK_PIXELS)
        heights = store.read_block(work.heights, block)
        rows, cols = np.nonzero(heights != np.float32(NODATA))
        if rows.size == 0:
            continue
        cell_rows, cell_cols = coarse_cells(coarse, spec, block)
        row, col = int(cell_rows[rows].min()), int(cell_cols[cols].min())
        shape = int(cell_rows[rows].max()) + 1 - row, int(cell_cols[cols].max()) + 1 - col
        places, size = (cell_rows[rows] - row) * shape[1] + (cell_cols[cols] - col), shape[0] * shape[1]
        near = np.s_[row : row + shape[0], col : col + shape[1]]
        total[near] += np.bincount(places, heights[rows, cols], size).reshape(shape)
        number[near] += np.bincount(places, minlength=size).reshape(shape).astype(np.int32)
    known = number > 0
    ground = np.divide(total, number, out=total, where=known)
    ground[~known] = np.nan
    ground *= float(store.meta.frame.units.vertical)
    del number
    domain = survey_of(points != 0, work.gap) != BEYOND
    return Cells(np.abs(points), points < 0, ground, domain, size_m)


def _without_islands(water: Bools, least: float) -> Bools:
    """Water with enclosed land of fewer cells filled."""
    labels, number = scipy.ndimage.label(scipy.ndimage.binary_fill_holes(water) & ~water)
    small = np.bincount(labels.ravel(), minlength=number + 1) < least
    small[0] = False
    filled: Bools = water | small[labels]
    return filled


def _bodies(
    work: FindWater,
    water: Bools,
    sure: npt.NDArray[np.float32],
    cells: Cells,
    place: tuple[float, float, float],
) -> list[Water]:
    """Those areas of water that are large enough; ``place``: counts of the north-west corner, and of a cell's side."""
    labels, _ = scipy.ndimage.label(water)
    found: list[Water] = []
    for number, window in enumerate(scipy.ndimage.find_objects(labels), start=1):
        mine = labels[window] == number
        area_m2 = float(mine.sum()) * cells.size**2
        if area_m2 < min(work.lake_m2, LEAST_LENGTH * work.river_width_m**2):
            continue
        kind, width_m = _kind(mine, cells.domain, window, cells.size)
        if area_m2 < work.lake_m2 if kind == LAKE else width_m < work.river_width_m:
            continue
        area = _polygon(mine, window, place)
        known = sure[window][mine]
        found.append(Water(len(found) + 1, kind, area, None, None, round(float(known[known > 0].mean()), 2)))
    return found


def _kind(mine: Bools, domain: Bools, window: tuple[slice, ...], size_m: float) -> tuple[str, float]:
    """Lake or river, and the mean width in metres; a river is long, or leaves the survey at two places."""
    rows, cols = window
    wide = np.pad(domain, 1)[rows.start : rows.stop + 2, cols.start : cols.stop + 2]
    body = np.pad(mine, 1)
    outer = ~np.pad(scipy.ndimage.binary_fill_holes(mine), 1)
    shore, ends = 0, np.zeros_like(body)
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        edge = body & np.roll(outer, step, axis)
        beyond = edge & ~np.roll(wide, step, axis)
        shore += int((edge & ~beyond).sum())
        ends |= beyond
    _, exits = scipy.ndimage.label(scipy.ndimage.binary_dilation(ends, np.ones((5, 5), np.bool_)))
    # Faces of cells are 4 / pi times as long as a shore, in the mean of all directions.
    length = max(shore * size_m * math.pi / 4, size_m)
    area = float(mine.sum()) * size_m**2
    river = exits > 1 or 4 * math.pi * area / length**2 < ROUND
    return (RIVER if river else LAKE), 2 * area / length


def _polygon(mine: Bools, window: tuple[slice, ...], place: tuple[float, float, float]) -> Area:
    """The area of some cells, in absolute counts."""
    import shapely
    from affine import Affine
    from rasterio.features import shapes

    west, north, side = place
    rows, cols = window
    to_counts = Affine(side, 0, west + cols.start * side, 0, -side, north - rows.start * side)
    parts = [shapely.geometry.shape(s) for s, _ in shapes(mine.astype(np.uint8), mine, transform=to_counts)]
    whole = shapely.make_valid(shapely.simplify(shapely.union_all(parts), SIMPLER * side))
    polygons = [p for p in shapely.get_parts(whole) if p.geom_type == "Polygon"]
    rings = [
        tuple(np.rint(shapely.get_coordinates(r)[:-1]).astype(np.int64) for r in (p.exterior, *p.interiors))
        for p in polygons
    ]
    return Area(tuple(rings))
