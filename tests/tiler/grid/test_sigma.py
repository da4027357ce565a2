"""The standard error of heights: what theory says of planes with noise, the same for any blocks, wider in gaps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from tests.tiler.grid.conftest import FINAL, Scene, make_block
from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.products import CANOPY, EDGES_M, GROUPS, MEASURED, Read
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.core.results import SigmaGroup
from tiler.core.units import FOOT, METRE, Units
from tiler.grid.block_surroundings import PointsNear
from tiler.grid.coarse import padded
from tiler.grid.sigma import (
    LASER,
    MATCHED,
    WEIGHTS,
    Measures,
    land_margin,
    measures_of,
    sigma_result,
    standard_error_m,
)
from tiler.grid.sigma import sigma as of_heights
from tiler.store import read_cells

PIXEL = Fraction(1000)
SIDE = 60_000
CAP = Fraction(50_000)


def plane(
    n: int, noise: float = 0.0, slope: float = 0.2, side: int = SIDE, seed: int = 1
) -> np.ndarray:
    """Points on a plane with noise (counts), int64 (n, 3)."""
    random = np.random.default_rng(seed)
    x, y = random.integers(0, side, (2, n))
    z = 100_000 + slope * x + random.normal(0, noise, n) if noise else 100_000 + slope * x
    return np.column_stack((x, y, np.rint(z))).astype(np.int64)


def gridded(scene: Scene, size: Fraction = PIXEL) -> RasterSpec:
    """Terrain and mask (all measured) of a scene in its store."""
    spec = scene.grid_into_store("dtm", size)
    scene.store.create_raster("mask", spec, MEASURED)
    scene.store.create_raster("sigma", spec)
    return spec


def sigma_block(
    scene: Scene, spec: RasterSpec, block: Block, kind: str | None = LASER, **more: Read
) -> Mapping[str, Any]:
    """Make a block of the raster ``sigma``, and return its counts."""
    margin = margin_of(scene, spec)
    terrain = Read("raster:dtm", margin)
    reads = {"points": Read("points"), "terrain": terrain, "mask": Read("raster:mask"), **more}
    values = {"kind": kind, "cap": CAP, "margin": margin}
    return make_block(scene.store, "sigma", of_heights, reads, spec, block, NODATA, **values)


def margin_of(scene: Scene, spec: RasterSpec) -> int:
    return land_margin(float(spec.lattice.size * scene.store.meta.frame.metres_xy))


def measured(scene: Scene, spec: RasterSpec, block: Block) -> Measures:
    """Return the measures of a block of the raster ``dtm``."""
    margin = margin_of(scene, spec)
    values = read_cells(scene.store, "dtm", spec, padded(block, margin), NODATA)
    heights = np.where(values == NODATA, np.nan, values.astype(np.float64))
    return measures_of(PointsNear(scene.store, FINAL, spec, block), heights, margin, CAP)


def sigma(
    scene: Scene, size: Fraction = PIXEL, kind: str | None = LASER
) -> tuple[np.ndarray, list[Mapping[str, Any]]]:
    """Sigma of the whole raster, NaN without a height, and the counts of the blocks."""
    spec = gridded(scene, size)
    records = [sigma_block(scene, spec, b, kind) for b in spec.blocks(512)]
    found = scene.store.read_block("sigma", Block(0, 0, spec.height, spec.width)).astype(
        np.float64
    )
    return np.where(found == NODATA, np.nan, found), records


@pytest.mark.parametrize("noise_m", [0.05, 0.15, 0.4])
@pytest.mark.parametrize("density", [1.0, 6.0])
def test_a_plane_with_noise_is_as_uncertain_as_theory_says(
    make_scene, noise_m: float, density: float
) -> None:
    """Linear between three points with noise s: at a random place the variance is s2 / 2."""
    n = int(density * (SIDE / 1000) ** 2)
    scene = make_scene(plane(n, 1000 * noise_m))
    found, _ = sigma(scene)
    inner = (slice(5, -5),) * 2
    theory = noise_m / np.sqrt(2)
    true = heights_of(scene) - (100 + 0.2 * (np.arange(SIDE // 1000) + 0.5))
    assert np.sqrt(np.nanmean(true[inner] ** 2)) == pytest.approx(theory, rel=0.15)
    assert np.sqrt(np.nanmean(found[inner] ** 2)) == pytest.approx(theory, rel=0.5)


def heights_of(scene: Scene) -> np.ndarray:
    found = scene.store.read_block("dtm", Block(0, 0, SIDE // 1000, SIDE // 1000)).astype(
        np.float64
    )
    return np.where(found == NODATA, np.nan, found)


def test_more_noise_and_wider_gaps_are_more_uncertain(make_scene) -> None:
    quiet, loud = (
        np.nanmean(sigma(make_scene(plane(8000, noise)))[0]) for noise in (30.0, 200.0)
    )
    assert loud > 2 * quiet
    xyz = plane(8000, 30.0)
    gap = np.hypot(*(xyz[:, :2] - 30_000).T) < 15_000
    holed, _ = sigma(make_scene(xyz[~gap]))
    assert holed[30, 30] > 3 * holed[5, 30]


def test_far_from_ground_only_crowns_that_give_a_height_make_it_surer(make_scene) -> None:
    xyz = plane(8000, 30.0)
    scene = make_scene(xyz[np.hypot(*(xyz[:, :2] - 30_000).T) > 25_000])
    spec = gridded(scene)
    block = Block(0, 0, spec.height, spec.width)
    crowns = np.full((spec.height, spec.width), NODATA, np.float32)
    crowns[:, 30:] = 100.0
    scene.store.create_raster("below", spec, NODATA)
    scene.store.write_block("below", block, crowns)
    found = []
    for more in ({}, {"below": Read("raster:below")}):
        sigma_block(scene, spec, block, MATCHED, **more)
        found.append(scene.store.read_block("sigma", block))
    usual, surer = found
    assert np.array_equal(surer[:, :30], usual[:, :30])
    assert surer[30, 30] < 0.9 * usual[30, 30]  # 25 m from ground
    assert np.array_equal(surer[30, 50:], usual[30, 50:])  # ground is near


@pytest.mark.parametrize("kind", [LASER, MATCHED])
def test_each_term_only_adds(kind: str) -> None:
    base = Measures(*(np.full((1, 1), v) for v in (0.1, 1.0, 0.2, 0.1, 0.2, 0.2)))
    mask = np.full((1, 1), MEASURED, np.float32)
    usual = standard_error_m(base, mask, kind)[0, 0]
    for name in Measures._fields:
        more = base._replace(**{name: 2 * getattr(base, name)})
        assert standard_error_m(more, mask, kind)[0, 0] >= usual, name
    assert standard_error_m(base, np.full_like(mask, CANOPY), kind)[0, 0] >= usual


def test_a_cloud_of_unknown_origin_has_the_larger_error() -> None:
    random = np.random.default_rng(4)
    found = Measures(*random.random((6, 20, 20)))
    mask = np.full((20, 20), MEASURED, np.float32)
    unknown = standard_error_m(found, mask, None)
    known = [standard_error_m(found, mask, kind) for kind in WEIGHTS]
    assert np.array_equal(unknown, np.maximum(*known))


def scattered_town(seed: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Ground with noise and a gap, objects on it, and low noise: points and labels."""
    ground = plane(6000, 80.0, seed=seed)
    ground = ground[np.hypot(*(ground[:, :2] - (20_000, 40_000)).T) > 9_000]
    things = plane(9000, 2000.0, seed=seed + 1)
    things = things[(things[:, 0] > 35_000) & (things[:, 1] < 30_000)] + (0, 0, 6_000)
    low = plane(40, seed=seed + 2) - (0, 0, 20_000)
    labels = np.repeat(np.uint8([2, 1, 7]), [len(ground), len(things), len(low)])
    return np.concatenate((ground, things, low)), labels


