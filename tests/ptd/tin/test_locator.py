"""The raster of start triangles: a walk starts near its end, even where vertices are missing."""

from __future__ import annotations

import numpy as np

from ptd.tin.mesh import Locator, Tin


def test_a_walk_starts_at_a_triangle_of_the_nearest_cell_of_its_row_that_holds_a_vertex() -> (
    None
):
    """Two distant clusters have empty rows around them, and corners lie far outside."""
    rng = np.random.default_rng(3)
    middles = np.repeat([[20_000, 50_000], [80_000, 50_000]], 200, axis=0)
    corners = [[0, 0], [100_000, 0], [0, 100_000], [100_000, 100_000]]
    xy = np.concatenate([middles + rng.integers(-3000, 3000, (400, 2)), corners]).astype(
        np.int32
    )
    tin = Tin.build(*xy.T.copy(), np.zeros(len(xy), np.int32))
    locator = Locator.of(tin)
    grid = locator.grid.reshape(locator.height, locator.width)
    row = grid[(50_000 - locator.south) // locator.cell]
    corner_x = tin.vertex_array.reshape(-1, 4)[tin.triangle_array.reshape(-1, 8)[row, 4:7], 0]
    places = locator.west + (np.arange(locator.width) + 0.5) * locator.cell
    nearest = np.where(places < 50_000, 20_000, 80_000)
    clear = abs(places - 50_000) > 4000
    near = (abs(corner_x - nearest[:, np.newaxis]) <= 3000).any(axis=1)
    assert clear.sum() > 15
    assert near[clear].all()
    assert (grid >= 0).all()
