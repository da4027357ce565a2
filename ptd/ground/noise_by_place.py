"""Density and noise of each place (`ptd.places`), from what windows counted there and around it.

A place alone may be a corner of the survey or all wood, so it is measured with those up to two places around it, and
nothing beyond `REACH_M` counts. Counts of noise are added up, near ones with more weight: what is smooth in a
neighbourhood tells the noise of all of it, as it would in a small survey. The density of any piece of a survey is known
well: it is the place's own, and that of its neighbours (by logarithms) only as far as it holds next to nothing.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ptd.frame import Scale, Window
from ptd.ground.noise_sums import PATCH_M, Roughness, Sums
from ptd.ground.roughness import patches
from ptd.places import PLACE_M, Int32

Place = tuple[int, int]
Partial = Mapping[str, Any]

WEIGHTS = (1, 4, 6, 4, 1)
"""Of counts of noise, by places along a row or column: near a Gaussian of 256 m."""
OF_DENSITY = (1, 32, 1024, 32, 1)
"""Of densities, for as many occupied cells."""
AROUND = len(WEIGHTS) // 2
REACH_M = (AROUND + 1.5) * PLACE_M
"""What is farther from a point than this has no part in its figures: the four middles around it are up to a place away,
and rest on what is up to two places and a half from them."""
PATCHES_ACROSS = round(PLACE_M / PATCH_M)
DIGITS = 4
"""Significant digits of a density."""


def measure_places(xyz: Int32, core: Window, scale: Scale) -> list[dict[str, Any]]:
    """What the core of a window adds to each place that it touches.

    Parameters and dicts are those of `ptd.ground.roughness.measure`, with ``place``, column and row, besides.
    """
    found = patches(xyz, core, scale)
    columns, rows = found.columns // PATCHES_ACROSS, found.rows // PATCHES_ACROSS
    order = np.lexsort((columns, rows))
    other = (np.diff(columns[order]) != 0) | (np.diff(rows[order]) != 0)
    parts = np.split(order, np.flatnonzero(other) + 1) if order.size else []
    return [{"place": [int(columns[part[0]]), int(rows[part[0]])], **found.counts(part)} for part in parts]


def by_place(partials: Iterable[Partial]) -> dict[Place, Roughness]:
    """Figures of all places within `AROUND` places of one that holds points, by rows.

    Parameters
    ----------
    partials : iterable of mapping
        Those of `measure_places`, of all cores, in any order; a place may have several.
    """
    held: dict[Place, list[Partial]] = defaultdict(list)
    for partial in partials:
        column, row = partial["place"]
        held[column, row].append(_packed(partial))
    steps = range(-AROUND, AROUND + 1)
    reached = {(column + right, row + up) for column, row in held for right in steps for up in steps}
    return {place: _around(place, held) for place in sorted(reached, key=lambda place: place[::-1])}


def _packed(partial: Partial) -> Partial:
    """A partial whose histograms take a tenth of the memory: a country has a million places."""
    arrays = {name: np.array(partial[name], np.int32) for name in ("patches", "quarters")}
    return {**partial, **arrays}


def _around(place: Place, held: Mapping[Place, list[Partial]]) -> Roughness:
    """Figures of a place, the surroundings taken row by row: sums of logarithms depend on their order."""
    sums, weights, logarithms = Sums(), 0, 0.0
    for row in range(2 * AROUND + 1):
        for column in range(2 * AROUND + 1):
            own = held.get((place[0] + column - AROUND, place[1] + row - AROUND), ())
            for partial in own:
                sums.add(partial, WEIGHTS[row] * WEIGHTS[column])
            points, cells = (sum(partial[name] for partial in own) for name in ("points", "cells"))
            if points and cells:
                weight = OF_DENSITY[row] * OF_DENSITY[column] * cells
                weights += weight
                logarithms += weight * math.log(points / (cells * PATCH_M**2))
    found = sums.roughness()
    density = math.exp(logarithms / weights) if weights else 0.0
    return Roughness(float(f"{density:.{DIGITS}g}"), found.sigma_m, found.patches, found.smoothest_m)
