"""Density and noise of a run and of each place (`ptd.places`), from the counts of windows (`ptd.ground.roughness`).

Sums are of whole numbers, in any order.

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
from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from ptd.arrays import Int32, Int64
from ptd.places import PLACE_M

PATCH_M = 4.0
"""Size of the cells that are counted."""
MAX_SIGMA_M = 0.3
"""Largest noise of patches that are counted."""
BIN_M = 0.001
BINS = round(MAX_SIGMA_M / BIN_M) + 2
MIN_SHARE = 0.005
"""Least share of planar patches among cells with enough points. In a wood the few planar
patches do not show the noise."""
SMOOTHEST_SHARE, SMOOTHEST_FACTOR = 0.05, 1.25
"""Quantile of the noise of all quarters of patches, and the factor by which it is multiplied to
estimate the noise of the smoothest patches, even where no ground is visible."""


class PatchCounts(TypedDict):
    """Counts that the core of a window adds to the figures of a run.

    ``points`` is the number of points, ``cells`` that of the cells of `PATCH_M` with points, and ``full`` that of the
    cells with at least `ptd.ground.roughness.MIN_POINTS`. ``patches`` and ``quarters`` are numbers of patches and of
    quarters by bins of `BIN_M` of their noise (`histogram`).
    """

    points: int
    cells: int
    full: int
    patches: list[int] | Int32
    quarters: list[int] | Int32


class PlaceCounts(PatchCounts):
    """Counts that the core of a window adds to a place, which is given by its column and row."""

    place: list[int]


@dataclass(frozen=True)
class Roughness:
    """Density and noise of a run or a place.

    Attributes
    ----------
    density_m2 : float
        Points per square metre of the cells of `PATCH_M` that contain points; 0 without points.
    sigma_m : float or None
        Noise of heights in metres; None if there are no or too few planar patches.
    patches : int
        Number of planar patches from which the noise is computed. For a place it is the sum of their weights.
    smoothest_m : float or None
        Noise of the smoothest patches in metres, whether or not they are planar ground: any dense cloud has some. None
        if no quarter of a patch has enough points.
    """

    density_m2: float
    sigma_m: float | None
    patches: int
    smoothest_m: float | None = None


def histogram(bins: Int64) -> list[int]:
    """Count the values of each bin, from the first bin that has any: [first, count, count, ...].

    Bins of -1 are not counted.
    """
    known = bins[bins >= 0]
    if known.size == 0:
        return []
    first = int(known.min())
    counts: list[int] = np.bincount(known - first).tolist()
    return [first, *counts]


def merge(partials: Iterable[PatchCounts]) -> Roughness:
    """Return the figures of a run from the partials of all cores, in any order."""
    sums = Sums()
    for partial in partials:
        sums.add(partial)
    return sums.roughness()


class Sums:
    """Sums of `PatchCounts`, with whole weights, in any order."""

    def __init__(self) -> None:
        self.points = self.cells = self.full = 0
        self.patches, self.quarters = np.zeros((2, BINS), np.int64)

    def add(self, partial: PatchCounts, weight: int = 1) -> None:
        """Add a partial ``weight`` times."""
        self.points += weight * partial["points"]
        self.cells += weight * partial["cells"]
        self.full += weight * partial["full"]
        _add(self.patches, partial["patches"], weight)
        _add(self.quarters, partial["quarters"], weight)

    def roughness(self) -> Roughness:
        """Return the figures."""
        density = self.points / (self.cells * PATCH_M**2) if self.cells else 0.0
        smoothest = _quantile(self.quarters, SMOOTHEST_SHARE)
        smoothest = None if smoothest is None else round(SMOOTHEST_FACTOR * smoothest, 6)
        n = int(self.patches.sum())
        sigma = None if n < MIN_SHARE * self.full else _quantile(self.patches, 0.25)
        return Roughness(density, sigma, n, smoothest)


def _add(histogram: Int64, counts: list[int] | Int32, weight: int) -> None:
    if len(counts):
        first = counts[0]
        histogram[first : first + len(counts) - 1] += weight * np.asarray(counts[1:], np.int64)


def _quantile(histogram: Int64, share: float) -> float | None:
    """Return the value below which a share of a histogram with bins of `BIN_M` lies, or None if it is empty."""
    below = np.cumsum(histogram)
    if below[-1] == 0:
        return None
    return round((int(np.argmax((below >= share * below[-1]) & (below > 0))) + 0.5) * BIN_M, 6)


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
DIGITS = 4
"""Significant digits of a density."""


def by_place(partials: Iterable[PlaceCounts]) -> dict[Place, Roughness]:
    """Return the figures of all places within `AROUND` places of one with points, by rows.

    Parameters
    ----------
    partials : iterable of PlaceCounts
        Results of `ptd.ground.roughness.measure_places` for all cores, in any order. A place may have several.
    """
    held: dict[Place, list[PlaceCounts]] = defaultdict(list)
    for partial in partials:
        column, row = partial["place"]
        # Histograms as arrays need a tenth of the memory: a country has a million places.
        held[column, row].append(
            {
                **partial,
                "patches": np.array(partial["patches"], np.int32),
                "quarters": np.array(partial["quarters"], np.int32),
            }
        )
    steps = range(-AROUND, AROUND + 1)
    reached = {
        (column + right, row + up) for column, row in held for right in steps for up in steps
    }
    return {
        place: _around(place, held) for place in sorted(reached, key=lambda place: place[::-1])
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
