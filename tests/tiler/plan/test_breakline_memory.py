"""What breaklines need is in the plan: by their pieces, all of them and those in one window."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.plan.memory import NEAR_PIECE_BYTES, PIECE_BYTES, breakline_bytes


def lines(places: list[tuple[int, int]], length: int) -> list[np.ndarray]:
    return [np.array([(x, y, 0), (x + length, y, 0)], np.int64) for x, y in places]


def test_lines_far_apart_are_in_no_window_together() -> None:
    pixel, window, length = 1000.0, 800_000.0, 100_000
    pieces = 2 * length / pixel
    assert breakline_bytes([], pixel, window) == 0
    near = breakline_bytes(lines([(1_000, 0), (5_000, 9_000)], length), pixel, window)
    far = breakline_bytes(lines([(1_000, 0), (50_000_000, 0)], length), pixel, window)
    assert near == pytest.approx(2 * pieces * (PIECE_BYTES + NEAR_PIECE_BYTES), rel=1e-6)
    assert far == pytest.approx(pieces * (2 * PIECE_BYTES + NEAR_PIECE_BYTES), rel=1e-6)


def test_lines_on_both_sides_of_a_square_count_together() -> None:
    both = breakline_bytes(lines([(-60_000, -5), (10_000, 5)], 20_000), 1000.0, 800_000.0)
    assert both == pytest.approx(80 * (PIECE_BYTES + NEAR_PIECE_BYTES), rel=1e-6)
