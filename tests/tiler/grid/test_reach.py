"""Cells near others, against the distance transform of the whole raster."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from tiler.grid.coarse import distances, opened, within, within_square


@given(
    shape=st.tuples(st.integers(1, 60), st.integers(1, 20)),
    share=st.sampled_from([0.0, 0.005, 0.1, 1.0]),
    radius=st.sampled_from([0.0, 0.9, 1.0, 1.5, 2.0**0.5, 5.0, 13.3, 100.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_strips_are_as_the_whole(
    shape: tuple[int, int], share: float, radius: float, seed: int
) -> None:
    cells = np.random.default_rng(seed).random(shape) < share
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tiler.grid.coarse.STRIP_ROWS", 7)
        found, far = within(cells, radius), distances(cells, radius)
    if not cells.any():
        assert not found.any()
        assert np.isinf(far).all()
        return
    distance = scipy.ndimage.distance_transform_edt(~cells)
    assert np.array_equal(found, distance <= radius)
    assert np.array_equal(far, np.where(found, distance, np.inf))


@given(
    shape=st.tuples(st.integers(1, 30), st.integers(1, 30)),
    share=st.sampled_from([0.0, 0.1, 0.6, 0.95, 1.0]),
    radius=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
)
def test_morphology_is_that_of_scipy(
    shape: tuple[int, int], share: float, radius: int, seed: int
) -> None:
    cells = np.random.default_rng(seed).random(shape) < share
    square = np.ones((2 * radius + 1, 2 * radius + 1), np.bool_)
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    disk = x * x + y * y <= radius * radius
    assert np.array_equal(
        within_square(cells, radius), scipy.ndimage.binary_dilation(cells, square)
    )
    assert np.array_equal(
        opened(cells, float(radius)), scipy.ndimage.binary_opening(cells, disk)
    )
