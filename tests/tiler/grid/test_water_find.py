"""Water ends on straight lines where it leaves the survey, and land at its border stays."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import shapely

from tiler.core.lattice import Lattice
from tiler.core.products import BEYOND, SURVEYED
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.core.water import Water
from tiler.grid.coarse import Piece
from tiler.grid.records import GroundSelection
from tiler.grid.river import polygon_of
from tiler.grid.water_find import BodyCells, describe_body
from tiler.grid.water_search import SearchRasters
from tiler.store import TileStore

CELL = 2000
WEST, NORTH = 250_000, 2_700_000
ROWS, COLUMNS = np.mgrid[:BLOCK_PIXELS, :BLOCK_PIXELS]
EDGE = 100
"""First column beyond the survey."""
LAKE = (ROWS >= 60) & (ROWS < 120) & (COLUMNS >= 40) & (COLUMNS < EDGE)


def body(store: TileStore, wet: np.ndarray, surveyed: np.ndarray) -> shapely.Geometry:
    """Return the polygon of the water in cells: x is the column and y the row of its vertices."""
    spec = RasterSpec(Lattice(Fraction(CELL)), WEST, NORTH, *ROWS.shape)
    block = spec.block_at(0, 0, BLOCK_PIXELS)
    rasters = {
        "water": wet,
        "domain": np.where(surveyed, SURVEYED, BEYOND),
        "occupancy": np.where(surveyed & ~wet, 20, 0),
        "ground": np.where(wet, 0.0, 2.0),
        "crowns": np.zeros(wet.shape),
    }
    for name, values in rasters.items():
        store.create_raster(name, spec, 0.0)
        store.write_block(name, block, values.astype(np.float32))
    sources = SearchRasters("occupancy", "ground", "domain")
    rule = GroundSelection("final")
    cells = BodyCells((Piece(0, 0, 1),), "water", "crowns", sources, rule, spec, 1000.0)
    found = describe_body(
        store, cells=cells, confidence=0.95, lake_m2=100.0, river_width_m=15.0
    )["body"]
    polygon = polygon_of(Water.from_json(found).area)
    return shapely.transform(
        polygon, lambda at: np.stack((at[:, 0] / CELL - WEST, NORTH - at[:, 1] / CELL), 1)
    )


def test_a_bay_of_the_border_is_filled_up_to_a_straight_line(small_store: TileStore) -> None:
    bay = (ROWS - 90.0) ** 2 + (COLUMNS - EDGE) ** 2 < 15**2
    surveyed = (COLUMNS < EDGE) & ~bay
    found = body(small_store, LAKE & surveyed, surveyed)
    assert found.symmetric_difference(shapely.box(40, 60, EDGE, 120)).area < 0.01 * found.area


def test_a_bay_that_is_too_wide_stays(small_store: TileStore) -> None:
    """Its chord is 112 m long, and its sides reach the lake's: only its corners are filled."""
    bay = (ROWS >= 62) & (ROWS < 118) & (COLUMNS >= EDGE - 30)
    surveyed = (COLUMNS < EDGE) & ~bay
    found = body(small_store, LAKE & surveyed, surveyed)
    assert not found.contains(shapely.Point(EDGE - 4, 90))


@pytest.mark.parametrize("rows", [3, 12])
def test_land_at_the_border_stays(rows: int, small_store: TileStore) -> None:
    """A bank of 4 cells at the border, whatever its length."""
    surveyed = COLUMNS < EDGE
    bank = (np.abs(ROWS - 90) <= rows) & (COLUMNS >= EDGE - 4) & surveyed
    found = body(small_store, LAKE & ~bank, surveyed)
    middle = shapely.box(EDGE - 3, 90 - rows + 1, EDGE - 0.5, 90 + rows)
    assert found.intersection(middle).area < 0.05 * middle.area


def test_land_that_a_bay_encloses_stays(small_store: TileStore) -> None:
    surveyed = (COLUMNS < EDGE - 8) | ((COLUMNS < EDGE) & (np.abs(ROWS - 90) > 10))
    bank = (np.abs(ROWS - 90) <= 1) & (COLUMNS >= EDGE - 12) & surveyed
    found = body(small_store, LAKE & surveyed & ~bank, surveyed)
    assert found.contains(shapely.Point(EDGE - 4, 90.5))
    assert not found.contains(shapely.Point(EDGE - 9.5, 90.5))
