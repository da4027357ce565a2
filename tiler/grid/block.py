"""One block of a raster: heights at pixel centres on the TIN of the ground points around it.

The pixels depend on the data alone, not on the block or its halo: a facet fills a pixel only if its longest edge
and its circumradius stay within a limit, so data farther than twice that limit have no say, and every pixel
that closer data beyond the window could change is marked. A block with marks is done again with more halo.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, replace
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.gridding.idw import inverse_distance
from ptd.tin import Pixels, Raster, Tin, Window, rasterise
from ptd.tin.mesh import MAX_EXTENT
from tiler.core.edits import OF_PIXELS
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.points import PointBlock
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.errors import ProcessingError
from tiler.grid.checksum import checksum
from tiler.grid.ground import Ground, central_points, ranked_points, read_ground
from tiler.grid.work import GridBlock, TinBlock
from tiler.store import TileStore, open_store

SMALLEST_PART = 32
"""Pixels a side below which a block is not divided any more."""


WIDEST_WINDOW = MAX_EXTENT // 2
"""Counts of a window's side from which on a block is divided, so that the TIN is exact."""


def full_halo(max_edge: Fraction) -> int:
    """Counts of halo with which no pixel of a block is ever marked, for a limit in counts.

    A facet's circle reaches at most two radii from a pixel inside of it; the rest covers rounding.
    """
    return math.ceil(2 * max_edge * (1 + Fraction(1, 1 << 19))) + 4


def grid_block(store_url: str, work: GridBlock) -> dict[str, Any]:
    """Write one block of a raster; a `tiler.schedule.task.Work`.

    Parameters
    ----------
    store_url : str
    work : GridBlock

    Returns
    -------
    dict
        ``pixels``, ``filled``, ``nodata``; ``marked`` (pixels that more data could change); ``tries``, ``halo``
        (counts) of the last one, and its ``ground_read``, ``ground_used``, ``ground_marked`` points; ``checksum``.

    Raises
    ------
    ProcessingError
        The window is too wide for the TIN, or the resolution too odd a fraction of the CRS's unit.
    """
    store = open_store(store_url)
    heights, record = _in_parts(store, work)
    edited = edit_heights(store, work.rule.edits, work.spec, work.block, heights)
    if edited:
        filled = int(np.count_nonzero(heights != np.float32(NODATA)))
        record |= {"filled": filled, "nodata": heights.size - filled, "edited": edited}
    store.write_block(work.name, work.block, heights)
    return {**record, "checksum": checksum(heights)}


Heights = npt.NDArray[np.float32]
Counts = npt.NDArray[np.int32]
Index = npt.NDArray[np.intp]


def edit_heights(
    store: TileStore, key: str | None, spec: RasterSpec, block: Block, heights: Heights
) -> list[tuple[int, int]]:
    """Set heights that corrections say; number of each that touches the block, and how many pixels it changed."""
    edits = None if key is None else store.edits(key, spec.block_bounds(block), OF_PIXELS)
    return [] if edits is None else edits.set_heights(spec, block, heights)


def _in_parts(store: TileStore, work: GridBlock) -> tuple[Heights, dict[str, Any]]:
    """As `block_heights`, in quarters where the window is too wide or too full; same pixels."""
    if _too_wide(work, work.halo) and not store.buckets_within(_window(work, full_halo(work.max_edge))):
        return _nothing(work.block, work.halo)
    if _too_full(store, work, work.halo):
        return _in_quarters(store, work)
    return block_heights(store, work)


def _nothing(block: Block, halo: int) -> tuple[Heights, dict[str, Any]]:
    """What `block_heights` would find far from all points."""
    heights = np.full((block.height, block.width), NODATA, np.float32)
    none = dict.fromkeys(("filled", "marked", "ground_read", "ground_used", "ground_marked"), 0)
    return heights, {"pixels": heights.size, "nodata": heights.size, **none, "tries": 1, "halo": halo}


def _window(work: GridBlock, halo: int) -> Bounds:
    return work.spec.block_bounds(work.block).pad(halo)


def _too_wide(work: GridBlock, halo: int) -> bool:
    """Whether a block's window is too wide for a TIN."""
    window = _window(work, halo)
    return max(window.x1 - window.x0, window.y1 - window.y0) >= WIDEST_WINDOW


def _too_full(store: TileStore, work: GridBlock, halo: int) -> bool:
    """Whether a block's window is too wide, or too full: of points the smallest part may hold any number."""
    side = max(work.block.height, work.block.width)
    if side > 1 and _too_wide(work, halo):
        return True
    if work.max_points is None or side <= SMALLEST_PART:
        return False
    held = [info.n for info in store.buckets_within(_window(work, halo)).values()]
    if work.thin is not None:
        most = math.ceil(store.meta.bucket.size / work.thin.size + 1) ** 2
        held = [min(points, most) for points in held]
    return sum(held) > work.max_points


