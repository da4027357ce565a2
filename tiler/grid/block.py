"""Blocks of a raster: heights at pixel centres on the TIN of the ground points around them.

The pixels depend only on the data, not on the block or its halo. A facet fills a pixel only if
its longest edge and its circumradius stay within a limit, so data farther away than twice that
limit have no influence. A pixel is uncertified if data within that distance but outside the
window could change it. A block with uncertified pixels is repeated with a larger halo.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import astuple, replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from ptd.arrays import Float32, Float64, Int32
from ptd.gridding.nearest import inverse_distance
from ptd.tin import KnownWindow, Pixels, Tin, TinRaster, rasterise
from ptd.tin.mesh import MAX_EXTENT
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.raster import MIN_PART, NODATA, Block, RasterSpec, hull_of
from tiler.core.records import JoinedRecord
from tiler.errors import ProcessingError
from tiler.grid.ground import max_points_in_bucket, surface_ground
from tiler.grid.records import Facets, GridBlock, TerrainRecord, checksum
from tiler.store import TileStore


class _GroundCounts(NamedTuple):
    """Numbers of ground points in a window: all, vertices of the TIN, and uncertified points."""

    n_read: int
    n_used: int
    n_uncertified: int


MAX_WINDOW = MAX_EXTENT // 2
"""Side of a window, in counts, from which its block is divided: half of the extent that a TIN
can have."""


def full_halo(max_edge: Fraction) -> int:
    """Return the halo with which all pixels of a block are certified. Halo and ``max_edge`` are in counts.

    A facet's circle reaches at most two radii from a pixel inside it. The rest covers rounding.
    """
    return math.ceil(2 * max_edge * (1 + Fraction(1, 1 << 19))) + 4


def grid_block(store: TileStore, *, work: GridBlock) -> TerrainRecord:
    """Write one block of a raster.

    Returns
    -------
    TerrainRecord
        Record of the block.

    Raises
    ------
    ProcessingError
        The window is too wide for the TIN, or the denominator of the resolution in units of the CRS is too large.
    """
    (record,) = grid_blocks(store, works=(work,)).parts
    return record


def grid_blocks(
    store: TileStore, *, works: tuple[GridBlock, ...]
) -> JoinedRecord[TerrainRecord]:
    """Write blocks of a raster that differ only in their positions and share a TIN.

    The pixels are those of `grid_block`. The record of each block, in ``parts``, is also the
    same except for the ground points, which are counted in the shared window.
    """
    parts = []
    for block, heights, record in heights_of_blocks(store, works):
        store.write_block(block.name, block.block, heights)
        parts.append(replace(record, checksum=checksum(heights)))
    return JoinedRecord(parts)


def _n_filled(heights: Float32) -> int:
    return int(np.count_nonzero(heights != np.float32(NODATA)))


def heights_of_blocks(
    store: TileStore, works: Sequence[GridBlock]
) -> Iterator[tuple[GridBlock, Float32, TerrainRecord]]:
    """Compute heights and records of blocks that differ only in their positions, without checksums.

    The blocks share a TIN if it is not too wide or too full. Otherwise each block has its own
    TIN, and a block that is still too full is divided into quarters. A block with uncertified
    pixels is repeated by itself with twice the halo.

    Yields
    ------
    work : GridBlock
    heights : float32, shape (height, width)
        Heights in vertical units of the CRS, `NODATA` for pixels without a height.
    record : TerrainRecord
        Record of the block without its checksum.
    """
    first = works[0]
    pixel = math.ceil(first.spec.lattice.size)
    yield from _heights(store, works, min(max(first.halo, pixel), _most_halo(first)), 1)


def _most_halo(work: GridBlock) -> int:
    return work.max_halo or full_halo(work.max_edge)


def _heights(
    store: TileStore, works: Sequence[GridBlock], halo: int, tries: int
) -> Iterator[tuple[GridBlock, Float32, TerrainRecord]]:
    """Yield the heights of blocks in attempt number ``tries``, which uses this halo."""
    whole = replace(works[0], block=hull_of(work.block for work in works))
    if len(works) > 1 and _too_full(store, whole, halo):
        for work in works:
            yield from _heights(store, (work,), halo, tries)
        return
    if _too_wide(whole, halo) and not store.buckets_within(
        _window(whole, full_halo(whole.max_edge))
    ):
        yield whole, *_nothing(whole.block, halo)
        return
    if _too_full(store, whole, halo):
        yield whole, *_in_quarters(store, whole, tries)
        return
    raster, ground = _attempt(store, whole, _window(whole, halo))
    for work in works:
        row, col = work.block.row - whole.block.row, work.block.col - whole.block.col
        part = (slice(row, row + work.block.height), slice(col, col + work.block.width))
        marked = int(raster.marks[part].sum())
        if marked and halo < _most_halo(work):
            yield from _heights(store, (work,), min(2 * halo, _most_halo(work)), tries + 1)
            continue
        heights = heights_in_units(raster.heights[part])
        filled = _n_filled(heights)
        record = TerrainRecord(
            pixels=heights.size, filled=filled, nodata=heights.size - filled, marked=marked, tries=tries, halo=halo,
            ground_read=ground.n_read, ground_used=ground.n_used, ground_marked=ground.n_uncertified,
        )  # fmt: skip
        yield work, heights, record


def _nothing(block: Block, halo: int) -> tuple[Float32, TerrainRecord]:
    """Return heights and record of a block far from all points: it has no heights."""
    heights = np.full((block.height, block.width), NODATA, np.float32)
    record = TerrainRecord(
        pixels=heights.size, filled=0, nodata=heights.size, marked=0, tries=1, halo=halo,
        ground_read=0, ground_used=0, ground_marked=0,
    )  # fmt: skip
    return heights, record


def _window(work: GridBlock, halo: int) -> Bounds:
    return work.spec.block_bounds(work.block).pad(halo)


def _too_wide(work: GridBlock, halo: int) -> bool:
    """Return whether a block's window is too wide for a TIN."""
    window = _window(work, halo)
    return max(window.x1 - window.x0, window.y1 - window.y0) >= MAX_WINDOW


