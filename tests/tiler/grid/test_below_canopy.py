"""Terrain below a wood: true on a hill that facets cut off, continuous at the edge, the same in any raster."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tiler.grid.conftest import Scene, make_block, sources_of
from tiler.core.lattice import Bounds, Lattice
from tiler.core.products import Read
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.grid.canopy import OPEN, below_canopy, crowns_margin
from tiler.grid.coarse import coarse_raster
from tiler.store import between_centres

SIDE, RADIUS_M, HILL_M, TREES_M = 400, 90.0, 8.0, 17.0
COARSE = coarse_raster(Lattice(Fraction(2000)), Bounds(0, 0, SIDE * 1000, SIDE * 1000))
PIXELS = RasterSpec(Lattice(Fraction(1000)), 0, SIDE, SIDE, SIDE)


@pytest.fixture
def scene(make_scene) -> Scene:
    return make_scene(np.zeros((1, 3), np.int64))


def wood(spec: RasterSpec, glimpses: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True terrain, terrain interpolated from the ground around a round wood on a hill, and crowns."""
    x, y = (
        axis / 1000 - SIDE / 2 for axis in spec.centres(Block(0, 0, spec.height, spec.width))
    )
    r = np.hypot(x, y)
    truth = 100.0 + HILL_M * np.maximum(1 - (r / RADIUS_M) ** 2, -1.0)
    inside = r < RADIUS_M
    crowns = truth + TREES_M + 2 * np.sin(x / 2) * np.sin(y / 2)
    terrain = np.where(inside, 100.0, truth)
    terrain = np.where((r < RADIUS_M - 50) | (r > SIDE / 2), NODATA, terrain)
    canopy = np.where(inside, crowns, OPEN if glimpses else NODATA)
    return truth, terrain.astype(np.float32), canopy.astype(np.float32)


def made(
    scene: Scene, spec: RasterSpec, coarse: RasterSpec = COARSE, glimpses: bool = True
) -> np.ndarray:
    """The heights below the canopy in all blocks."""
    store = scene.store
    rasters = {
        "model": spec,
        "canopy": spec,
        "terrain": coarse,
        "crowns": coarse,
        "below": spec,
    }
    for name, of in rasters.items():
        store.create_raster(name, of, NODATA)
    for (height, canopy), of in ((("model", "canopy"), spec), (("terrain", "crowns"), coarse)):
        _, *values = wood(of, glimpses)
        for b in of.blocks(512):
            part = np.s_[b.row : b.row + b.height, b.col : b.col + b.width]
            store.write_block(height, b, values[0][part])
            store.write_block(canopy, b, values[1][part])
    margin = crowns_margin(float(coarse.lattice.size * store.meta.frame.metres_xy))
    reads = {
        "terrain": Read("raster:model"),
        "canopy": Read("raster:canopy"),
        "crowns": Read("canopy-grid:crowns", margin),
        "bridge": Read("canopy-grid:terrain", margin),
        "place": Read("place"),
    }
    sources = sources_of(spec, canopy_grid=coarse)
    filled = 0
    for b in spec.blocks(512):
        counts = make_block(store, "below", below_canopy, reads, spec, b, NODATA, sources)
        filled += counts["filled"]
    heights = store.read_block("below", Block(0, 0, spec.height, spec.width))
    assert filled == (heights != np.float32(NODATA)).sum()
    return heights


@pytest.mark.parametrize("pixel", [1000, 700, 3100])
def test_a_hill_below_a_wood_is_found(scene: Scene, pixel: int) -> None:
    spec = RasterSpec.covering(Lattice(Fraction(pixel)), Bounds(0, 0, SIDE * 1000, SIDE * 1000))
    truth, terrain, canopy = wood(spec)
    heights = made(scene, spec)
    known, hidden = heights != np.float32(NODATA), canopy > OPEN
    assert np.array_equal(known, hidden)  # the hole in the middle, too, and nothing else
    facets = np.where(terrain == np.float32(NODATA), 100.0, terrain)
    error, without = (np.sqrt(((z - truth)[hidden] ** 2).mean()) for z in (heights, facets))
    assert error < 0.4 * without


def test_near_ground_the_terrain_stays(scene: Scene) -> None:
    _, terrain, canopy = wood(PIXELS)
    heights = made(scene, PIXELS)
    rows, columns = np.indices(terrain.shape)
    edge = np.hypot(rows - SIDE / 2, columns - SIDE / 2) > RADIUS_M - 2
    edge &= canopy > OPEN
    assert np.abs(heights - terrain)[edge].max() < 0.05


def test_without_ground_in_sight_the_terrain_stays(scene: Scene) -> None:
    assert (made(scene, PIXELS, glimpses=False) == np.float32(NODATA)).all()


@pytest.mark.parametrize(
    ("west", "north", "height", "width"), [(-301, 701, 701, 701), (150, 260, 90, 70)]
)
def test_a_place_does_not_depend_on_the_raster(
    scene: Scene, west: int, north: int, height: int, width: int
) -> None:
    """Neither on a larger one with other blocks, nor on one that ends in the wood."""
    whole = made(scene, PIXELS)
    other = RasterSpec(PIXELS.lattice, west, north, height, width)
    wider = coarse_raster(COARSE.lattice, Bounds(-1_500_000, 0, SIDE * 1000, 1_500_000))
    heights = made(scene, other, wider)
    left, top = max(west, 0), min(north, SIDE)
    right, bottom = min(west + width, SIDE), max(north - height, 0)
    own = heights[north - top : north - bottom, left - west : right - west]
    assert own.size
    assert np.array_equal(own, whole[SIDE - top : SIDE - bottom, left:right])


sizes = st.fractions(min_value=50, max_value=5000, max_denominator=400)


@given(sizes, sizes, st.integers(-(10**7), 10**7), st.integers(-(10**7), 10**7))
def test_pixels_lie_between_the_centres_of_cells(
    pixel: Fraction, cell: Fraction, west: int, north: int
) -> None:
    spec = RasterSpec(Lattice(pixel), west, north, 3, 3)
    coarse = coarse_raster(Lattice(cell), spec.block_bounds(Block(0, 0, 3, 3)))
    (rows, down), (columns, right) = between_centres(coarse, spec, Block(1, 1, 2, 2))
    for n in range(2):
        x, y = (west + 1 + n + Fraction(1, 2)) * pixel, (north - 1 - n - Fraction(1, 2)) * pixel
        for at, before, share in (
            (x / cell - coarse.west, columns[n], right[n]),
            (coarse.north - y / cell, rows[n], down[n]),
        ):
            assert before + Fraction(1, 2) <= at < before + Fraction(3, 2)
            assert share == pytest.approx(float(at - before - Fraction(1, 2)))
