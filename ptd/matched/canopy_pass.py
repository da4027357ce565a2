"""The pass that finds closed canopy among the cells of photogrammetric clouds."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
import scipy

from ptd.frame import CellLattice, Scale, Window
from ptd.ground.morphology import Bool
from ptd.matched import by_size, surface
from ptd.matched.canopy import PIT_M, canopy, may_be
from ptd.matched.canopy import reach_cells as canopy_reach_cells
from ptd.matched.cells import CELL_M, EMPTY, raster_of
from ptd.matched.evidence import percent
from ptd.matched.ground_model import band
from ptd.matched.place_figures import CELL_SIZE, CELL_SIZES_M
from ptd.matched.step import COVERED, CROWN, OBJECT, TERRAIN, Codes, MatchedPass, noise_m
from ptd.matched.tree_heights import measure_trees, tree_heights
from ptd.passes import Int32, Model, Partial, Points, State, UInt8, add_notes
from ptd.places import PLACES, TREES, of_places, on_cells

BORDER_M = 8.0
"""Distance from a canopy, in metres, within which the surface may differ from the surface with
crowns."""

Float64 = npt.NDArray[np.float64]

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


def _widened(core: Window, more: float) -> Window:
    """Return the core extended by a number of counts to all sides."""
    counts = math.ceil(more)
    return Window(
        core.west - counts, core.south - counts, core.east + counts, core.north + counts
    )


@dataclass(frozen=True)
class CanopyPass(MatchedPass):
    """Pass that finds crowns classified as ground, and cells where crowns hide the ground."""

    name: str = "canopy"
    title = "find closed canopy"
    columns: tuple[str, ...] = ("labels",)
    by_place: bool = True
    elected: bool = True
    raster_cell_m: float = CELL_M
    influence_radius_m: float | None = max(
        (surface.reach_cells(size_m, summits=False) + canopy_reach_cells(size_m) + 3) * size_m
        for size_m in CELL_SIZES_M
    )

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> CanopyModel:
        """Find the canopy among the cells of each size, and count its cells in the core."""
        trees: list[list[int]] = []
        of_size = partial(self.of_size, core=core, trees=trees)
        model = by_size.of_each_size(of_size, points, core, scale, state, cells=True)
        is_in_core = core.contains(points.xyz[0], points.xyz[1])
        return CanopyModel(model, points.take(is_in_core), trees, scale, state)

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
        flat = np.zeros(raster.heights.size, np.uint8)
        flat[raster.keys] = codes
        coded = flat.reshape(raster.heights.shape)
        metres = np.where(raster.heights == EMPTY, np.nan, raster.heights / scale.counts_z(1.0))
        # Pits lie next to a canopy, too.
        beside = scale.counts(PIT_M / 2 + 2 * size_m)
        is_near_core = _widened(core, beside).contains(*points.xyz[:2])
        # Without cells that a canopy may cover, no surface is needed. The surface is nearly all
        # of the work.
        if not may_be(metres, size_m).reshape(-1)[raster.keys[is_near_core]].any():
            return Codes(raster, codes, cells)
        left = np.where(coded == OBJECT, EMPTY, raster.heights).astype(np.int32)
        noise = on_cells(
            noise_m(state, scale), cells, raster.row, raster.column, raster.heights.shape
        )
        ground = surface.ground_surface(
            left, coded == TERRAIN, noise, scale, raster.row, raster.column, size_m
        )
        near = band(ground.sigma, ground.narrowing)
        on_ground = np.abs(metres - ground.height) < near
        covered, crowns, land_depths = canopy(metres, ground, on_ground, size_m)
        depth = land_depths.reshape(-1)[raster.keys]
        is_measured = np.isfinite(depth) & core.contains(*points.xyz[:2])
        is_measured &= of_own_place(points, scale, state)
        trees += measure_trees(depth[is_measured], points.xyz[:, is_measured], scale)
        coded[crowns & (coded != OBJECT)] |= CROWN
        coded[covered] |= COVERED
        return Codes(raster, coded.reshape(-1)[raster.keys], cells)

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


def of_own_place(points: Points, scale: Scale, state: State) -> Bool:
    """Return a mask of the cells whose size is that of their place."""
    place_sizes = of_places(state[PLACES], CELL_SIZE, points.xyz[0], points.xyz[1], scale)
    same: Bool = place_sizes == by_size.size_of_cells(points, scale)
    return same


class CanopyModel(Model):
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
        sizes_m = by_size.size_of_cells(core_cells, scale)
        counted, covered = of_own_place(core_cells, scale, state), labels >= COVERED
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
        own = of_own_place(points, self._scale, self._state)
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
