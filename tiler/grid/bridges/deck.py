"""Detection of bridge decks, which have lower ground on both sides and a road at both ends.

Precision is more important than recall, so each of these conditions has to be true:

- The deck is smooth, and its edges are sharp: next to them hardly any point lies between the
  deck and the ground below. An embankment, or the bank of a ditch, has points on its slopes.
- The ground is about equally low on both sides. At a retaining wall, a dam or a quay the sides
  differ.
- The ground next to the deck rises at both ends, more steeply than a ramp, since the gap under
  the bridge ends there.
- The road goes on at both ends: there are ground points as high as the deck.

A deck is examined in slices, which are parts of equal length along the deck. The free part of a
deck consists of the slices with lower ground on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ptd.arrays import Bool, Float64, Indices
from tiler.grid.bridges.deck_cells import DROP_M, MAX_WIDTH_M

Surface = tuple[float, float, float, float]
"""Coefficients of height = a + b s + c s^2 + d t in metres, with s along a deck and t across
it."""

END_M = 12.0
"""The ground next to the deck has to rise within this distance beyond each end of the free
part, in metres."""
MIN_LENGTH_M, MAX_LENGTH_M = 5.0, 300.0
"""The length of the free part is within these limits, in metres."""
MIN_WIDTH_M = 2.0
"""The free part is at least this wide, in metres."""
SLIMNESS = 1.0
"""The length of the free part is at least this multiple of its width."""
MIN_SLICES = 4
"""The free part has at least this many slices."""
CLEARANCE_M = 2.0
"""A deck is at least this high above the ground next to it, in metres.

Lower areas look like terraces, or banks with plants.
"""
MIN_SLICE_M = 1.5
"""A slice is at least this long, in metres. It is longer if the points are sparse."""
MAX_TURNS = 2
"""The direction of a deck is adjusted at most this many times."""
STRAIGHT = 0.02
"""The direction of a deck is not adjusted if the slope of its edges relative to the direction
is below this."""
ROAD_SLICES = 3
"""The road is searched in this many slices beyond each end of the free part."""
MIN_ROAD_POINTS = 3
"""The road goes on only if at least this many points in those slices are ground as high as the deck.

Only points between the edges of the deck count.
"""
MIN_ROAD_SHARE = 0.5
"""The road goes on only if also at least this share of those points is ground as high as the
deck."""
INNER_M = 0.7
"""A point beneath the deck is counted only if it is this far inside both edges, in metres."""
WIDER_M = 0.3
"""The outline of a deck is this much wider on each side than its points, in metres."""
ALIKE = 0.35
"""The ground on the two sides may differ in height by this share of the clearance, or by
`ALIKE_M` if that is more."""
ALIKE_M = 0.7
"""Height difference between the two sides that is always allowed, in metres."""


@dataclass(frozen=True)
class Deck:
    """Free part of a deck, in the coordinates of the points passed to `find_deck`, in metres.

    Attributes
    ----------
    ring : float64 (n, 2)
        Corners of the outline.
    centre : (float, float)
        Position where s and t are 0.
    along : (float, float)
        Unit vector of the s axis. The t axis points to the left of the s axis.
    surface : (float, float, float, float)
        See `Surface`.
    length_m : float
    width_m : float
        Median of the widths of the slices.
    clearance_m : float
        Height above the ground next to the deck: the median over the slices, on the side where the ground is higher.
    n_below : int
        Number of points beneath the free part.
    """

    ring: Float64
    centre: tuple[float, float]
    along: tuple[float, float]
    surface: Surface
    length_m: float
    width_m: float
    clearance_m: float
    n_below: int


@dataclass(frozen=True)
class _View:
    """Points in the coordinates of a deck, and the slices of the deck.

    Attributes
    ----------
    s, t, off : float64 (n,)
        Positions of the points along and across the deck, and heights above its surface, in metres.
    surface : (float, float, float, float)
        See `Surface`.
    starts : float64 (slices,)
        Value of s at the start of each slice.
    slice_m : float
        Length of a slice along the deck.
    edges : _DeckEdges
        Edges of each slice.
    """

    s: Float64
    t: Float64
    off: Float64
    surface: Surface
    starts: Float64
    slice_m: float
    edges: _DeckEdges


def find_deck(
    xyz: Float64, ground: Bool, seeds: Bool, across: tuple[float, float], spacing_m: float
) -> tuple[Deck | None, str]:
    """Find the free part of a deck among points. Return it, or None and the reason why there is none.

    Parameters
    ----------
    xyz : float64 (n, 3)
        Points in and around the cells of a candidate, without noise, in metres.
    ground : bool (n,)
        Mask of the ground points.
    seeds : bool (n,)
        Mask of the points in those cells of the candidate that have the tried direction.
    across : (float, float)
        Unit vector that points roughly across the deck.
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
        left, right = view.edges.free.T
        free = _longest_run(left & right)
        if free is None:
            return None, "no part stands free on both sides"
        slope = _slope(view, free)
        if turns == MAX_TURNS or abs(slope) < STRAIGHT:
            break
        along = along + slope * np.array((-along[1], along[0]))
        along = along / np.hypot(*along)
        turns += 1
    free_edges = view.edges.edge[free]
    length = len(free) * view.slice_m
    width = float(np.median(free_edges[:, 1] - free_edges[:, 0]))
    levels = np.median(view.edges.level[free], axis=0)
    clearance = float(-levels.max())
    reason = (
        _wrong_size(length, width, len(free))
        or _wrong_levels(levels)
        or _wrong_end(view, ground, free_edges, int(free[-1]), 1, clearance)
        or _wrong_end(view, ground, free_edges, int(free[0]), -1, clearance)
    )
    if reason:
        return None, reason
    ring = _ring(view, free) @ np.array((along, (-along[1], along[0]))) + centre
    position = (float(centre[0]), float(centre[1]))
    direction = (float(along[0]), float(along[1]))
    n_below = _beneath(view, free, free_edges)
    return Deck(ring, position, direction, view.surface, length, width, clearance, n_below), ""


