"""What looks like a roof or a crown in the finished terrain has one warning with its remedy."""

from __future__ import annotations

import tomllib
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import shapely

from ptd.matched.crowns import Crowns
from ptd.methods import METHODS
from tests.scenes.halls import ROWS, with_hall
from tiler.core.lattice import Lattice
from tiler.core.raster import NODATA, RasterSpec
from tiler.core.water import LAKE, Water, Waters
from tiler.grid.flaws import TOO_WIDE, crown_advice, crowns_in_block, roofs_in_terrain, thinned
from tiler.grid.river import area_of
from tiler.store import TileStore


def test_pooling_keeps_the_place() -> None:
    assert np.array_equal(thinned(ROWS, 4)[:3, 0], [2, 6, 10])


@pytest.mark.parametrize("part_cells", [1000, 50])
def test_a_roof_in_the_terrain_of_a_store(
    part_cells: int, small_store: TileStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiler.grid.flaws.PART_CELLS", part_cells)
    heights = np.kron(with_hall(), np.ones((2, 2))).astype(np.float32)
    heights[:20] = NODATA
    spec = RasterSpec(Lattice(Fraction(1000)), 500_000, 5_400_000, *heights.shape)
    small_store.create_raster("dtm", spec)
    for block in spec.blocks(512):
        part = heights[
            block.row : block.row + block.height, block.col : block.col + block.width
        ]
        small_store.write_block("dtm", block, part)

    def advice(
        building_m: float, roof_m: float | None = None, waters: str | None = None
    ) -> str:
        found = roofs_in_terrain(
            small_store, "dtm", spec, spec.blocks(512), building_m, roof_m, waters
        )
        assert found is None or f"x {found.x:.0f}, y {found.y:.0f}" in found.text
        return "" if found is None else found.text

    text = advice(20.0)
    assert text.startswith("the terrain holds what looks like a roof 60 m wide")
    assert "x 500130, y 5399890" in text
    assert text.endswith(
        "max_building_size is 20 m; if it is one, use --set max_building_size=80"
    )
    assert advice(80.0) == ""
    assert advice(20.0, 50.0).endswith(
        "roof_size is 50 m; if it is one, use --set roof_size=80"
    )
    assert advice(20.0, 200.0) == text
    around = shapely.box(500_060_000, 5_399_820_000, 500_200_000, 5_399_960_000)
    hall = shapely.box(500_098_000, 5_399_858_000, 500_162_000, 5_399_922_000)
    moat = Waters((Water(1, LAKE, area_of(around.difference(hall)), 0),))
    small_store.put_waters(moat)
    assert advice(20.0, waters=moat.key) == ""


@pytest.mark.parametrize("pixels", [1, 2])
def test_crowns_in_the_terrain_of_a_store(pixels: int, small_store: TileStore) -> None:
    """A canopy of 120 m in the north, a slope in the south; pixels of 1 and 0.5 m."""
    rows, columns = np.indices((240, 240), np.float64)
    heights = 0.1 * columns
    for row, column in np.random.default_rng(2).uniform(0, (120, 240), (1500, 2)):
        away = np.hypot(rows - row, columns - column) / 4
        heights = np.maximum(
            heights, np.where(away < 1, 0.1 * columns + 3 * (1 - away**2), -np.inf)
        )
    heights = np.kron(heights, np.ones((pixels, pixels))).astype(np.float32)
    spec = RasterSpec(Lattice(Fraction(1000, pixels)), 500_000, 5_400_000, *heights.shape)
    small_store.create_raster("dtm", spec)
    for block in spec.blocks(512):
        part = heights[
            block.row : block.row + block.height, block.col : block.col + block.width
        ]
        small_store.write_block("dtm", block, part)
    looked = [crowns_in_block(small_store, "dtm", spec, block) for block in spec.blocks(512)]
    told = crown_advice(looked, spec)
    assert told is not None
    text = told.text
    assert f"x {told.x:.0f}, y {told.y:.0f}" in text
    share = int(text.split(" %")[0])
    assert 25 < share <= 50
    y = float(text.split(", y ")[1].split(";")[0])
    assert 5_400_000 / pixels - 120 < y < 5_400_000 / pixels
    assert crown_advice([Crowns(900, looked[0].found[:20])], spec) is None
    assert crown_advice([Crowns(15, looked[0].found[:9])], spec) is None  # too few


def test_methods_md_says_from_which_width_a_roof_is_named() -> None:
    def width(building_m: float) -> str:
        return f"{TOO_WIDE * building_m:.0f} m"

    root = Path(__file__).resolve().parents[3]
    city = tomllib.loads((root / "tiler/config/presets/city.toml").read_text("utf-8"))
    auto, classic = (METHODS[m].params().max_building_size_m for m in ("auto", "classic"))
    text = (root / "docs/methods.md").read_text("utf-8")
    assert (
        f"({width(auto)} by default, {width(classic)} with `classic`, "
        f"{width(city['parameters']['max_building_size_m'])} with `--preset city`)"
    ) in text
    without = [
        f"`{n}`" for n in METHODS if not hasattr(METHODS[n].params, "max_building_size_m")
    ]
    assert f"(all but {', '.join(without)} and `keep`)" in text
