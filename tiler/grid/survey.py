"""Where the survey is: a coarse raster of the whole run, by which a hole is told from what lies outside.

A coarse cell is occupied if it holds a point that counts as surface. Gaps narrower than the limit of a facet's edge
belong to the survey, as the terrain bridges them as well (a closing by a disk of half the limit); so does whatever is
enclosed, however wide. What remains is outside: it reaches the raster's border. Being run-wide, it carries no
certificate.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from tiler.core.lattice import Bounds
from tiler.core.raster import Block, RasterSpec
from tiler.grid.checksum import checksum
from tiler.grid.density import pixel_indices
from tiler.grid.ground import GroundRule, surface_points
from tiler.store import TileStore, open_store

CHUNK = 512

Bools = npt.NDArray[np.bool_]


def occupancy_block(store_url: str, args: dict[str, Any]) -> dict[str, Any]:
    """Write one block of the raster of occupied cells, 1 or 0; a `tiler.schedule.task.Work`.

    Parameters
    ----------
    store_url : str
    args : dict
        ``name``; ``spec``: `RasterSpec` of the coarse cells as JSON; ``block``; ``labels``, ``classes``,
        ``skip_flags``: as those of `grid_block`.

    Returns
    -------
    dict
        ``occupied`` cells; ``checksum``.
    """
    store, spec, block = open_store(store_url), RasterSpec.from_json(args["spec"]), Block(*args["block"])
    rule, bounds, present = GroundRule.from_args(args), spec.block_bounds(block), store.buckets()
    occupied = np.zeros(block.height * block.width, np.float32)
    for cell in store.meta.bucket.cells(bounds):
        if cell in present:
            points, chosen = surface_points(store, rule, cell)
            chosen &= points.inside(bounds, store.meta.frame.origin)
            occupied[pixel_indices(points.xyz[:, chosen], store.meta.frame.origin, spec, block)] = 1
    values = occupied.reshape(block.height, block.width)
    store.write_block(args["name"], block, values)
    return {"occupied": int(values.sum()), "checksum": checksum(values)}


def survey_raster(store_url: str, args: dict[str, Any]) -> dict[str, Any]:
    """Write the whole raster of the survey, 1 inside, 0 outside; a `tiler.schedule.task.Work`.

    Parameters
    ----------
    store_url : str
    args : dict
        ``name``; ``spec``: of the coarse cells; ``occupancy``: name of that raster; ``bridge``: cells, the widest
        gap that belongs to the survey.

    Returns
    -------
    dict
        ``inside`` and ``cells``; ``checksum``.
    """
    store, spec = open_store(store_url), RasterSpec.from_json(args["spec"])
    occupied = store.read_block(args["occupancy"], Block(0, 0, spec.height, spec.width)) > 0
    inside = survey_of(occupied, args["bridge"]).astype(np.float32)
    for b in spec.blocks(CHUNK):
        store.write_block(args["name"], b, inside[b.row : b.row + b.height, b.col : b.col + b.width])
    return {"inside": int(inside.sum()), "cells": inside.size, "checksum": checksum(inside)}


def survey_of(occupied: Bools, bridge: float) -> Bools:
    """The survey's cells: what is occupied, gaps narrower than ``bridge`` cells, and everything enclosed.

    Without its outermost ring of cells, which the outline cuts: of a pixel there nobody could say on which side
    of the outline it lies.
    """
    radius = bridge / 2
    pad = int(np.ceil(radius)) + 1
    padded = np.pad(occupied, pad)
    if padded.any():
        grown = ndimage.distance_transform_edt(~padded) <= radius
        padded |= ndimage.distance_transform_edt(grown) > radius
    whole = ndimage.binary_fill_holes(padded)
    inner: Bools = ndimage.binary_erosion(whole, np.ones((3, 3), np.bool_))[pad:-pad, pad:-pad]
    return inner


def coarse_cells(coarse: RasterSpec, spec: RasterSpec, block: Block) -> tuple[npt.NDArray[np.int64], ...]:
    """Row and column of the coarse cell below each pixel's centre: int64 (height,) and (width,)."""
    p, q = spec.lattice.p, spec.lattice.q
    x = ((2 * (spec.west + block.col + np.arange(block.width, dtype=np.int64)) + 1) * p) // (2 * q)
    y = ((2 * (spec.north - 1 - block.row - np.arange(block.height, dtype=np.int64)) + 1) * p) // (2 * q)
    return coarse.north - 1 - coarse.lattice.index(y), coarse.lattice.index(x) - coarse.west


def coarse_values(
    store: TileStore, name: str, coarse: RasterSpec, spec: RasterSpec, block: Block
) -> npt.NDArray[np.float32]:
    """Values of a coarse raster at a block's pixels, float32 (height, width)."""
    rows, cols = (
        np.clip(axis, 0, end - 1)
        for axis, end in zip(coarse_cells(coarse, spec, block), (coarse.height, coarse.width), strict=True)
    )
    top, left = int(rows.min()), int(cols.min())
    window = Block(top, left, int(rows.max()) - top + 1, int(cols.max()) - left + 1)
    return store.read_block(name, window)[np.ix_(rows - top, cols - left)]


def covered(coarse: RasterSpec, spec: RasterSpec, cells: Block) -> Block:
    """The pixels of a raster that some coarse cells touch, as far as it reaches."""
    bounds: Bounds = coarse.block_bounds(cells)
    index = spec.lattice.index_of
    left, right = index(bounds.x0) - spec.west, index(bounds.x1 - 1) + 1 - spec.west
    top, bottom = spec.north - 1 - index(bounds.y1 - 1), spec.north - index(bounds.y0)
    left, top = max(left, 0), max(top, 0)
    return Block(top, left, min(bottom, spec.height) - top, min(right, spec.width) - left)