def test_measures_are_what_they_say(make_scene) -> None:
    """Against searches of the points themselves, at some pixels."""
    xyz, labels = scattered_town()
    scene = make_scene(xyz, labels)
    spec = gridded(scene)
    block = Block(0, 0, spec.height, spec.width)
    found = measured(scene, spec, block)
    ground, things = xyz[labels == 2] / 1000, xyz[labels == 1] / 1000
    tree = KDTree(ground[:, :2])
    for row, col in ((30, 30), (20, 20), (50, 45), (12, 50), (45, 12)):
        x, y = col + 0.5, spec.height - row - 0.5
        assert found.distance[row, col] == pytest.approx(tree.query((x, y))[0], abs=2e-3)
        inside = [np.abs(p[:, :2] - (x, y)).max(axis=1) for p in (ground, things)]
        for half, name in ((3.5, "near_objects"), (10.5, "around_objects")):
            n_ground, n_things = (int((away < half).sum()) for away in inside)
            expected = n_things / max(n_ground + n_things, 1)
            assert getattr(found, name)[row, col] == pytest.approx(expected, abs=0.01)
        half = next(h for h in (2.5, 5.5, 10.5, 20.5) if (inside[0] < h).sum() >= 6)
        near = ground[inside[0] < half]
        design = np.column_stack((near[:, :2] - (x, y), np.ones(len(near))))
        rest = near[:, 2] - design @ np.linalg.lstsq(design, near[:, 2], rcond=None)[0]
        assert found.roughness[row, col] == pytest.approx(
            np.sqrt((rest**2).sum() / (len(near) - 3)), rel=1e-3
        )
    assert found.slope[30, 30] == pytest.approx(0.2, abs=0.03)


