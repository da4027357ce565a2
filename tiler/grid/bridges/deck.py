"""Detection of bridge decks, which have lower ground on both sides and a road at both ends.

Precision is more important than recall, so each of these conditions has to be true:

- The deck is smooth, and its edges are sharp: next to them hardly any point lies between the deck and the ground below.
  An embankment, or the bank of a ditch, has points on its slopes.
- The ground is about equally low on both sides. At a retaining wall, a dam or a quay the sides differ.
- The ground next to the deck rises at both ends, more steeply than a ramp, since the gap under the bridge ends there.
- Ground goes on at both ends as a continuation of the deck.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiler.grid.bridges.deck_cells import DROP_M, MAX_WIDTH_M
from tiler.grid.bridges.deck_sides import BESIDE_M, TOLERANCE_M, Bools, DeckEdges, Floats, sides_of

Ints = npt.NDArray[np.intp]
Surface = tuple[float, float, float, float]
"""Coefficients of height = a + b s + c s^2 + d t, with s along a deck and t across it."""

END_M = 12.0
"""Distance beyond each end of the free part within which the ground next to the deck has to rise."""
MIN_LENGTH_M, MAX_LENGTH_M = 5.0, 300.0
"""Limits of the length of the free part."""
MIN_WIDTH_M = 2.0
"""Least width of the free part."""
SLIMNESS = 1.0
"""Least ratio of length to width of the free part."""
MIN_SLICES = 4
"""Least number of slices of the free part."""
CLEARANCE_M = 2.0
"""Least height of a deck above the ground next to it: lower ones look like terraces, or banks with plants."""
MIN_SLICE_M = 1.5
"""Least length of a slice."""
MAX_TURNS = 2
"""Largest number of times that the direction of a deck is adjusted."""
STRAIGHT = 0.02
"""Slope of a deck's edges relative to its direction below which the direction is not adjusted."""
ROAD_SLICES = 3
"""Number of slices beyond an end in which the road has to go on."""
MIN_ROAD_POINTS, MIN_ROAD_SHARE = 3, 0.5
"""Least number of ground points of the road in these slices, and their least share of all points in them."""
INNER_M = 0.7
"""Least distance from the edges of a deck of a point that counts as beneath the deck."""
WIDER_M = 0.3
"""Distance by which the outline of a deck is wider than its points, on each side."""
ALIKE, ALIKE_M = 0.35, 0.7
"""Largest height difference of the two sides: share of the clearance, and metres. The larger limit counts."""


@dataclass(frozen=True)
class Deck:
    """Free part of a deck, in metres from the origin of its points.

    Attributes
    ----------
    ring : float64 (n, 2)
        Corners of the outline.
    centre, along : (float, float)
        Position where s and t are 0, and the unit vector of s. The t axis points to the left of it.
    surface : (float, float, float, float)
        Coefficients of height = a + b s + c s^2 + d t.
    length_m, width_m, clearance_m : float
        Length and mean width of the free part, and median of its height above the ground next to it.
    below : int
        Number of points beneath the free part.
    """

    ring: Floats
    centre: tuple[float, float]
    along: tuple[float, float]
    surface: Surface
    length_m: float
    width_m: float
    clearance_m: float
    below: int


@dataclass(frozen=True)
class _View:
    """Points in the coordinates of a deck, and the slices of the deck.

    Attributes
    ----------
    s, t, off : float64 (n,)
        Positions along and across the deck, and heights above its surface.
    surface : (float, float, float, float)
    starts : float64 (slices,)
        Start of each slice along s.
    width : float
        Width of a slice along s.
    sides : DeckEdges
    """

    s: Floats
    t: Floats
    off: Floats
    surface: Surface
    starts: Floats
    width: float
    sides: DeckEdges


