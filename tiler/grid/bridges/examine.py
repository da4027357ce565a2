"""Functions that search for bridge decks: find the candidate cells of each block, then examine each candidate."""

from __future__ import annotations

import math
from functools import reduce
from typing import Any

import numpy as np

from ptd.arrays import Bool, Int64
from tiler.core.lattice import Bounds
from tiler.core.points import UNCERTIFIED_BIT, PointBlock
from tiler.core.raster import Block, RasterSpec
from tiler.grid.bridges.deck import Deck, find_deck
from tiler.grid.bridges.deck_cells import DIRECTIONS, REACH_M, CoarseHeights, candidate_cells
from tiler.grid.ground import read_classes, surface_points
from tiler.grid.records import DeckRecord, GroundSelection
from tiler.grid.steps import Counts
from tiler.store import TileStore

CandidateCells = tuple[tuple[int, int, int], ...]
"""Row, column and direction of each cell of a candidate (see `candidate_cells`)."""

EXAMINED_M = 45.0
"""Points up to this distance from a candidate are examined, in metres."""
VOXEL_M = (0.25, 0.25, 0.1)
"""Sides of a voxel in metres.

The centres of voxels replace the points, so that neither the density nor the order of the
points matters.
"""
LOWEST = -(1 << 31)
"""All points are at least this high, in counts. Their heights are below ``-LOWEST``."""
MIN_POINTS = 12
"""A candidate needs at least this many points in its cells."""
MAX_DIRECTIONS = 3
"""At most this many directions are tried per candidate, starting with the one that most cells
have."""


def find_deck_cells(
    store: TileStore, *, spec: RasterSpec, block: Block, rule: GroundSelection
) -> Counts:
    """Find the cells of a block of coarse cells that may be part of a deck.

    The rule for ground points has no edits, because the search for decks precedes all edits.

    Returns
    -------
    dict
        ``cells``: row, column and direction of each cell.
    """
    size_m = float(spec.lattice.size * store.meta.frame.metres_xy)
    pad = math.ceil(REACH_M / size_m)
    shape = (block.height + 2 * pad, block.width + 2 * pad)
    low = np.full(shape, np.inf, np.float32)
    top = np.full(shape, -np.inf, np.float32)
    window = Block(block.row - pad, block.col - pad, *shape)
    bounds = spec.block_bounds(window)
    for bucket in store.buckets_within(bounds):
        points, chosen, is_ground = _points(store, rule, bucket, bounds)
        cell_indices = _cells(points, chosen, store, spec, window)
        z = (points.xyz[2][chosen] * float(store.meta.frame.metres_z)).astype(np.float32)
        np.minimum.at(low, cell_indices, z)
        ground = is_ground[chosen]
        np.maximum.at(top, tuple(axis[ground] for axis in cell_indices), z[ground])
    ground, known = np.isfinite(top), np.isfinite(low)
    top = np.where(ground, top, np.where(known, low, np.float32(np.nan)))
    low = np.where(known, low, np.float32(np.nan))
    rows, cols, directions = candidate_cells(CoarseHeights(top, low, ground, size_m))
    in_block = (
        (rows >= pad) & (rows < pad + block.height) & (cols >= pad) & (cols < pad + block.width)
    )
    block_cells = np.stack(
        (rows[in_block] + window.row, cols[in_block] + window.col, directions[in_block]), axis=1
    )
    return {"cells": block_cells.tolist()}


def examine_decks(
    store: TileStore,
    *,
    rule: GroundSelection,
    spec: RasterSpec,
    candidates: tuple[CandidateCells, ...],
) -> Counts:
    """Decide which candidates in a raster of coarse cells are decks of bridges.

    Returns
    -------
    dict
        ``decks``: `DeckRecord` of each deck. ``reasons``: why each other candidate is not a deck.
    """
    frame = store.meta.frame
    metres = np.array((frame.metres_xy, frame.metres_xy, frame.metres_z), np.float64)
    bounds = [examined_bounds(spec, cells, float(frame.metres_xy)) for cells in candidates]
    xyz, ground = _voxels(store, rule, reduce(Bounds.union, bounds), metres)
    decks: list[DeckRecord] = []
    reasons: list[str] = []
    for cells, window in zip(candidates, bounds, strict=True):
        x, y = xyz[:, 0], xyz[:, 1]
        inside = (x >= window.x0) & (x < window.x1) & (y >= window.y0) & (y < window.y1)
        deck, reason = _examine(spec, cells, window, xyz[inside], ground[inside], metres)
        if deck is None:
            reasons.append(reason)
        else:
            decks.append(deck)
    return {"decks": decks, "reasons": reasons}


