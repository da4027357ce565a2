"""Edges of a bridge deck, and the heights next to them, in slices along the deck."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tiler.grid.bridges.deck_cells import DROP_M

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

TOLERANCE_M = 0.3
"""Largest distance of the points of a deck from its surface."""
BESIDE_M = 4.0
"""Distance from an edge within which the ground has to be lower."""
FARTHER_M = 40.0
"""Largest distance from an edge to the next lower point. Water in between may not return pulses."""
BETWEEN = 0.34
"""Largest share of the points next to an edge that may lie between the deck and the ground below it."""


@dataclass(frozen=True)
class DeckEdges:
    """Edges of a deck: arrays (slices, 2), for both sides of each slice.

    Attributes
    ----------
    edge : float64
        Position of the edge across the deck.
    free : bool
        Whether the ground next to the edge is lower, with few points in between.
    level : float64
        Height of the ground next to the edge above the surface of the deck, or NaN if it is unknown.
    """

    edge: Floats
    free: Bools
    level: Floats

    def both_free(self) -> Bools:
        """Return a mask of the slices that stand free on both sides."""
        is_free: Bools = self.free[:, 0] & self.free[:, 1]
        return is_free


def sides_of(s: Floats, t: Floats, off: Floats, bins: Floats, width: float, spacing: float) -> DeckEdges:
    """Find the edges of a deck in slices of ``width`` with the numbers ``bins``, and the heights next to them.

    All points have the coordinates ``s`` along the deck, ``t`` across it and ``off`` above its surface. Their
    spacing is ``spacing``.
    """
    n = len(bins)
    edge = np.full((n, 2), np.nan)
    free = np.zeros((n, 2), np.bool_)
    level = np.full((n, 2), np.nan)
    number = np.floor(s / width) - bins[0]
    order = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[order], np.arange(n + 1))
    for i in range(n):
        rows = order[starts[i] : starts[i + 1]]
        deck = np.sort(t[rows][np.abs(off[rows]) < TOLERANCE_M])
        cluster = _around_zero(deck, max(1.5, 4 * spacing))
        if cluster is None:
            continue
        edge[i] = cluster
        for k, sign in enumerate((-1, 1)):
            away = sign * (t[rows] - edge[i, k])
            free[i, k], level[i, k] = _beside(away, off[rows])
    return DeckEdges(edge, free, level)


def _around_zero(t: Floats, gap: float) -> tuple[float, float] | None:
    """Return the first and last value of the group around 0 without gaps wider than ``gap``, or None."""
    if len(t) < 2:
        return None
    groups = np.split(t, np.flatnonzero(np.diff(t) > gap) + 1)
    best = min(groups, key=lambda g: max(g[0], -g[-1], 0.0))
    if max(best[0], -best[-1]) > gap or len(best) < 2:
        return None
    return float(best[0]), float(best[-1])


def _beside(away: Floats, off: Floats) -> tuple[bool, float]:
    """Return whether an edge is free, and the level of the ground next to it (see `DeckEdges`).

    ``away`` and ``off`` are the distances of points beyond the edge, and their heights above the surface of the deck.
    """
    near = (away > 0.2) & (away < BESIDE_M) & (off < TOLERANCE_M)
    lower = off[near & (off < -DROP_M)]
    if not len(lower):
        if near.sum() > 2:
            return False, float(np.median(off[near]))
        beyond = np.flatnonzero((away >= BESIDE_M) & (away < FARTHER_M) & (off < 4.0))
        if not len(beyond):
            return False, float("nan")
        nearest = beyond[np.argsort(away[beyond], kind="stable")[:3]]
        level = float(np.median(off[nearest]))
        return level < -DROP_M, level
    level = float(np.median(lower))
    low = near & (off < 0.6 * level)
    between = near & ~low
    return bool(between.sum() <= BETWEEN * near.sum()), level
