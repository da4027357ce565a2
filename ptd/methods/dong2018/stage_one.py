"""The first two passes of `dong2018`: measuring the noise, and stage one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale, Window
from ptd.ground import noise_sums, roughness
from ptd.ground.densify import densify_seeds
from ptd.ground.distance_angle import Bool
from ptd.ground.labelling import GROUND, LOW_NOISE, LabelRule, TinLabels
from ptd.methods.classic import ClassicPass, thinned
from ptd.methods.dong2018 import pits
from ptd.methods.dong2018.params import Dong2018Parameters
from ptd.params import DECIMALS
from ptd.passes import (
    MethodRefusal,
    Model,
    Partial,
    Pass,
    Points,
    State,
    StatisticsModel,
    UInt8,
    add_notes,
)

SPARSE_M2 = 1.0
"""Points per square metre below which no plausible noise has an effect."""
MAX_STOP_M = 1000.0
"""Upper limit of ``edge_length_stop_m``. Noise of many metres would require longer edges."""


@dataclass(frozen=True)
class NoisePass(Pass):
    """Steps 1 and 2: measure density and noise, and decide whether the run needs stage two."""

    params: Dong2018Parameters
    name: str = "noise"
    title = "decide whether noise matters"
    every_point: bool = True
    gives_labels: bool = False

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> StatisticsModel:
        """Measure density and planar patches."""
        return StatisticsModel(roughness.measure(points.xyz, window, core, scale))

    def reduce(self, partials: Iterable[Partial], state: State) -> State:
        """Add the figures of the run to the state.

        These are ``density_m2``, ``cells``, ``sigma_m``, ``patches``, ``threshold_m2``,
        ``thin_cell_m`` and ``dense``.

        Raises
        ------
        MethodRefusal
            If noise matters and there is no planar patch, or if a thinning cell cannot reach DEN_thr.
        """
        parts = cast(list[noise_sums.PatchCounts], list(partials))
        measured = noise_sums.merge(parts)
        given = state["run"]["sigma_m"]
        sigma, origin = measured.sigma_m, f"from {measured.patches} planar patches"
        if given is not None:
            sigma, origin = given, "given"
        figures = {
            "density_m2": measured.density_m2,
            "cells": sum(p["cells"] for p in parts),
            "sigma_m": sigma,
            "patches": measured.patches,
            "threshold_m2": None,
            "thin_cell_m": None,
            "dense": False,
        }
        density = f"{measured.density_m2:.3g} points/m2"
        assumed = sigma
        if assumed is None:
            assumed = noise_sums.MAX_SIGMA_M
        least = self.params.threshold_m2(assumed)
        if measured.density_m2 < SPARSE_M2 or (sigma is None and measured.density_m2 <= least):
            return with_notes(
                state,
                figures,
                f"{density}: too sparse for noise to matter, so the result is classic's",
            )
        if sigma is None:
            raise MethodRefusal(
                f"dong2018: {measured.patches or 'no'} planar patches of ground are too few to estimate the noise of"
                f" heights, which matters at {density}; give it with --sigma METRES"
            )

        summary = f"sigma {sigma:.3g} m ({origin}), {density}, DEN_thr {least:.3g} points/m2"
        figures["threshold_m2"] = least
        if measured.density_m2 <= least:
            return with_notes(
                state, figures, f"{summary}: sparser than that, so the result is classic's"
            )
        cell = self.params.thin_cell_m or _thin_cell(least)
        if 1.0 / cell**2 <= least:
            raise MethodRefusal(
                f"dong2018: with thin_cell {cell:g} m the TIN cannot be denser than {1 / cell**2:.3g} points/m2 and"
                f" never passes DEN_thr ({summary}); use --set thin_cell={_thin_cell(least):g}, or 0 to have it chosen"
            )
        figures.update(dense=True, thin_cell_m=cell)
        return with_notes(
            state,
            figures,
            f"{summary}: two stages, vertices of stage one thinned to {cell:g} m",
        )


def _thin_cell(threshold_m2: float) -> float:
    """The coarsest thinning cell (whole centimetres, at most 1 m) with which a TIN can exceed a density."""
    centimetres = math.ceil(100.0 / math.sqrt(threshold_m2)) - 1
    return min(max(centimetres, 1), 100) / 100


def with_notes(state: State, figures: Mapping[str, Any], *lines: str) -> State:
    """The state with more figures, and with notes about them."""
    return {
        **state,
        **figures,
        "notes": add_notes(state, *(f"dong2018: {line}" for line in lines)),
    }


def even_edge_m(density_m2: float) -> float:
    """Edge of the facets of an equilateral TIN of a density, which has a vertex for two facets."""
    return math.sqrt(2.0 / (math.sqrt(3.0) * density_m2))


@dataclass(frozen=True)
class StageOnePass(Pass):
    """Step 3: densify until noise decides. In dense clouds only vertices become ground, as in the paper."""

    params: Dong2018Parameters
    name: str = "stage-one"
    title = "find the first terrain"
    every_point: bool = True

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        """Densify the window's TIN."""
        if not state["dense"]:
            return ClassicPass(self.params.classic()).fit(points, window, core, scale, state)
        return StageOneModel(self.params, points, window, scale, state)


class StageOneModel(TinLabels):
    """The TIN of a window after stage one."""

    def __init__(
        self,
        params: Dong2018Parameters,
        points: Points,
        window: Window,
        scale: Scale,
        state: State,
    ) -> None:
        super().__init__(
            window.closed, {"candidates": 0, "rounds": 0, "pit_points": 0, "vertices": 0}
        )
        x, y, z = points.columns()
        if not x.size:
            return
        self._depth = math.ceil(scale.counts_z(params.pit_sigmas * state["sigma_m"]))
        self._pits = pits.pits(x, y, z, params.pit_sigmas * state["sigma_m"], scale)
        low = self._pits.holds(x, y, z)
        cell = float(state["thin_cell_m"])
        x, y, z = thinned((x[~low], y[~low], z[~low]), cell, scale)
        edge = min(round(even_edge_m(state["threshold_m2"]), DECIMALS), MAX_STOP_M)
        limits = replace(
            params, edge_length_stop_m=max(params.edge_length_stop_m, edge)
        ).limits(scale)
        cells = CellLattice.of(cell, scale)
        known = window.inside(CellLattice.of(pits.CELL_M, scale), pits.REACH_CELLS).inside(
            cells
        )
        tin, uncertified, rounds = densify_seeds(
            Xyz(x, y, z),
            np.zeros(x.size, np.bool_),
            CellLattice.of(params.max_building_size_m, scale),
            limits,
            params.rounds,
            known,
            scale,
        )
        self.stats.update(candidates=int(x.size), rounds=rounds, pit_points=int(low.sum()))
        self.finish(tin, uncertified, LabelRule(limits, 0.0, vertices_only=True))

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label vertices as ground, and points in pits below the TIN as low noise."""
        labels, uncertified_labels = super().label(points)
        if self.tin is not None:
            x, y, z = points.columns()
            low = np.flatnonzero((labels != GROUND) & self._pits.holds(x, y, z))
            below = z[low] < self.tin.heights(x[low], y[low]) - self._depth
            labels[low[below]] = LOW_NOISE
        return labels, uncertified_labels
