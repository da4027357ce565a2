"""Hypothesis strategies for point sets that are hard to triangulate: lists of (x, y, z)."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

Points = list[tuple[int, int, int]]

_Z = st.integers(-50, 50)


def _points(
    x: st.SearchStrategy[int], y: st.SearchStrategy[int], most: int
) -> st.SearchStrategy[Points]:
    return st.lists(st.tuples(x, y, _Z), max_size=most)


@st.composite
def _on_a_line(draw: st.DrawFn) -> Points:
    dx, dy = draw(st.sampled_from([(1, 0), (0, 1), (1, 1), (3, -2), (100_000, 70_001)]))
    steps = draw(st.lists(st.integers(-20, 20), max_size=12))
    line = [(dx * s, dy * s, s % 7) for s in steps]
    return line + draw(_points(st.integers(-9, 9), st.integers(-9, 9), 2))


@st.composite
def _on_a_circle(draw: st.DrawFn) -> Points:
    # x^2 + y^2 = 5^2 13^2 17^2 has many integer solutions; scaled they exceed what doubles hold
    # exactly.
    r2 = (5 * 13 * 17) ** 2
    ring = [
        (x, y)
        for x in range(-1105, 1106)
        for y in (round((r2 - x * x) ** 0.5), -round((r2 - x * x) ** 0.5))
        if x * x + y * y == r2
    ]
    scale = draw(st.sampled_from([1, 7, 30_000]))
    chosen = draw(st.lists(st.sampled_from(ring), max_size=11))
    nudge = draw(st.sampled_from([0, 0, 1]))
    return [
        (scale * x + (nudge if i == 0 else 0), scale * y, i) for i, (x, y) in enumerate(chosen)
    ]


@st.composite
def _clusters(draw: st.DrawFn) -> Points:
    far, beside = st.integers(-(2**25) + 10, 2**25 - 10), st.integers(-2, 2)
    centres = draw(st.lists(st.tuples(far, far), min_size=1, max_size=3))
    near = draw(st.lists(st.tuples(st.sampled_from(centres), beside, beside), max_size=14))
    return [(c[0] + dx, c[1] + dy, dx) for c, dx, dy in near]


_small, _wide = st.integers(0, 4), st.integers(-(2**25), 2**25 - 1)

point_sets = st.one_of(
    _points(_small, _small, 16),
    _points(st.integers(-500, 500), st.integers(-500, 500), 14),
    _points(_wide, _wide, 12),
    _on_a_line(),
    _on_a_circle(),
    _clusters(),
)


def columns(points: Points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y, z as int32 arrays."""
    table = np.array(points, np.int32).reshape(-1, 3)
    return table[:, 0].copy(), table[:, 1].copy(), table[:, 2].copy()
