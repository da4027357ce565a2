"""Structures among the breaklines of water: one line from bank to bank at each step of a river."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from tiler.core.area import Area
from tiler.core.lattice import CoordFrame
from tiler.core.water import LAKE, RIVER, Water
from tiler.export.water import dams, structures


def river(shape: shapely.Geometry, flow: list[list[float]]) -> Water:
    """A river from metres."""
    rings = [
        np.rint(shapely.get_coordinates(r)[:-1] * 1000)
        for r in (shape.exterior, *shape.interiors)
    ]
    area = Area((tuple(ring.astype(np.int64) for ring in rings),))
    return Water(1, RIVER, area, flow=np.rint(np.array(flow) * 1000).astype(np.int64))


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.2, 2.5])
def test_a_dam_is_one_line_from_bank_to_bank_with_the_level_above_it(turn: float) -> None:
    flow = np.array([[0, 0, 9], [99.95, 0, 8.9], [100.05, 0, 6.5], [200, 0, 6.4]], float)
    cos, sin = np.cos(turn), np.sin(turn)
    flow[:, :2] = flow[:, :2] @ np.array([[cos, sin], [-sin, cos]])
    shape = shapely.affinity.rotate(
        shapely.box(-10, -12, 210, 8), turn, (0, 0), use_radians=True
    )
    (line,) = structures(river(shape, flow.tolist()))
    assert np.hypot(*np.diff(line[:, :2], axis=0)[0]) == pytest.approx(20_000, abs=50)
    assert np.hypot(*(line[:, :2].mean(axis=0) - 1000 * np.array([cos, sin]) * 100)) < 2050
    assert line[:, 2].tolist() == [8900.0, 8900.0]


def test_an_island_at_a_step_does_not_make_two_lines() -> None:
    shape = shapely.box(0, -10, 200, 10) - shapely.box(90, 2, 110, 5)
    flow = [[0, 0, 9], [99.95, 0, 9], [100.05, 0, 6], [150, 0, 6], [150.1, 0, 5], [200, 0, 5]]
    first, second = structures(river(shape, flow))
    assert sorted(np.rint(first[:, 1] / 1000).tolist()) == [-10, 2]
    assert sorted(np.rint(second[:, 1] / 1000).tolist()) == [-10, 10]


def test_rapids_and_lakes_have_no_structures() -> None:
    shape = shapely.box(0, -10, 200, 10)
    assert structures(river(shape, [[0, 0, 9], [100, 0, 5], [200, 0, 2]])) == []
    assert (
        structures(Water(1, LAKE, river(shape, [[0, 0, 9], [9, 0, 9]]).area, level=9000)) == []
    )


def lake(number: int, shape: shapely.Geometry, level_m: float) -> Water:
    """A lake from metres."""
    return Water(
        number, LAKE, river(shape, [[0, 0, 9], [9, 0, 9]]).area, level=round(level_m * 1000)
    )


def test_the_upper_shore_at_a_dam_between_two_bodies_is_a_structure() -> None:
    upper, lower = (
        lake(1, shapely.box(0, 0, 100, 50), 9.0),
        lake(2, shapely.box(110, 0, 200, 50), 6.0),
    )
    at_level = lake(3, shapely.box(0, 60, 60, 90), 9.2)
    far = lake(4, shapely.box(300, 0, 400, 50), 2.0)
    (line,), *others = dams([upper, lower, at_level, far], CoordFrame())
    assert others == [[], [], []]
    shore = shapely.LineString([(90, 0), (100, 0), (100, 50), (90, 50)])
    assert shapely.LineString(line[:, :2] / 1000).hausdorff_distance(shore) < 0.1
    assert set(line[:, 2].tolist()) == {9000.0}