def find_deck(
    xyz: Floats, ground: Bools, seeds: Bools, across: tuple[float, float], spacing_m: float
) -> tuple[Deck | None, str]:
    """Find the free part of a deck among points. Return it, or None and the reason why there is none.

    Parameters
    ----------
    xyz : float64 (n, 3)
        Points of a candidate and around it, without noise, in metres.
    ground, seeds : bool (n,)
        Masks of the ground points, and of the points in the candidate's cells.
    across : (float, float)
        Unit vector across the deck, roughly.
    spacing_m : float
        Spacing of the points.
    """
    centre = np.median(xyz[seeds, :2], axis=0)
    along = np.array((-across[1], across[0]))
    turns = 0
    while True:
        view = _view(xyz, seeds, centre, along, spacing_m)
        if view is None:
            return None, "not smooth"
        free = _longest_run(view.sides.both_free())
        if free is None:
            return None, "no part stands free on both sides"
        slope = _slope(view, free)
        if turns == MAX_TURNS or abs(slope) < STRAIGHT:
            break
        along = along + slope * np.array((-along[1], along[0]))
        along = along / np.hypot(*along)
        turns += 1
    edges = view.sides.edge[free]
    length = len(free) * view.width
    width = float(np.median(edges[:, 1] - edges[:, 0]))
    levels = np.median(view.sides.level[free], axis=0)
    clearance = float(-levels.max())
    reason = (
        _wrong_size(length, width, len(free))
        or _wrong_levels(levels)
        or _wrong_end(view, ground, edges, int(free[-1]), 1, clearance)
        or _wrong_end(view, ground, edges, int(free[0]), -1, clearance)
    )
    if reason:
        return None, reason
    ring = _ring(view, free) @ np.array((along, (-along[1], along[0]))) + centre
    position = (float(centre[0]), float(centre[1]))
    direction = (float(along[0]), float(along[1]))
    below = _beneath(view, free, edges)
    return Deck(ring, position, direction, view.surface, length, width, clearance, below), ""


def _view(xyz: Floats, seeds: Bools, centre: Floats, along: Floats, spacing: float) -> _View | None:
    """Return the points in the coordinates of a deck, or None if its seeds do not form a surface."""
    s, t = _rotated(xyz[:, :2] - centre, along)
    surface = _fitted(s, t, xyz[:, 2], seeds)
    if surface is None:
        return None
    off = xyz[:, 2] - _height(surface, s, t)
    width = max(MIN_SLICE_M, 2.5 * spacing)
    first = s[seeds].min() - 2 * END_M
    last = s[seeds].max() + 2 * END_M
    numbers = np.arange(np.floor(first / width), np.ceil(last / width))
    return _View(s, t, off, surface, numbers * width, width, sides_of(s, t, off, numbers, width, spacing))


def _slope(view: _View, free: Ints) -> float:
    """Return the slope of the edges of a free part relative to its direction."""
    if len(free) < 3:
        return 0.0
    return float(np.mean([np.polyfit(view.starts[free], view.sides.edge[free, k], 1)[0] for k in (0, 1)]))


def _wrong_size(length: float, width: float, n_slices: int) -> str:
    """Return the size of the free part if it is wrong for a deck, or an empty text."""
    min_length = max(MIN_LENGTH_M, SLIMNESS * width)
    fits = MIN_WIDTH_M <= width <= MAX_WIDTH_M and min_length <= length <= MAX_LENGTH_M
    return "" if fits and n_slices >= MIN_SLICES else f"{length:.0f} m by {width:.0f} m"


def _wrong_levels(levels: Floats) -> str:
    """Return why the levels of the ground next to both sides are wrong for a deck, or an empty text."""
    clearance = float(-levels.max())
    difference = float(abs(levels[0] - levels[1]))
    if clearance < CLEARANCE_M:
        return f"clearance {clearance:.1f} m"
    return f"sides differ by {difference:.1f} m" if difference > max(ALIKE_M, ALIKE * clearance) else ""


