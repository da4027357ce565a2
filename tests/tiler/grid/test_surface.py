"""The surface model and the distance to the ground: true by definition, and no block shows."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from tests.scenes.ground_points import islands, l_shape, scattered, void
from tests.tiler.grid.conftest import FINAL, Scene, make_block, sources_of
from tests.tiler.grid.test_above import REACH, SPIKE, above_block
from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.points import WITHHELD_FLAG
from tiler.core.products import SURVEYED, Read
from tiler.core.raster import NODATA, RasterSpec
from tiler.core.units import FOOT, METRE, Units
from tiler.grid.block_surroundings import PointsNear
from tiler.grid.derived import distance, raised_to, surface_heights
from tiler.grid.derived import surface as surface_of
from tiler.grid.records import Facets

PIXEL = Fraction(2000)


def facets(scene: Scene, halo: int = 0) -> Facets:
    return Facets(data=scene.data, max_edge=Fraction(50_000), halo=halo)


def dsm(
    scene: Scene,
    block: int = 512,
    terrain: float = NODATA,
    halo: int = 0,
    spike: Fraction = SPIKE,
) -> tuple[np.ndarray, list[Mapping[str, Any]]]:
    """Heights of the surface, NaN for none, and the counts of its blocks. Nowhere are places without returns."""
    spec = RasterSpec.covering(Lattice(PIXEL), scene.data)
    scene.store.create_raster("dtm", spec, fill=terrain)
    heights, records = np.full((spec.height, spec.width), np.nan, np.float32), []
    for b in spec.blocks(block):
        points = PointsNear(scene.store, FINAL, spec, b, "dtm")
        bare = np.zeros((b.height, b.width), bool)
        part, _, counts = surface_heights(points, bare, facets(scene, halo), REACH, spike)
        heights[b.row : b.row + b.height, b.col : b.col + b.width] = part
        records.append(counts)
    return heights, records


def pixels_of_points(scene: Scene, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    spec = RasterSpec.covering(Lattice(PIXEL), scene.data)
    return spec.north - 1 - xyz[:, 1] // 2000, xyz[:, 0] // 2000 - spec.west


def test_each_pixel_has_its_highest_return(make_scene) -> None:
    xyz = scattered(9_000, 120_000)
    scene = make_scene(xyz)
    heights, (record,) = dsm(scene)
    truth = np.full(heights.shape, -np.inf)
    np.maximum.at(truth, pixels_of_points(scene, xyz), xyz[:, 2] / 1000)
    measured = np.isfinite(truth)
    assert record["measured"] == measured.sum()
    assert np.array_equal(heights[measured], truth[measured].astype(np.float32))
    # A pixel without a return has a height between those of the others.
    gaps = ~measured & ~np.isnan(heights)
    assert gaps.sum() > 50
    assert heights[gaps].min() > truth[measured].min()


def test_spikes_noise_and_withheld_points_are_left_out(make_scene) -> None:
    xyz = scattered(20_000, 120_000)
    clean, _ = dsm(make_scene(xyz))
    _, rows = np.unique(xyz[:, :2] // 20_000, axis=0, return_index=True)  # no two side by side
    rows = rows[(xyz[rows, :2] % 20_000 < 14_000).all(axis=1)]
    extra = xyz[rows] + np.array([1, 1, 90_000])
    labels = np.full(len(xyz) + len(rows), 2, np.uint8)
    labels[len(xyz) :] = np.resize(np.uint8([1, 7, 18, 0x87, 2]), len(rows))
    flags = np.zeros(len(labels), np.uint8)
    flags[-1] = WITHHELD_FLAG
    scene = make_scene(np.concatenate((xyz, extra)), labels, flags)
    assert dsm(scene)[0].tobytes() == clean.tobytes()
    kept, _ = dsm(scene, spike=Fraction(100_000))
    higher = kept > clean + 50
    assert 0 < higher.sum() <= np.isin(labels[-len(rows) :], (1, 2)).sum()


@pytest.mark.parametrize("bucket", [5_000, 40_000, 1_000_000])
def test_a_group_above_any_structure_is_left_out(make_scene, bucket) -> None:
    """The points of a cloud or an aircraft support one another, like those of a tower, also where nothing else is."""
    xyz = scattered(20_000, 120_000)
    under = (abs(xyz[:, :2] - 60_000) < 10_000).all(axis=1)
    ground = xyz[~(abs(xyz[:, :2] - 60_000) < 7_000).all(axis=1)]
    labels = np.r_[np.full(len(ground), 2), np.ones(under.sum())].astype(np.uint8)

    def with_group(height_m: int) -> np.ndarray:
        group = xyz[under] + [1, 1, height_m * 1000]
        scene = make_scene(np.concatenate((ground, group)), labels, bucket=bucket)
        return dsm(scene, terrain=50.0)[0]

    assert with_group(1100).tobytes() == dsm(make_scene(ground))[0].tobytes()
    assert np.nanmax(with_group(900)) > 850


@pytest.mark.parametrize(
    "shape", [lambda p: p, void, l_shape, islands], ids=["full", "void", "l", "islands"]
)
def test_blocks_do_not_show(make_scene, shape) -> None:
    xyz = shape(scattered(4_000, 100_000))
    xyz[::97, 2] += 30_000
    scene = make_scene(xyz)
    whole, (record,) = dsm(scene)
    assert record["marked"] == 0
    for block, halo in ((17, 0), (40, 60_000)):
        tiled, records = dsm(scene, block, halo=halo)
        assert tiled.tobytes() == whole.tobytes()
        assert sum(r["marked"] for r in records) == 0
    other, _ = dsm(
        make_scene(xyz[::-1], frame=CoordFrame(origin=(-5_000, 70_001)), bucket=23_000), 25
    )
    assert other.tobytes() == whole.tobytes()


def test_the_surface_is_never_below_the_terrain(make_scene) -> None:
    """A steep plane, and blunders below it that nobody called noise, each alone in its pixel but for two."""
    xyz = scattered(8_000, 120_000)
    xyz[:, 2] = xyz[:, 0]
    labels = np.full(len(xyz), 2, np.uint8)
    pixels, first, counts = np.unique(
        xyz[:, :2] // 2000, axis=0, return_index=True, return_counts=True
    )
    alone = first[(counts == 1) & (pixels > 1).all(axis=1) & (pixels < 58).all(axis=1)][::40]
    xyz[alone, 2] -= 30_000
    labels[alone] = 1
    scene = make_scene(xyz, labels)
    spec = scene.grid_into_store("dtm", PIXEL)
    scene.store.create_raster("dsm", spec)
    coarse = RasterSpec.covering(Lattice(PIXEL), scene.data)
    scene.store.create_raster("survey", coarse, fill=SURVEYED)
    (block,) = spec.blocks(512)
    reads = {
        "points": Read("points:dtm"),
        "terrain": Read("raster:dtm"),
        "survey": Read("cells:survey"),
        "waters": Read("waters"),
        "facets": Read("facets"),
    }
    sources = sources_of(spec, coarse=coarse, facets=facets(scene))
    values = {"reach": REACH, "spike": SPIKE}
    make_block(scene.store, "dsm", surface_of, reads, spec, block, NODATA, sources, **values)
    above = above_block(scene, spec, block)
    surface, terrain = (
        scene.store.read_block("dsm", block),
        scene.store.read_block("dtm", block),
    )
    both = (surface != np.float32(NODATA)) & (terrain != np.float32(NODATA))
    assert both.mean() > 0.9
    assert (surface[both] >= terrain[both]).all()
    plain, _ = dsm(scene)
    # Also of ground at the lower side of its pixel.
    assert (plain[both] < terrain[both] - 0.5).sum() > len(alone)
    assert above["wrong"] == len(alone) > 10
    deepest = plain[both] < terrain[both] - 20
    assert deepest.sum() == len(alone)


def test_only_known_heights_are_held_against_the_terrain() -> None:
    none = np.nan
    surface = raised_to(np.array([5, 5, none, none, 5]), np.array([4, 7, 3, none, none]))
    assert np.array_equal(surface, [5, 7, none, none, 5], equal_nan=True)


@pytest.mark.parametrize("shape", [void, islands], ids=["void", "islands"])
@pytest.mark.parametrize("unit", [METRE, FOOT], ids=["metres", "feet"])
def test_the_distance_is_that_of_the_nearest_ground_point(make_scene, shape, unit) -> None:
    xyz = shape(scattered(6_000, 140_000))
    labels = np.where(xyz[:, 0] % 3 > 0, 2, 6).astype(np.uint8)
    scene = make_scene(xyz, labels, frame=CoordFrame(Units(unit, unit)))
    spec, cap = RasterSpec.covering(Lattice(Fraction(1000)), scene.data), 15_000
    scene.store.create_raster("distance", spec, 0.0)
    reads = {"points": Read("points", cap + 1)}
    records = [
        make_block(scene.store, "distance", distance, reads, spec, b, cap=Fraction(cap))
        for b in spec.blocks(512)
    ]
    (found,) = [scene.store.read_block("distance", b) for b in spec.blocks(1024)]
    x = (np.arange(spec.width) + spec.west) * 1000 + 500
    y = (spec.north - np.arange(spec.height)) * 1000 - 500
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    truth, _ = KDTree(xyz[labels == 2, :2]).query(centres)
    truth = np.minimum(truth, cap).reshape(found.shape) * float(unit) / 1000
    assert np.abs(found - truth).max() < 1e-5
    assert found.max() == np.float32(15 * float(unit))
    assert records[0]["filled"] < found.size
