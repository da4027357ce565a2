"""Objects left in the terrain: boxes are found wherever they stand, and land forms are not."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation

from tests.tiler.grid.conftest import Scene, make_block
from tiler.core.products import Read
from tiler.core.raster import NODATA, RasterSpec
from tiler.grid.left_objects import left_margin, left_objects
from tiler.grid.object_candidates import candidates, chances, chosen, measures_of
from tiler.grid.sigma import LASER, MATCHED

SIDE = 160
ROWS, COLUMNS = np.indices((SIDE, SIDE)).astype(float)


def found_in(heights: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Return the cells of the places in a terrain of cells of 1 m with two ground points, or two objects if hidden."""
    found, levels = candidates(heights, 1.0)
    ground, objects = np.where(hidden, 0, 2), np.where(hidden, 2, 0)
    chance = chances(measures_of(found, levels, ground, objects, 1.0))
    cells = np.zeros(heights.shape, np.bool_)
    for _, inside, part in chosen(found, levels, chance):
        cells[part] |= inside
    return cells


def box(row: float, column: float, length: float, width: float, degrees: float) -> np.ndarray:
    """Return the cells of a rectangle with its middle at a row and column."""
    turn = np.deg2rad(degrees)
    down, right = ROWS - row, COLUMNS - column
    along = down * np.cos(turn) + right * np.sin(turn)
    across = right * np.cos(turn) - down * np.sin(turn)
    cells: np.ndarray = (abs(along) <= length / 2) & (abs(across) <= width / 2)
    return cells


@settings(max_examples=30, deadline=None)
@given(
    row=st.floats(60, 100),
    column=st.floats(60, 100),
    degrees=st.floats(0, 180),
    length=st.floats(8, 25),
    height=st.floats(2.5, 9),
    slope=st.floats(0, 0.15),
)
def test_a_box_on_a_slope_is_found_with_its_outline(
    row: float, column: float, degrees: float, length: float, height: float, slope: float
) -> None:
    house = box(row, column, length, 0.7 * length, degrees)
    hidden = house & (np.random.default_rng(1).random(house.shape) < 0.8)
    cells = found_in(100 + slope * ROWS + height * house, hidden)
    assert np.count_nonzero(cells & house) >= 0.9 * np.count_nonzero(house)
    assert np.count_nonzero(cells & ~house) <= 0.1 * np.count_nonzero(house)


def slope_up(distance: np.ndarray, height: float, width: float) -> np.ndarray:
    """Return heights that fall from ``height`` to 0 within ``width`` beyond a distance of 0."""
    return height * np.clip(1 - distance / width, 0, 1)


LAND_FORMS = {
    "plane": 0.3 * ROWS,
    "hill": 12 * np.exp(-((ROWS - 80) ** 2 + (COLUMNS - 80) ** 2) / (2 * 18**2)),
    "mound": slope_up(np.hypot(ROWS - 80, COLUMNS - 80) - 6, 5, 10),
    "dam": slope_up(abs(ROWS - 80) - 3, 5, 8),
    "dam that ends": slope_up(np.maximum(abs(ROWS - 80) - 3, abs(COLUMNS - 80) - 40), 5, 8),
    "terraces": 2.4 * np.floor(ROWS / 13),
    "bank": slope_up(80 - ROWS, 6, 4),
    "stepped quarry": -4
    * np.floor(np.clip(60 - np.hypot(ROWS - 80, COLUMNS - 80), 0, None) / 12),
    "waves": 1.5 * np.sin(ROWS / 6) * np.sin(COLUMNS / 7),
}


@pytest.mark.parametrize("name", LAND_FORMS)
def test_land_forms_are_no_objects(name: str) -> None:
    noise = np.random.default_rng(1).normal(0, 0.03, (SIDE, SIDE))
    bushes = np.random.default_rng(2).random((SIDE, SIDE)) < 0.2
    assert not found_in(100 + LAND_FORMS[name] + noise, bushes).any()


def town(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return a sloping terrain with boxes, and the cells in which the ground is not seen."""
    heights, hidden = 100 + 0.05 * ROWS, np.zeros((SIDE, SIDE), np.bool_)
    for _ in range(12):
        row, column = rng.uniform(10, SIDE - 10, 2)
        house = box(row, column, *rng.uniform(5, 20, 2), rng.uniform(0, 180))
        heights = np.where(house, 100 + 0.05 * row + rng.uniform(1, 6), heights)
        hidden |= house & (rng.random(house.shape) < 0.8)
    return heights, hidden


def scanned(make_scene, heights: np.ndarray, hidden: np.ndarray) -> Scene:
    """Return a scene with two points in each cell, which are ground unless the cell is hidden."""
    x, y = COLUMNS.ravel() * 1000, (SIDE - 1 - ROWS.ravel()) * 1000
    z, labels = heights.ravel() * 1000, np.where(hidden, 1, 2).ravel().astype(np.uint8)
    pulses = [np.stack((x + dx, y + 500, z), axis=1) for dx in (250, 750)]
    return make_scene(np.concatenate(pulses).astype(np.int64), np.tile(labels, 2))


def test_the_outline_is_wider_than_the_place(make_scene) -> None:
    """An edit also takes the points beside the place, which would span it again."""
    house = box(80, 80, 16, 10, 0)
    hidden = house & ((ROWS + COLUMNS) % 5 > 0)
    scene = scanned(make_scene, 100.0 + 4 * house, hidden)
    (place,) = places(scene, scene.grid_into_store("dtm", Fraction(1000)), 10_000)
    outline = np.zeros(house.shape, np.bool_)
    for top, left, bottom, right in place["rectangles"]:
        outline[top : bottom + 1, left : right + 1] = True
    assert np.array_equal(outline, binary_dilation(outline & house, np.ones((3, 3)), 2))
    assert place["pixels"] == np.count_nonzero(outline & house)
    assert place["pixels"] >= 0.9 * np.count_nonzero(house)


@pytest.mark.parametrize("resolution", [500, 1000])
@pytest.mark.parametrize("size", [37, 64])
def test_places_do_not_depend_on_blocks(make_scene, resolution: int, size: int) -> None:
    scene = scanned(make_scene, *town(np.random.default_rng(5)))
    spec = scene.grid_into_store("dtm", Fraction(resolution))
    whole, parts = places(scene, spec, 10_000), places(scene, spec, size)
    assert whole
    assert parts == whole
    assert not blocks_of(scene, spec, 10_000, "objects", MATCHED)


def places(scene: Scene, spec: RasterSpec, size: int) -> list[dict]:
    """Return the objects in all blocks of a size."""
    return blocks_of(scene, spec, size, "objects")


def blocks_of(
    scene: Scene, spec: RasterSpec, size: int, places: str, kind: str = LASER
) -> list[dict]:
    """Return the places in all blocks of a size, ``objects`` or ``unsure``. ``kind`` is that of the cloud."""
    margin = left_margin(float(spec.lattice.size * scene.store.meta.frame.metres_xy))
    reads = {
        "points": Read("points"),
        "terrain": Read("raster:dtm", margin),
    }
    found = []
    for block in spec.blocks(size):
        counts = make_block(
            scene.store,
            "dtm-left",
            left_objects,
            reads,
            spec,
            block,
            NODATA,
            margin=margin,
            kind=kind,
        )
        found += counts[places]
    return sorted(found, key=lambda place: place["rectangles"])