def _view(
    xyz: Float64, seeds: Bool, centre: Float64, along: Float64, spacing: float
) -> _View | None:
    """Return the points in the coordinates of a deck, or None if the seeds do not form a surface."""
    s, t = _rotated(xyz[:, :2] - centre, along)
    surface = _fitted(s, t, xyz[:, 2], seeds)
    if surface is None:
        return None
    off = xyz[:, 2] - _height(surface, s, t)
    slice_m = max(MIN_SLICE_M, 2.5 * spacing)
    first = s[seeds].min() - 2 * END_M
    last = s[seeds].max() + 2 * END_M
    numbers = np.arange(np.floor(first / slice_m), np.ceil(last / slice_m))
    edges = _find_edges(s, t, off, numbers, slice_m, spacing)
    return _View(s, t, off, surface, numbers * slice_m, slice_m, edges)


def _slope(view: _View, free: Indices) -> float:
    """Return the mean slope of both edges of a free part relative to the s axis, or 0 for less than three slices."""
    if len(free) < 3:
        return 0.0
    edges = view.edges.edge[free].T
    return float(np.mean([np.polyfit(view.starts[free], edge, 1)[0] for edge in edges]))


def _wrong_size(length: float, width: float, n_slices: int) -> str:
    """Return the size of the free part as a text if the size is wrong for a deck, or an empty text."""
    min_length = max(MIN_LENGTH_M, SLIMNESS * width)
    fits = MIN_WIDTH_M <= width <= MAX_WIDTH_M and min_length <= length <= MAX_LENGTH_M
    return "" if fits and n_slices >= MIN_SLICES else f"{length:.0f} m by {width:.0f} m"


def _wrong_levels(levels: Float64) -> str:
    """Return why a deck cannot have these heights of the ground on its two sides, or an empty text if it can."""
    clearance = float(-levels.max())
    difference = float(abs(levels[0] - levels[1]))
    if clearance < CLEARANCE_M:
        return f"clearance {clearance:.1f} m"
    return (
        f"sides differ by {difference:.1f} m"
        if difference > max(ALIKE_M, ALIKE * clearance)
        else ""
    )


