"""Decks of bridges, by formula: what stands free is found where it is, and nothing that stands on the ground is."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from tiler.grid.bridges.deck import Deck, find_deck
from tiler.grid.bridges.deck_cells import DIRECTIONS, REACH_M, CoarseHeights, candidate_cells

Floats = np.ndarray
SIDE, SPACING, CELL = 120.0, 0.5, 2.0
HALF = 5.0  # of the width of what crosses


def road(x: Floats) -> Floats:
    return 100 + 0.01 * x


def bridge(x: Floats, y: Floats) -> Floats:
    return road(x) - np.where(np.abs(y) < HALF, 0, 5 - np.clip((np.abs(x) - 15) / 2, 0, 5))


def embankment(x: Floats, y: Floats) -> Floats:
    """A dam with slopes of 1 : 1.5 through the same valley, as of a railway over a culvert."""
    free = 5 - np.clip((np.abs(x) - 15) / 2, 0, 5)
    return road(x) - np.minimum(free, np.clip((np.abs(y) - HALF) / 1.5, 0, None))


def dam(x: Floats, y: Floats) -> Floats:
    """Walls on both sides, with water 1.5 m below the crest on one of them."""
    free = 5 - np.clip((np.abs(x) - 15) / 2, 0, 5)
    return road(x) - np.where(np.abs(y) < HALF, 0, np.where(y > 0, np.minimum(free, 1.5), free))


def retaining_wall(x: Floats, y: Floats) -> Floats:
    return road(x) - np.where(y < -HALF, 5 - np.clip((np.abs(x) - 15) / 2, 0, 5), 0)


def ramp(x: Floats, y: Floats) -> Floats:
    """A ramp of 8 % between walls."""
    return 100 + np.where(np.abs(y) < HALF, np.clip(0.08 * (x + 30), 0, 5), 0)


def terraces(x: Floats, y: Floats) -> Floats:
    return 100 - 2.5 * np.floor((y + 60) / 12)


def found(height: Callable[[Floats, Floats], Floats], turn: float, seed: int = 1) -> list[Deck]:
    """Decks in a cloud that is all ground, turned by some degrees."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-SIDE / 2, SIDE / 2, (int((SIDE / SPACING) ** 2), 2))
    cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    z = height(xy[:, 0] * cos + xy[:, 1] * sin, xy[:, 1] * cos - xy[:, 0] * sin)
    z += rng.normal(0, 0.02, len(xy))
    n = int(SIDE / CELL)
    cols, rows = ((xy.T + SIDE / 2) // CELL).astype(int)
    rows = n - 1 - rows
    low, top = np.full((n, n), np.inf, np.float32), np.full((n, n), -np.inf, np.float32)
    np.minimum.at(low, (rows, cols), z.astype(np.float32))
    np.maximum.at(top, (rows, cols), z.astype(np.float32))
    ground = np.isfinite(top)
    low[~ground] = top[~ground] = np.nan
    r, c, directions = candidate_cells(CoarseHeights(top, low, ground, CELL))
    decks = []
    for direction in np.unique(directions):
        mask = np.zeros((n, n), np.bool_)
        mask[r[directions == direction], c[directions == direction]] = True
        angle = math.pi * direction / DIRECTIONS
        across = (math.cos(angle), math.sin(angle))
        xyz, every = np.column_stack((xy, z)), np.ones(len(xy), np.bool_)
        deck, why = find_deck(xyz, every, mask[rows, cols], across, SPACING)
        assert (deck is None) == bool(why)
        decks += [] if deck is None else [deck]
    return decks


@pytest.mark.parametrize("turn", [0.0, 31.0, 77.0, 140.0])
def test_a_bridge_is_found_as_long_and_wide_as_it_is(turn: float) -> None:
    decks = found(bridge, turn)
    assert decks
    for deck in decks:
        # Where the banks are less than a metre below it nobody can tell.
        assert 30 <= deck.length_m <= 48
        assert deck.width_m == pytest.approx(2 * HALF, abs=0.6)
        assert deck.clearance_m == pytest.approx(5, abs=0.5)
        true = np.array((math.cos(math.radians(turn)), math.sin(math.radians(turn))))
        assert abs(np.array(deck.along) @ true) > math.cos(math.radians(3))
        inside = deck.ring @ np.array([[true[0], -true[1]], [true[1], true[0]]])
        assert np.abs(inside[:, 1]).max() < HALF + 0.8
        assert np.abs(inside[:, 0]).max() < 25


@pytest.mark.parametrize("height", [embankment, dam, retaining_wall, ramp, terraces])
@pytest.mark.parametrize("turn", [0.0, 31.0, 77.0])
def test_what_stands_on_the_ground_is_no_bridge(
    height: Callable[..., Floats], turn: float
) -> None:
    assert not found(height, turn)


def test_cells_depend_on_nothing_beyond_their_reach() -> None:
    """The cells of a window, with what lies within the reach around it, are those of the whole."""
    n, pad = 240, math.ceil(REACH_M / CELL)
    y, x = (np.mgrid[:n, :n] - n / 2 + 0.5) * CELL
    low = (bridge(x - 20, y) + np.random.default_rng(2).normal(0, 0.05, x.shape)).astype(
        np.float32
    )
    low[np.random.default_rng(3).random(low.shape) < 0.1] = np.nan
    whole = cells_of(low)
    assert len(whole) > 50
    parts = set()
    for window in (np.s_[:, : n // 2], np.s_[:, n // 2 :]):
        left, right, _ = window[1].indices(n)
        first, last = max(left - pad, 0), min(right + pad, n)
        found = {(r, c + first, d) for r, c, d in cells_of(low[:, first:last])}
        parts |= {(r, c, d) for r, c, d in found if left <= c < right}
    assert parts == whole


def cells_of(low: Floats) -> set[tuple[int, int, int]]:
    found = candidate_cells(CoarseHeights(low, low, ~np.isnan(low), CELL))
    return set(zip(*(axis.tolist() for axis in found), strict=True))
