"""The map of the density, from a few successive points of a file: held against clouds whose density is known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tiler.inputs import DensityPatch
from tiler.inputs.extent import find_patches, local_density
from tiler.plan.sizes import DensityMap, covered_m2

Array = np.ndarray[Any, Any]


def runs_of(cloud: Array, places: int = 16, length: int = 2048) -> list[Array]:
    """Successive points at even distances, as the reader of a file takes them."""
    starts = [(cloud.shape[1] - length) * i // (places - 1) for i in range(places)]
    return [cloud[:, s : s + length] for s in starts]


def patches_of(cloud: Array) -> tuple[DensityPatch, ...]:
    bounds = [*cloud.min(axis=1).tolist(), *cloud.max(axis=1).tolist()]
    return find_patches(runs_of(cloud), cloud.shape[1], bounds)


def map_of(cloud: Array) -> DensityMap:
    return DensityMap(patches_of(cloud), 1.0)


def square(density: float, side: float, seed: int = 0) -> Array:
    return np.random.default_rng(seed).uniform(0, side, (2, int(density * side**2)))


def in_tiles(cloud: Array, side: float) -> Array:
    """Sorted by place: the order of many deliveries."""
    cells = np.floor(cloud / side)
    return cloud[:, np.lexsort((cells[0], cells[1]))]


def in_lines(cloud: Array) -> Array:
    """In scan lines, 1 m wide."""
    return cloud[:, np.lexsort((cloud[0], np.floor(cloud[1])))]


@pytest.mark.parametrize("order", [lambda c: c, lambda c: in_tiles(c, 20.0), in_lines])
def test_an_even_cloud_is_even_in_any_order(order: Any) -> None:
    density_map = map_of(order(square(4.0, 300.0)))
    assert 0.5 < density_map.max_points(64) / (4.0 * 64**2) < 2.2, "patches may overlap"
    assert density_map.max_points(200) == pytest.approx(4.0 * 200**2, rel=0.5)
    assert density_map.max_points(1000) == pytest.approx(4.0 * 300**2)


def test_a_diagonal_strip_is_not_thinned_out_over_its_bounds() -> None:
    random = np.random.default_rng(1)  # a strip of 2000 x 100 m at 4 per m2
    along, across = np.sort(random.uniform(0, 2000, 800_000)), random.uniform(0, 100, 800_000)
    strip = np.stack([along - across, along + across]) / np.sqrt(2)
    density_map = map_of(strip)
    mean = 800_000 / np.prod(np.ptp(strip, axis=1))
    assert mean < 0.5
    assert 1.0 < density_map.max_points(100) / 100**2 < 8.0


def test_strips_that_cross_add_up() -> None:
    patches = [DensityPatch(0, 0, 1000, 1000, 1e6)] * 20 + [
        DensityPatch(5000, 0, 6000, 1000, 1e6)
    ]
    density_map = DensityMap(patches, 1.0)
    assert density_map.max_points(100) == pytest.approx(20 * 100**2, rel=0.05)
    assert density_map.max_points(10) == pytest.approx(20 * 10**2, rel=0.05)
    half_metres = DensityMap(patches, 0.5)
    assert half_metres.max_points(50) == pytest.approx(20 * 100**2, rel=0.05)


def test_a_map_of_a_country_stays_small() -> None:
    patches = [
        DensityPatch(x, y, x + 5e4, y + 5e4, 1e10) for x in (0, 5e4) for y in (0, 5e4, 1e5)
    ]
    density_map = DensityMap(patches, 1.0)
    assert density_map.max_points(512) == pytest.approx(4 * 512**2, rel=0.05)


@pytest.mark.parametrize(
    "points", [np.zeros((2, 1)), np.zeros((2, 500)), np.stack([np.arange(9.0), np.zeros(9)])]
)
def test_points_on_a_spot_or_a_line(points: Array) -> None:
    assert local_density(points) > 0
    (patch,) = find_patches([points], points.shape[1], [0, 0, 10, 10])
    assert patch.points == points.shape[1]
    assert 0 <= patch.x0 <= patch.x1 <= 10
    assert DensityMap([patch], 1.0).max_points(64) == pytest.approx(points.shape[1])


def test_without_points_nothing_is_dense() -> None:
    assert find_patches([], 0, [0, 0, 0, 0]) == ()
    assert DensityMap([], 1.0).max_points(100) == 0
    outside = np.full((2, 5), 99.0)
    assert find_patches([outside], 7, [0, 0, 10, 10]) == (DensityPatch(0, 0, 10, 10, 7),)


def test_a_long_line_has_few_cells() -> None:
    """In kilometres: 16 million cells of 64 m along it, next to no area."""
    density_map = DensityMap([DensityPatch(0.0, 0.0, 1e6, 1.0, 1000.0)], 1000.0)
    assert 900 < density_map.max_points(1e9) < 1001


def box_of(cloud: Array) -> tuple[float, ...]:
    (x0, y0), (x1, y1) = cloud.min(axis=1).tolist(), cloud.max(axis=1).tolist()
    return x0, y0, 0.0, x1, y1, 0.0


def test_voids_between_islands_are_no_part_of_the_density() -> None:
    island = in_tiles(square(2.0, 300.0), 25.0)
    cloud = np.concatenate([island, island + 50_000.0, [[90_000.0], [10.0]]], axis=1)
    notes: list[str] = []
    covered = covered_m2([box_of(cloud)], cloud.shape[1], map_of(cloud), 1.0, notes)
    assert 0.8 < cloud.shape[1] / covered < 4.0
    assert len(notes) == 1
    assert "mostly void" in notes[0]


@pytest.mark.parametrize("density", [0.3, 6.0])
@pytest.mark.parametrize(
    "order", [lambda cloud: cloud, in_lines, lambda cloud: in_tiles(cloud, 25.0)]
)
@pytest.mark.parametrize("files", [1, 9])
def test_every_place_counts_once_where_files_are_full(
    density: float, order: Callable[[Array], Array], files: int
) -> None:
    """However many of them lie on each other."""
    cloud = order(square(density, 300.0))
    notes: list[str] = []
    density_map = DensityMap(files * patches_of(cloud), 1.0)
    found = covered_m2(files * [box_of(cloud)], files * cloud.shape[1], density_map, 1.0, notes)
    assert found == pytest.approx(300.0**2, rel=0.01)
    assert notes == []


def test_bounds_that_overlap_in_part() -> None:
    boxes = [
        (0.0, 0.0, 0.0, 10.0, 10.0, 1.0),
        (5.0, 5.0, 0.0, 15.0, 15.0, 1.0),
        (40.0, 0.0, 0.0, 40.0, 0.0, 1.0),
    ]
    assert covered_m2(boxes, 5, DensityMap([], 1.0), 2.0, []) == pytest.approx(4 * (175 + 1))


@pytest.mark.parametrize("files", [1, 5])
def test_a_random_order_shows_where_nothing_is(files: int) -> None:
    """A band of a tenth of the bounds, as one file or as random subsets."""
    cloud = square(2.0, 640.0)
    cloud = cloud[:, np.abs(cloud[0] - cloud[1]) < 45]
    parts = [cloud[:, number::files] for number in range(files)]
    density_map = DensityMap([patch for part in parts for patch in patches_of(part)], 1.0)
    assert density_map.max_points(2000) == pytest.approx(cloud.shape[1])
    covered = covered_m2([box_of(part) for part in parts], cloud.shape[1], density_map, 1.0, [])
    assert covered < 0.35 * 640**2
    assert len(patches_of(parts[0])) < 100
