"""The interval follows nearly all of the terrain; spots keep away from water."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import shapely
from pyogrio import raw

from tiler.core.area import Area
from tiler.core.lattice import Lattice
from tiler.core.raster import RasterSpec
from tiler.core.water import LAKE, Water, Waters
from tiler.export.contours import Heights, write_contours, write_spots
from tiler.export.output_files import OutFile
from tiler.store import TileStore

SIDE = 200
SPEC = RasterSpec(Lattice(Fraction(1000)), 0, SIDE, SIDE, SIDE)


def stored(store: TileStore, heights: np.ndarray) -> None:
    store.create_raster("dtm", SIDE, SIDE)
    for block in SPEC.blocks(512):
        store.write_block("dtm", block, heights.astype(np.float32))


@pytest.mark.parametrize("tower", [0, 300])
def test_one_tower_does_not_change_the_interval(
    tower: float, small_store: TileStore, tmp_path: Path
) -> None:
    heights = np.tile(np.linspace(20, 40, SIDE), (SIDE, 1))
    heights[50:60, 50:60] += tower
    stored(small_store, heights)
    to, terrain = OutFile(str(tmp_path), "contours.gpkg"), Heights("dtm", SPEC, None, None)
    record = write_contours(
        small_store, to=to, heights=terrain, interval=None, noise=0.02, sigma=0.0
    )
    assert record.interval == 0.5
    assert (record.low, record.high) == pytest.approx((20.4, 39.6), abs=0.2)


def test_no_spot_in_water_or_within_two_pixels_of_it(
    small_store: TileStore, tmp_path: Path
) -> None:
    rng = np.random.default_rng(3)
    heights = 20 + rng.normal(0, 2, (SIDE, SIDE))
    stored(small_store, heights)
    ring = np.array([(60, 60), (140, 60), (140, 140), (60, 140)], np.int64) * 1000
    waters = Waters((Water(1, LAKE, Area(((ring,),)), 15_000),))
    small_store.put_waters(waters)
    kept, to = {}, OutFile(str(tmp_path), "spots.gpkg")
    for key in (None, waters.key):
        terrain = Heights("dtm", SPEC, None, key)
        record = write_spots(
            small_store, to=to, heights=terrain, interval=Fraction(1), noise=0.0, reach=3
        )
        _, _, shapes, _ = raw.read(tmp_path / "spots.gpkg")
        places = shapely.get_coordinates(shapely.from_wkb(shapes))
        assert len(places) == record.highs + record.lows
        kept[key] = {tuple(place) for place in places}
    near = {place for place in kept[None] if all(58 < v < 142 for v in place)}
    assert near
    assert kept[waters.key] == kept[None] - near
