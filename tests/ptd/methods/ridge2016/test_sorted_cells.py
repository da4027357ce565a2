"""Points by cells, and the lowest point within a radius, compared with a plain search."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ptd.frame import CellLattice, Scale
from ptd.methods.ridge2016.ridges import Stacks, indices_in_stacks, lowest_within

SCALE = Scale(origin=(-12_345, 987))


def cloud(
    seed: int, n: int, spread: int, step: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, y, z = np.random.default_rng(seed).integers(-spread, spread, (3, n)) // step * step
    return x.astype(np.int32), y.astype(np.int32), z.astype(np.int32)


@pytest.mark.parametrize(
    ("n", "spread", "step"), [(1, 9, 1), (3000, 40_000, 1), (3000, 2_000, 100), (500, 10**7, 1)]
)
def test_sorted_by_cell_then_height(n: int, spread: int, step: int) -> None:
    """Cells hold few and many points, with ties; one cloud is too sparse for a raster of cells."""
    x, y, z = cloud(1, n, spread, step)
    cells = CellLattice.of(1.0, SCALE)
    stacks = Stacks(x, y, z, cells)
    columns = np.array([cells.column(int(v)) for v in x])
    rows = np.array([cells.row(int(v)) for v in y])
    order = np.lexsort((y, x, z, columns, rows))
    for got, given_ in ((stacks.x, x), (stacks.y, y), (stacks.z, z)):
        assert np.array_equal(got, given_[order])
    lines = np.column_stack([rows, columns])[order]
    starts = np.flatnonzero(np.append(True, (lines[1:] != lines[:-1]).any(axis=1)))
    assert stacks.starts.tolist() == [*starts.tolist(), n]


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    radius=st.sampled_from([0.0, 300.0, 2000.0, 2500.5, 7000.0]),
    cell=st.sampled_from([0.3, 1.0, 4.0]),
    step=st.sampled_from([1, 500]),
    spread=st.sampled_from([5_000, 900_000]),
    x3=st.integers(-20_000, 20_000),
    y3=st.integers(-20_000, 20_000),
)
def test_lowest_within_a_radius(
    seed: int, radius: float, cell: float, step: int, spread: int, x3: int, y3: int
) -> None:
    x, y, z = cloud(seed, 200, spread, step)
    stacks = Stacks(x, y, z, CellLattice.of(cell, SCALE))
    got = lowest_within(stacks.x, stacks.y, stacks.z, stacks.raster, x3, y3, radius)
    near = (3 * x.astype(np.int64) - x3) ** 2 + (
        3 * y.astype(np.int64) - y3
    ) ** 2 <= 9 * radius**2
    expected = min(zip(*(v[near].tolist() for v in (z, x, y)), strict=True), default=None)
    found = (int(stacks.z[got]), int(stacks.x[got]), int(stacks.y[got])) if got >= 0 else None
    assert found == expected


def test_points_are_found_again_and_strangers_are_not() -> None:
    x, y, z = cloud(3, 400, 900, 100)  # many in one place
    s = Stacks(x, y, z, CellLattice.of(0.5, SCALE))
    place = indices_in_stacks(x, y, z, s.x, s.y, s.z, s.raster)
    for own, sorted_ in ((x, s.x), (y, s.y), (z, s.z)):
        assert np.array_equal(sorted_[place], own)
    one = np.ones(x.size, np.int32)
    for moved in ((x + one, y, z), (x, y, z + one), (x + 10**6 * one, y, z)):
        assert (indices_in_stacks(*moved, s.x, s.y, s.z, s.raster) == -1).all()
