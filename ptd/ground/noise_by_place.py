"""Density and noise of each place (`ptd.places`), from the counts that windows add to it and to nearby places.

A single place may be a corner of the survey or may contain only wood. So it is measured
together with the places up to two places away, and points beyond `REACH_M` do not count. Counts
of noise are added up with larger weights for nearer places: the smooth patches of a
neighbourhood give the noise of all of it, as they would in a small survey. The density of any
part of a survey is known well. So the density of a place is computed almost only from its own
points. Its neighbours, in a weighted geometric mean, matter only if the place contains hardly
any points.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping

import numpy as np

from ptd.frame import Scale, Window
from ptd.ground.noise_sums import PATCH_M, PlaceCounts, Roughness, Sums
from ptd.ground.roughness import patches
from ptd.places import PLACE_M, Int32

Place = tuple[int, int]

NOISE_WEIGHTS = (1, 4, 6, 4, 1)
"""Weights of counts of noise, by places along a row or column: nearly a Gaussian of 256 m."""
DENSITY_WEIGHTS = (1, 32, 1024, 32, 1)
"""Weights of densities, by places along a row or column. Numbers of occupied cells multiply
them."""
AROUND = len(NOISE_WEIGHTS) // 2
"""Largest distance, in places, of the places that are measured together."""
REACH_M = (AROUND + 1.5) * PLACE_M
"""Distance beyond which points do not change the figures at a position. The four middles around
it are up to a place away, and depend on points up to two and a half places from them."""
PATCHES_ACROSS = round(PLACE_M / PATCH_M)
DIGITS = 4
"""Significant digits of a density."""


def measure_places(xyz: Int32, core: Window, scale: Scale) -> list[PlaceCounts]:
    """Return the counts that the core of a window adds to each place that it touches.

    `ptd.ground.roughness.measure` describes the parameters.
    """
    measured_patches = patches(xyz, core, scale)
    columns, rows = (
        measured_patches.columns // PATCHES_ACROSS,
        measured_patches.rows // PATCHES_ACROSS,
    )
    order = np.lexsort((columns, rows))
    other = (np.diff(columns[order]) != 0) | (np.diff(rows[order]) != 0)
    parts = np.split(order, np.flatnonzero(other) + 1) if order.size else []
    return [
        {"place": [int(columns[part[0]]), int(rows[part[0]])], **measured_patches.counts(part)}
        for part in parts
    ]


def by_place(partials: Iterable[PlaceCounts]) -> dict[Place, Roughness]:
    """Return the figures of all places within `AROUND` places of one with points, by rows.

    Parameters
    ----------
    partials : iterable of PlaceCounts
        Results of `measure_places` for all cores, in any order. A place may have several.
    """
    held: dict[Place, list[PlaceCounts]] = defaultdict(list)
    for partial in partials:
        column, row = partial["place"]
        held[column, row].append(_packed(partial))
    steps = range(-AROUND, AROUND + 1)
    reached = {
        (column + right, row + up) for column, row in held for right in steps for up in steps
    }
    return {
        place: _around(place, held) for place in sorted(reached, key=lambda place: place[::-1])
    }


def _packed(partial: PlaceCounts) -> PlaceCounts:
    """Return a partial with histograms as arrays, which need a tenth of the memory: a country has a million places."""
    return {
        **partial,
        "patches": np.array(partial["patches"], np.int32),
        "quarters": np.array(partial["quarters"], np.int32),
    }


def _around(place: Place, held: Mapping[Place, list[PlaceCounts]]) -> Roughness:
    """Return the figures of a place.

    Surroundings are added row by row, because sums of logarithms depend on the order.
    """
    sums, weights, logarithms = Sums(), 0, 0.0
    for row in range(2 * AROUND + 1):
        for column in range(2 * AROUND + 1):
            place_partials = held.get((place[0] + column - AROUND, place[1] + row - AROUND), ())
            for partial in place_partials:
                sums.add(partial, NOISE_WEIGHTS[row] * NOISE_WEIGHTS[column])
            points, cells = (
                sum(partial[name] for partial in place_partials) for name in ("points", "cells")
            )
            if points and cells:
                weight = DENSITY_WEIGHTS[row] * DENSITY_WEIGHTS[column] * cells
                weights += weight
                logarithms += weight * math.log(points / (cells * PATCH_M**2))
    roughness = sums.roughness()
    density = math.exp(logarithms / weights) if weights else 0.0
    return Roughness(
        float(f"{density:.{DIGITS}g}"),
        roughness.sigma_m,
        roughness.patches,
        roughness.smoothest_m,
    )
