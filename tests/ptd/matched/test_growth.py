"""Ground that grows to the edges of terraces and down the faces of banks, and on nothing that stands there."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.matched.growth import (
    GROWS_M,
    MAX_HEIGHT_M,
    STRIP_GROWS_M,
    STRIP_MAX_HEIGHT_M,
    grown,
)

SHAPE = (40, 60)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
FREE = np.zeros(SHAPE, bool)
FREE[3:-3, 3:-3] = True


def growing(
    height: np.ndarray,
    ground: np.ndarray,
    terrain: bool = False,
    sigma_m: float = 0.05,
    above_m: float = 1.0,
) -> np.ndarray:
    """What `grown` finds where all that is no ground may join, but the raster's edges."""
    everywhere = np.ones(SHAPE)
    whole = np.full(SHAPE, terrain)
    above = np.where(~ground & FREE, above_m, np.nan)
    return grown(height, FREE, ground & FREE, above, whole, sigma_m * everywhere, everywhere)


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_it_grows_on_a_plane_as_many_cells_as_it_says(slope: float) -> None:
    height = slope * ROW + 0.02 * np.random.default_rng(1).standard_normal(SHAPE)
    found = growing(height, COLUMN < 20)
    joined = ~np.isnan(found)
    assert joined[18:-18, 20 : 20 + round(GROWS_M)].all()  # cells of 1 m
    assert not joined[:, 20 + round(GROWS_M) :].any()
    assert abs(found - slope * ROW)[joined].max() < 0.15


def test_a_hut_does_not_join() -> None:
    hut = (COLUMN >= 24) & (COLUMN < 28) & (ROW >= 15) & (ROW < 20)
    joined = ~np.isnan(growing(np.where(hut, 2.0, 0.0), COLUMN < 20))
    assert not joined[hut].any()
    assert joined[15:20, 20:23].all()


@pytest.mark.parametrize("is_terrain", [True, False])
def test_the_face_of_a_bank_joins_on_terrain_as_a_whole(is_terrain: bool) -> None:
    """Two cells as steep as the side of a crown."""
    height = np.interp(COLUMN, [19.0, 20.0, 21.0, 22.0], [0.0, 0.9, 2.2, 4.0])
    joined = ~np.isnan(growing(height, (COLUMN < 20) | (COLUMN > 21), is_terrain))
    assert joined[10:-10, 20:22].all() == is_terrain
    assert joined.any() == is_terrain


def test_what_rises_above_both_sides_of_a_step_does_not_join() -> None:
    """A wall on the edge of a terrace, and what has ground on one side alone."""
    height = np.where(COLUMN < 20, 0.0, np.where(COLUMN < 22, 5.0, 4.0))
    assert np.isnan(growing(height, (COLUMN < 20) | (COLUMN > 21), terrain=True)).all()
    height = np.where(COLUMN < 20, 0.0, -2.0)
    assert np.isnan(growing(height, COLUMN < 20, terrain=True)).all()


def test_what_is_level_joins_where_few_cells_make_no_plane() -> None:
    """The top of a narrow dam."""
    top = (COLUMN >= 19) & (COLUMN < 22)
    joined = ~np.isnan(
        growing(np.where(top, 0.0, -9.0), top & (abs(ROW - 20.0) < 1.5) & (COLUMN < 21))
    )
    assert joined[14:18, 19:22].all()
    assert not joined[~top].any()


@pytest.mark.parametrize(
    ("above_m", "joins_m"), [(MAX_HEIGHT_M - 0.1, GROWS_M), (MAX_HEIGHT_M + 0.1, 0.0)]
)
def test_the_edge_of_a_high_terrace_joins(above_m: float, joins_m: float) -> None:
    """A terrace of 12 m, of which the hull reaches the back, and ground below."""
    height = np.where(COLUMN < 40, 0.0, -12.0)
    joined = ~np.isnan(growing(height, (COLUMN < 20) | (COLUMN >= 40), above_m=above_m))
    assert joined[18:-18, 20:40].sum(axis=1).max(initial=0) == round(joins_m)


@pytest.mark.parametrize(
    ("above_m", "joins_m"),
    [(STRIP_MAX_HEIGHT_M - 0.1, STRIP_GROWS_M), (STRIP_MAX_HEIGHT_M + 0.1, 0.0)],
)
def test_the_deck_of_a_bridge_joins_only_near_ground_and_surface(
    above_m: float, joins_m: float
) -> None:
    """A deck of 8 m between ground that is 5 m lower, from its ramp on."""
    deck = abs(ROW - 20) < 4.5
    height = np.where(deck, 0.0, -5.0)
    joined = ~np.isnan(growing(height, ~deck | (COLUMN < 20), above_m=above_m))
    assert joined[20, 20:].sum() == round(joins_m)