def _examine(
    spec: RasterSpec,
    cells: CandidateCells,
    window: Bounds,
    points: Int64,
    ground: Bool,
    metres: Any,
) -> tuple[DeckRecord | None, str]:
    """Find a deck among the points of a window. Return its record, or None and the reason why there is none.

    ``points`` (n, 3) are in counts. ``metres`` (3,) is the length of a count along each axis.
    """
    if len(points) < MIN_POINTS:
        return None, "too few points"
    rows = spec.north - 1 - spec.lattice.index(points[:, 1])
    cols = spec.lattice.index(points[:, 0]) - spec.west
    top, left = int(rows.min()), int(cols.min())
    rows, cols = rows - top, cols - left
    shape = (int(rows.max()) + 1, int(cols.max()) + 1)
    occupied = np.zeros(shape, np.bool_)
    occupied[rows, cols] = True
    cell_m = float(spec.lattice.size) * float(metres[0])
    spacing = cell_m * math.sqrt(int(occupied.sum()) / len(points))
    corner = np.array((window.x0, window.y0, 0.0))
    xyz = (points - corner) * metres
    cell_array = np.array(cells)
    reason = "too few points"
    votes = np.bincount(cell_array[:, 2], minlength=DIRECTIONS)
    for direction in np.argsort(-votes, kind="stable")[:MAX_DIRECTIONS].tolist():
        mask = np.zeros(shape, np.bool_)
        cells_of_direction = cell_array[cell_array[:, 2] == direction, :2] - (top, left)
        inside = ((cells_of_direction >= 0) & (cells_of_direction < shape)).all(axis=1)
        mask[cells_of_direction[inside, 0], cells_of_direction[inside, 1]] = True
        seeds = mask[rows, cols]
        if seeds.sum() < MIN_POINTS:
            continue
        angle = math.pi * direction / DIRECTIONS
        deck, reason = find_deck(
            xyz, ground, seeds, (math.cos(angle), math.sin(angle)), spacing
        )
        if deck is not None:
            return _record(deck, metres, corner), ""
    return None, reason


def examined_bounds(spec: RasterSpec, cells: CandidateCells, metres_per_count: float) -> Bounds:
    """Return the bounds in counts of the points that are examined for a candidate."""
    rows, cols, _ = np.array(cells).T
    top, left = int(rows.min()), int(cols.min())
    block = Block(top, left, int(rows.max()) - top + 1, int(cols.max()) - left + 1)
    return spec.block_bounds(block).pad(math.ceil(EXAMINED_M / metres_per_count))


def _voxels(
    store: TileStore, rule: GroundSelection, bounds: Bounds, metres: Any
) -> tuple[Int64, Bool]:
    """Return the centres of the voxels with points, (n, 3) in counts, and a mask of the voxels with ground points.

    Each voxel gets a number, so that the voxels of all buckets can be sorted.
    """
    steps = np.maximum(np.round(np.array(VOXEL_M) / metres), 1).astype(np.int64)
    first = np.array((bounds.x0 // steps[0], bounds.y0 // steps[1], LOWEST // steps[2]))
    n_y = bounds.y1 // steps[1] - first[1] + 1
    n_z = 2 * -first[2]
    parts = [np.empty(0, np.int64)]
    for bucket in store.buckets_within(bounds):
        points, chosen, is_ground = _points(store, rule, bucket, bounds)
        ox, oy = store.meta.frame.origin
        x, y, z = points.xyz[:, chosen].astype(np.int64) + np.array(((ox,), (oy,), (0,)))
        column = (x // steps[0] - first[0]) * n_y + y // steps[1] - first[1]
        voxel = column * n_z + z // steps[2] - first[2]
        # The lowest bit sorts ground before other points of the same voxel.
        parts.append(np.unique(voxel * 2 + ~is_ground[chosen]))
    keys = np.unique(np.concatenate(parts))
    voxels, rows = np.unique(keys // 2, return_index=True)
    column, iz = np.divmod(voxels, n_z)
    ix, iy = np.divmod(column, n_y)
    centres = (np.stack((ix, iy, iz), axis=1) + first) * steps + steps // 2
    return centres, keys[rows] % 2 == 0


def _points(
    store: TileStore, rule: GroundSelection, bucket: Any, bounds: Bounds
) -> tuple[PointBlock, Bool, Bool]:
    """Return the points of a bucket, a mask of its chosen points, and a mask of its ground points.

    Chosen points are in ``bounds``, are not noise, and are not excluded by a flag.
    """
    points, chosen = surface_points(store, rule, bucket)
    chosen &= points.inside(bounds, store.meta.frame.origin)
    if rule.labels is None:
        return points, chosen, read_classes(store, rule, bucket)[2]
    labels = store.read_labels(rule.labels, bucket) & ~np.uint8(UNCERTIFIED_BIT)
    return points, chosen, rule.is_ground()[labels]


def _cells(
    points: PointBlock, chosen: Bool, store: TileStore, spec: RasterSpec, window: Block
) -> tuple[Int64, Int64]:
    """Return row and column of the cell of each chosen point, counted from the first row and column of a window."""
    x, y = (
        points.xyz[axis][chosen].astype(np.int64) + store.meta.frame.origin[axis]
        for axis in (0, 1)
    )
    rows = spec.north - 1 - spec.lattice.index(y) - window.row
    return rows, spec.lattice.index(x) - spec.west - window.col


def _record(deck: Deck, metres: Any, corner: Any) -> DeckRecord:
    """Return the record of a deck. Its coordinates are 0 at the position ``corner`` in counts."""
    ring = np.rint(deck.ring / metres[:2] + corner[:2]).astype(np.int64)
    (x, y), (a, b, c, d) = deck.centre, deck.surface
    metres_xy, metres_z = float(metres[0]), float(metres[2])
    surface = [
        x / metres_xy + float(corner[0]), y / metres_xy + float(corner[1]), *deck.along,
        a / metres_z, b * metres_xy / metres_z, c * metres_xy * metres_xy / metres_z, d * metres_xy / metres_z,
    ]  # fmt: skip
    return DeckRecord(
        ring=ring.tolist(),
        surface=surface,
        length_m=round(deck.length_m, 2),
        width_m=round(deck.width_m, 2),
        clearance_m=round(deck.clearance_m, 2),
        below=deck.n_below,
    )