def test_a_plane_without_noise_has_its_slope_and_no_deviation(make_scene) -> None:
    scene = make_scene(plane(8000))
    spec = gridded(scene, Fraction(700))
    block = Block(10, 10, spec.height - 20, spec.width - 20)
    found = measured(scene, spec, block)
    assert found.slope == pytest.approx(0.2, abs=2e-3)
    inner = (slice(5, -5),) * 2
    assert found.off_trend[inner].max() < 0.01
    assert found.roughness.max() < 1e-3


@pytest.mark.parametrize("size", [Fraction(300), Fraction(1000), Fraction(2500)])
def test_blocks_do_not_show(make_scene, size: Fraction) -> None:
    xyz, labels = scattered_town()
    scene = make_scene(xyz, labels)
    spec = gridded(scene, size)
    whole = measured(scene, spec, Block(0, 0, spec.height, spec.width))
    for b in (
        Block(3, 5, 9, 11),
        Block(spec.height - 8, 0, 8, spec.width),
        Block(7, spec.width - 3, 13, 3),
    ):
        part = measured(scene, spec, b)
        for name in Measures._fields:
            mine = getattr(whole, name)[b.row : b.row + b.height, b.col : b.col + b.width]
            assert mine.tobytes() == getattr(part, name).tobytes(), name


def test_neither_the_order_of_points_nor_the_frame_matters(make_scene) -> None:
    xyz, labels = scattered_town()
    order = np.random.default_rng(3).permutation(len(xyz))
    frame = CoordFrame(origin=(12_345, -6_789))
    found = [
        sigma(make_scene(xyz, labels))[0],
        sigma(make_scene(xyz[order], labels[order], bucket=13_000))[0],
        sigma(make_scene(xyz, labels, frame=frame))[0],
    ]
    assert found[0].tobytes() == found[1].tobytes() == found[2].tobytes()


def test_sigma_is_where_the_terrain_is_and_adds_up(make_scene) -> None:
    xyz, labels = scattered_town()
    scene = make_scene(xyz, labels)
    found, records = sigma(scene)
    assert np.array_equal(np.isnan(found), np.isnan(heights_of(scene)))
    result = sigma_result(LASER, records)
    groups = [getattr(result, name) for name in GROUPS]
    pixels = sum(group.pixels for group in groups)
    assert pixels == np.isfinite(found).sum() == sum(sum(group.histogram) for group in groups)
    squares = sum(group.pixels * (group.rmse_m or 0) ** 2 for group in groups)
    assert np.sqrt(squares / pixels) == pytest.approx(np.sqrt(np.nanmean(found**2)), rel=1e-3)
    assert result.covered.rmse_m > result.open.rmse_m
    assert result.water == SigmaGroup(0, None, [0] * (len(EDGES_M) - 1))


def test_heights_in_feet_have_errors_in_feet(make_scene) -> None:
    """The same points, once with heights in metres and once in feet."""
    xyz = plane(6000, 100.0)
    metres, _ = sigma(make_scene(xyz))
    frame = replace(CoordFrame(), units=Units(METRE, FOOT))
    feet = xyz * (1, 1, 1 / 0.3048)
    found, _ = sigma(make_scene(np.rint(feet).astype(np.int64), frame=frame))
    assert found * 0.3048 == pytest.approx(metres, rel=0.01, nan_ok=True)


def test_few_points_and_none_are_no_error(make_scene) -> None:
    scene = make_scene(np.int64([[500, 500, 0], [9_500, 700, 100], [4_000, 9_000, 50]]))
    found, (record,) = sigma(scene)
    assert record["filled"] == np.isfinite(found).sum() > 20
    assert (found[np.isfinite(found)] > 0).all()
    spec = RasterSpec.covering(Lattice(PIXEL), scene.data)
    taller = replace(spec, height=spec.height + 1)
    for name in ("dtm", "mask", "sigma"):
        scene.store.create_raster(name, taller)
    record = sigma_block(scene, taller, Block(0, 0, taller.height, taller.width))
    assert record["filled"] == 0
