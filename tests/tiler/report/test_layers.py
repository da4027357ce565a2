"""Layers of the report's map: one for each thing that decided on the terrain, none where there is nothing."""

from __future__ import annotations

import numpy as np
import shapely

from tiler.core.breaklines import MAX_VERTICES, rings_of
from tiler.report.drawn import drawn, shapes

RING = [0.0, 0.0, 9.0, 0.0, 9.0, 9.0, 0.0, 0.0]


def test_each_layer_has_its_lines() -> None:
    bridge = {"length_m": 20.0, "width_m": 7.5, "clearance_m": 4.0, "below": 3, "rings": [RING]}
    run = {
        "plan": {},
        "outline": {"gap_m": 20.0, "rings": [RING, RING]},
        "bridges": [bridge],
        "edits": [],
        "breaklines": None,
    }
    found = {layer["name"]: layer for layer in shapes(run)}
    assert list(found) == ["outline", "bridges"]
    assert [len(layer["lines"]) for layer in found.values()] == [2, 1]
    assert [layer["tinted"] for layer in found.values()] == [False, True]
    (section,) = drawn(run)
    assert "1 bridge left out of the terrain" in "".join(section.itertext())
    assert not shapes({})
    assert not drawn({"plan": {}})


def test_an_outline_of_many_steps_fits_the_page_and_stays_where_it_is() -> None:
    angle = np.linspace(0, 2 * np.pi, 40_000, endpoint=False)
    wave = 5000 + 500 * np.sin(900 * angle)
    coast = shapely.Polygon(np.column_stack((wave * np.cos(angle), wave * np.sin(angle))))
    rings = rings_of(np.array([coast], object), 2.0)
    assert sum(len(ring) for ring in rings) <= 2 * MAX_VERTICES
    drawn_ring = shapely.Polygon(np.reshape(rings[0], (-1, 2)))
    assert abs(drawn_ring.area / coast.area - 1) < 0.1
