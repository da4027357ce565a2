"""Places of a run are judged by the true terrain, and the chances of a scene come from the others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine
from pyogrio import raw

from tests.benchmarks.places import (
    Judged,
    TrueScene,
    in_gaps,
    judged,
    left_out,
    ranges,
    text_of,
    true_scenes,
)
from tests.benchmarks.scorecard_scenes import Cloud
from tests.benchmarks.sigma_scenes import CORNER
from tiler.core.chances import LEAST_PLACES, Counts, chance_from
from tiler.simulate import SCENES

SIDE = 40
SCENE = TrueScene("flat", "flat", "als", lambda: Cloud(np.empty((0, 3)), np.empty(0, np.uint8)))


def place(family: str, wrong: bool, known: bool = True) -> Judged:
    return Judged(family, family, "lidar", "shed", 9.0, None, known, wrong, 0.0, None)


def step(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Flat land with a wall at x = 20, unknown in the north."""
    return np.where(y > 30, np.nan, np.where(x < 20, 10.0, 15.0))


def test_places_are_wrong_where_the_terrain_is_off_or_missing(tmp_path: Path) -> None:
    y, x = np.indices((SIDE, SIDE)) + 0.5
    heights = np.where(x < 21, 10.0, 15.0)  # The wall is moved by a pixel.
    from_south = SIDE - y
    heights[(abs(x - 5) < 3) & (abs(from_south - 5) < 3)] += 2.0
    heights[(abs(x - 30) < 3) & (abs(from_south - 5) < 3)] = -9999.0
    profile = {"dtype": "float32", "count": 1, "nodata": -9999.0, "height": SIDE, "width": SIDE}
    corner = Affine(1, 0, CORNER[0], 0, -1, CORNER[1] + SIDE)
    with rasterio.open(tmp_path / "dtm.tif", "w", transform=corner, **profile) as raster:
        raster.write(heights.astype(np.float32), 1)
    boxes = {
        "raised": (2, 2, 8, 8),
        "small, raised": (4, 4, 4.4, 4.4),
        "mostly right": (2, 6, 30, 30),
        "hole": (28, 2, 32, 8),
        "wall": (18, 10, 23, 25),
        "unknown": (2, 32, 8, 38),
    }
    shapes = [shapely.affinity.translate(shapely.box(*box), *CORNER) for box in boxes.values()]
    columns = [np.array(list(boxes), object), np.full(len(boxes), np.nan)]
    raw.write(
        tmp_path / "review.gpkg", shapely.to_wkb(shapes), columns, ["reason", "stake_m"],
        layer="review", geometry_type="Polygon", crs="EPSG:25832",
    )  # fmt: skip
    found = {place.reason: place for place in judged(SCENE, tmp_path, step)}
    assert {name for name, place in found.items() if place.wrong} == {
        "raised", "small, raised", "hole",
    }  # fmt: skip
    assert [name for name, place in found.items() if not place.known] == ["unknown"]
    assert found["raised"].share == pytest.approx(1.0)
    assert found["raised"].error_m == pytest.approx(2.0)
    assert found["hole"].error_m is None


def test_a_range_is_that_of_the_neighbours() -> None:
    heights = np.array([[1.0, 2.0, 9.0], [4.0, np.nan, 6.0]])
    low, high = ranges(heights)
    assert np.array_equal(low, [[1, 1, 2], [1, np.nan, 2]], equal_nan=True)
    assert np.array_equal(high, [[4, 9, 9], [4, np.nan, 9]], equal_nan=True)


def test_gaps_take_part_of_a_scene() -> None:
    x, y = np.meshgrid(np.arange(0.5, 200), np.arange(0.5, 100))
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    share = np.mean([in_gaps(points, np.random.default_rng(seed)).mean() for seed in range(20)])
    assert 0.03 < share < 0.3


def test_a_scene_is_not_judged_by_itself() -> None:
    wrong = [place("a", True)] * LEAST_PLACES
    right = [place("b", False)] * LEAST_PLACES
    low, high = (chance_from([Counts(LEAST_PLACES, n)], 0) for n in (0, LEAST_PLACES))
    assert left_out([*wrong, *right, place("c", True, known=False)]) == (
        [(low, True)] * LEAST_PLACES + [(high, False)] * LEAST_PLACES
    )
    assert left_out(wrong) == []


def test_the_tables_have_the_reasons_and_the_shares() -> None:
    places = [place(str(i % 3), i % 10 != 0) for i in range(30)]
    text = text_of(places)
    assert "| shed | lidar |  | 3 | 30 | 27 | - |" in text
    assert "| 80 to 100 % | 30 | 90 |" in text


def test_the_scenes_of_the_simulator_come_with_each_seed(tmp_path: Path) -> None:
    scenes = list(true_scenes(tmp_path, 2))
    assert len(scenes) == len({scene.name for scene in scenes}) == 2 * len(SCENES)
    assert {scene.family for scene in scenes} == set(SCENES)
