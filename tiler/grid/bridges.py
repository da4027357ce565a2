"""Decks of bridges among the points of a run: cells that may be one, block by block, then each such place."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.classes import MARK_BIT
from tiler.core.lattice import Bounds
from tiler.core.points import PointBlock
from tiler.core.raster import Block, RasterSpec
from tiler.grid.deck import Deck, find_deck
from tiler.grid.deck_cells import DIRECTIONS, REACH_M, Cells, deck_cells
from tiler.grid.ground import GroundRule, read_classes, surface_points
from tiler.grid.work import ExamineDeck, FindDeckCells
from tiler.store import TileStore, open_store

Bools = npt.NDArray[np.bool_]

AROUND_M = 45.0
"""Around a place that may be a deck, in which points are looked at."""
VOXEL_M = (0.25, 0.25, 0.1)
"""Of points in one of these one is looked at, so that neither density nor the order of points matters."""
FEWEST = 12
"""Points that a deck has at least."""
MOST_DIRECTIONS = 3
"""Directions across a deck that are tried, those of the most cells first."""


def find_deck_cells(store_url: str, work: FindDeckCells) -> dict[str, Any]:
    """Find the cells of a block that may be decks; a `tiler.schedule.task.Work`.

    Parameters
    ----------
    store_url : str
    work : FindDeckCells

    Returns
    -------
    dict
        ``cells``: row, column and direction across of each.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    size_m = float(spec.lattice.size * store.meta.frame.metres_xy)
    pad = math.ceil(REACH_M / size_m)
    shape = (block.height + 2 * pad, block.width + 2 * pad)
    low, top = np.full(shape, np.inf, np.float32), np.full(shape, -np.inf, np.float32)
    window = Block(block.row - pad, block.col - pad, *shape)
    bounds = spec.block_bounds(window)
    for cell in store.buckets_within(bounds):
        points, chosen, is_ground = _points(store, work.rule, cell, bounds)
        places = _cells(points, chosen, store, spec, window)
        z = (points.xyz[2][chosen] * float(store.meta.frame.metres_z)).astype(np.float32)
        np.minimum.at(low, places, z)
        ground = is_ground[chosen]
        np.maximum.at(top, tuple(axis[ground] for axis in places), z[ground])
    ground, known = np.isfinite(top), np.isfinite(low)
    top = np.where(ground, top, np.where(known, low, np.float32(np.nan)))
    low = np.where(known, low, np.float32(np.nan))
    rows, cols, directions = deck_cells(Cells(top, low, ground, size_m))
    own = (rows >= pad) & (rows < pad + block.height) & (cols >= pad) & (cols < pad + block.width)
    found = np.stack((rows[own] + window.row, cols[own] + window.col, directions[own]), axis=1)
    return {"cells": found.tolist()}


def examine_deck(store_url: str, work: ExamineDeck) -> dict[str, Any]:
    """Look whether some cells are the deck of a bridge; a `tiler.schedule.task.Work`.

    Parameters
    ----------
    store_url : str
    work : ExamineDeck

    Returns
    -------
    dict
        ``why``: why they are none, empty where they are. Else also ``ring``, ``surface`` (as of
        `tiler.core.edits.DeckSurface`, without its limits), ``length_m``, ``width_m``, ``clearance_m``, ``below``.
    """
    store, spec = open_store(store_url), work.spec
    frame = store.meta.frame
    bounds = examined(spec, work.cells, float(frame.metres_xy))
    metres = np.array((frame.metres_xy, frame.metres_xy, frame.metres_z), np.float64)
    corner = np.array((bounds.x0, bounds.y0, 0.0))
    xyz, ground, places = _window(store, work, bounds, metres, corner)
    if len(xyz) < FEWEST:
        return {"why": "too few points"}
    rows, cols, directions = np.array(work.cells).T
    occupied = len(np.unique(places[0] * (spec.width + 1) + places[1]))
    spacing = math.sqrt(occupied * float(spec.lattice.size * frame.metres_xy) ** 2 / len(xyz))
    why = "too few points"
    for direction in np.argsort(-np.bincount(directions, minlength=DIRECTIONS), kind="stable")[
        :MOST_DIRECTIONS
    ]:
        mine = directions == direction
        cells = {(int(r), int(c)) for r, c in zip(rows[mine], cols[mine], strict=True)}
        seeds = np.array(
            [place in cells for place in zip(*(p.tolist() for p in places), strict=True)], np.bool_
        )
        if seeds.sum() < FEWEST:
            continue
        angle = math.pi * float(direction) / DIRECTIONS
        deck, why = find_deck(xyz, ground, seeds, (math.cos(angle), math.sin(angle)), spacing)
        if deck is not None:
            return _record(deck, metres, corner)
    return {"why": why}


