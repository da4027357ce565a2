"""Passes of photogrammetric clouds: heights of cells, large objects, canopy, and labels by the ground surface."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from ptd.arrays import Bool, Float64, Int32, UInt8
from ptd.frame import CellLattice, Scale, Window
from ptd.matched import bent_hull, ground_model, last_look, objects, surface
from ptd.matched.canopy import PIT_M, canopy, may_be, pit_reach_cells, pits
from ptd.matched.canopy import reach_cells as canopy_reach_cells
from ptd.matched.cells import EMPTY, SPARSE_CELL_M, cell_heights, raster_of
from ptd.matched.crowns import measure_trees, tree_heights, tree_heights_on_cells
from ptd.matched.evidence import percent
from ptd.matched.ground_model import GroundModel, band
from ptd.matched.hull import ROOFS_TILT_BLOCKS, lower_envelope
from ptd.matched.step import (
    CODE,
    COVERED,
    CROWN,
    LEFT,
    OBJECT,
    TERRAIN,
    Codes,
    MatchedPass,
    OnCellsPass,
    OneSizePass,
    cell_m,
    needed,
    noise_m,
    of_each_size,
    size_of_cells,
)
from ptd.matched.survey import CELL_SIZE, CELL_SIZES_M, cell_sizes
from ptd.passes import Model, Partial, Pass, Points, State, StatisticsModel, add_notes
from ptd.places import PLACES, TREES, of_places

BORDER_M = 8.0
"""Distance from a canopy, in metres, within which the surface may differ from the surface with
crowns."""


BLOCK_M = 64.0
"""Side of the blocks by which covered cells are counted; their lattice is anchored at CRS
coordinate 0."""


def below_canopy(
    with_crowns: surface.Surface, without: surface.Surface, covered: Bool, cell_m: float
) -> surface.Surface:
    """Return the surface without crowns in a canopy and within `BORDER_M` of it, and the one with crowns elsewhere."""
    near = scipy.ndimage.maximum_filter(
        covered, 2 * round(BORDER_M / cell_m) + 1, mode="constant"
    )
    both = zip(without, with_crowns, strict=True)
    return surface.Surface(*(np.where(near, new, old) for new, old in both))


def _widened_by(core: Window, more: float) -> Window:
    """Return the core extended by a number of counts to all sides."""
    counts = math.ceil(more)
    return Window(
        core.west - counts, core.south - counts, core.east + counts, core.north + counts
    )


@dataclass(frozen=True)
class CanopyPass(OnCellsPass):
    """Pass that finds crowns classified as ground, and cells where crowns hide the ground."""

    name: str = "canopy"
    title = "find closed canopy"
    influence_radius_m: float | None = max(
        (surface.reach_cells(size_m, summits=False) + canopy_reach_cells(size_m) + 3) * size_m
        for size_m in CELL_SIZES_M
    )

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> _CanopyModel:
        """Find the canopy among the cells of each size, and count its cells in the core."""
        trees: list[list[int]] = []
        of_size = partial(self.of_size, core=core, trees=trees)
        model = of_each_size(of_size, points, core, scale, state, cells=True)
        is_in_core = core.contains(points.xyz[0], points.xyz[1])
        return _CanopyModel(model, points.take(is_in_core), trees, scale, state)

    def of_size(
        self,
        points: Points,
        scale: Scale,
        state: State,
        size_m: float,
        core: Window,
        trees: list[list[int]],
    ) -> Codes:
        """Compute the surface of the cells of one size as if there were no canopy, and test it.

        The heights of trees in the core are added to ``trees``.
        """
        cells, codes = CellLattice.of(size_m, scale), points.known_labels()
        if not (codes != OBJECT).any():
            return Codes(None, codes, cells)
        raster = raster_of(points.xyz, cells)
        coded = raster.spread(codes)
        metres = np.where(raster.heights == EMPTY, np.nan, raster.heights / scale.counts_z(1.0))
        # Pits lie next to a canopy, too.
        beside = scale.counts(PIT_M / 2 + 2 * size_m)
        is_near_core = _widened_by(core, beside).contains(*points.xyz[:2])
        # Without cells that a canopy may cover, no surface is needed. The surface is nearly all
        # of the work.
        if not raster.at_cells(may_be(metres, size_m))[is_near_core].any():
            return Codes(raster, codes, cells)
        left = np.where(coded == OBJECT, EMPTY, raster.heights).astype(np.int32)
        noise = raster.noise(noise_m(state, scale), cells)
        ground = surface.ground_surface(
            left, coded == TERRAIN, noise, scale, raster.row, raster.column, size_m
        )
        near = band(ground.sigma, ground.narrowing)
        on_ground = np.abs(metres - ground.height) < near
        covered, crowns, land_depths = canopy(metres, ground, on_ground, size_m)
        depth = raster.at_cells(land_depths)
        is_measured = np.isfinite(depth) & core.contains(*points.xyz[:2])
        is_measured &= _of_own_place(points, scale, state)
        trees += measure_trees(depth[is_measured], points.xyz[:, is_measured], scale)
        coded[crowns & (coded != OBJECT)] |= CROWN
        coded[covered] |= COVERED
        return Codes(raster, raster.at_cells(coded), cells)

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Add ``canopy`` to the state: its share of the area with points, None if there are no points."""
        parts = list(partials)
        area, covered = (
            sum(part[name] for part in parts) for name in ("area_m2", "covered_m2")
        )
        after = {**state, "canopy": {"share": covered / area if area else None}}
        if not covered:
            return after
        after[TREES] = tree_heights((part["trees"] for part in parts), state[PLACES])
        line = (
            f"decided: a closed canopy hides the ground in {percent(covered / area)} % of the area; only "
            "openings in it contain ground points"
        )
        return {**after, "notes": add_notes(state, line)}