def _wrong_end(
    view: _View, ground: Bool, free_edges: Float64, end: int, step: int, clearance: float
) -> str:
    """Check that the ground next to the deck rises beyond the slice ``end``, and that the road continues.

    Slices beyond the end have higher numbers if ``step`` is 1, and lower numbers if it is -1.
    Return the reason why this is not the end of a deck, or an empty text.
    """
    n_slices = int(np.ceil(END_M / view.slice_m))
    near = end + step * np.arange(1, n_slices + 1)
    near = near[(near >= 0) & (near < len(view.starts))]
    # The ground has risen if it is less than half the clearance below the deck. It has also
    # risen if points as high as the deck lie well beyond the edges of the free part.
    up = view.edges.level[near] > -0.5 * clearance
    up |= (view.edges.edge[near] - np.median(free_edges, axis=0)) * (-1, 1) > BESIDE_M / 2
    if not up.any(axis=0).all():
        return "the ground next to the deck does not rise at an end"
    road_starts = view.starts[near[:ROAD_SLICES]]
    box = (view.s >= road_starts.min()) & (view.s < road_starts.max() + view.slice_m)
    box &= (view.t > np.median(free_edges[:, 0])) & (view.t < np.median(free_edges[:, 1]))
    n_road = int((box & ground & (np.abs(view.off) < 2 * TOLERANCE_M)).sum())
    if n_road >= max(MIN_ROAD_POINTS, MIN_ROAD_SHARE * int(box.sum())):
        return ""
    return "the road does not continue at an end"


def _beneath(view: _View, free: Indices, free_edges: Float64) -> int:
    """Count the points beneath the free part of a deck, at least `INNER_M` inside its edges."""
    inner = view.t > np.median(free_edges[:, 0]) + INNER_M
    inner &= view.t < np.median(free_edges[:, 1]) - INNER_M
    inner &= (view.s >= view.starts[free[0]]) & (view.s < view.starts[free[-1]] + view.slice_m)
    return int((inner & (view.off < -DROP_M)).sum())


def _ring(view: _View, free: Indices) -> Float64:
    """Return the corners (s, t) of the outline of the free part, `WIDER_M` wider on each side than its points.

    The outline has two corners (left and right) per slice: at its middle, or at its outer end
    for the first and last slice.
    """
    s = view.starts[free] + view.slice_m / 2
    s[0] = view.starts[free[0]]
    s[-1] = view.starts[free[-1]] + view.slice_m
    right = np.column_stack((s, view.edges.edge[free, 0] - WIDER_M))
    left = np.column_stack((s, view.edges.edge[free, 1] + WIDER_M))
    return np.concatenate((right, left[::-1]))


def _rotated(xy: Float64, along: Float64) -> tuple[Float64, Float64]:
    return xy @ along, xy @ np.array((-along[1], along[0]))


def _height(surface: Surface, s: Float64, t: Float64) -> Float64:
    a, b, c, d = surface
    return a + b * s + c * s * s + d * t


def _fitted(s: Float64, t: Float64, z: Float64, seeds: Bool) -> Surface | None:
    """Fit a surface to the seeds, without outliers. Return None if too few seeds are near the surface."""
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
        rows = all_rows[
            np.abs(z[all_rows] - _height(surface, s[all_rows], t[all_rows])) < limit
        ]
    return surface if len(rows) > 0.4 * seeds.sum() else None


def _longest_run(free: Bool) -> Indices | None:
    """Return the indices of the free slices of the longest run, or None if there are fewer than two.

    A single slice that is not free does not end a run.
    """
    closed = free.copy()
    closed[1:-1] |= free[:-2] & free[2:]
    runs = np.flatnonzero(np.diff(closed, prepend=False, append=False)).reshape(-1, 2)
    if not len(runs):
        return None
    start, stop = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    rows = np.arange(start, stop)
    return rows[free[rows]] if free[rows].sum() >= 2 else None


