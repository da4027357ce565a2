"""What is said of lines that people drew."""

from __future__ import annotations

import numpy as np

from tiler.plan.drawings import _warn_vertical


def test_upright_segments_are_told_of() -> None:
    wall = np.array(
        [(1000, 2000, 0), (1000, 2000, 5000), (3000, 2000, 5000), (3000, 2000, 5000)]
    )
    slope = np.array([(0, 0, 0), (1000, 0, 1000)])
    assert _warn_vertical([slope, wall]) == [
        "--breaklines: vertical segments are left out (1, the first at 1, 2); draw the top and the foot of a wall some "
        "centimetres apart"
    ]
    assert _warn_vertical([slope]) == []
