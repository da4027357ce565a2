"""Positions along the line of a river, against GEOS, and levels of several bodies."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from tiler.core import water
from tiler.core.area import Area


@given(
    n_vertices=st.integers(2, 12),
    step=st.sampled_from([1, 500]),
    seed=st.integers(0, 2**32 - 1),
    at_once=st.sampled_from([1, 7, 1000]),
)
def test_positions_along_a_line_are_those_of_geos(
    n_vertices: int, step: int, seed: int, at_once: int
) -> None:
    """A step of 500 gives equal distances from several segments."""
    rng = np.random.default_rng(seed)
    line = rng.integers(-40, 40, (n_vertices, 2)) * 500 + 60_000_000
    line = np.concatenate((line, line[-1:]))
    x, y = (rng.integers(-25_000, 25_000, (2, 100)) // step * step) + 60_000_000
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(water, "POINTS_AT_ONCE", at_once)
        along = water.places_along(line, x, y)
    assert np.array_equal(
        along, shapely.line_locate_point(shapely.LineString(line), shapely.points(x, y))
    )


def test_levels_are_those_of_the_last_body() -> None:
    """A river falls from 900 to 700 counts over a part of a lake."""
    lake, river = (
        Area.from_json([[[west, 0, west + 1000, 0, west + 1000, 1000, west, 1000]]])
        for west in (0, 500)
    )
    flow = np.array([[500, 500, 900], [1500, 500, 700]])
    bodies = (
        water.Water(1, water.LAKE, lake, level=400),
        water.Water(2, water.RIVER, river, flow=flow),
    )
    x = np.array([-100, 100, 600, 1400, 1600])
    levels = water.Waters(bodies).levels(x, np.full(5, 300))
    assert levels.tolist() == [-np.inf, 400, 880, 720, -np.inf]
