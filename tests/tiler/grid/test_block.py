"""Heights at pixel centres: true on planes, and the same whatever the blocks, halos and frames."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from tests.scenes.ground_points import islands, l_shape, plane_points, scattered, void
from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.points import WITHHELD_FLAG
from tiler.core.raster import NODATA, RasterSpec, north_west
from tiler.core.units import FOOT, US_SURVEY_FOOT, Units
from tiler.errors import ProcessingError
from tiler.grid.block import full_halo, heights_of_blocks
from tiler.grid.records import GroundSelection

METRE = Fraction(1000)


@pytest.mark.parametrize(
    ("units", "shift", "size"),
    [
        (Units(), (0, 0), METRE),
        (Units(), (637_000_003, 5_400_000_001), METRE),
        (Units(), (-70_000_123, -30_000_456), Fraction(1000, 3)),
        (Units(FOOT, FOOT), (2_100_000_000, 1_400_000_000), Fraction(3000)),
        (
            Units(US_SURVEY_FOOT, US_SURVEY_FOOT),
            (2_100_000_000, 1_400_000_000),
            METRE / US_SURVEY_FOOT,
        ),
        (Units(FOOT, FOOT), (2_100_000_000, 1_400_000_000), METRE / FOOT),
    ],
    ids=["metres", "far", "third", "3ft", "1m-in-usft", "1m-in-ft"],
)
def test_a_tilted_plane_is_exact_at_pixel_centres(make_scene, units, shift, size):
    xyz = plane_points(4_000, 120_000, shift)
    frame = CoordFrame(units, (shift[0] - 17, shift[1] + 50_000_003))
    scene = make_scene(xyz, frame=frame)
    heights, records = scene.grid(size)
    spec = RasterSpec.covering(Lattice(size), scene.data)
    x = np.array(
        [float((spec.west + i + Fraction(1, 2)) * size - shift[0]) for i in range(spec.width)]
    )
    y = np.array(
        [float((spec.north - i - Fraction(1, 2)) * size - shift[1]) for i in range(spec.height)]
    )
    truth = (50_000 + x[None, :] / 4 - y[:, None] / 8) / 1000
    valid = heights != np.float32(NODATA)
    assert valid.mean() > 0.9
    assert np.abs(heights - truth)[valid].max() < 0.001 * min(1.0, float(units.vertical))
    assert sum(r.marked for r in records) == 0
    assert sum(r.filled for r in records) == int(valid.sum())


@pytest.mark.parametrize(
    ("shape", "max_edge"),
    [
        pytest.param(void, 50_000, id="void"),
        pytest.param(islands, 50_000, id="islands"),
        pytest.param(l_shape, 12_000, id="l, short"),
    ],
)
def test_blocks_do_not_show(make_scene, shape, max_edge):
    scene = make_scene(shape(scattered(4_500, 140_000)))
    whole, (record,) = scene.grid(METRE, max_edge=max_edge)
    assert record.marked == 0
    for block, halo in ((37, 0), (64, 9_000), (101, 400_000)):
        tiled, records = scene.grid(METRE, block, max_edge=max_edge, halo=halo)
        assert tiled.tobytes() == whole.tobytes()
        assert sum(r.marked for r in records) == 0
    assert 0 < np.count_nonzero(whole == np.float32(NODATA)) < whole.size


@pytest.mark.parametrize(
    "options", [{"halo": 50_000}, {"halo": 9_000}, {"halo": 9_000, "max_points": 2_000}]
)
def test_blocks_that_share_a_tin_are_those_that_do_not(make_scene, options):
    scene = make_scene(void(scattered(3_000, 140_000)), bucket=20_000)
    options = {"max_edge": 12_000, **options}
    alone, records = scene.grid(METRE, 48, **options)
    spec = RasterSpec.covering(Lattice(METRE), scene.data)
    works = [scene.work("", spec, block, **options) for block in spec.blocks(48)]
    made = [
        part for some in (works[:3], works[3:]) for part in heights_of_blocks(scene.store, some)
    ]
    found = {work.block: (heights, record) for work, heights, record in made}
    assert sorted(found, key=north_west) == [work.block for work in works]
    for work, record in zip(works, records, strict=True):
        b, (heights, joined) = work.block, found[work.block]
        assert (
            heights.tobytes()
            == alone[b.row : b.row + b.height, b.col : b.col + b.width].copy().tobytes()
        )
        assert joined.marked == record.marked == 0
        assert (joined.pixels, joined.filled) == (record.pixels, record.filled)
    assert any(r.tries > 1 for _, r in found.values()) == (options["halo"] < 12_000)


def test_the_frame_does_not_show(make_scene):
    xyz = void(scattered(4_000, 150_000)) + np.array([431_000_123, 5_300_000_777, 0])
    one, _ = make_scene(xyz, frame=CoordFrame(origin=(431_000_000, 5_300_000_000))).grid(METRE)
    two, _ = make_scene(xyz, frame=CoordFrame(origin=(430_123_457, 5_301_000_001))).grid(
        METRE, 40
    )
    assert one.tobytes() == two.tobytes()


def test_buckets_and_order_do_not_show(make_scene):
    xyz = void(scattered(4_000, 150_000))
    one, _ = make_scene(xyz).grid(METRE)
    two, _ = make_scene(xyz[::-1], bucket=23_000).grid(METRE)
    assert one.tobytes() == two.tobytes()


def test_a_pixel_is_empty_where_the_facet_is_long(make_scene):
    corners = np.array([[0, 0, 0], [40_000, 0, 0], [0, 40_000, 0], [40_000, 40_000, 0]])
    scene = make_scene(corners)
    filled, _ = scene.grid(METRE, max_edge=57_000)
    empty, _ = scene.grid(METRE, max_edge=56_000)
    # 41 x 41 pixels; the last row and column lie outside of the hull
    assert np.all(filled[1:, :-1] == 0)
    assert np.all(empty == np.float32(NODATA))


@pytest.mark.parametrize(
    "points", [[], [0], [0, 1], [0, 1, 2]], ids=["none", "one", "two", "collinear"]
)
def test_no_facet_no_heights(make_scene, points):
    xyz = np.array([[0, 0, 5], [5_000, 5_000, 5], [9_000, 9_000, 5]])
    labels = np.ones(3, np.uint8)
    labels[points] = 2
    heights, (record,) = make_scene(xyz, labels).grid(METRE)
    assert np.all(heights == np.float32(NODATA))
    assert (record.filled, record.ground_read, record.marked) == (0, len(points), 0)


def test_only_ground_counts_and_marks_are_carried(make_scene):
    xyz = scattered(2_000, 60_000)
    roof = xyz + np.array([1, 1, 30_000])
    labels = np.repeat(np.array([2, 6], np.uint8), len(xyz))
    labels[:7] |= 0x80
    withheld = np.column_stack((xyz[:300, :2] + 3, np.full(300, -90_000)))
    labels = np.append(labels, np.full(300, 2, np.uint8))
    flags = np.zeros(len(labels), np.uint8)
    flags[-300:] = WITHHELD_FLAG
    heights, (record,) = make_scene(np.concatenate((xyz, roof, withheld)), labels, flags).grid(
        METRE
    )
    assert record.ground_marked == 7
    assert record.ground_read == len(xyz)
    assert heights.max() < 30
    assert np.all((heights > 0) | (heights == np.float32(NODATA)))


def test_the_classes_of_the_input_are_trusted_for_keep(make_scene):
    scene = make_scene(scattered(500, 30_000))
    heights, (record,) = scene.grid(METRE, rule=GroundSelection(None, (1,)))
    assert record.ground_read == 500
    assert heights.max() > 0


def test_a_small_halo_is_widened_until_nothing_is_marked(make_scene):
    scene = make_scene(scattered(3_000, 200_000))
    _, records = scene.grid(METRE, 64, max_edge=40_000)
    assert max(r.tries for r in records) > 1
    assert all(r.halo <= full_halo(Fraction(40_000)) for r in records)
    _, capped = scene.grid(METRE, 64, max_edge=40_000, max_halo=1_000)
    assert sum(r.marked for r in capped) > 0


def test_thinning_does_not_show_blocks_and_keeps_a_plane(make_scene):
    scene = make_scene(plane_points(60_000, 60_000))
    whole, (record,) = scene.grid(METRE, thin=Lattice(Fraction(250)))
    tiled, _ = scene.grid(METRE, 17, thin=Lattice(Fraction(250)))
    assert tiled.tobytes() == whole.tobytes()
    assert record.ground_used < 0.75 * record.ground_read
    assert_plane(whole, scene)


def assert_plane(heights, scene):
    """All heights are those of `plane_points` at the centres of pixels of a metre."""
    spec = RasterSpec.covering(Lattice(METRE), scene.data)
    x, y = (
        (np.arange(spec.width) + 0.5) * 1000,
        (spec.north - np.arange(spec.height) - 0.5) * 1000,
    )
    truth = (50_000 + x[None, :] / 4 - y[:, None] / 8) / 1000
    assert np.abs(heights - truth)[heights != np.float32(NODATA)].max() < 0.001


def test_an_impossible_pixel_is_one_line(make_scene):
    scene = make_scene(scattered(50, 90))
    with pytest.raises(
        ProcessingError, match=r"block r0000000c0000000: .*; use a smaller max_edge"
    ):
        scene.grid(Fraction(100_003, 99_991))


@pytest.mark.parametrize("interpolation", ["natural", "idw"])
@pytest.mark.parametrize("shape", [void, islands], ids=["void", "islands"])
def test_every_interpolation_fills_the_same_pixels_and_shows_no_block(
    make_scene, shape, interpolation
):
    scene = make_scene(shape(scattered(2_500, 100_000)))
    linear, _ = scene.grid(METRE, max_edge=20_000)
    options = {"max_edge": 20_000, "interpolation": interpolation}
    whole, (record,) = scene.grid(METRE, **options)
    assert record.marked == 0
    assert np.array_equal(whole == np.float32(NODATA), linear == np.float32(NODATA))
    valid = whole != np.float32(NODATA)
    assert 0 < np.abs(whole - linear)[valid].mean() < 0.5
    tiled, records = scene.grid(METRE, 37, **options)
    marked = sum(r.marked for r in records)
    assert (tiled != whole).sum() <= marked
    # whose neighbours at the hull nothing bounds
    assert marked == 0 or interpolation == "natural"


@pytest.mark.parametrize("percent", [0, 10, 50])
def test_a_robust_surface_keeps_planes_and_shows_no_block(make_scene, percent):
    scene = make_scene(plane_points(30_000, 50_000))
    options = {"thin": Lattice(Fraction(500)), "percent": percent}
    whole, (record,) = scene.grid(METRE, **options)
    tiled, _ = scene.grid(METRE, 17, **options)
    assert tiled.tobytes() == whole.tobytes()
    assert record.ground_used <= 100 * 100
    assert_plane(whole, scene)


def test_a_robust_surface_is_smoother_and_a_low_percentile_lower(make_scene):
    rng = np.random.default_rng(1)
    xy, z = rng.integers(0, 40_000, (40_000, 2)), np.round(rng.normal(5_000, 100, 40_000))
    scene = make_scene(np.column_stack((xy, z)).astype(np.int64))
    every, _ = scene.grid(METRE)
    median, _ = scene.grid(METRE, thin=Lattice(Fraction(500)), percent=50)
    low, _ = scene.grid(METRE, thin=Lattice(Fraction(500)), percent=10)
    inner = (slice(2, -2), slice(2, -2))
    assert median[inner].std() < 0.7 * every[inner].std()
    assert abs(median[inner].mean() - 5) < 0.03
    assert low[inner].mean() < 4.92


def test_stumps_beside_objects_are_not_gridded(make_scene):
    rng = np.random.default_rng(2)
    xy = rng.integers(0, 60_000, (30_000, 2))
    house = (np.abs(xy - 30_000) < 8_000).all(axis=1)
    foot = (np.abs(xy - 30_000) < 8_400).all(axis=1) & ~house
    z = np.select([house, foot], [9_000, 800], 0)
    labels = np.where(house, 1, 2).astype(np.uint8)
    xyz, rule = (
        np.column_stack((xy, z)).astype(np.int64),
        GroundSelection("final", erode=Fraction(1500), erode_rise=1000),
    )
    scene = make_scene(xyz, labels)
    stumps, _ = scene.grid(METRE)
    clean, _ = scene.grid(METRE, rule=rule)
    assert stumps.max() > 0.5
    assert np.abs(clean[clean != np.float32(NODATA)]).max() == 0
    assert scene.grid(METRE, 13, rule=rule)[0].tobytes() == clean.tobytes()
    assert (
        make_scene(xyz, labels, bucket=8_000).grid(METRE, rule=rule)[0].tobytes()
        == clean.tobytes()
    )


@pytest.mark.slow
def test_a_wider_window_that_is_too_full_is_left_to_quarters(make_scene):
    scene = make_scene(scattered(3_000, 200_000), bucket=20_000)
    whole, (plain,) = scene.grid(METRE, max_edge=40_000, halo=1_000)
    tiled, records = scene.grid(METRE, 128, max_edge=40_000, halo=1_000, max_points=1_600)
    assert max(r.tries for r in records) > 2
    assert (
        max(r.ground_read for r in records) < sum(r.pixels for r in records) * plain.ground_read
    )
    assert sum(r.pixels for r in records) == whole.size
    assert tiled.tobytes() == whole.tobytes()


@pytest.mark.parametrize(("cell", "percent"), [("1000/3", None), ("1500/7", 50)])
def test_a_choice_made_bucket_by_bucket_is_that_of_all(make_scene, monkeypatch, cell, percent):
    rng = np.random.default_rng(3)
    xy = rng.integers(0, 60_000, (40_000, 2))
    scene = make_scene(
        np.column_stack((xy, rng.integers(0, 5_000, 40_000))).astype(np.int64), bucket=20_000
    )
    options = {
        "thin": Lattice(Fraction(cell)),
        "percent": percent,
        "max_edge": 20_000,
        "max_points": 30_000,
    }
    kept, (record,) = scene.grid(METRE, **options)
    monkeypatch.setattr(
        "tiler.grid.ground._whole_cells", lambda *rest: np.arange(rest[-1].shape[1])
    )
    every, (whole,) = scene.grid(METRE, **options)
    assert kept.tobytes() == every.tobytes()
    assert record == whole
