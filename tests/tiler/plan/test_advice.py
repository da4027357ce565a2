"""Wrong choices that the data show have one warning with its remedy; choices that may be right have none."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from tests.scenes.halls import ROWS, with_hall
from tests.tiler.conftest import MakeCloud
from tiler.config import RunConfig
from tiler.core.lattice import Bounds, Lattice
from tiler.core.raster import NODATA, RasterSpec
from tiler.ingest import SourceInfo, inspect
from tiler.plan import make_plan
from tiler.plan.advice import before, pooled, roofs_in_terrain
from tiler.plan.refuse import warnings_of
from tiler.store import TileStore


def test_pooling_keeps_the_place() -> None:
    assert np.array_equal(pooled(ROWS, 4)[:3, 0], [2, 6, 10])


@pytest.mark.parametrize("part_cells", [1000, 50])
def test_a_roof_in_the_terrain_of_a_store(
    part_cells: int, small_store: TileStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiler.plan.advice.PART_CELLS", part_cells)
    heights = np.kron(with_hall(), np.ones((2, 2))).astype(np.float32)
    heights[:20] = NODATA
    spec = RasterSpec(Lattice(Fraction(1000)), 500_000, 5_400_000, *heights.shape)
    small_store.create_raster("dtm", *heights.shape)
    for block in spec.blocks(512):
        part = heights[block.row : block.row + block.height, block.col : block.col + block.width]
        small_store.write_block("dtm", block, part)

    def advice(building_m: float, roof_m: float | None = None) -> str:
        return roofs_in_terrain(small_store, "dtm", spec, spec.blocks(512), building_m, roof_m) or ""

    text = advice(20.0)
    assert text.startswith("the terrain holds what looks like a roof 60 m wide")
    assert "x 500130, y 5399890" in text
    assert text.endswith("max_building_size is 20 m; if it is one, use --set max_building_size=80")
    assert advice(80.0) == ""
    assert advice(20.0, 50.0).endswith("roof_size is 50 m; if it is one, use --set roof_size=80")
    assert advice(20.0, 200.0) == text


@pytest.fixture
def source(make_cloud: MakeCloud) -> SourceInfo:
    return inspect(make_cloud("a.las", 500, 3))


MATCHED = {"has_rgb": True, "returns": 1, "point_format": 2}


@pytest.mark.parametrize(
    ("changes", "settings", "density", "words"),
    [
        (MATCHED, {}, 1.0, ["look like image matching", "method classic", "use --preset dim"]),
        ({**MATCHED, "point_format": 7}, {}, 40.0, ["look like image matching"]),
        (MATCHED, {"method": "ridge2016"}, 1.0, ["method ridge2016 is made for laser scanning"]),
        ({**MATCHED, "point_format": 7}, {}, 8.0, []),  # a scan whose returns were taken off
        ({**MATCHED, "returns": 3}, {}, 40.0, []),
        (MATCHED, {"method": "dong2018"}, 40.0, []),
        (MATCHED, {"method": "keep"}, 40.0, []),
        ({}, {"resolution": "0.5"}, 1.0, ["--resolution 0.5 m is finer", "1 m apart", "use --resolution 1"]),
        ({}, {"resolution": "0.5"}, 3.0, []),
        ({}, {"halo": "10"}, 3.0, ["--halo 10 m is too small", "leave it out, or use --halo 100"]),
        ({}, {"halo": "60"}, 3.0, []),
        ({}, {}, 0.1, []),
    ],
)
def test_choices(
    changes: dict[str, Any], settings: dict[str, Any], density: float, words: list[str], source: SourceInfo
) -> None:
    plain = {"has_rgb": False, "returns": 3, **changes}
    config = RunConfig.from_mapping({"method": "classic", **settings})
    found = list(before([replace(source, **plain)], config, density, 100.0))
    assert len(found) == bool(words)
    for word in words:
        assert word in found[0]


def test_the_plan_gives_the_advice(make_cloud: MakeCloud) -> None:
    path = make_cloud("b.las", 2000, 1)
    config = RunConfig.from_mapping({"method": "classic", "halo": "10", "resolution": "0.1"})
    warnings = make_plan([str(path)], config).warnings
    assert sum("--halo 10 m is too small" in text for text in warnings) == 1
    assert sum("is finer than the points" in text for text in warnings) == 1


@pytest.mark.parametrize(
    ("side", "tile", "times"), [(90, 128, None), (900, 512, None), (900, 128, "6.6"), (300, 100, "9.0")]
)
def test_small_tiles_are_told_of_where_there_are_several(
    side: int, tile: int, times: str | None, make_cloud: MakeCloud
) -> None:
    settings = {"method": "classic", "tile_size": tile, "halo": 100, "in_process": True}
    plan = make_plan([str(make_cloud())], RunConfig.from_mapping(settings))
    found = warnings_of(replace(plan, extent=Bounds(0, 0, 1000 * side, 1000 * side)))
    assert [f"do {times} times the work; use --tile-size 483 or more --memory" in text for text in found] == (
        [True] if times else []
    )


@pytest.mark.parametrize(("crs", "told"), [("EPSG:3857", 1), ("EPSG:25832", 0)])
def test_a_crs_that_stretches_lengths_is_told_of(crs: str, told: int, make_cloud: MakeCloud) -> None:
    plan = make_plan([str(make_cloud(crs=crs))], RunConfig.from_mapping({"in_process": True}))
    found = [text for text in plan.warnings if "times those on the ground" in text]
    assert len(found) == told
    assert all("makes lengths 1.38 times" in text and "UTM" in text for text in found)
