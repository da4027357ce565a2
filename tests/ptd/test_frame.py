"""The points within a window."""

from __future__ import annotations

import numpy as np

from ptd.frame import Window


def test_a_window_has_its_west_and_south_side_but_not_its_east_and_north_side() -> None:
    x, y = (a.ravel().astype(np.int32) for a in np.meshgrid([0, 1, 2, 3], [4, 5, 6, 7]))
    own = Window(1, 5, 3, 7).contains(x, y)
    assert sorted(zip(x[own].tolist(), y[own].tolist(), strict=True)) == [
        (1, 5),
        (1, 6),
        (2, 5),
        (2, 6),
    ]
    assert Window.everything().contains(x, y).all()
