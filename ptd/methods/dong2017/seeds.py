"""Parameters of `dong2017`, and its first passes: greenness, density and noise of the run, then seeds beside facades.

In a photogrammetric cloud the seeds found among points go to cells of robust heights.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ptd.arrays import Bool, Int32, Int64, UInt8, UInt16
from ptd.cells import lowest_per_cell, position_keys
from ptd.frame import CellLattice, Scale, Window
from ptd.ground import noise_sums, roughness
from ptd.ground.labelling import GROUND, UNCLASSIFIED
from ptd.matched.passes import CellModel, CellPass
from ptd.matched.robust_cells import RobustCells
from ptd.matched.step import cell_m
from ptd.methods.dong2017.facades import (
    FacadeRule,
    Facades,
    density_of,
    facade_threshold,
    on_podium,
)
from ptd.methods.dong2017.histograms import BINS, COLOURLESS, gli_bins, green_from, index_of_bin
from ptd.params import check, like, parameter
from ptd.passes import (
    MethodRefusal,
    Model,
    Partial,
    Pass,
    Points,
    State,
    StatisticsModel,
    add_notes,
)


@dataclass(frozen=True)
class Dong2017Parameters:
    """Parameters of `dong2017`, to which `ptd.methods.dong2017.method.Dong2017` adds the passes."""

    facade_cell_m: float = parameter(
        1.0, "size of the cells in which projected points are counted", unit="m", minimum=0.25, maximum=10.0,
        source="Dong 2017, 3.3.2: GRIDESIZE",
    )  # fmt: skip
    facade_height_m: float = parameter(
        3.0,
        "height of the lowest building; lower steps are not facades",
        unit="m",
        minimum=0.5,
        maximum=100.0,
        source="Dong 2017, 3.3.2: H",
    )
    glass_factor: float = parameter(
        0.5,
        "share of a facade that image matching can see; the rest is glass",
        0.01,
        1.0,
        source="Dong 2017, 3.3.2",
    )
    seed_distance_m: float = parameter(
        4.0, "distance of a seed from the facade", 1.0, 30.0, "m", source="Dong 2017, 3.1: d"
    )
    seed_variation: float = parameter(
        2.0,
        "largest noise around a seed, in multiples of sigma",
        0.5,
        10.0,
        source="Dong 2017, 3.1: 2 sigma",
    )
    podium_radius_m: float = parameter(
        15.0, "a seed is dropped if a much lower one lies within this distance", unit="m", minimum=1.0,
        maximum=100.0, source="Dong 2017, 3.1: neighbourhood of a seed",
    )  # fmt: skip
    terrain_slope: float = parameter(
        0.3, "steepest slope between two seeds that are both ground", minimum=0.0, maximum=5.0,
        source="Dong 2017, equation 1: 0.3",
    )  # fmt: skip
    seed_cell_m: float = parameter(
        15.0, "one seed, the lowest, per cell of this size", 2.0, 200.0, "m"
    )
    first_spacing_m: float = parameter(
        4.0, "size of the cells of the first TIN of ground, halved until the last", unit="m", minimum=0.5,
        maximum=50.0, source="Dong 2017, table 4: 4 m",
    )  # fmt: skip
    last_spacing_m: float = parameter(
        1.0,
        "size of the cells of the last TIN of ground",
        0.25,
        50.0,
        "m",
        source="Dong 2017, table 4: 2 m",
    )
    tins: int = parameter(
        8,
        "number of TINs of each density; ground grows by two cells with each",
        minimum=1,
        maximum=20,
        source="Dong 2017, 3.2: several TINs",
    )
    contour_level: float = parameter(
        0.01, "height of the contour that gives the thresholds, in parts of the histogram's peak", minimum=0.0001,
        maximum=0.9, source="Dong 2017, 3.3.4",
    )  # fmt: skip
    robust_cells: bool = like(RobustCells, "robust_cells")

    def __post_init__(self) -> None:
        check(self)
        if self.last_spacing_m > self.first_spacing_m:
            raise ValueError(
                f"last_spacing_m {self.last_spacing_m:g}: use at most first_spacing_m, {self.first_spacing_m:g} m"
            )

    @property
    def spacings_m(self) -> tuple[float, ...]:
        """Sizes of the cells of the TINs of ground, halved from the first down to the last."""
        spacings_m = [self.first_spacing_m]
        while spacings_m[-1] > self.last_spacing_m:
            spacings_m.append(max(spacings_m[-1] / 2, self.last_spacing_m))
        return tuple(spacings_m)


VEGETATION = 5
"""Label of vegetation between passes. Seeds are `GROUND`, all other points `UNCLASSIFIED`."""


@dataclass(frozen=True)
class ColourPass(Pass):
    """Step 1, and the figures that facades need: greenness, density and noise of the run."""

    params: Dong2017Parameters
    influence_radius_m: float | None
    name: str = "colours"
    title = "measure greenness, density and noise"
    columns: tuple[str, ...] = ("rgb",)
    every_point: bool = True
    gives_labels: bool = False

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        """Count greenness and points per cell, and measure planar patches."""
        is_in_core = core.contains(points.xyz[0], points.xyz[1])
        bins = gli_bins(_rgb(points))
        counts = np.bincount(bins[is_in_core & (bins != COLOURLESS)], minlength=BINS)
        x, y, _ = points.columns()
        cells = CellLattice.of(self.params.facade_cell_m, scale)
        partial: dict[str, Any] = {
            "gli": counts.tolist(),
            "points": int(is_in_core.sum()),
            "cells": _points_by_count(x, y, cells, is_in_core),
        }
        if state["run"]["sigma_m"] is None and "survey" not in state:
            partial["patches"] = roughness.measure(points.xyz, window, core, scale)
        return StatisticsModel(partial, {"points": int(is_in_core.sum())})

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Find the threshold of greenness, the density and the noise of the run."""
        gli, cells, patches = np.zeros(BINS, np.int64), Counter[int](), []
        for partial in partials:
            gli += np.array(partial["gli"], np.int64)
            cells.update({int(count): int(points) for count, points in partial["cells"]})
            if "patches" in partial:
                patches.append(partial["patches"])
        if not gli.any():
            raise MethodRefusal(
                "no point has a colour, which dong2017 needs to find vegetation; use another method"
            )
        green = green_from(gli.tolist())
        density = density_of(cells, self.params.facade_cell_m**2)
        sigma, origin = _sigma(state, patches)
        vegetation = (
            "vegetation by colour: none, the histogram of greenness (GLI) has no two modes"
        )
        if green is not None:
            share = gli[green:].sum() / gli.sum()
            vegetation = f"vegetation by colour: GLI above {index_of_bin(green):.3f} (Otsu), {share:.1%} of the points"
        return {
            **state,
            "green_from": green,
            "density_m2": density,
            "sigma_m": sigma,
            "notes": add_notes(
                state, vegetation, f"noise {sigma:g} m ({origin}), {density:.1f} points/m2"
            ),
        }