def _in_quarters(store: TileStore, work: GridBlock) -> tuple[Heights, dict[str, Any]]:
    """A block, quarter by quarter."""
    row, col, height, width = astuple(work.block)
    heights = np.empty((height, width), np.float32)
    total: dict[str, Any] = {}
    for top, tall in ((0, height // 2), (height // 2, height - height // 2)):
        for left, wide in ((0, width // 2), (width // 2, width - width // 2)):
            if tall == 0 or wide == 0:
                continue
            part, record = _in_parts(store, replace(work, block=Block(row + top, col + left, tall, wide)))
            heights[top : top + tall, left : left + wide] = part
            total = {
                k: (max if k in ("tries", "halo") else int.__add__)(total.get(k, 0), v)
                for k, v in record.items()
            }
    return heights, total


def block_heights(store: TileStore, work: GridBlock) -> tuple[Heights, dict[str, Any]]:
    """Heights of any block, and the record, but for the checksum; see `grid_block`.

    Where marks ask for a wider window and that would hold too many points, quarters of the block go on.

    Returns
    -------
    heights : float32, shape (height, width)
        Vertical units of the CRS, `NODATA` where there is none.
    record : dict
    """
    bounds = work.spec.block_bounds(work.block)
    max_halo = work.max_halo or full_halo(work.max_edge)
    halo = min(max(work.halo, math.ceil(work.spec.lattice.size)), max_halo)
    tries = 1
    while True:
        heights, record = _attempt(store, work, bounds.pad(halo))
        if record["marked"] == 0 or halo >= max_halo:
            return heights, {**record, "tries": tries, "halo": halo}
        halo, tries = min(2 * halo, max_halo), tries + 1
        if _too_full(store, work, halo):
            heights, record = _in_quarters(store, work)
            return heights, {**record, "tries": record["tries"] + 1}


def _attempt(store: TileStore, work: GridBlock, window: Bounds) -> tuple[Heights, dict[str, Any]]:
    """Heights of a block from what a window holds, and the record."""
    ground, xyz = _ground(store, work, window)
    if work.breaklines is not None:
        lines = store.breaklines(work.breaklines)
        xyz = lines.applied(xyz, window, work.data, store.meta.frame.origin)
    raster = rasterise_window(store, work, window, xyz)
    heights = heights_in_units(raster)
    filled = int(np.count_nonzero(heights != np.float32(NODATA)))
    return heights, {
        "pixels": heights.size,
        "filled": filled,
        "nodata": heights.size - filled,
        "marked": int(raster.marks.sum()),
        "ground_read": ground.read,
        "ground_used": xyz.shape[1],
        "ground_marked": ground.marked,
    }


def _ground(store: TileStore, work: GridBlock, window: Bounds) -> tuple[Ground, npt.NDArray[np.int32]]:
    """Ground points read, and the coordinates of those in the window that make the TIN."""
    if work.thin is None:
        ground = read_ground(store, work.rule, window)
        return ground, ground.xyz
    # Cells that the window cuts are read whole, so that the choice in them is everybody's choice.
    origin = store.meta.frame.origin
    choose = _choice(work.thin, work.percent, origin)
    by_bucket = partial(_whole_cells, choose, work.thin, store.meta.bucket, origin)
    ground = read_ground(store, work.rule, work.thin.around(window), by_bucket)
    xyz = ground.xyz[:, choose(ground.xyz)]
    return ground, xyz[:, PointBlock(xyz).inside(window, origin)]


def _choice(cell: Lattice, percent: int | None, origin: tuple[int, int]) -> Callable[[Counts], Index]:
    """Which point of each cell makes the surface."""
    if percent is None:
        return partial(central_points, origin=origin, lattice=cell)
    return partial(ranked_points, origin=origin, lattice=cell, percent=percent)


def _whole_cells(
    choose: Callable[[Counts], Index],
    thin: Lattice,
    buckets: Lattice,
    origin: tuple[int, int],
    cell: Cell,
    xyz: Counts,
) -> Index:
    """The points of a bucket that may make the surface: one of each cell that it holds whole, all of the others."""
    whole = PointBlock(xyz).inside(thin.within(buckets.bounds(cell)), origin)
    inner = np.flatnonzero(whole)
    return np.append(inner[choose(xyz[:, inner])], np.flatnonzero(~whole))


def pixels_of(spec: RasterSpec, block: Block, origin: tuple[int, int]) -> Pixels:
    """The pixels of a block, as kernels want them."""
    return Pixels(
        spec.lattice.p,
        spec.lattice.q,
        left=spec.west + block.col,
        top=spec.north - 1 - block.row,
        columns=block.width,
        rows=block.height,
        origin_x=origin[0],
        origin_y=origin[1],
    )


def rasterise_window(store: TileStore, work: TinBlock, window: Bounds, xyz: npt.NDArray[np.int32]) -> Raster:
    """Heights in counts, NaN where there are none, and marks of the block's pixels."""
    east, north = store.meta.frame.origin
    spec, block, limit = work.spec, work.block, float(work.max_edge)
    try:
        pixels = pixels_of(spec, block, (east, north))
        raster = rasterise(
            Tin.build(xyz[0], xyz[1], xyz[2]),
            pixels,
            interpolator="natural" if work.interpolation == "natural" else "linear",
            max_edge=limit,
            max_radius=limit,
            window=Window(
                window.x0 - east,
                window.y0 - north,
                window.x1 - east,
                window.y1 - north,
                open_west=window.x0 <= work.data.x0,
                open_south=window.y0 <= work.data.y0,
                open_east=window.x1 >= work.data.x1,
                open_north=window.y1 >= work.data.y1,
            ),
        )
        if work.interpolation != "idw":
            return raster
        heights, distance = inverse_distance(xyz[0], xyz[1], xyz[2], pixels, limit)
        known = spec.block_bounds(block).x0 - window.x0  # the halo: beyond it there may be nearer points
        filled = ~np.isnan(raster.heights)
        return Raster(np.where(filled, heights, np.nan), raster.marks | (filled & (distance > known)))
    except ValueError as error:
        raise ProcessingError(
            f"block {block.name}: {error}; use a smaller max_edge or another resolution"
        ) from error


def heights_in_units(raster: Raster) -> npt.NDArray[np.float32]:
    """Heights in vertical units of the CRS, `NODATA` where there are none."""
    heights = (raster.heights / COUNTS_PER_UNIT).astype(np.float32)
    heights[np.isnan(raster.heights)] = NODATA
    return heights
