"""Sums by cells and planes through windows: the same as least squares on the points themselves."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.gridding.ground_cells import CellWindow, box_sums, cell_counts, plane_variance

HALVES = (1, 2, 4)
MARGIN = max(HALVES)


def cloud(n: int, seed: int, height: int = 0) -> np.ndarray:
    """Points of a rough slope over 20 x 15 cells of 1000 counts, int32 (3, n)."""
    random = np.random.default_rng(seed)
    x, y = random.integers(0, 20_000, n), random.integers(0, 15_000, n)
    z = height + 0.4 * x - 0.7 * y + random.normal(0, 300, n)
    return np.stack((x, y, np.rint(z))).astype(np.int32)


def window(origin: tuple[int, int] = (0, 0)) -> CellWindow:
    west, south = (o // 1000 for o in origin)
    return CellWindow(1000, 1, west, south + 14, 15, 20, *origin)


def slow_variance(xyz: np.ndarray, row: int, column: int) -> float:
    """By least squares, in the first window with six points."""
    x, y, z = xyz.astype(np.float64)
    for half in HALVES:
        inside = (np.abs(x // 1000 - column) <= half) & (np.abs(y // 1000 - (14 - row)) <= half)
        if inside.sum() >= 6:
            design = np.stack((x[inside], y[inside], np.ones(inside.sum())), axis=1)
            rest = z[inside] - design @ np.linalg.lstsq(design, z[inside], rcond=None)[0]
            return float((rest**2).sum() / (inside.sum() - 3))
    return np.nan


@pytest.mark.parametrize(("n", "height"), [(60, 0), (300, 4_000_000), (3000, -30_000)])
def test_variances_are_those_of_least_squares(n: int, height: int) -> None:
    xyz = cloud(n, n, height)
    found = plane_variance(xyz, window(), HALVES)
    rows, columns = found.shape
    slow = [
        [slow_variance(xyz, r + MARGIN, c + MARGIN) for c in range(columns)]
        for r in range(rows)
    ]
    assert found == pytest.approx(np.array(slow), rel=1e-6, nan_ok=True)


def test_neither_the_order_nor_the_frame_matters() -> None:
    xyz = cloud(400, 5)
    usual = plane_variance(xyz, window(), HALVES)
    shuffled = plane_variance(
        xyz[:, np.random.default_rng(1).permutation(400)], window(), HALVES
    )
    far = plane_variance(xyz, window((5_000_000, 480_000_000)), HALVES)
    assert usual.tobytes() == shuffled.tobytes() == far.tobytes()


def test_points_on_a_line_span_no_plane() -> None:
    x = np.arange(0, 20_000, 100, dtype=np.int32)
    xyz = np.stack((x, x * 3 // 4, x))
    assert np.isnan(plane_variance(xyz, window(), HALVES)).all()
    assert np.isnan(plane_variance(xyz[:, :0], window(), HALVES)).all()


def test_windows_are_sums_of_cells() -> None:
    xyz = cloud(500, 9)
    counts = cell_counts(xyz, window())
    assert counts.sum() == 500
    assert counts[14 - xyz[1, 0] // 1000, xyz[0, 0] // 1000] >= 1
    found = box_sums(counts, 2, 4)
    assert found.shape == (7, 12)
    for row in range(7):
        for column in range(12):
            assert (
                found[row, column] == counts[row + 2 : row + 7, column + 2 : column + 7].sum()
            )