@dataclass(frozen=True)
class SeedPass(Pass):
    """Steps 2 to 4: label vegetation and seeds, which lie beside facades and not on podiums."""

    params: Dong2017Parameters
    influence_radius_m: float | None
    name: str = "seeds"
    title = "find seeds beside facades"
    columns: tuple[str, ...] = ("rgb",)
    every_point: bool = True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> SeedModel:
        """Find the window's seeds."""
        return SeedModel(self.params, points, core, scale, state)

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Refuse a run without facades or seeds."""
        total: Counter[str] = Counter()
        for partial in partials:
            total.update(partial)
        p = self.params
        if not total["facade_points"]:
            least = facade_threshold(
                state["density_m2"], p.facade_height_m, p.facade_cell_m, p.glass_factor
            )
            raise MethodRefusal(
                f"no facade found: no cell of {p.facade_cell_m:g} m holds more than {least:.0f} points (the cloud has "
                f"{state['density_m2']:.1f}/m2); seeds lie beside facades, so use another method, or --set "
                f"facade_height or --set glass_factor to something lower"
            )
        if not total["seeds"]:
            raise MethodRefusal(
                f"no seed found beside the facades ({total['facade_points']} points in them): no flat place "
                f"{p.seed_distance_m:g} m from one; use another method, change --set seed_distance, or give a larger "
                "--sigma"
            )
        note = f"facades: {total['facade_points']:,} points in dense cells; {total['seeds']:,} seeds beside them"
        return {**state, "seeds": total["seeds"], "notes": add_notes(state, note)}


class SeedModel(Model):
    """Seeds of a window."""

    def __init__(
        self,
        params: Dong2017Parameters,
        points: Points,
        core: Window,
        scale: Scale,
        state: State,
    ) -> None:
        self.green = state["green_from"]
        keep = ~_green(points, self.green)
        x, y, z = (np.ascontiguousarray(c) for c in points.xyz[:, keep])
        self._facade_points = 0
        chosen = np.zeros(0, np.int32)
        if x.size:
            least = facade_threshold(
                state["density_m2"],
                params.facade_height_m,
                params.facade_cell_m,
                params.glass_factor,
            )
            facades = Facades(x, y, z, CellLattice.of(params.facade_cell_m, scale), least)
            inside = facades.points()
            self._facade_points = int(core.contains(x[inside], y[inside]).sum())
            chosen = _seeds(params, facades, scale, state["sigma_m"])
        self._seeds = np.unique(np.stack([x, y, z])[:, chosen], axis=1)
        self._own = int(core.contains(x[chosen], y[chosen]).sum())
        self.stats = {
            "seeds": self._seeds.shape[1],
            "facade_cells": int(facades.holds.sum()) if x.size else 0,
        }

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label vegetation and seeds."""
        x, y, _ = points.columns()
        labels = np.full(x.size, UNCLASSIFIED, np.uint8)
        seed_positions = position_keys(
            *self._seeds[:2]
        )  # Each position holds one seed, because each cell gives one.
        order = np.argsort(seed_positions)
        at = np.flatnonzero(np.isin(position_keys(x, y), seed_positions))
        seed = order[np.searchsorted(seed_positions, position_keys(x[at], y[at]), sorter=order)]
        labels[at[points.xyz[2, at] == self._seeds[2, seed]]] = GROUND
        labels[_green(points, self.green)] = VEGETATION
        return labels, np.zeros(len(points), np.bool_)

    def partial(self) -> Partial:
        """Number of points in facades, and of seeds, in the core."""
        return {"facade_points": self._facade_points, "seeds": self._own}


