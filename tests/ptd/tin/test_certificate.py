"""A pixel without a mark has the value of the whole data: small lattices full of ties, some with a void."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ptd.tin import KnownWindow, Pixels, Tin, rasterise


def random_window(rng: np.random.Generator, unit: int) -> KnownWindow:
    """A part of the square of 40 units; a side is open only at the end of the data."""
    closed = [*rng.integers(2, 12, 2), *rng.integers(25, 39, 2)]
    is_open = rng.random(4) < 0.3
    sides = [
        int(end if free else side) * unit
        for side, free, end in zip(closed, is_open, (0, 0, 40, 40), strict=True)
    ]
    return KnownWindow(*sides, *(bool(free) for free in is_open))


@pytest.mark.parametrize("interpolator", ["linear", "natural"])
@pytest.mark.parametrize("unit", [1, 2, 37])
def test_unmarked_pixels_equal_those_of_the_whole(interpolator: str, unit: int) -> None:
    rng = np.random.default_rng(11)
    n_clear = n_filled = n_marked = 0
    for trial in range(150):
        x, y = rng.integers(0, 40, (2, int(rng.integers(5, 120))))
        # the window may end within a void, where long circles cover unknown data
        if trial % 5 == 0:
            x, y = np.stack([x, y])[
                :, np.hypot(x - rng.integers(40), y - rng.integers(40)) > rng.integers(5, 15)
            ]
        x, y = x * unit, y * unit
        z = rng.integers(0, 100, x.size)
        window = random_window(rng, unit)
        known = (
            (x >= window.west) & (x < window.east) & (y >= window.south) & (y < window.north)
        )
        p, q = [(unit, 1), (2 * unit, 1), (4 * unit, 1), (2 * unit, 3)][trial % 4]
        side = 40 * unit * q // p + 1
        pixels = Pixels(p, q, 0, side - 1, side, side)
        limits = {
            "max_edge": float(rng.choice([math.inf, 6 * unit, 10 * unit, 20 * unit])),
            "max_radius": float(rng.choice([math.inf, 4 * unit, 8 * unit, 20 * unit])),
            "interpolator": interpolator,
        }
        whole = rasterise(Tin.build(x, y, z), pixels, **limits)
        part = rasterise(
            Tin.build(x[known], y[known], z[known]), pixels, window=window, **limits
        )
        clear = ~part.marks
        np.testing.assert_array_equal(
            part.heights[clear], whole.heights[clear], err_msg=f"trial {trial}"
        )
        n_clear += clear.sum()
        n_marked += part.marks.sum()
        n_filled += (clear & ~np.isnan(part.heights)).sum()
    assert min(n_clear, n_marked, n_filled) > 5000
