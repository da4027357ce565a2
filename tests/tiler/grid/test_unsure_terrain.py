"""Unsure terrain: rough places far from ground are found, and rough ground that is seen is not."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest

from tests.tiler.grid.conftest import Scene
from tests.tiler.grid.test_left_objects import blocks_of
from tiler.core.raster import Block
from tiler.core.units import METRE, Units
from tiler.grid.object_candidates import MOST_CHANCE, near_cells
from tiler.grid.tasks.left_objects import report_left_objects, report_unsure
from tiler.grid.unsure_terrain import (
    RIM_CELLS,
    SEARCHES,
    Place,
    shape_of,
    square_cells,
    unsure_places,
)

SIDE = 200
ROWS, COLUMNS = np.indices((SIDE, SIDE)).astype(float)


def rough(rng: np.random.Generator, height_m: float) -> np.ndarray:
    """Return a slope with facets of 4 m that rise by up to a height."""
    corners = rng.uniform(0, height_m, (SIDE // 4 + 2, SIDE // 4 + 2))
    row, column = (ROWS // 4).astype(int), (COLUMNS // 4).astype(int)
    u, v = ROWS % 4 / 4, COLUMNS % 4 / 4
    upper = corners[row, column] * (1 - v) + corners[row, column + 1] * v
    lower = corners[row + 1, column] * (1 - v) + corners[row + 1, column + 1] * v
    heights: np.ndarray = 100 + 0.1 * ROWS + upper * (1 - u) + lower * u
    return heights


def patch(row: float, column: float, radius: float) -> np.ndarray:
    """Return the cells of a disc."""
    cells: np.ndarray = np.hypot(ROWS - row, COLUMNS - column) <= radius
    return cells


def seen_at(hidden: np.ndarray) -> np.ndarray:
    """Return the cells with ground points: all that are not hidden, and the corners of facets."""
    seen: np.ndarray = ~hidden | ((ROWS % 4 == 0) & (COLUMNS % 4 == 0) & (ROWS % 8 == 0))
    return seen


def land(where: np.ndarray, height_m: float) -> np.ndarray:
    """Return a slope that is rough in some cells."""
    return np.where(where, rough(np.random.default_rng(3), height_m), 100 + 0.1 * ROWS)


@pytest.mark.parametrize("kind", SEARCHES)
@pytest.mark.parametrize("cell_m", [0.8, 1.0, 1.4])
def test_rough_land_far_from_ground_is_found_there(kind: str, cell_m: float) -> None:
    rough_land = patch(100, 100, 14)
    places = found(land(rough_land, 5.0), seen_at(rough_land), cell_m, kind)
    cells = np.zeros(rough_land.shape, np.bool_)
    for place in places:
        cells[place.box] |= place.cells
        assert max(place.cells.shape) <= square_cells(cell_m)
        assert SEARCHES[kind].least_chance <= place.told["chance"] <= MOST_CHANCE
    assert np.count_nonzero(cells & rough_land) >= 0.3 * np.count_nonzero(rough_land)
    assert not (cells & ~patch(100, 100, 17)).any()


@pytest.mark.parametrize("kind", SEARCHES)
def test_rough_land_with_ground_points_is_not_unsure(kind: str) -> None:
    everywhere = np.ones(ROWS.shape, np.bool_)
    assert not found(land(everywhere, 5.0), everywhere, 1.0, kind)


@pytest.mark.parametrize("kind", SEARCHES)
def test_smooth_land_without_ground_points_is_not_unsure(kind: str) -> None:
    hidden = patch(100, 100, 30)
    assert not found(100 + 0.4 * ROWS + 0.2 * COLUMNS, ~hidden, 1.0, kind)


@pytest.mark.parametrize("kind", SEARCHES)
def test_sparse_clouds_are_not_judged(kind: str) -> None:
    rough_land = patch(100, 100, 14)
    heights, seen = land(rough_land, 5.0), seen_at(rough_land)
    assert found(heights, seen, 1.0, kind, 3)
    assert not found(heights, seen, 1.0, kind, 1)


def found(
    heights: np.ndarray, seen: np.ndarray, cell_m: float, kind: str, n: int = 6
) -> list[Place]:
    """Return the places in cells with ``n`` ground points each where the ground is seen, else with ``n`` objects."""
    return unsure_places(shape_of(heights, cell_m), n * seen, n * ~seen, cell_m, SEARCHES[kind])


def test_a_place_is_not_listed_where_an_object_is(
    make_scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Objects cover half of the first place, less of the second one, and none of the third one."""
    spec = make_scene(np.zeros((1, 3), np.int64), np.array([2], np.uint8)).grid_into_store(
        "dtm", Fraction(1000)
    )
    told = {"chance": 0.8, "error_m": 1.0, "gap_m": 2.0, "tilt": 0.1, "objects": 0.5}
    places = [
        {**told, "pixels": 60, "rectangles": [[row, 10, row + 5, 19]]} for row in (10, 30, 50)
    ]
    objects = [
        {
            "chance": 0.7,
            "height_m": 2.0,
            "steep": 0.8,
            "ground": 1,
            "pixels": 1,
            "rectangles": r,
        }
        for r in ([[10, 0, 15, 11]], [[8, 12, 17, 14]], [[30, 16, 39, 30]])
    ]
    blocks = {
        Block(0, 0, 64, 64): {"objects": objects[1:], "unsure": places[:1]},
        Block(0, 64, 64, 64): {"objects": objects[:1], "unsure": places[1:]},
    }
    plan = SimpleNamespace(
        grid=SimpleNamespace(resolution=Fraction(1)),
        frame=SimpleNamespace(units=Units(METRE, METRE)),
    )
    notes: list[str] = []
    job = SimpleNamespace(plan=plan, results=SimpleNamespace(), note=notes.append)
    objects = report_left_objects(job, spec, blocks)
    report_unsure(job, spec, blocks, objects)
    norths = [place.bounds[3] for place in job.results.unsure]
    assert norths == [float(spec.north - row) for row in (30, 50)]
    assert notes[1] == "the terrain is unsure in 2 places, see review.gpkg"
    monkeypatch.setattr("tiler.grid.tasks.left_objects.MAX_LISTED", 1)
    report_unsure(job, spec, blocks, objects)
    assert [place.bounds[3] for place in job.results.unsure] == norths[:1]
    assert notes[2] == "the terrain is unsure in at least 1 place, see review.gpkg"


