"""Windows, thresholds and openings of Chen (2023), equations 1 to 3."""

from __future__ import annotations

from fractions import Fraction
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from ptd.frame import CellLattice, Scale, Window
from ptd.methods.chen2023 import progressive_opening
from ptd.methods.chen2023.progressive_opening import (
    Opening,
    height_thresholds,
    opened_surfaces,
    potential_seeds,
    window_widths,
)

EVERYTHING = Window.everything()


@pytest.mark.parametrize(
    ("initial", "exponential", "building", "widths"),
    [
        (1, False, 8, [3, 5, 7, 9]),  # 2 k + 1
        (3, False, 18, [7, 13, 19]),  # 6 k + 1
        (2, True, 32, [5, 9, 17, 33]),  # 2 * 2^k + 1
        (3, True, 54, [7, 19, 55]),  # 2 * 3^k + 1
        (1, False, 9, [3, 5, 7, 9, 11]),  # 9 cells are not wider than a building of 9
        (2, True, 20, [5, 9, 17, 21]),  # 33 is cut to the smallest odd width above 20
        (5, False, 3, [5]),  # 11 as well
        (1, False, Fraction(1, 2), [3]),  # at least one window
    ],
)
def test_the_series_of_windows(
    initial: int, exponential: bool, building: int, widths: list[int]
) -> None:
    assert window_widths(initial, exponential, Fraction(building)) == widths


def test_thresholds_of_linear_windows() -> None:
    """W 3: h_0 = 0.3; then s (W_k - W_k-1) c + h_0 = 0.2 * 2 * 0.5 + 0.3 = 0.5."""
    assert height_thresholds([3, 5, 7], 0.2, 0.5, 0.3, 9.0) == pytest.approx([0.3, 0.5, 0.5])


def test_thresholds_of_exponential_windows_up_to_the_largest() -> None:
    """Differences of W 5, 9, 17, 33 (1 at first) are 4, 4, 8, 16: 1.5, 1.5, 2.7, 5.1, at most 2.5."""
    found = height_thresholds([5, 9, 17, 33], 0.3, 1.0, 0.3, 2.5)
    assert found == pytest.approx([1.5, 1.5, 2.5, 2.5])
    assert height_thresholds([5, 9, 17, 33], 0.3, 1.0, 0.3, 9.0) == pytest.approx(
        [1.5, 1.5, 2.7, 5.1]
    )


def test_the_initial_threshold_is_not_above_the_largest_either() -> None:
    assert height_thresholds([3], 1.0, 1.0, 3.0, 2.5) == [2.5]


def surface_of(seed: int, side: int = 40) -> np.ndarray:
    return np.random.default_rng(seed).integers(-1000, 1000, (side, side)).astype(np.int32)


@pytest.mark.parametrize("widths", [[3], [3, 5, 7], [5, 9, 17], [1, 3]])
def test_openings_are_those_of_another_library_chained_or_not(widths: list[int]) -> None:
    surface = surface_of(4, 70)
    rim = max(widths) - 1
    chained = surface
    for width, got in zip(widths, opened_surfaces(surface, widths), strict=True):
        inner = np.s_[rim : 70 - rim, rim : 70 - rim]
        once = ndimage.grey_opening(surface, size=(width, width))
        assert np.array_equal(got, once[inner])
        chained = ndimage.grey_opening(chained, size=(width, width))
        deep = np.s_[2 * rim : 70 - 2 * rim, 2 * rim : 70 - 2 * rim]
        assert np.array_equal(
            got[rim : rim + 70 - 4 * rim, rim : rim + 70 - 4 * rim], chained[deep]
        )


