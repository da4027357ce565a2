"""Passes of photogrammetric clouds: heights of cells, large objects, canopy, and labels by the ground surface."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ptd.frame import CellLattice, Scale, Window
from ptd.ground.morphology import Bool
from ptd.matched import (
    bent_hull,
    by_size,
    cell_features,
    islands,
    last_look,
    objects,
    surface,
    voting,
)
from ptd.matched.canopy import pit_reach_cells, pits
from ptd.matched.canopy_pass import CanopyPass, below_canopy
from ptd.matched.cells import CELL_M, EMPTY, SPARSE_CELL_M, cell_heights, raster_of
from ptd.matched.ground_model import GroundModel, band
from ptd.matched.hull import ROOFS_TILT_BLOCKS, lower_envelope
from ptd.matched.place_figures import CELL_SIZES_M, cell_sizes
from ptd.matched.step import (
    CODE,
    COVERED,
    CROWN,
    LEFT,
    OBJECT,
    TERRAIN,
    Codes,
    MatchedPass,
    OneSizePass,
    cell_m,
    noise_m,
)
from ptd.matched.tree_heights import tree_heights_on_cells
from ptd.passes import Int32, Model, Pass, Points, State, UInt8
from ptd.places import PLACES, TREES, on_cells

PIT_ROUNDS = 5
"""Number of times that pits of a canopy are searched for next to those found before."""


@dataclass(frozen=True)
class CellPass(OneSizePass):
    """Pass that elects a point with a robust height per cell, for the next passes."""

    name: str = "cells"
    title = "one height for each cell"
    every_point: bool = True
    by_place: bool = True
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
    by_place: bool = True
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
            cells_by_size.append(cells[:, by_size.needed(cells, size_m, state, scale)])
        return CellModel(np.concatenate(cells_by_size, axis=1))


def _widened(core: Window, scale: Scale) -> Window:
    """Return the core extended by half a metre, because bounds of buckets may be rounded differently."""
    more = round(scale.counts(0.5))
    return Window(core.west - more, core.south - more, core.east + more, core.north + more)


class CellModel(Model):
    """Model with the elected points of cells, by rows."""

    def __init__(self, xyz: Int32) -> None:
        self._xyz, self.stats = xyz, {"cells": int(xyz.shape[1])}

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Raise NotImplementedError, because the pass gives no labels."""
        raise NotImplementedError("the pass gives no labels")

    def elect(self, bounds: Window) -> Int32:
        """Return the points of the cells whose centres lie within bounds."""
        return np.ascontiguousarray(self._xyz[:, bounds.contains(self._xyz[0], self._xyz[1])])


@dataclass(frozen=True)
class ObjectPass(MatchedPass):
    """Pass that finds large objects, or objects within those found before."""

    name: str = "objects"
    columns: tuple[str, ...] = ("labels",)
    by_place: bool = True
    elected: bool = True
    raster_cell_m: float = CELL_M
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
        return by_size.of_each_size(self.of_size, points, core, scale, state, cells=True)

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
        is_object = np.zeros(raster.heights.size, np.bool_)
        is_object[raster.keys[codes == OBJECT]] = True
        removed = is_object.reshape(raster.heights.shape)
        stiff = replace(bent_hull.STIFF, cell_m=size_m)
        hull = lower_envelope(
            raster.heights, stiff, scale, raster.row, raster.column, ROOFS_TILT_BLOCKS
        )
        noise = on_cells(
            noise_m(state, scale), cells, raster.row, raster.column, raster.heights.shape
        )
        large, terrain = objects.judged(raster.heights, hull, removed, noise, scale, size_m)
        codes[large.reshape(-1)[raster.keys]] = OBJECT
        codes[terrain.reshape(-1)[raster.keys]] = TERRAIN
        return Codes(raster, codes, cells)


@dataclass(frozen=True)
class SurfacePass(MatchedPass):
    """Pass that fits the ground surface and classifies all points by their height above it."""

    name: str = "surface"
    title = "fit the surface, label all points"
    columns: tuple[str, ...] = ("labels",)
    by_place: bool = True
    elected: bool = True
    raster_cell_m: float = CELL_M
    influence_radius_m: float | None = max(
        (
            surface.reach_cells(size_m)
            + max(
                islands.reach_cells(size_m) + cell_features.reach_cells(size_m),
                pit_reach_cells(size_m, PIT_ROUNDS),
            )
        )
        * size_m
        for size_m in CELL_SIZES_M
    )
    label_margin_m: float = voting.REACH_M + last_look.REACH_M
    refine: bool = True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        """Fit the surface to the cells that belong neither to large objects nor to crowns."""
        return by_size.of_each_size(self.of_size, points, core, scale, state, cells=False)

    def of_size(self, points: Points, scale: Scale, state: State, size_m: float) -> GroundModel:
        """Fit the surface to the cells of one size."""
        cells, known = CellLattice.of(size_m, scale), points.known_labels()
        left = known & CODE != OBJECT
        if not left.any():
            return GroundModel(None, {"cells": 0})
        raster = raster_of(points.xyz, cells)
        flat = np.zeros(raster.heights.size, np.uint8)
        flat[raster.keys] = known
        codes = flat.reshape(raster.heights.shape)
        everything = raster.heights
        heights = np.where(codes & CODE == OBJECT, EMPTY, everything).astype(np.int32)
        raster = replace(raster, heights=heights, keys=raster.keys[left])
        noise = on_cells(
            noise_m(state, scale), cells, raster.row, raster.column, raster.heights.shape
        )

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
        fitted_surface = islands.without_islands(
            fitted_surface, raster.heights, everything, scale, size_m
        )
        model = GroundModel.of(fitted_surface, raster, cells, scale, state, hidden)
        return model.with_last_look(raster, size_m) if self.refine else model


def _pits(
    heights: Int32,
    codes: UInt8,
    fitted: surface.Surface,
    far_trees: npt.NDArray[np.float64],
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