def _seeds(p: Dong2017Parameters, facades: Facades, scale: Scale, sigma_m: float) -> Int32:
    """Steps 3 and 4: indices of the points of `facades` that are seeds."""
    cell = p.facade_cell_m
    rule = FacadeRule(
        max(1, round(p.seed_distance_m / cell)),
        max(1, round(p.seed_distance_m / (math.sqrt(2) * cell))),
        # The height at which a facade fills its cell with enough points.
        scale.counts_z(p.glass_factor * p.facade_height_m),
        scale.counts(p.seed_variation * sigma_m),
        scale.z_ratio,
    )
    x, y, z = facades.x, facades.y, facades.z
    seeds = facades.seeds(rule)
    seeds = seeds[
        ~on_podium(
            x[seeds], y[seeds], z[seeds], scale, p.podium_radius_m, p.terrain_slope, sigma_m
        )
    ]
    return seeds[
        lowest_per_cell(x[seeds], y[seeds], z[seeds], CellLattice.of(p.seed_cell_m, scale))
    ]


def _sigma(state: State, patches: Sequence[noise_sums.PatchCounts]) -> tuple[float, str]:
    """The noise of heights, and its origin. An earlier survey may have measured it already."""
    given = state["run"]["sigma_m"]
    if given is not None:
        return given, "--sigma"
    if "survey" in state:
        sigma, origin = state["survey"]["sigma_m"], "from planar patches"
    else:
        measured = noise_sums.merge(patches)
        sigma, origin = measured.sigma_m, f"from {measured.patches:,} planar patches"
    if sigma is None:
        raise MethodRefusal(
            "no planar patch to measure the noise of heights; give it with --sigma (metres)"
        )
    return sigma, origin


def _points_by_count(x: Int32, y: Int32, cells: CellLattice, own: Bool) -> list[list[int]]:
    """Return pairs (n, m), ascending in n: m points of the core lie in cells with n points."""
    if not x.size:
        return []
    columns, rows = cells.cell_indices(x, y)
    keys = (
        (rows - rows.min()) * (int(columns.max() - columns.min()) + 1) + columns - columns.min()
    )
    _, slot, counts = np.unique(keys, return_inverse=True, return_counts=True)
    points_per_cell, points = np.unique(counts[slot[own]], return_counts=True)
    return [[int(n), int(p)] for n, p in zip(points_per_cell, points, strict=True)]


def _rgb(points: Points) -> UInt16:
    if points.rgb is None:
        raise ValueError("the pass was given no colours")
    return points.rgb


def _green(points: Points, green_from: int | None) -> Bool:
    if green_from is None:
        return np.zeros(len(points), np.bool_)
    return gli_bins(_rgb(points)) >= green_from


@dataclass(frozen=True)
class SeedCellPass(CellPass):
    """Pass that makes a robust height per cell. Cells with a seed are ground, all others unclassified."""

    title = "one height per cell, and the cells with seeds"
    columns: tuple[str, ...] = ("labels",)
    gives_labels: bool = True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> SeedCells:
        """Find all cells, and those with seeds."""
        heights = super().fit(points, window, core, scale, state)
        seeds = points.known_labels() == GROUND
        return SeedCells(heights, points.xyz[:, seeds], CellLattice.of(cell_m(state), scale))


class SeedCells(CellModel):
    """Cells of robust heights, with a mask of those that contain a seed.

    Parameters
    ----------
    heights : CellModel
    seeds : int32 [3, m]
        Local counts.
    cells : CellLattice
    """

    def __init__(self, heights: CellModel, seeds: Int32, cells: CellLattice) -> None:
        super().__init__(heights.elect(Window.everything()))
        self._seeds, self._cells = seeds, cells

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label the cells."""
        seeds = self._keys(self._seeds)
        holds = np.isin(self._keys(points.xyz), seeds)
        labels = np.where(holds, np.uint8(GROUND), np.uint8(UNCLASSIFIED))
        return labels, np.zeros(len(points), np.bool_)

    def _keys(self, xyz: Int32) -> Int64:
        columns, rows = self._cells.cell_indices(xyz[0], xyz[1])
        return columns * 2**32 + rows
