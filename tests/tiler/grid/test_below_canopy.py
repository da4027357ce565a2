"""Terrain below a wood: true on a hill that facets cut off, continuous at the edge, the same in any block."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from tests.tiler.grid.conftest import Scene
from tiler.core.lattice import Lattice
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.grid import BelowCanopy, below_canopy
from tiler.grid.canopy import OPEN

SIDE, RADIUS_M, HILL_M, TREES_M = 400, 90.0, 8.0, 17.0


@pytest.fixture
def scene(make_scene) -> Scene:
    return make_scene(np.zeros((1, 3), np.int64))


def wood(side: int, glimpses: bool = True) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True terrain, terrain interpolated from the ground around a round wood on a hill, and crowns, pixels of 1 m."""
    rows, columns = np.indices((side, side))
    r = np.hypot(rows - side / 2, columns - side / 2)
    truth = 100.0 + HILL_M * np.maximum(1 - (r / RADIUS_M) ** 2, -1.0)
    inside = r < RADIUS_M
    crowns = truth + TREES_M + 2 * np.sin(rows / 2) * np.sin(columns / 2)
    terrain = np.where(inside, 100.0, truth)
    terrain = np.where(r < RADIUS_M - 50, NODATA, terrain)
    canopy = np.where(inside, crowns, OPEN if glimpses else NODATA)
    return truth, terrain.astype(np.float32), canopy.astype(np.float32)


def made(scene: Scene, spec: RasterSpec, terrain: np.ndarray, canopy: np.ndarray) -> np.ndarray:
    """The heights below the canopy in all blocks."""
    store, blocks = scene.store, list(spec.blocks(512))
    for name in ("terrain", "canopy", "below"):
        store.create_raster(name, spec.height, spec.width, NODATA)
    for b in blocks:
        rows, columns = slice(b.row, b.row + b.height), slice(b.col, b.col + b.width)
        store.write_block("terrain", b, terrain[rows, columns])
        store.write_block("canopy", b, canopy[rows, columns])
    names = {"name": "below", "terrain": "terrain", "canopy": "canopy"}
    filled = sum(
        below_canopy(store.url, BelowCanopy(spec=spec, block=b, **names)).filled for b in blocks
    )
    heights = store.read_block("below", Block(0, 0, spec.height, spec.width))
    assert filled == (heights != np.float32(NODATA)).sum()
    return heights


def spec_of(side: int, west: int = 0, north: int = 0, pixel: int = 1000) -> RasterSpec:
    return RasterSpec(Lattice(Fraction(pixel)), west, north, side, side)


def test_a_hill_below_a_wood_is_found(scene: Scene) -> None:
    truth, terrain, canopy = wood(SIDE)
    heights = made(scene, spec_of(SIDE), terrain, canopy)
    known, hidden = heights != np.float32(NODATA), canopy > OPEN
    assert np.array_equal(known, hidden)  # the hole in the middle, too, and nothing else
    facets = np.where(terrain == np.float32(NODATA), 100.0, terrain)
    error, without = (np.sqrt(((z - truth)[hidden] ** 2).mean()) for z in (heights, facets))
    assert error < 0.4 * without


def test_near_ground_the_terrain_stays(scene: Scene) -> None:
    _, terrain, canopy = wood(SIDE)
    heights = made(scene, spec_of(SIDE), terrain, canopy)
    rows, columns = np.indices(terrain.shape)
    edge = np.hypot(rows - SIDE / 2, columns - SIDE / 2) > RADIUS_M - 2
    edge &= canopy > OPEN
    assert np.abs(heights - terrain)[edge].max() < 0.05


def test_without_ground_in_sight_the_terrain_stays(scene: Scene) -> None:
    _, terrain, canopy = wood(SIDE, glimpses=False)
    assert (made(scene, spec_of(SIDE), terrain, canopy) == np.float32(NODATA)).all()


@pytest.mark.parametrize(("west", "north", "pad"), [(0, 0, 301), (7, -13, 250), (-50, 31, 333)])
def test_a_place_does_not_depend_on_the_block(
    scene: Scene, west: int, north: int, pad: int
) -> None:
    _, terrain, canopy = wood(SIDE)
    whole = made(scene, spec_of(SIDE, west, north), terrain, canopy)
    wider = spec_of(SIDE + pad, west - pad, north + pad)
    more = [np.full((SIDE + pad,) * 2, NODATA, np.float32) for _ in range(2)]
    for values, own in zip(more, (terrain, canopy), strict=True):
        values[pad:, pad:] = own
    assert np.array_equal(made(scene, wider, *more)[pad:, pad:], whole)
