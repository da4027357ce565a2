"""Terrain above all returns: the pixels by definition, and places that blocks do not divide."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely

from tests.tiler.grid.conftest import FINAL, Scene, make_block, sources_of
from tiler.core.area import Area
from tiler.core.edits import FLAT, Edit, Edits
from tiler.core.lattice import Bounds, CoordFrame, Lattice
from tiler.core.products import Read
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec
from tiler.core.units import FOOT, METRE, Units
from tiler.core.water import LAKE, Water, Waters
from tiler.grid.block_surroundings import PointsNear
from tiler.grid.coarse import padded
from tiler.grid.flaws import ABOVE_M, above, heights_above, min_pixels
from tiler.grid.tasks.findings import places_of, report_above
from tiler.store import read_cells

PIXEL = Fraction(1000)
SIDE = 40
"""Pixels of the scenes along a side, each with one return at its centre."""


REACH, SPIKE = 1, Fraction(5000)


def above_block(
    scene: Scene, spec: RasterSpec, block: Block, **sources: Any
) -> Mapping[str, Any]:
    """Return the counts of the places in a block of the raster ``dtm``."""
    reads = {
        "points": Read("points:dtm", 1000),
        "terrain": Read("raster:dtm", 1),
        "waters": Read("waters"),
        "edits": Read("edits"),
    }
    least = min_pixels((spec.lattice.size * scene.store.meta.frame.metres_xy) ** 2)
    values = {"reach": REACH, "spike": SPIKE, "least": least, "above_m": ABOVE_M}
    given = sources_of(spec, **sources)
    return make_block(
        scene.store, "dtm-above", above, reads, spec, block, sources=given, **values
    )


def heights_of(scene: Scene, block: Block) -> tuple[np.ndarray, np.ndarray]:
    """Return the result of `heights_above` for a block of the raster ``dtm``, without water and edits."""
    spec = spec_of(scene)
    values = read_cells(scene.store, "dtm", spec, padded(block, 1), NODATA)
    terrain = np.where(values == NODATA, np.nan, values.astype(np.float64))
    points = PointsNear(scene.store, FINAL, spec, block, "dtm")
    nothing = np.zeros((block.height, block.width), np.bool_)
    return heights_above(points, terrain, nothing, REACH, SPIKE)


def flat_scene(make_scene, low: np.ndarray, depth_m: float = 3.0, **options) -> Scene:
    """Returns at 50 m, but ``depth_m`` lower in the pixels ``low``, bool (rows, columns); terrain at 50 m."""
    rows, cols = np.indices(low.shape).reshape(2, -1)
    heights = np.where(low.ravel(), 50_000 - 1000 * depth_m, 50_000)
    xyz = np.stack((cols * 1000 + 500, (low.shape[0] - 1 - rows) * 1000 + 500, heights), axis=1)
    scene = make_scene(xyz.astype(np.int64), **options)
    spec = spec_of(scene)
    scene.store.create_raster("dtm", spec)
    for block in spec.blocks(BLOCK_PIXELS):
        scene.store.write_block(
            "dtm", block, np.full((block.height, block.width), 50.0, np.float32)
        )
    return scene


def spec_of(scene: Scene) -> RasterSpec:
    return RasterSpec.enclosing(Lattice(PIXEL), scene.data)


def pixels(*places: tuple[slice, slice]) -> np.ndarray:
    low = np.zeros((SIDE, SIDE), np.bool_)
    for rows, cols in places:
        low[rows, cols] = True
    return low


def records(scene: Scene, **sources: Any) -> dict[Block, Mapping[str, Any]]:
    spec = spec_of(scene)
    return {
        block: above_block(scene, spec, block, **sources) for block in spec.blocks(BLOCK_PIXELS)
    }


def found(scene: Scene, **sources: Any) -> list[tuple[int, list[float], float]]:
    """Area, bounds and height of each place."""
    places = places_of(records(scene, **sources), spec_of(scene), Fraction(1))
    return [(place.area_m2, place.bounds, place.height_m) for place in places]


def test_a_place_has_its_area_its_bounds_and_its_largest_height(make_scene) -> None:
    low = pixels((slice(10, 14), slice(20, 25)), (slice(30, 34), slice(5, 9)))
    scene = flat_scene(make_scene, low)
    dtm = np.full((SIDE, SIDE), 50.0, np.float32)
    dtm[30:34, 5:9] = 54.5
    scene.store.write_block("dtm", Block(0, 0, SIDE, SIDE), dtm)
    assert found(scene) == [
        (16.0, [5.0, SIDE - 34.0, 9.0, SIDE - 30.0], 7.5),
        (20.0, [20.0, SIDE - 14.0, 25.0, SIDE - 10.0], 3.0),
    ]
    above_m, _ = heights_of(scene, Block(0, 0, SIDE, SIDE))
    assert np.array_equal(above_m > ABOVE_M, low)


def test_a_slope_whose_returns_lie_at_the_low_edge_of_pixels_is_right(make_scene) -> None:
    """Pixels of 1 m on a slope of 3: the terrain is 1.4 m above the return at the lower edge."""
    rows, cols = np.indices((SIDE, SIDE)).reshape(2, -1)
    x = cols * 1000 + 30
    xyz = np.stack((x, (SIDE - 1 - rows) * 1000 + 500, 50_000 + 3 * x), axis=1)
    scene = make_scene(xyz.astype(np.int64))
    spec = spec_of(scene)
    scene.store.create_raster("dtm", spec)
    terrain = np.tile(50.0 + 3.0 * (np.arange(SIDE) + 0.5), (SIDE, 1)).astype(np.float32)
    scene.store.write_block("dtm", Block(0, 0, SIDE, SIDE), terrain)
    (record,) = records(scene).values()
    assert record["wrong"] == 0


def test_small_places_are_counted_but_not_listed(make_scene) -> None:
    low = pixels((slice(10, 13), slice(20, 23)), (slice(20, 22), slice(5, 10)))
    assert [area for area, _, _ in found(flat_scene(make_scene, low))] == [10.0]
    (record,) = records(flat_scene(make_scene, low)).values()
    assert record["wrong"] == 19


def test_pixels_that_touch_at_a_corner_are_one_place(make_scene) -> None:
    low = pixels((slice(10, 12), slice(10, 13)), (slice(12, 14), slice(13, 16)))
    assert [area for area, _, _ in found(flat_scene(make_scene, low))] == [12.0]


def test_terrain_up_to_a_metre_above_is_no_place(make_scene) -> None:
    low = pixels((slice(10, 20), slice(10, 20)))
    assert found(flat_scene(make_scene, low, 1.0)) == []
    assert len(found(flat_scene(make_scene, low, 1.001))) == 1


def test_the_limit_is_a_metre_in_feet_too(make_scene) -> None:
    low = pixels((slice(10, 30), slice(10, 30)))
    feet = CoordFrame(Units(FOOT, FOOT))
    assert found(flat_scene(make_scene, low, 3.2, frame=feet)) == []
    ((_, _, height),) = found(flat_scene(make_scene, low, 3.3, frame=feet))
    assert height == pytest.approx(3.3 * 0.3048, abs=1e-3)


def test_neither_noise_nor_pixels_without_terrain_count(make_scene) -> None:
    low = pixels((slice(10, 20), slice(10, 20)))
    noise = np.where(low.ravel(), 7, 2).astype(np.uint8)
    assert found(flat_scene(make_scene, low, labels=noise)) == []
    scene = flat_scene(make_scene, low)
    scene.store.write_block(
        "dtm", Block(0, 0, SIDE, SIDE), np.where(low, -9999, 50).astype(np.float32)
    )
    assert found(scene) == []


def test_a_height_that_an_edit_sets_is_no_problem(make_scene) -> None:
    low = pixels((slice(10, 20), slice(10, 20)))
    scene = flat_scene(make_scene, low)
    area = Area.rectangle(Bounds(10_000, 20_000, 15_000, 30_000))
    edits = Edits((Edit(number=1, action=FLAT, area=area, z=50_000),), Lattice(PIXEL))
    scene.store.put_edits(edits)
    rule = replace(FINAL, edits=edits.key)
    ((area_m2, bounds, _),) = found(scene, rule=rule)
    assert (area_m2, bounds) == (50.0, [15.0, 20.0, 20.0, 30.0])


def test_water_is_no_problem(make_scene) -> None:
    """Returns far below the level of water are noise."""
    scene = flat_scene(make_scene, pixels((slice(10, 20), slice(10, 20))))
    area = Area.rectangle(Bounds(10_000, 20_000, 20_000, 30_000))
    waters = Waters((Water(1, LAKE, area, 50_000),))
    scene.store.put_waters(waters)
    assert found(scene, waters=waters.key) == []


def test_places_across_blocks_are_joined(make_scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """A place on four blocks, another that touches only diagonally across a corner, and one too small in each block."""
    low = pixels(
        (slice(14, 19), slice(12, 20)),
        (slice(28, 32), slice(30, 32)),
        (slice(32, 34), slice(32, 34)),
        (slice(2, 4), slice(13, 19)),
    )
    scene = flat_scene(make_scene, low)
    whole = found(scene)
    assert [area for area, _, _ in whole] == [40.0, 12.0, 12.0]
    spec = spec_of(scene)
    for side in (8, 16):
        monkeypatch.setattr("tiler.grid.coarse.BLOCK_PIXELS", side)
        of_blocks = {block: above_block(scene, spec, block) for block in spec.blocks(side)}
        places = places_of(of_blocks, spec, Fraction(1))
        assert [(p.area_m2, p.bounds, p.height_m) for p in places] == whole


def test_blocks_do_not_change_the_height_above_a_slope(make_scene) -> None:
    """The rise across a pixel needs its neighbours, in blocks of a single row or column as well."""
    scene = flat_scene(make_scene, np.zeros((SIDE, SIDE), np.bool_))
    spec, whole = spec_of(scene), Block(0, 0, SIDE, SIDE)
    terrain = 50.0 + np.random.default_rng(3).normal(0.0, 3.0, (SIDE, SIDE))
    scene.store.write_block("dtm", whole, terrain.astype(np.float32))
    expected = np.stack(heights_of(scene, whole))
    assert (expected > ABOVE_M).any(axis=(1, 2)).all()
    for side in (1, 8, 13):
        of_blocks = np.full((2, SIDE, SIDE), np.nan)
        for block in spec.blocks(side):
            rows = slice(block.row, block.row + block.height)
            cols = slice(block.col, block.col + block.width)
            of_blocks[:, rows, cols] = heights_of(scene, block)
        assert np.array_equal(of_blocks, expected)


def test_pixels_whose_lowest_return_is_far_above_the_terrain_are_counted(make_scene) -> None:
    """A crown 4 m up in 200 pixels, ground below it in 50 of these, a shrub of 2 m in 30, and 60 pixels of water."""
    crown, seen = (slice(0, 10), slice(0, 20)), (slice(0, 10), slice(0, 5))
    shrub, wet = (slice(20, 23), slice(0, 10)), (slice(30, 36), slice(30, 40))
    rows, cols = np.indices((SIDE, SIDE))
    heights = np.full((SIDE, SIDE), 50_000)
    heights[crown], heights[shrub], heights[wet] = 54_000, 52_000, 60_000
    below = np.zeros((SIDE, SIDE), np.bool_)
    below[seen] = True
    top, ground = (
        np.stack((cols * 1000 + 500, (SIDE - 1 - rows) * 1000 + 500, z), axis=-1)
        for z in (heights, np.full((SIDE, SIDE), 50_000))
    )
    scene = make_scene(np.concatenate((top.reshape(-1, 3), ground[below])).astype(np.int64))
    spec = spec_of(scene)
    scene.store.create_raster("dtm", spec)
    dtm = np.full((SIDE, SIDE), 50.0, np.float32)
    dtm[20:23, 20:30] = NODATA
    scene.store.write_block("dtm", Block(0, 0, SIDE, SIDE), dtm)
    waters = Waters(
        (Water(1, LAKE, Area.rectangle(Bounds(30_000, 4000, 40_000, 10_000)), 50_000),)
    )
    scene.store.put_waters(waters)
    (record,) = records(scene, waters=waters.key).values()
    assert record["cells"] == [[0, 0, SIDE**2 - 30 - 60, 150]]


def test_the_note_counts_the_pixels_of_its_places(make_scene) -> None:
    low = pixels((slice(10, 13), slice(20, 23)), (slice(20, 22), slice(5, 10)))
    scene = flat_scene(make_scene, low)
    notes: list[str] = []
    plan = SimpleNamespace(
        grid=SimpleNamespace(resolution=Fraction(1)),
        frame=SimpleNamespace(units=Units(METRE, METRE)),
    )
    job = SimpleNamespace(plan=plan, results=SimpleNamespace(), note=notes.append)
    report_above(job, spec_of(scene), records(scene))
    assert (job.results.above_returns.pixels, job.results.above_returns.number) == (19, 1)
    (note,) = notes
    assert note.startswith("in 10 pixels all returns lie more than 1 m below the terrain, ")
    assert "in 1 place of at least 10 m2" in note


def test_the_rings_of_a_place_enclose_its_pixels_also_in_parts_and_around_holes(
    make_scene,
) -> None:
    ring = pixels((slice(10, 20), slice(10, 20)))
    ring[13:17, 13:17] = False
    apart = pixels((slice(20, 26), slice(20, 26)))  # touches the ring at a corner
    (place,) = places_of(
        records(flat_scene(make_scene, ring | apart)),
        spec_of(flat_scene(make_scene, ring)),
        Fraction(1),
    )
    rings = [np.reshape(part, (-1, 2)) for part in place.rings]
    shape = shapely.build_area(shapely.MultiLineString(rings))
    row, col = np.indices((SIDE, SIDE)) + 0.5
    assert np.array_equal(shapely.contains_xy(shape, col, SIDE - row), ring | apart)