TOLERANCE_M = 0.3
"""Points of a deck are at most this far from its surface, in metres."""
BESIDE_M = 4.0
"""Points up to this distance beyond an edge are next to the edge, in metres."""
FARTHER_M = 40.0
"""Ground is searched up to this distance if an edge has next to it at most two points, none below the deck (`DROP_M`).

The distance is in metres. Water often returns no pulses.
"""
MAX_ABOVE_M = 4.0
"""In the search up to `FARTHER_M`, points higher than this above the deck do not count as
ground, in metres."""
EDGE_M = 0.2
"""Points nearer to an edge than this do not count as next to the edge, in metres."""
LOW = 0.6
"""A point next to an edge is low if its depth below the deck is more than this share of the
depth of the ground."""
BETWEEN = 0.34
"""An edge is free if at most this share of the points next to the edge is not low."""


@dataclass(frozen=True)
class _DeckEdges:
    """Edges of a deck in metres: arrays (slices, 2), for both sides of each slice.

    Attributes
    ----------
    edge : float64
        Coordinate t (across the deck) of the edge.
    free : bool
        Whether the ground next to the edge is lower, with few points in between.
    level : float64
        Height of the ground next to the edge, relative to the deck (below 0 for lower ground). NaN if it is unknown.
    """

    edge: Float64
    free: Bool
    level: Float64


def _find_edges(
    s: Float64, t: Float64, off: Float64, numbers: Float64, slice_m: float, spacing: float
) -> _DeckEdges:
    """Find the edges of a deck, and the heights next to the edges, in each slice.

    All lengths are in metres.

    Parameters
    ----------
    s, t, off : float64 (n,)
        Positions of points along and across the deck, and heights above its surface.
    numbers : float64 (slices,)
        Consecutive numbers of the slices. A slice starts at its number times ``slice_m`` along the deck.
    slice_m : float
        Length of a slice along the deck.
    spacing : float
        Spacing of the points.
    """
    n = len(numbers)
    edge = np.full((n, 2), np.nan)
    free = np.zeros((n, 2), np.bool_)
    level = np.full((n, 2), np.nan)
    slice_of = np.floor(s / slice_m) - numbers[0]
    order = np.argsort(slice_of, kind="stable")
    starts = np.searchsorted(slice_of[order], np.arange(n + 1))
    for i in range(n):
        rows = order[starts[i] : starts[i + 1]]
        deck = np.sort(t[rows][np.abs(off[rows]) < TOLERANCE_M])
        both_edges = _group_around_zero(deck, max(1.5, 4 * spacing))
        if both_edges is None:
            continue
        edge[i] = both_edges
        for k, sign in enumerate((-1, 1)):
            away = sign * (t[rows] - edge[i, k])
            free[i, k], level[i, k] = _beside(away, off[rows])
    return _DeckEdges(edge, free, level)


def _group_around_zero(t: Float64, gap: float) -> tuple[float, float] | None:
    """Return the first and last value of the group around 0 in sorted values, or None if there is no such group.

    Gaps wider than ``gap`` separate groups. The group has to have two values, and to come
    within ``gap`` of 0.
    """
    if len(t) < 2:
        return None
    groups = np.split(t, np.flatnonzero(np.diff(t) > gap) + 1)
    nearest = min(groups, key=lambda g: max(g[0], -g[-1], 0.0))
    if max(nearest[0], -nearest[-1]) > gap or len(nearest) < 2:
        return None
    return float(nearest[0]), float(nearest[-1])


def _beside(away: Float64, off: Float64) -> tuple[bool, float]:
    """Return whether an edge is free, and the level of the ground next to it (see `_DeckEdges`).

    ``away`` is the distance of points beyond the edge, and ``off`` is their height above the surface of the deck.
    """
    near = (away > EDGE_M) & (away < BESIDE_M) & (off < TOLERANCE_M)
    lower = off[near & (off < -DROP_M)]
    if not len(lower):
        if near.sum() > 2:
            return False, float(np.median(off[near]))
        beyond = np.flatnonzero((away >= BESIDE_M) & (away < FARTHER_M) & (off < MAX_ABOVE_M))
        if not len(beyond):
            return False, float("nan")
        nearest = beyond[np.argsort(away[beyond], kind="stable")[:3]]
        level = float(np.median(off[nearest]))
        return level < -DROP_M, level
    level = float(np.median(lower))
    low = near & (off < LOW * level)
    between = near & ~low
    return bool(between.sum() <= BETWEEN * near.sum()), level