def field(
    heights: np.ndarray, keep: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A point in the middle of each cell of a metre, in millimetres; heights in metres."""
    rows, columns = np.nonzero(np.ones(heights.shape, bool) if keep is None else keep)
    found = 1000 * columns + 500, 1000 * rows + 500, 1000 * heights[rows, columns]
    return tuple(np.rint(v).astype(np.int32) for v in found)  # type: ignore[return-value]


def seeds_of(
    heights: np.ndarray, opening: Opening, keep: np.ndarray | None = None
) -> np.ndarray:
    """A map of the potential seeds."""
    x, y, z = field(heights, keep)
    args = CellLattice.of(1.0, Scale()), opening, EVERYTHING
    found, uncertified = potential_seeds(x, y, z, np.ones(x.size, bool), *args)
    assert not uncertified.any()
    seen = np.zeros(heights.shape, bool)
    seen[y // 1000, x // 1000] = found
    return seen


def test_a_house_goes_with_the_window_that_is_wider_than_it() -> None:
    heights = np.zeros((40, 40))
    heights[10:15, 10:22] = 3.0  # 5 x 12 m
    house = heights > 0
    assert seeds_of(heights, Opening([3, 5], [300, 300], 3)).all()
    assert np.array_equal(seeds_of(heights, Opening([3, 5, 7], [300, 300, 300], 3)), ~house)


def test_a_drop_up_to_the_threshold_is_ground() -> None:
    heights = np.zeros((30, 30))
    heights[10:12, 10:12] = 0.5
    assert seeds_of(heights, Opening([3], [500], 3)).all()
    assert np.array_equal(seeds_of(heights, Opening([3], [499], 3)), heights == 0)


def test_steps_are_judged_from_surface_to_surface_not_from_the_first() -> None:
    """A pyramid of steps of 0.4 m drops by 0.4 m with each window, 1.2 m in all."""
    heights = np.zeros((40, 40))
    for k in range(3):
        heights[15 + k : 22 - k, 15 + k : 22 - k] += 0.4  # 7, 5 and 3 m wide
    assert seeds_of(heights, Opening([5, 7, 9], [500, 500, 500], 3)).all()
    assert not seeds_of(heights, Opening([9], [500], 3)).all()


def test_a_plane_is_ground_to_its_border_and_around_holes() -> None:
    """Heights of the rim repeat beyond the border, so a slope drops by less than its rise over a window."""
    rows, columns = np.indices((60, 60))
    keep = (rows - 30) ** 2 + (columns - 25) ** 2 > 64
    assert seeds_of(0.1 * columns, Opening([3, 5, 7, 9], [300] * 4, 3), keep)[keep].all()


def test_points_that_are_not_eligible_leave_their_cells_empty() -> None:
    heights = np.zeros((20, 20))
    heights[10, 10] = -5.0
    x, y, z = field(heights)
    low = z < 0
    args = CellLattice.of(1.0, Scale()), Opening([3, 5], [300, 300], 3), EVERYTHING
    found, _ = potential_seeds(x, y, z, ~low, *args)
    assert np.array_equal(found, ~low)
    assert potential_seeds(x[:0], y[:0], z[:0], low[:0], *args)[0].size == 0


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), block=st.sampled_from([16, 25, 300]))
def test_blocks_change_nothing(seed: int, block: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 600))
    cells = rng.choice(90 * 70, n, replace=False)
    x, y = (
        (1000 * (cells % 90) + 100).astype(np.int32),
        (1000 * (cells // 90) + 100).astype(np.int32),
    )
    z = rng.integers(0, 2000, n).astype(np.int32)
    eligible = rng.random(n) < 0.95
    opening = Opening([3, 5], [300.0, 500.0], int(rng.integers(0, 4)))
    scale = Scale(origin=(int(rng.integers(-(10**5), 10**5)), 777))
    known = Window(20_000, 10_000, 70_000, 65_000)
    args = x, y, z, eligible, CellLattice.of(1.0, scale), opening, known
    found = []
    for side in (10_000, block):
        with mock.patch.object(progressive_opening, "BLOCK_CELLS", side):
            found.append(potential_seeds(*args))
    whole, parts = found
    assert np.array_equal(whole[0], parts[0])
    assert np.array_equal(whole[1], parts[1])


def test_certain_cells_lie_a_window_and_its_fill_inside() -> None:
    """In a full raster that is W - 1 = 4 cells, half a window twice; beside a hole it is farther."""
    x, y, z = field(np.zeros((40, 40)))
    known = Window(10_000, -(2**40), 2**40, 2**40)
    args = CellLattice.of(1.0, Scale()), Opening([3, 5], [300, 300], 3)
    _, uncertified = potential_seeds(x, y, z, np.ones(x.size, bool), *args, known)
    middle = abs(y - 20_000) < 12_000
    assert np.array_equal(uncertified[middle], x[middle] < 14_000)
    # 5 cells deep, and filled from unknown cells
    hole = (x // 1000 < 15) & (abs(y // 1000 - 20) < 3)
    x, y, z = x[~hole], y[~hole], z[~hole]
    _, uncertified = potential_seeds(x, y, z, np.ones(x.size, bool), *args, known)
    beside = (y // 1000 == 20) & (x // 1000 == 15)
    assert uncertified[beside].all()
    assert not uncertified[x // 1000 > 20].any()
