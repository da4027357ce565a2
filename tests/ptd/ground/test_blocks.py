"""Blocks hold each point once, with all that lies within reach, and no raster between points far apart."""

from __future__ import annotations

import numpy as np

from ptd.frame import CellLattice, Scale
from ptd.ground.morphology import blocks

CELLS = CellLattice.of(1.0, Scale())


def test_blocks_hold_each_point_once_and_all_within_reach() -> None:
    rows, columns = np.indices((50, 50)).reshape(2, -1)
    keep = (columns < 10) | (columns > 37)  # a gap that holds a whole block
    x, y = (1000 * columns[keep]).astype(np.int32), (1000 * rows[keep]).astype(np.int32)
    times, parts, reach = np.zeros(x.size, int), 0, 4
    for index, inner in blocks(x, y, CELLS, reach, 16):
        times[index[inner]] += 1
        own = index[inner]
        near = (abs(y - y[own, None]) <= 1000 * reach) & (abs(x - x[own, None]) <= 1000 * reach)
        assert np.isin(np.flatnonzero(near.any(axis=0)), index).all()
        assert np.ptp(y[index]) < 1000 * (16 + 2 * reach)
        parts += 1
    assert parts == 12  # of 4 x 4, a column of blocks is empty
    assert (times == 1).all()


def test_points_far_apart_take_no_raster_between_them() -> None:
    x = np.array([0, 2_000_000_000], np.int32)
    assert [index.tolist() for index, _ in blocks(x, np.zeros(2, np.int32), CELLS, 50)] == [
        [0],
        [1],
    ]
    assert list(blocks(x[:0], x[:0], CELLS, 50)) == []