def examined(spec: RasterSpec, cells: tuple[tuple[int, int, int], ...], metres: float) -> Bounds:
    """Where the points lie that are looked at for some cells, counts."""
    rows, cols, _ = np.array(cells).T
    top, left = int(rows.min()), int(cols.min())
    block = Block(top, left, int(rows.max()) - top + 1, int(cols.max()) - left + 1)
    return spec.block_bounds(block).pad(math.ceil(AROUND_M / metres))


def _window(
    store: TileStore, work: ExamineDeck, bounds: Bounds, metres: Any, corner: Any
) -> tuple[Any, Bools, tuple[Any, ...]]:
    """Points of a window, one for each voxel: metres from its corner, which are ground, row and column of cells."""
    steps = np.maximum(np.round(np.array(VOXEL_M) / metres), 1).astype(np.int64)
    parts = [np.empty((0, 4), np.int64)]
    for cell in store.buckets_within(bounds):
        points, chosen, is_ground = _points(store, work.rule, cell, bounds)
        ox, oy = store.meta.frame.origin
        xyz = points.xyz[:, chosen].astype(np.int64) + np.array(((ox,), (oy,), (0,)))
        voxels = np.concatenate((xyz.T // steps, ~is_ground[chosen][:, None]), axis=1)
        parts.append(np.unique(voxels, axis=0))
    voxels = np.unique(np.concatenate(parts), axis=0)
    # Of a voxel with ground and other points the first one is the ground.
    first = np.ones(len(voxels), np.bool_)
    first[1:] = (voxels[1:, :3] != voxels[:-1, :3]).any(axis=1)
    centres = voxels[first, :3] * steps + steps // 2
    lattice = work.spec.lattice
    places = (
        work.spec.north - 1 - lattice.index(centres[:, 1]),
        lattice.index(centres[:, 0]) - work.spec.west,
    )
    return (centres - corner) * metres, voxels[first, 3] == 0, places


def _points(store: TileStore, rule: GroundRule, cell: Any, bounds: Bounds) -> tuple[PointBlock, Bools, Bools]:
    """Points of a bucket, those that are surface and lie in some bounds, and those that are ground."""
    points, chosen = surface_points(store, rule, cell)
    chosen &= points.inside(bounds, store.meta.frame.origin)
    if rule.labels is None:
        return points, chosen, read_classes(store, rule, cell)[2]
    labels = store.read_labels(rule.labels, cell) & ~np.uint8(MARK_BIT)
    return points, chosen, rule.is_ground()[labels]


def _cells(
    points: PointBlock, chosen: Bools, store: TileStore, spec: RasterSpec, window: Block
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Row and column within a window, which may reach beyond the raster, of the cells of some points."""
    x, y = (points.xyz[axis][chosen].astype(np.int64) + store.meta.frame.origin[axis] for axis in (0, 1))
    rows = spec.north - 1 - spec.lattice.index(y) - window.row
    return rows, spec.lattice.index(x) - spec.west - window.col


def _record(deck: Deck, metres: Any, corner: Any) -> dict[str, Any]:
    """What the run keeps of a deck: in counts, but for its sizes."""
    ring = np.rint(deck.ring / metres[:2] + corner[:2]).astype(np.int64)
    (x, y), (a, b, c, d) = deck.centre, deck.surface
    flat, high = float(metres[0]), float(metres[2])
    return {
        "why": "",
        "ring": ring.tolist(),
        "surface": [
            x / flat + float(corner[0]), y / flat + float(corner[1]), *deck.along,
            a / high, b * flat / high, c * flat * flat / high, d * flat / high,
        ],
        "length_m": round(deck.length_m, 2), "width_m": round(deck.width_m, 2),
        "clearance_m": round(deck.clearance_m, 2), "below": deck.below,
    }  # fmt: skip
