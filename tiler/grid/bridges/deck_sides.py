"""Edges of a bridge deck, and the heights next to them, in slices along the deck."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiler.grid.bridges.deck_cells import DROP_M

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

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
class DeckEdges:
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

    edge: Floats
    free: Bools
    level: Floats

    def both_free(self) -> Bools:
        """Return a mask of the slices with two free edges."""
        is_free: Bools = self.free[:, 0] & self.free[:, 1]
        return is_free


def find_edges(
    s: Floats, t: Floats, off: Floats, numbers: Floats, slice_m: float, spacing: float
) -> DeckEdges:
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
    return DeckEdges(edge, free, level)


def _group_around_zero(t: Floats, gap: float) -> tuple[float, float] | None:
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


def _beside(away: Floats, off: Floats) -> tuple[bool, float]:
    """Return whether an edge is free, and the level of the ground next to it (see `DeckEdges`).

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