def _of_own_place(points: Points, scale: Scale, state: State) -> Bool:
    """Return a mask of the cells whose size is that of their place."""
    place_sizes = of_places(state[PLACES], CELL_SIZE, points.xyz[0], points.xyz[1], scale)
    same: Bool = place_sizes == size_of_cells(points, scale)
    return same


class _CanopyModel(Model):
    """Codes of the cells, and the area of the core that a canopy covers.

    Where both cell sizes occur, only cells of the size of their place get the code `COVERED`.
    Cells of the other size only give context.
    """

    def __init__(
        self,
        model: Model,
        core_cells: Points,
        trees: list[list[int]],
        scale: Scale,
        state: State,
    ) -> None:
        self._model, self._scale, self._state = model, scale, state
        labels, _ = self.label(core_cells)
        sizes_m = size_of_cells(core_cells, scale)
        counted, covered = _of_own_place(core_cells, scale, state), labels >= COVERED
        self._partial = {
            "area_m2": int((sizes_m[counted] ** 2).sum()),
            "covered_m2": int((sizes_m[covered] ** 2).sum()),
            "blocks": _by_block(core_cells.xyz[:, covered], sizes_m[covered], scale),
            "trees": trees,
        }
        self.stats = {**model.stats, "covered": int(covered.sum())}

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Return the codes of cells."""
        labels, uncertified = self._model.label(points)
        own = _of_own_place(points, self._scale, self._state)
        return np.where(own, labels, labels & ~np.uint8(COVERED)).astype(np.uint8), uncertified

    def partial(self) -> Partial:
        """Return the areas of all and of covered cells in m2, covered areas by block, and depths of land by place."""
        return self._partial


def _by_block(xyz: Int32, sizes_m: Float64, scale: Scale) -> list[list[int]]:
    """Return column and row of each block of `BLOCK_M` that contains cells, and their area in square metres."""
    cell_blocks = np.stack(CellLattice.of(BLOCK_M, scale).cell_indices(xyz[0], xyz[1]))
    blocks, block_numbers = np.unique(cell_blocks, axis=1, return_inverse=True)
    areas = np.bincount(block_numbers.ravel(), sizes_m**2, blocks.shape[1]).astype(np.int64)
    block_areas: list[list[int]] = np.column_stack([blocks.T, areas]).tolist()
    return block_areas


PIT_ROUNDS = 5
"""Number of times that pits of a canopy are searched for next to those found before."""


@dataclass(frozen=True)
class CellPass(OneSizePass):
    """Pass that elects a point with a robust height per cell, for the next passes."""

    name: str = "cells"
    title = "one height for each cell"
    every_point: bool = True
    gives_labels: bool = False
    elects: bool = True
    influence_radius_m: float | None = 2 * SPARSE_CELL_M

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CellModel:
        """Compute the heights of all cells of the core."""
        around = _widened(core, scale)
        return CellModel(
            cell_heights(points.xyz, around, scale, noise_m(state, scale), cell_m(state))
        )


@dataclass(frozen=True)
class PlaceCellPass(MatchedPass):
    """`CellPass` with cells whose size follows from the density of the place.

    Where cells of two sizes meet, cells of both are elected.
    """

    name: str = CellPass.name
    title = CellPass.title
    every_point: bool = True
    gives_labels: bool = False
    elects: bool = True
    influence_radius_m: float | None = CellPass.influence_radius_m

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CellModel:
        """Compute the heights of all cells of the core, the smaller cells first."""
        around, noise = _widened(core, scale), noise_m(state, scale)
        cells_by_size = [np.zeros((3, 0), np.int32)]
        for size_m in cell_sizes(state[PLACES]):
            cells = cell_heights(points.xyz, around, scale, noise, size_m)
            cells_by_size.append(cells[:, needed(cells, size_m, state, scale)])
        return CellModel(np.concatenate(cells_by_size, axis=1))


def _widened(core: Window, scale: Scale) -> Window:
    """Return the core extended by half a metre, because bounds of buckets may be rounded differently."""
    return _widened_by(core, round(scale.counts(0.5)))


class CellModel(StatisticsModel):
    """Model with the elected points of cells, by rows."""

    def __init__(self, xyz: Int32) -> None:
        super().__init__({}, {"cells": int(xyz.shape[1])})
        self._xyz = xyz

    def elect(self, bounds: Window) -> Int32:
        """Return the points of the cells whose centres lie within bounds."""
        return np.ascontiguousarray(self._xyz[:, bounds.contains(self._xyz[0], self._xyz[1])])


@dataclass(frozen=True)
class ObjectPass(OnCellsPass):
    """Pass that finds large objects, or objects within those found before."""

    name: str = "objects"
    influence_radius_m: float | None = max(
        (objects.reach_cells(size_m) + replace(bent_hull.STIFF, cell_m=size_m).reach + 1)
        * size_m
        for size_m in CELL_SIZES_M
    )

    @property
    def title(self) -> str:  # type: ignore[override]
        """Title of the pass, by whether it finds large objects or objects within them."""
        return "find large objects" if self.name == "objects" else "find objects within others"

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        """Classify the surfaces of the cells that do not belong to objects yet."""
        return of_each_size(self.of_size, points, core, scale, state, cells=True)

    def of_size(self, points: Points, scale: Scale, state: State, size_m: float) -> Codes:
        """Classify the surfaces of the cells of one size."""
        cells = CellLattice.of(size_m, scale)
        known = points.known_labels()
        codes = np.where(known == OBJECT, np.uint8(OBJECT), np.uint8(LEFT))
        if len(points) == 0:
            return Codes(None, codes, cells)
        raster = raster_of(points.xyz, cells)
        if (known > 0).all() and not (known == OBJECT).any():
            # The first search found no objects, so the second would give the same codes.
            return Codes(raster, known, cells)
        removed = raster.spread(codes == OBJECT)
        stiff = replace(bent_hull.STIFF, cell_m=size_m)
        hull = lower_envelope(
            raster.heights, stiff, scale, raster.row, raster.column, ROOFS_TILT_BLOCKS
        )
        noise = raster.noise(noise_m(state, scale), cells)
        large, terrain = objects.judged(raster.heights, hull, removed, noise, scale, size_m)
        codes[raster.at_cells(large)] = OBJECT
        codes[raster.at_cells(terrain)] = TERRAIN
        return Codes(raster, codes, cells)


@dataclass(frozen=True)
class SurfacePass(OnCellsPass):
    """Pass that fits the ground surface and classifies all points by their height above it."""

    name: str = "surface"
    title = "fit the surface, label all points"
    influence_radius_m: float | None = max(
        (
            surface.reach_cells(size_m)
            + max(
                objects.island_reach_cells(size_m) + last_look.reach_cells(size_m),
                pit_reach_cells(size_m, PIT_ROUNDS),
            )
        )
        * size_m
        for size_m in CELL_SIZES_M
    )
    label_margin_m: float = ground_model.REACH_M + last_look.REACH_M
    refine: bool = True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        """Fit the surface to the cells that belong neither to large objects nor to crowns."""
        return of_each_size(self.of_size, points, core, scale, state, cells=False)

    def of_size(self, points: Points, scale: Scale, state: State, size_m: float) -> GroundModel:
        """Fit the surface to the cells of one size."""
        cells, known = CellLattice.of(size_m, scale), points.known_labels()
        left = known & CODE != OBJECT
        if not left.any():
            return GroundModel(None, {"cells": 0})
        raster = raster_of(points.xyz, cells)
        codes = raster.spread(known)
        everything = raster.heights
        heights = np.where(codes & CODE == OBJECT, EMPTY, everything).astype(np.int32)
        raster = replace(raster, heights=heights, keys=raster.keys[left])
        noise = raster.noise(noise_m(state, scale), cells)

        def ground(heights: Int32) -> surface.Surface:
            terrain = (codes & CODE == TERRAIN) & (heights != EMPTY)
            return surface.ground_surface(
                heights, terrain, noise, scale, raster.row, raster.column, size_m, bare
            )

        crowns = (codes & CROWN) > 0
        bare = ~crowns & (codes < COVERED)
        fitted_surface = ground(raster.heights)
        if crowns.any():
            raster = replace(
                raster, heights=np.where(crowns, EMPTY, raster.heights).astype(np.int32)
            )
            fitted_surface = below_canopy(fitted_surface, ground(raster.heights), ~bare, size_m)
        # The pits are those of the surface with islands, so that the two radii do not add up.
        at = cells, raster.row, raster.column, everything.shape
        far_trees = tree_heights_on_cells(state.get(TREES, {}), *at, scale)
        hidden = _pits(everything, codes, fitted_surface, far_trees, scale, size_m)
        fitted_surface = objects.without_islands(
            fitted_surface, raster.heights, everything, scale, size_m
        )
        model = GroundModel.of(fitted_surface, raster, cells, scale, state, hidden)
        return model.with_last_look(raster, size_m) if self.refine else model


def _pits(
    heights: Int32,
    codes: UInt8,
    fitted: surface.Surface,
    far_trees: Float64,
    scale: Scale,
    cell_m: float,
) -> Bool:
    """Return the cells of crowns near a surface, from heights in counts and codes of all cells."""
    metres = np.where(heights == EMPTY, np.nan, heights / scale.counts_z(1.0))
    near = np.abs(metres - fitted.height) < band(fitted.sigma, fitted.narrowing)
    ground = near & (codes & CODE != OBJECT) & (codes & CROWN == 0)
    return pits(metres, fitted.height, ground, codes >= COVERED, cell_m, PIT_ROUNDS, far_trees)


PASSES: tuple[Pass, ...] = (
    PlaceCellPass(),
    ObjectPass(),
    ObjectPass(name="inner-objects"),
    CanopyPass(),
    SurfacePass(),
)
