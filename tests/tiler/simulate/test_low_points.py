"""Low points of raw scans: rates, depths, shapes, and independence of the division into patches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.cluster.hierarchy import fclusterdata

from tiler.simulate import (
    SCENES,
    AlsSensor,
    Site,
    Terrain,
    als,
    describe_scene,
    make_site,
    survey,
)
from tiler.simulate.als import Mirror, mirrors_near
from tiler.simulate.points import SimulatedPoints, survey_patch
from tiler.simulate.terrain import Line

CLEAN = AlsSensor(
    density=8.0, overlap_m=0.0, low_singles_km2=0.0, low_groups_km2=0.0, high_km2=0.0
)
EVERYTHING = replace(CLEAN, low_share=0.01, low_clumps_km2=2000.0, mirrors_km2=400.0)
RAW = [name for name, spec in SCENES.items() if spec.scene_class == "als raw"]


def flat(side_m: float, slope: float = 0.0, seed: int = 3) -> Site:
    return Site(Terrain(100.0, (slope, 0.0)), side_m, seed)


def depth_of(site: Site, points: SimulatedPoints) -> np.ndarray:
    """Depth of all points below the ground, metres."""
    x, y, z = points.xyz.T
    return np.asarray(site.terrain.height_at(x, y) - z)


def test_single_points_have_their_share_and_every_depth():
    site = flat(200.0)
    points = survey(site, replace(CLEAN, low_share=0.01))
    low = points.label == 7
    expected = 0.01 * len(points)
    assert low.sum() == pytest.approx(expected, abs=4 * np.sqrt(expected))
    depth = depth_of(site, points)[low]
    assert 0.3 <= depth.min() + 0.001 < 0.32 < 7.5 < depth.max() < 8.001
    per_depth, _ = np.histogram(np.log(depth), np.linspace(np.log(0.29), np.log(8.01), 9))
    expected = low.sum() / 8
    assert per_depth == pytest.approx(expected, abs=4 * np.sqrt(expected))
    per_quarter, _, _ = np.histogram2d(*points.xyz[low, :2].T, bins=2)
    assert per_quarter == pytest.approx(low.sum() / 4, abs=2 * np.sqrt(low.sum()))


@pytest.mark.parametrize("kind", ["forest", "terraces", "quarry", "city"])
def test_low_points_are_last_returns_far_below_the_ground(kind: str):
    site = make_site(kind, 4, 100.0)
    points = survey_patch(site, EVERYTHING, 0, 0)
    low = points.label == 7
    assert depth_of(site, points)[low].min() > 0.25
    assert np.all(points.number[low] == points.count[low])
    if kind == "forest":
        assert np.unique(points.count[low]).tolist() == [1, 2, 3, 4, 5]


def test_all_other_points_are_those_of_a_clean_scan():
    site = make_site("suburb", 4, 100.0)
    clean, raw = (sensor.survey(site, 0, 0) for sensor in (CLEAN, EVERYTHING))
    scanned = raw.take(np.arange(len(raw)) < len(clean))
    other = scanned.label != 7
    assert 100 < np.sum(~other) < 0.2 * len(clean)
    for name in ("xyz", "label"):
        same = getattr(clean, name)[other], getattr(scanned, name)[other]
        assert np.array_equal(*same), name
    for name in ("number", "count", "angle_deg"):
        assert np.array_equal(getattr(clean, name), getattr(scanned, name)), name
    assert np.all(raw.label[len(clean) :] == 7)


def test_clumps_have_8_to_30_points_within_2_m():
    site = flat(400.0, 0.1)
    rate = 300.0
    points = survey(site, replace(CLEAN, density=0.5, low_clumps_km2=rate))
    low = points.label == 7
    assert np.all(points.count[low] == 1)
    depth, xy = depth_of(site, points)[low], points.xyz[low, :2]
    clump = fclusterdata(xy, 2.0, criterion="distance", method="single")
    inside = np.all(np.abs(xy - 200) < 197, axis=1)
    sizes, heights, widths = [], [], []
    for number in np.unique(clump):
        own = clump == number
        if inside[own].all():
            sizes.append(own.sum())
            heights.append(np.ptp(depth[own]))
            widths.append(np.ptp(xy[own], axis=0).max())
    expected = rate * 0.394**2
    assert len(sizes) == pytest.approx(expected, abs=4 * np.sqrt(expected))
    assert 8 <= min(sizes) < 12
    assert 26 < max(sizes) <= 30
    assert 0.5 < min(widths) < 1.1 < max(widths) <= 2.001
    assert max(heights) < 0.601
    assert 0.999 < depth.min() < 2
    assert 5 < depth.max() < 6.001


def test_mirrored_planes_repeat_the_ground_below_their_rectangle_and_nowhere_else():
    site, rate = flat(400.0, 0.02), 40.0
    points = survey(site, replace(CLEAN, mirrors_km2=rate, flying_height_m=1e6, sigma_m=0.0))
    x, y, z = points.xyz.T
    low, seen = points.label == 7, np.zeros(len(points), np.bool_)
    kinds = set()
    for mirror in mirrors_near(site, rate, (0.0, 0.0, 400.0, 400.0)):
        # Along the ray, a depth of 5 m is 0.1 m to the south.
        inside = mirror.inside(x, y + 0.02 * mirror.depth_m) & ~seen
        own, ground = np.sum(inside & low), np.sum(inside & ~low)
        if inside.sum() < 2000:
            continue
        kinds.add(mirror.rise)
        assert own / ground == pytest.approx(mirror.density, abs=4 * np.sqrt(2 * own) / ground)
        level = site.terrain.height_at(mirror.line.x, mirror.line.y)
        shape = (1 - mirror.rise) * (site.terrain.height_at(x, y) - level)
        off = (z - level - shape + mirror.depth_m)[inside & low]
        assert off.mean() == pytest.approx(0.0, abs=0.02)
        assert off.std() == pytest.approx(mirror.sigma_m, rel=0.15)
        seen |= inside
    assert kinds == {0, 2}
    near = np.zeros(len(points), np.bool_)
    for mirror in mirrors_near(site, rate, (0.0, 0.0, 400.0, 400.0)):
        wide = replace(mirror, length_m=mirror.length_m + 0.4, width_m=mirror.width_m + 0.4)
        near |= wide.inside(x, y)
    assert not np.any(low & ~near)


def test_number_of_mirrored_planes_is_their_rate():
    site, rate = flat(50.0), 100.0
    box = (0.0, 0.0, 2000.0, 2000.0)
    own = [
        m
        for m in mirrors_near(site, rate, box)
        if 0 <= m.line.x < 2000 and 0 <= m.line.y < 2000
    ]
    assert len(own) == pytest.approx(4 * rate, abs=4 * np.sqrt(4 * rate))
    assert all(m.line.x % 50 == pytest.approx(0, abs=1e-9) or m.line.y % 50 == 0 for m in own)
    assert 0.15 <= min(m.density for m in own) < 0.17 < 0.58 < max(m.density for m in own) < 0.6
    part = mirrors_near(site, rate, (300.0, 300.0, 310.0, 320.0))
    assert part
    assert all(mirror in mirrors_near(site, rate, box) for mirror in part)


def test_a_plane_continues_across_the_border_of_patches(monkeypatch: pytest.MonkeyPatch):
    mirror = Mirror(Line(102.0, 97.0, 30.0), 60.0, 50.0, 4.0, 0.5, 0.0, 0)
    monkeypatch.setattr(als, "mirrors_near", lambda *_: [mirror])
    points = survey(flat(200.0), replace(CLEAN, mirrors_km2=1.0))
    x, y, _ = points.xyz.T
    low, inside = points.label == 7, mirror.inside(x, y)
    for east in (x < 100, x >= 100):
        for north in (y < 100, y >= 100):
            here = inside & east & north
            assert np.mean(low[here]) == pytest.approx(1 / 3, abs=2 / np.sqrt(here.sum()))
    # A depth of 4 m shifts points by less than 0.7 m along their rays.
    border = np.hypot(x - 100, y - 100)[low & ((np.abs(x - 100) < 1) | (np.abs(y - 100) < 1))]
    assert np.histogram(border, np.arange(0, 21, 2))[0].min() > 5


def test_low_points_do_not_depend_on_the_extent_of_the_site():
    def rows(side_m: float) -> np.ndarray:
        points = survey(flat(side_m), EVERYTHING)
        here = np.all(points.xyz[:, :2] < 130.0, axis=1)
        table = np.column_stack((points.xyz, points.label, points.number, points.count))[here]
        return table[np.lexsort(table.T)]

    small, large = rows(130.0), rows(230.0)
    assert np.sum(small[:, 3] == 7) > 1000
    assert np.array_equal(small, large)


@pytest.mark.parametrize("name", RAW)
def test_raw_scenes_have_low_points_as_described_and_blunders_scale_them(name: str):
    spec = SCENES[name]
    site = spec.make_site()
    points = survey_patch(site, spec.make_sensor(), 1, 1)
    low = points.label == 7
    assert depth_of(site, points)[low].min() > 0.25
    share = spec.sensor.get("low_share", 0.0)
    expected = max(share * len(points), 1.0)
    assert low.sum() > expected - 4 * np.sqrt(expected)
    assert not np.any(survey_patch(site, _sensor(name, 0.0), 1, 1).label == 7)
    assert np.sum(survey_patch(site, _sensor(name, 3.0), 1, 1).label == 7) > 1.5 * low.sum()


def _sensor(name: str, blunders: float) -> AlsSensor:
    sensor = describe_scene(name, blunders=blunders).make_sensor()
    assert isinstance(sensor, AlsSensor)
    return sensor
