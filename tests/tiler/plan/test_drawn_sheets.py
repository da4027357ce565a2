"""To which of the sheets that the user drew a pixel belongs: to one, also if its centre lies on a shared edge."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from hypothesis import example, given
from hypothesis import strategies as st

from tiler.core.drawn_sheets import DrawnSheet
from tiler.core.lattice import Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.io.vector import Feature
from tiler.io.vector.reading import area_in_counts
from tiler.plan.drawn_sheets import in_order

SIDE = 20
SPEC = RasterSpec(Lattice(1000), 0, SIDE, SIDE, SIDE)
"""Pixels of one unit."""
HALF = st.integers(0, 2 * SIDE).map(lambda n: n / 2)
"""Every other value is on the centres of a row or a column."""


def drawn(shapes: Sequence[Any]) -> list[DrawnSheet]:
    sheets = [
        DrawnSheet(str(number), area_in_counts("", [Feature("", shape, {})]))
        for number, shape in enumerate(shapes)
    ]
    ordered, _ = in_order(sheets, 1000.0)
    return ordered


def owners(sheets: Sequence[DrawnSheet]) -> np.ndarray:
    """Number of sheets that have each pixel."""
    areas, block = {sheet.area.key: sheet.area for sheet in sheets}, Block(0, 0, SIDE, SIDE)
    number = np.zeros((SIDE, SIDE), int)
    for sheet in sheets:
        own = SPEC.inside(block, sheet.area)
        for key in sheet.earlier:
            own &= ~SPEC.inside(block, areas[key])
        number += own
    return number


@given(st.lists(st.tuples(HALF, HALF), min_size=2, max_size=12, unique=True))
@example([(0.0, 0.0), (9.0, 9.0), (0.0, 9.0), (9.0, 0.0)])
def test_neighbours_have_each_pixel_once(sites: list[tuple[float, float]]) -> None:
    """Voronoi cells share their vertices, and many of their edges run through centres."""
    square = shapely.box(0, 0, SIDE, SIDE)
    cells = shapely.get_parts(
        shapely.voronoi_polygons(shapely.MultiPoint(sites), extend_to=square)
    )
    parts = [shapely.intersection(cell, square) for cell in cells]
    sheets = drawn([part for part in parts if part.geom_type == "Polygon" and part.area > 0.01])
    assert (owners(sheets) == 1).all()


@given(st.lists(st.tuples(HALF, HALF, HALF, HALF), min_size=2, max_size=6, unique=True))
def test_a_pixel_of_several_polygons_is_in_the_first(
    corners: list[tuple[float, float, float, float]],
) -> None:
    boxes = [shapely.box(min(a, c), min(b, d), max(a, c), max(b, d)) for a, b, c, d in corners]
    sheets = drawn(
        [box for box in dict.fromkeys(boxes) if box.area] or [shapely.box(0, 0, 1, 1)]
    )
    covered = np.zeros((SIDE, SIDE), bool)
    for sheet in sheets:
        covered |= SPEC.inside(Block(0, 0, SIDE, SIDE), sheet.area)
    assert np.array_equal(owners(sheets), covered)


def test_overlaps_narrower_than_a_pixel_are_no_cause_for_a_warning() -> None:
    """Two grids of different accuracy: a sliver of 0.9 pixels, then a strip of 1.1 pixels."""
    for width, pairs in ((0.9, []), (1.1, [("0", "1")])):
        shapes = shapely.box(0, 0, 10 + width, 20), shapely.box(10, 0, 20, 20)
        sheets = [
            DrawnSheet(str(n), area_in_counts("", [Feature("", s, {})]))
            for n, s in enumerate(shapes)
        ]
        ordered, wide = in_order(sheets, 1000.0)
        assert wide == pairs
        assert [len(sheet.earlier) for sheet in ordered] == [0, 1]
        assert (owners(ordered) == 1).all()