def _too_full(store: TileStore, work: GridBlock, halo: int) -> bool:
    """Return whether a window is too wide or too full.

    Blocks with sides of at most `MIN_PART` pixels may exceed ``max_points``.
    """
    side = max(work.block.height, work.block.width)
    if side > 1 and _too_wide(work, halo):
        return True
    if work.max_points is None or side <= MIN_PART:
        return False
    held = store.buckets_within(_window(work, halo)).values()
    return (
        sum(max_points_in_bucket(info.n, store.meta.bucket, work.thin) for info in held)
        > work.max_points
    )


def _in_quarters(
    store: TileStore, work: GridBlock, tries: int
) -> tuple[Float32, TerrainRecord]:
    row, col, height, width = astuple(work.block)
    heights = np.empty((height, width), np.float32)
    records = []
    for top, tall in ((0, height // 2), (height // 2, height - height // 2)):
        for left, wide in ((0, width // 2), (width // 2, width - width // 2)):
            if tall == 0 or wide == 0:
                continue
            part, record = block_heights(
                store, replace(work, block=Block(row + top, col + left, tall, wide))
            )
            heights[top : top + tall, left : left + wide] = part
            records.append(record)
    filled = sum(record.filled for record in records)
    total = TerrainRecord(
        pixels=heights.size,
        filled=filled,
        nodata=heights.size - filled,
        marked=sum(record.marked for record in records),
        tries=max(record.tries for record in records) + tries - 1,
        halo=max(record.halo for record in records),
        ground_read=sum(record.ground_read for record in records),
        ground_used=sum(record.ground_used for record in records),
        ground_marked=sum(record.ground_marked for record in records),
    )
    return heights, total


def block_heights(store: TileStore, work: GridBlock) -> tuple[Float32, TerrainRecord]:
    """Return heights and record of any block, without the checksum (see `heights_of_blocks`)."""
    ((_, heights, record),) = heights_of_blocks(store, (work,))
    return heights, record


def _attempt(
    store: TileStore, work: GridBlock, window: Bounds
) -> tuple[TinRaster, _GroundCounts]:
    """Return heights and uncertified pixels of a block, and the counts of its ground points."""
    ground, xyz = surface_ground(store, work, window)
    if work.breaklines is not None:
        lines = store.breaklines(work.breaklines)
        xyz = lines.applied(xyz, window, work.data, store.meta.frame.origin)
    counts = _GroundCounts(ground.read, xyz.shape[1], ground.marked)
    origin = store.meta.frame.origin
    return rasterise_window(work.spec, work.block, origin, work, window, xyz), counts


def pixels_of(spec: RasterSpec, block: Block, origin: tuple[int, int]) -> Pixels:
    """Return the pixels of a block in the form that kernels need."""
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


def rasterise_window(
    spec: RasterSpec,
    block: Block,
    origin: tuple[int, int],
    facets: Facets,
    window: Bounds,
    xyz: Int32,
) -> TinRaster:
    """Return the heights of a block in counts, NaN for none, and a mask of its uncertified pixels.

    ``xyz``, int32 (3, n) in counts from ``origin``, are the points in ``window``.
    """
    (east, north), limit = origin, float(facets.max_edge)
    try:
        pixels = pixels_of(spec, block, origin)
        raster = rasterise(
            Tin.build(xyz[0], xyz[1], xyz[2]),
            pixels,
            interpolator="natural" if facets.interpolation == "natural" else "linear",
            max_edge=limit,
            max_radius=limit,
            window=KnownWindow(
                window.x0 - east,
                window.y0 - north,
                window.x1 - east,
                window.y1 - north,
                open_west=window.x0 <= facets.data.x0,
                open_south=window.y0 <= facets.data.y0,
                open_east=window.x1 >= facets.data.x1,
                open_north=window.y1 >= facets.data.y1,
            ),
        )
        if facets.interpolation != "idw":
            return raster
        heights, distance = inverse_distance(xyz[0], xyz[1], xyz[2], pixels, limit)
        # All points within the halo are known. If the search went farther, there may be nearer
        # points.
        known = spec.block_bounds(block).x0 - window.x0
        filled = ~np.isnan(raster.heights)
        return TinRaster(
            np.where(filled, heights, np.nan), raster.marks | (filled & (distance > known))
        )
    except ValueError as error:
        raise ProcessingError(
            f"block {block.name}: {error}; use a smaller max_edge or another resolution"
        ) from error


def heights_in_units(counts: Float64) -> Float32:
    """Convert heights in counts (NaN for none) to vertical units of the CRS (`NODATA` for none)."""
    heights = (counts / COUNTS_PER_UNIT).astype(np.float32)
    heights[np.isnan(counts)] = NODATA
    return heights