@pytest.mark.parametrize("cell_m", np.linspace(0.65, 2.0, 28))
def test_the_cells_near_a_block_decide_on_all_squares_that_touch_it(cell_m: float) -> None:
    assert near_cells(cell_m) >= square_cells(cell_m) - 1 + RIM_CELLS


@pytest.mark.parametrize("kind", SEARCHES)
@pytest.mark.parametrize("resolution", [500, 700, 1000])
@pytest.mark.parametrize("size", [37, 64])
def test_places_do_not_depend_on_blocks(
    make_scene, resolution: int, size: int, kind: str
) -> None:
    rough_land = patch(60, 70, 20) | patch(130, 120, 30)
    heights, seen = land(rough_land, 6.0), seen_at(rough_land)
    scene = scanned(make_scene, heights, seen)
    spec = scene.grid_into_store("dtm", Fraction(resolution))
    whole, parts = (blocks_of(scene, spec, n, "unsure", kind) for n in (10_000, size))
    assert whole
    assert parts == whole


def scanned(make_scene, heights: np.ndarray, seen: np.ndarray) -> Scene:
    """Return a scene with two points in each cell, which are ground where it is seen."""
    x, y = COLUMNS.ravel() * 1000, (SIDE - 1 - ROWS.ravel()) * 1000
    z, labels = heights.ravel() * 1000, np.where(seen, 2, 1).ravel().astype(np.uint8)
    pulses = [np.stack((x + dx, y + dy, z), axis=1) for dx in (250, 750) for dy in (250, 750)]
    return make_scene(np.concatenate(pulses).astype(np.int64), np.tile(labels, 4))
