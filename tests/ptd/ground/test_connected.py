"""Connected surfaces on rasters drawn by hand, and against a slow union of pairs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ptd.ground.morphology import EMPTY, connected_surfaces

WAYS = [(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c]


def test_surfaces_are_connected_cells_of_like_heights() -> None:
    """Steps of 0.6 m part neighbours, of 0.4 m not; across corners 0.6 m does not either."""
    z = np.full((16, 16), EMPTY, np.int32)
    z[2, 2:5] = 0, 400, 1000
    z[3, 5] = 1600
    z[10, 10] = 0
    surface, n = connected_surfaces(z, 500.0, 700.0)
    assert n == 3
    assert surface[2, 2] == surface[2, 3] != surface[2, 4] == surface[3, 5]
    assert surface[10, 10] not in (surface[2, 2], surface[2, 4], -1)
    assert np.array_equal(surface == -1, z == EMPTY)


def test_heights_at_both_ends_of_the_range_are_apart() -> None:
    ends = np.array([[-(2**31), 2**31 - 2]], np.int32)
    assert connected_surfaces(ends, 10.0, 10.0)[1] == 2


@pytest.mark.parametrize("gap", [1, 3])
def test_surfaces_are_components_of_the_graph_of_neighbours(gap: int) -> None:
    rng = np.random.default_rng(gap)
    z = rng.integers(0, 6, (14, 17)).astype(np.int32)
    z[rng.random(z.shape) < 0.3] = EMPTY
    tilts = rng.integers(-2, 3, (2, 4, 5))
    pairs = []
    for row, column in np.argwhere(z != EMPTY):
        for north, east in WAYS:
            for steps in range(1, gap + 1):
                r, c = row + steps * north, column + steps * east
                if not (0 <= r < z.shape[0] and 0 <= c < z.shape[1]):
                    break
                if z[r, c] == EMPTY:
                    continue
                slope = [(t[r // 4, c // 4] + t[row // 4, column // 4]) / 2 for t in tilts]
                rise = int(z[r, c]) - int(z[row, column])
                limit = 3 if north and east else 2
                bent = rise - steps * (north * slope[0] + east * slope[1])
                if min(abs(rise), abs(bent)) < limit:
                    pairs.append((row * z.shape[1] + column, r * z.shape[1] + c))
                break
    first, second = np.array(pairs).T
    graph = coo_array((np.ones(first.size), (first, second)), shape=(z.size, z.size))
    expected = connected_components(graph, directed=False)[1].reshape(z.shape)[z != EMPTY]
    surface, n = connected_surfaces(z, 2.0, 3.0, gap, (tilts[0], tilts[1]), 4)
    found = surface[z != EMPTY]
    assert (
        n == len(set(expected)) == len(set(zip(found.tolist(), expected.tolist(), strict=True)))
    )
