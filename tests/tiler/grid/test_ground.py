"""The choice of one point per cell against a slow reference."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from tiler.core.lattice import Lattice
from tiler.grid.ground import central_points


@pytest.mark.parametrize("size", [Fraction(250), Fraction(1000, 3), Fraction(7, 2)])
@pytest.mark.parametrize("origin", [(0, 0), (-100, 77)])
def test_the_central_point_is_kept(size, origin):
    rng = np.random.default_rng(1)
    xyz = rng.integers(-900, 900, (3, 400)).astype(np.int32)
    xyz[:, 200:300] = xyz[:, :100]  # repeated points, and others above them
    xyz[2, 250:300] += 5
    lattice = Lattice(size)
    best: dict[tuple[int, int], tuple[Fraction, int, int, int]] = {}
    for x, y, z in xyz.T.tolist():
        x, y = x + origin[0], y + origin[1]
        ix, iy = lattice.index_of(x), lattice.index_of(y)
        distance = (x - (ix + Fraction(1, 2)) * size) ** 2 + (
            y - (iy + Fraction(1, 2)) * size
        ) ** 2
        best[ix, iy] = min(best.get((ix, iy), (distance, x, y, z)), (distance, x, y, z))
    kept = central_points(xyz, origin, lattice)
    chosen = {tuple(p) for p in (xyz[:, kept].T + np.array([*origin, 0])).tolist()}
    assert len(kept) == len(best)
    assert chosen == {(x, y, z) for _, x, y, z in best.values()}
