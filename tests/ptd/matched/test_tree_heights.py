"""The height of trees of a place: a mean of the land there and around, whatever the order and the cut of the tiles."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ptd.frame import CellLattice, Scale
from ptd.matched.crowns import measure_trees, tree_heights, tree_heights_on_cells
from ptd.places import PLACE_M, name_of

SCALE = Scale(Fraction(1, 100), Fraction(1, 100), (-12_345, 678))
PLACES = {name_of(column, row): [1.0] for column in range(-6, 7) for row in range(-6, 7)}


def cells(places: list[tuple[int, int]]) -> np.ndarray:
    """The middles of places in local counts, int32 [3, n]."""
    xy = [[round((index + 0.5) * PLACE_M * 100) for index in place] for place in places]
    local = np.array(xy, np.int64).reshape(-1, 2).T - np.array(SCALE.origin)[:, None]
    return np.vstack([local, np.zeros_like(local[:1])]).astype(np.int32)


def test_land_counts_in_its_place_and_up_to_two_places_away() -> None:
    heights = tree_heights([measure_trees(np.array([18.0]), cells([(1, -2)]), SCALE)], PLACES)
    assert heights.keys() == PLACES.keys()
    known = {name for name, (_, is_known) in heights.items() if is_known}
    assert known == {name_of(1 + i, -2 + j) for i in range(-2, 3) for j in range(-2, 3)}
    assert {tuple(figures) for figures in heights.values()} == {(0.0, 0.0), (18.0, 1.0)}


def test_nearer_land_counts_almost_alone() -> None:
    measured = measure_trees(
        np.array([10.0, 10.0, 25.0]), cells([(0, 0), (0, 0), (2, 0)]), SCALE
    )
    heights = tree_heights([measured], PLACES)
    assert heights[name_of(0, 0)] == [round((2 * 64 * 10 + 25) / (2 * 64 + 1), 2), 1.0]
    assert heights[name_of(1, 0)] == [15.0, 1.0]  # as near to both


def test_heights_are_interpolated_between_known_places_alone() -> None:
    """Towards an unknown place, the height does not fall to 0, which would be the height of a lawn."""
    measured = measure_trees(np.array([10.0, 25.0]), cells([(0, 0), (3, 0)]), SCALE)
    table = {
        name: f for name, f in tree_heights([measured], PLACES).items() if f[1] or "6" in name
    }
    lattice = CellLattice.of(PLACE_M / 4, SCALE)
    heights = tree_heights_on_cells(table, lattice, 0, -24, (1, 60), SCALE)[0]
    known = heights > 0
    assert known[14:40].all()
    assert not known[:10].any()
    assert heights[known].min() == 10.0
    assert heights[known].max() == 25.0


@given(
    st.lists(
        st.tuples(st.integers(-4, 4), st.integers(-4, 4), st.floats(1.0, 60.0)), min_size=1
    )
)
def test_tiles_do_not_matter(land: list[tuple[int, int, float]]) -> None:
    xyz = cells([(column, row) for column, row, _ in land])
    depths = np.array([depth for *_, depth in land])
    whole = tree_heights([measure_trees(depths, xyz, SCALE)], PLACES)
    parts = [
        measure_trees(depths[i : i + 1], xyz[:, i : i + 1], SCALE) for i in range(len(land))
    ]
    assert tree_heights(parts[::-1], PLACES) == whole
