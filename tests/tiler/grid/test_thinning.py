"""The point that stands for the heights of its cell."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiler.core.lattice import Lattice
from tiler.grid.ground import ranked_points


@given(
    st.lists(
        st.tuples(st.integers(-25, 25), st.integers(-25, 25), st.integers(-3, 3)), max_size=60
    ),
    st.sampled_from([0, 10, 50, 100]),
)
def test_ranked_points_by_definition(points: list[tuple[int, int, int]], percent: int) -> None:
    """Cells of 20/3 counts, many equal heights and positions: the chosen are those of sorted lists."""
    cells: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
    for x, y, z in points:
        cells.setdefault(((y + 5) * 3 // 20, (x - 7) * 3 // 20), []).append((z, x, y))
    truth = [
        sorted(held)[(len(held) - 1) * percent // 100] for _, held in sorted(cells.items())
    ]
    xyz = np.array(points, np.int32).reshape(-1, 3).T
    chosen = ranked_points(xyz, (-7, 5), Lattice(Fraction(20, 3)), percent)
    assert [(z, x, y) for x, y, z in xyz[:, chosen].T.tolist()] == truth


@pytest.mark.parametrize("height", [100, 2**31 - 1])
def test_cells_far_apart_and_heights_far_apart_are_ranked(height: int) -> None:
    """Of the large ones the product of columns, rows and heights is beyond int64."""
    x, y = np.array([[-(2**31), 2**31 - 1, 0], [2**31 - 1, -(2**31), 0]], np.int32)
    xyz = np.stack(
        [np.repeat(x, 3), np.repeat(y, 3), np.tile(np.array([height, -height, 0], np.int32), 3)]
    )
    chosen = ranked_points(xyz, (0, 0), Lattice(Fraction(1)), 50)
    assert chosen.tolist() == [5, 8, 2]
