"""The level of a river: its line goes through its middle, and its heights fall along it, with steps at dams."""

from __future__ import annotations

import numpy as np
import shapely
from hypothesis import given
from hypothesis import strategies as st

from tiler.grid.river import MIN_PIXELS, centreline, mean_width, profile_along

NONE = np.empty((3, 0), np.int64)
STRAIGHT = np.array([[0.0, 0.0], [300_000.0, 0.0], [600_000.0, 0.0]])
"""600 m to the east, in counts of a millimetre."""


def bend(width: float) -> shapely.Polygon:
    """A river around a quarter of a circle of radius 3000, with an island."""
    angle = np.linspace(0, np.pi / 2, 80)
    middle = shapely.LineString(np.stack((3000 * np.cos(angle), 3000 * np.sin(angle)), axis=1))
    return middle.buffer(width / 2, cap_style="flat") - shapely.Point(2121, 2121).buffer(
        width / 6
    )


def places(
    heights: object, rng: np.random.Generator, across: float, number: int = 4000
) -> np.ndarray:
    """Places along `STRAIGHT`, up to ``across`` metres from it, with the heights, metres, of a formula; counts."""
    x, y = rng.uniform(0, 600, number), rng.uniform(-across, across, number)
    return np.rint(np.stack((x, y, heights(x))) * 1000).astype(np.int64)  # type: ignore[operator]


def level_at(flow: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Metres of the profile at metres along `STRAIGHT`."""
    order = np.argsort(flow[:, 0], kind="stable")
    return np.interp(x, flow[order, 0] / 1000, flow[order, 2] / 1000)


def test_the_course_of_a_bend_stays_in_the_middle_third() -> None:
    shape = bend(300)
    line = centreline(shape)
    assert line is not None
    assert np.abs(np.hypot(*line.T) - 3000).max() < 90
    assert shapely.LineString(line).length > 0.85 * 3000 * np.pi / 2
    assert abs(mean_width(shape) - 300) < 30


def test_banks_alone_give_a_profile_that_falls_towards_the_lower_end() -> None:
    rng = np.random.default_rng(1)
    banks = places(lambda x: 50 + x / 250 + rng.uniform(0, 0.3, len(x)), rng, 20)
    flow, stations = profile_along(STRAIGHT, banks, NONE, 40_000)
    assert flow[0, 0] == 600_000  # the water runs to the west
    assert np.diff(flow[:, 2]).max() <= 0
    x = np.linspace(50, 550, 50)
    assert np.abs(level_at(flow, x) - 50 - x / 250).max() < 0.1
    assert {station.seen for station in stations} == {0}


def test_returns_of_the_water_decide_whatever_the_banks_are() -> None:
    rng = np.random.default_rng(2)
    # the ground at the foot of a dam, too
    walls = places(lambda x: np.where(x > 550, 1.0, 30.0), rng, 20)
    water = places(lambda x: 12 + rng.normal(0, 0.05, len(x)), rng, 10)
    flow, _ = profile_along(STRAIGHT, walls, water, 40_000)
    assert np.ptp(flow[:, 2]) == 0
    assert abs(flow[0, 2] - 12_000) < 10


def test_a_dam_is_a_step_and_the_water_on_both_sides_is_level() -> None:
    rng = np.random.default_rng(3)
    water = places(
        lambda x: np.where(x < 313, 143.4, 140.4) + rng.normal(0, 0.05, len(x)), rng, 10
    )
    flow, _ = profile_along(STRAIGHT, NONE, water, 40_000)
    x = np.array([0, 150, 290, 310, 316, 340, 500, 600])
    assert np.abs(level_at(flow, x) - np.where(x < 313, 143.4, 140.4)).max() < 0.05


def test_without_evidence_at_two_places_there_are_no_two_stations() -> None:
    few = np.array([[0, 1, 2, 3, 4], [0] * 5, [7000] * 5])
    assert len(profile_along(STRAIGHT, NONE, few, 40_000).stations) < 2
    assert not profile_along(STRAIGHT, few[:, : MIN_PIXELS - 1], NONE, 40_000).stations


@given(st.integers(0, 10_000), st.floats(0, 3), st.floats(0, 0.5))
def test_no_profile_rises_and_none_leaves_the_range_of_its_stations(
    seed: int, swing: float, noise: float
) -> None:
    rng = np.random.default_rng(seed)

    def heights(x: np.ndarray) -> np.ndarray:
        return 20 + swing * np.sin(x / rng.uniform(30, 300)) + noise * rng.normal(size=len(x))

    banks, water = (
        places(heights, rng, 20, 300),
        places(heights, rng, 10, int(rng.integers(0, 300))),
    )
    flow, stations = profile_along(STRAIGHT, banks, water, 40_000)
    assert np.diff(flow[:, 2]).max() <= 0
    levels = [station.level for station in stations]
    assert levels == sorted(levels, reverse=True)
    assert abs(flow[0, 2] - levels[0]) <= 1
    assert abs(flow[-1, 2] - levels[-1]) <= 1
