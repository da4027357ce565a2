"""Where the water of a river stands: its line goes through its middle, and its heights fall along it."""

from __future__ import annotations

import numpy as np
import shapely

from tiler.grid.course import course_of, mean_width
from tiler.grid.water_level import falling_line


def bend(width: float) -> shapely.Polygon:
    """A river around a quarter of a circle of radius 3000, with an island."""
    angle = np.linspace(0, np.pi / 2, 80)
    middle = shapely.LineString(np.stack((3000 * np.cos(angle), 3000 * np.sin(angle)), axis=1))
    return middle.buffer(width / 2, cap_style="flat") - shapely.Point(2121, 2121).buffer(width / 6)


def test_the_course_of_a_bend_stays_in_the_middle_third() -> None:
    shape = bend(300)
    line = course_of(shape)
    assert line is not None
    assert np.abs(np.hypot(*line.T) - 3000).max() < 90
    assert shapely.LineString(line).length > 0.85 * 3000 * np.pi / 2
    assert abs(mean_width(shape) - 300) < 30


def test_heights_fall_along_the_line_and_stay_at_the_bank() -> None:
    rng = np.random.default_rng(1)
    along = rng.uniform(0, 10_000, 4000)
    bank = np.rint(5000 - along / 10 + rng.uniform(0, 300, 4000)).astype(np.int64)
    shore = np.stack((along.astype(np.int64), rng.choice([-500, 500], 4000), bank))
    line = np.array([[10_000.0, 0.0], [5000.0, 0.0], [0.0, 0.0]])
    none = np.empty((3, 0), np.int64)
    flow = falling_line(line, shore, none, 400)
    assert flow[0, 0] == 0
    assert flow[-1, 0] == 10_000
    assert np.diff(flow[:, 2]).max() <= 0
    misfit = flow[1:-1, 2] - (5000 - flow[1:-1, 0] / 10)
    assert np.abs(misfit - 30).max() < 40  # a tenth of the banks lies below 30


def test_returns_of_the_water_tell_its_level_where_walls_stand_around_it() -> None:
    x = np.arange(0, 1000)
    shore = np.stack((x, np.full(1000, 50), np.full(1000, 3000)))
    within = np.stack((x, np.zeros(1000, np.int64), np.full(1000, 1200)))
    assert set(falling_line(np.array([[0.0, 0.0], [999.0, 0.0]]), shore, within, 100)[:, 2].tolist()) == {
        1200
    }
