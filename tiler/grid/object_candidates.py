"""Objects left in the terrain of a laser scan: places that rise where the ground is not seen.

Where a filter takes some points of a building or of dense plants for ground, the terrain rises over it, but most
returns there are those of objects. Where a mound or a bank rises, most returns are ground, as they are around it.

A candidate is a connected part of the terrain above a level over the land around, which is the opening of the terrain
by a square. Levels are nested, so that the border of an object lies near one of them. Each candidate gets a chance
from three measures. Only those are judged whose measures mean something (`Limits`): there are none on steep land, in
closed woods or in sparse scans, where the terrain between few ground points is rough. Surfaces of which all returns
became ground are not found, nor are wide ones.

All that decides on a candidate lies within a fixed distance of it (`reach_cells`). So blocks do not change the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from ptd.arrays import AnyArray, Bool, Float64, Indices, Int32, Int64

Box = tuple[slice, ...]

WINDOW_M = 40.0
"""Side of the square of the opening."""
WIDEST_M = 60.0
"""Largest extent of a candidate along rows and columns. Longer ones are mostly dams, banks and ridges."""
LEVELS_M = (0.5, 0.8, 1.25, 2.0, 3.2, 5.0, 8.0)
"""Levels above the land around at which candidates are cut off."""
LEAST_M2 = 4.0
"""Area of the smallest candidate."""
STEEP_M = 0.8
"""Fall within `FALL_CELLS` from which a cell of the border is steep."""
FALL_CELLS, GAP_CELLS, RING_CELLS = 2, 2, 6
"""Distance in cells within which a border falls, and at which the land around begins and ends."""
LEAST_CHANCE = 0.5
"""Least chance of a place that is listed."""
MOST_CHANCE = 0.9
"""Largest chance that is told, as the constants of `Weights` are of simulated scenes."""
TOUCHING = np.ones((3, 3), np.bool_)


@dataclass(frozen=True)
class Limits:
    """Limits beyond which a candidate is not judged.

    Attributes
    ----------
    height_m : float
        Least height above the land around. Lower ones are not worth a look.
    steep : float
        Least share of the border that is steep. Below it, a candidate is a swell of the land.
    slope : float
        Largest slope of the land around. On steeper land, the terrain between distant ground points is rough.
    objects : float
        Largest share of objects among the returns around. In closed woods, the land around is not known.
    returns_m2 : float
        Least number of returns around per square metre. Ground is uncertain in sparser scans.
    unknown : float
        Largest share of cells without terrain in and beside it. What the border of the terrain cuts may continue there.
    seen : float
        Largest share of cells in it with a ground point. Through plants the ground is seen nearly everywhere, through
        roofs nowhere.
    """

    height_m: float = 1.0
    steep: float = 0.3
    slope: float = 0.35
    objects: float = 0.75
    returns_m2: float = 2.0
    unknown: float = 0.05
    seen: float = 0.6


@dataclass(frozen=True)
class Weights:
    """Logarithm of the odds that a candidate is an object, as a sum.

    The constants were fitted by ``python -m tests.benchmarks.left_objects`` without the limit `Limits.seen`. With it,
    nearly all candidates of the scenes are right, so a fit would give chances that are too high for real scans.

    Attributes
    ----------
    always : float
    objects : float
        For the share of objects among the returns in it: the ground is not seen there.
    slope : float
        For the slope of the land around (rise over run).
    border_ground : float
        For the density of ground points along its border, as a ratio to that around it. Walls have none.
    """

    always: float = 0.03
    objects: float = 4.83
    slope: float = -4.58
    border_ground: float = -1.84


MOST_BORDER_GROUND = 2.0
"""Largest ratio of densities that counts."""


class Candidates(NamedTuple):
    """Candidates of all levels, each [n], in the order of levels and of first cells.

    Attributes
    ----------
    level, label : int64
        Number of the level, and label among the cells of its level.
    row, column : int64
        First cell, row by row.
    height_m : float64
        Largest height above the land around.
    steep : float64
        Share of the border that is steep.
    slope : float64
        Mean slope of the land around.
    unknown : float64
        Share of cells without terrain in it and next to it.
    """

    level: Int64
    label: Int64
    row: Int64
    column: Int64
    height_m: Float64
    steep: Float64
    slope: Float64
    unknown: Float64

    def shaped(self, limits: Limits) -> Bool:
        """Return a mask of the candidates whose shape and land around are within limits."""
        is_shaped = (self.height_m >= limits.height_m) & (self.steep >= limits.steep)
        return is_shaped & (self.slope <= limits.slope) & (self.unknown <= limits.unknown)


def candidates(heights: Float64, cell_m: float, rim: int = 0) -> tuple[Candidates, list[Level]]:
    """Find the candidates in a window of cells without its outer ``rim``, which decides on their extent alone.

    Parameters
    ----------
    heights : float64 (rows, columns)
        Terrain in metres, NaN where there is none.
    cell_m : float
        Side of a cell.

    Returns
    -------
    candidates : Candidates
    levels : list of Level
    """
    known = ~np.isnan(heights)
    above = np.where(known, heights - _opened(heights, known, cell_m), 0.0)
    lowest = scipy.ndimage.minimum_filter(
        np.where(known, above, np.inf), 2 * FALL_CELLS + 1, mode="constant", cval=np.inf
    )
    is_steep = known & (above - lowest > STEEP_M)
    slope = np.nan_to_num(np.hypot(*np.gradient(heights))) / cell_m
    labels = [_labels_above(above, level, cell_m) for level in LEVELS_M]
    inner = tuple(slice(rim, size - rim) for size in heights.shape)
    above, known, is_steep, slope = (a[inner] for a in (above, known, is_steep, slope))
    levels = [Level.of(_without_gaps(of_level[inner]), known) for of_level in labels]
    columns = []
    for number, level in enumerate(levels):
        label, n = level.labels, level.n
        inside, of = level.inside
        first, height = np.full(n + 1, label.size, np.int64), np.zeros(n + 1)
        np.minimum.at(first, of, inside)
        np.maximum.at(height, of, above.ravel()[inside])
        columns.append(
            (
                np.full(n, number, np.int64),
                np.arange(1, n + 1),
                first[1:] // label.shape[1],
                first[1:] % label.shape[1],
                height[1:],
                level.mean(is_steep, level.border),
                level.mean(slope, level.ring),
                level.mean(~known, level.beside),
            )
        )
    joined = (np.concatenate(column) for column in zip(*columns, strict=True))
    return Candidates(*joined), levels


def _opened(heights: Float64, known: Bool, cell_m: float) -> Float64:
    """Return the opening by a square with an odd number of cells. Cells without a height do not count."""
    side = int(WINDOW_M / cell_m / 2) * 2 + 1
    lowest = scipy.ndimage.minimum_filter(
        np.where(known, heights, np.inf), side, mode="constant", cval=np.inf
    )
    lowest[np.isinf(lowest)] = -np.inf
    return scipy.ndimage.maximum_filter(lowest, side, mode="constant", cval=-np.inf)


def _labels_above(above: Float64, level: float, cell_m: float) -> Int32:
    """Label the parts above a level that are large enough and not too long."""
    label, n = scipy.ndimage.label(above > level, TOUCHING)
    longest = int(WIDEST_M / cell_m)
    is_kept = np.bincount(label.ravel(), minlength=n + 1) * cell_m**2 >= LEAST_M2
    is_kept[0] = False
    for number, (rows, columns) in enumerate(scipy.ndimage.find_objects(label), start=1):
        extent = max(rows.stop - rows.start, columns.stop - columns.start)
        is_kept[number] &= extent <= longest
    return np.where(is_kept, np.arange(n + 1), 0).astype(np.int32)[label]


def _without_gaps(labels: Int32 | Int64) -> Int32:
    """Number labels from 1, in their order. Cells with 0 keep it."""
    is_present = np.bincount(labels.ravel()) > 0
    is_present[0] = False
    numbers = np.where(is_present, np.cumsum(is_present), 0).astype(np.int32)
    numbered: Int32 = numbers[labels]
    return numbered


Zone = tuple[Indices, Int32]
"""Flat indices of cells, and the label of the candidate to which each belongs."""


class Level(NamedTuple):
    """Candidates of a level: labels (0 elsewhere), number, and cells in, at the border of, beside and around them."""

    labels: Int32
    n: int
    inside: Zone
    border: Zone
    beside: Zone
    ring: Zone

    @classmethod
    def of(cls, labels: Int32, known: Bool) -> Level:
        """Return a level of its labels. The land around lies in cells that are ``known``."""
        n, flat = int(labels.max(initial=0)), labels.ravel()
        if n == 0:
            nothing = np.zeros(0, np.intp), np.zeros(0, np.int32)
            return cls(labels, n, nothing, nothing, nothing, nothing)
        near, wide = (
            scipy.ndimage.maximum_filter(labels, 2 * cells + 1, mode="constant").ravel()
            for cells in (GAP_CELLS, RING_CELLS)
        )
        is_inside = labels > 0
        inside = np.flatnonzero(is_inside)
        border = np.flatnonzero(is_inside & ~scipy.ndimage.binary_erosion(is_inside))
        ring = np.flatnonzero((wide > 0) & (near == 0) & known.ravel())
        beside = np.flatnonzero(near)
        zones = ((inside, flat), (border, flat), (beside, near), (ring, wide))
        return cls(labels, n, *((cells, of[cells]) for cells, of in zones))

    def mean(self, values: AnyArray, zone: Zone) -> Float64:
        """Return the mean of the cells of a zone for each candidate, 0 if it has none."""
        cells, of = zone
        total = np.bincount(of, values.ravel()[cells], self.n + 1)
        return total[1:] / np.maximum(np.bincount(of, minlength=self.n + 1)[1:], 1)


class Measures(NamedTuple):
    """Measures of candidates for `Weights`, each [n], and a mask of those that are within all limits."""

    objects: Float64
    slope: Float64
    border_ground: Float64
    is_judged: Bool


def measures_of(
    found: Candidates,
    levels: list[Level],
    ground: Int64,
    objects: Int64,
    cell_m: float,
) -> Measures:
    """Measure candidates of `candidates` by the points in each cell.

    ``ground`` and ``objects`` are the numbers of points in each cell.
    """
    limits, columns = Limits(), []
    for level in levels:
        of_zones = [
            level.mean(points, zone)
            for zone in (level.inside, level.ring)
            for points in (ground, objects)
        ]
        seen = level.mean(ground > 0, level.inside)
        columns.append((*of_zones, level.mean(ground, level.border), seen))
    in_ground, in_objects, ring_ground, ring_objects, border_ground, seen = (
        np.concatenate(column) for column in zip(*columns, strict=True)
    )
    returns = ring_ground + ring_objects
    is_judged = found.shaped(limits) & (ring_objects <= limits.objects * returns)
    is_judged &= (returns >= limits.returns_m2 * cell_m**2) & (seen <= limits.seen)
    ratio = border_ground / np.maximum(ring_ground, 1e-9)
    return Measures(
        in_objects / np.maximum(in_ground + in_objects, 1e-9),
        found.slope,
        np.minimum(ratio, MOST_BORDER_GROUND),
        is_judged,
    )


def chances(measures: Measures, weights: Weights | None = None) -> Float64:
    """Return the chance of each candidate that it is an object, 0 beyond the limits."""
    by = weights or Weights()
    odds = by.always + by.objects * measures.objects + by.slope * measures.slope
    odds += by.border_ground * measures.border_ground
    return np.where(measures.is_judged, scipy.special.expit(odds), 0.0)


def chosen(
    found: Candidates, levels: list[Level], chance: Float64
) -> list[tuple[int, Bool, Box]]:
    """Return the candidates that are listed: index, cells, and the box of these.

    Of candidates that overlap, the one with the largest chance is listed.
    """
    taken = np.zeros(levels[0].labels.shape, np.bool_)
    boxes = [scipy.ndimage.find_objects(level.labels) for level in levels]
    places = []
    for i in np.argsort(-chance, kind="stable"):
        if chance[i] < LEAST_CHANCE:
            break
        level, number = int(found.level[i]), int(found.label[i])
        box = boxes[level][number - 1]
        cells = levels[level].labels[box] == number
        if not taken[box][cells].any():
            taken[box] |= cells
            places.append((int(i), cells, box))
    return places


def reach_cells(cell_m: float) -> int:
    """Return the distance in cells from the first cell of a candidate within which all lies that decides on it.

    It extends at most `WIDEST_M`. So does another candidate that takes cells of the land around it, or that overlaps
    it and has land around of its own. The opening there depends on heights up to the width of its square away.
    """
    opening = 2 * int(WINDOW_M / cell_m / 2)
    return near_cells(cell_m) + int(WIDEST_M / cell_m) + opening + FALL_CELLS + 1


def near_cells(cell_m: float) -> int:
    """Return the distance within which candidates lie that overlap it, and those that take land around these."""
    return int(WIDEST_M / cell_m) + 2 * RING_CELLS