def _wrong_end(view: _View, ground: Bools, edges: Floats, end: int, step: int, clearance: float) -> str:
    """Check that the ground next to the deck rises beyond the slice ``end``, and that the road continues.

    Slices beyond the end have higher numbers if ``step`` is 1, and lower numbers if it is -1. Return the reason why
    this is not the end of a deck, or an empty text.
    """
    n_slices = int(np.ceil(END_M / view.width))
    near = end + step * np.arange(1, n_slices + 1)
    near = near[(near >= 0) & (near < len(view.starts))]
    # The ground is halfway up, or it is as high as the deck and extends beyond the edge.
    up = view.sides.level[near] > -0.5 * clearance
    up |= (view.sides.edge[near] - np.median(edges, axis=0)) * (-1, 1) > BESIDE_M / 2
    if not up.any(axis=0).all():
        return "the ground next to the deck does not rise at an end"
    road_starts = view.starts[near[:ROAD_SLICES]]
    box = (view.s >= road_starts.min()) & (view.s < road_starts.max() + view.width)
    box &= (view.t > np.median(edges[:, 0])) & (view.t < np.median(edges[:, 1]))
    n_road = int((box & ground & (np.abs(view.off) < 2 * TOLERANCE_M)).sum())
    if n_road >= max(MIN_ROAD_POINTS, MIN_ROAD_SHARE * int(box.sum())):
        return ""
    return "the road does not continue at an end"


def _beneath(view: _View, free: Ints, edges: Floats) -> int:
    """Count the points beneath the free part of a deck, well within its edges."""
    inner = (view.t > np.median(edges[:, 0]) + INNER_M) & (view.t < np.median(edges[:, 1]) - INNER_M)
    inner &= (view.s >= view.starts[free[0]]) & (view.s < view.starts[free[-1]] + view.width)
    return int((inner & (view.off < -DROP_M)).sum())


def _ring(view: _View, free: Ints) -> Floats:
    """Return the outline (s, t) of the free part, `WIDER_M` wider on each side than its points."""
    middles = view.starts[free] + view.width / 2
    middles[0], middles[-1] = view.starts[free[0]], view.starts[free[-1]] + view.width
    right = np.column_stack((middles, view.sides.edge[free, 0] - WIDER_M))
    left = np.column_stack((middles, view.sides.edge[free, 1] + WIDER_M))
    return np.concatenate((right, left[::-1]))


def _rotated(xy: Floats, along: Floats) -> tuple[Floats, Floats]:
    return xy @ along, xy @ np.array((-along[1], along[0]))


def _height(surface: Surface, s: Floats, t: Floats) -> Floats:
    a, b, c, d = surface
    heights: Floats = a + b * s + c * s * s + d * t
    return heights


def _fitted(s: Floats, t: Floats, z: Floats, seeds: Bools) -> Surface | None:
    """Fit a surface to the seeds, without outliers. Return None if too few seeds are near it."""
    all_rows = np.flatnonzero(seeds)
    deviations = np.abs(z[all_rows] - np.median(z[all_rows]))
    rows = all_rows[deviations < max(1.5, 2 * float(np.median(deviations)))]
    surface = None
    for limit in (2.0, 1.0, 0.5, TOLERANCE_M):
        if len(rows) < 12:
            return None
        terms = np.column_stack((np.ones(len(rows)), s[rows], s[rows] ** 2, t[rows]))
        solved = np.linalg.lstsq(terms, z[rows], rcond=None)[0]
        surface = (float(solved[0]), float(solved[1]), float(solved[2]), float(solved[3]))
        rows = all_rows[np.abs(z[all_rows] - _height(surface, s[all_rows], t[all_rows])) < limit]
    return surface if len(rows) > 0.4 * seeds.sum() else None


def _longest_run(free: Bools) -> Ints | None:
    """Return the indices of the longest run of free slices, or None if it has fewer than two.

    A single slice that is not free does not end a run, but it is left out.
    """
    closed = free.copy()
    closed[1:-1] |= free[:-2] & free[2:]
    runs = np.flatnonzero(np.diff(closed, prepend=False, append=False)).reshape(-1, 2)
    if not len(runs):
        return None
    start, stop = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    rows = np.arange(start, stop)
    return rows[free[rows]] if free[rows].sum() >= 2 else None
