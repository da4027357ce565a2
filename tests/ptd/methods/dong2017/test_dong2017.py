"""The method as a whole on a small coloured town: the points that it keeps and removes, and its invariance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import Delaunay

from ptd import classify
from ptd.frame import Scale, Window
from ptd.matched import robust_cells, surface
from ptd.matched.robust_cells import NearGroundPass
from ptd.methods.classic import Classic
from ptd.methods.dong2017.histograms import gli_bins
from ptd.methods.dong2017.method import Dong2017
from ptd.passes import MethodRefusal, Points
from tests.ptd.tiling import classify_tiled
from tests.ptd.town import CAR, HOUSE, SCALE, SIGMA_M, TREE, Town, town

PAPER = Dong2017(robust_cells=False)
"""The paper's steps, on points."""
QUICK = Dong2017(tins=3, last_spacing_m=2.0, robust_cells=False)
Run = tuple[np.ndarray, np.ndarray, dict[str, Any]]


@pytest.fixture(scope="module")
def scene() -> Town:
    return town(podium=True)


@pytest.fixture(scope="module")
def whole(scene: Town) -> Run:
    return classify_tiled(scene.points, SCALE, PAPER, None)


@pytest.fixture(scope="module")
def small() -> Town:
    return town(side=90.0, density=8.0)


@pytest.fixture(scope="module")
def quick(small: Town) -> Run:
    return classify_tiled(small.points, SCALE, QUICK, None)


def test_ground_is_kept_and_objects_are_removed(scene: Town, whole: Run) -> None:
    labels, marks, _ = whole
    assert not marks.any()
    assert set(labels.tolist()) == {1, 2}
    ground = {
        what: (labels[scene.truth == what] == 2).mean() for what in (2, 3, CAR, TREE, HOUSE)
    }
    assert ground[2] > 0.985
    assert ground[3] == ground[TREE] == 0.0  # green points are not ground, as in the paper
    assert ground[CAR] < 0.05
    # the feet of facades lie within the first threshold of the ground
    assert ground[HOUSE] < 0.04


def test_on_cells_green_ground_is_kept_and_cars_are_removed(scene: Town) -> None:
    """Robust heights make lawns ground, regardless of colour; houses, cars and crowns are not ground."""
    xyz, rgb = xyz_rgb(scene)
    result = classify(xyz, "dong2017", rgb=rgb)
    labels = result.classification
    kept = {
        what: (labels[scene.truth == what] == 2).mean() for what in (2, 3, CAR, TREE, HOUSE)
    }
    assert min(kept[2], kept[3]) > 0.985
    assert kept[CAR] < 0.05
    assert kept[TREE] == 0.0
    assert kept[HOUSE] < 0.04
    assert any(
        "green points may be ground" in note for note in result.decisions["statistics"]["notes"]
    )


def test_tiles_do_not_show_on_cells(small: Town, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells of tiles that see only a part of the town have the labels and seeds of the whole."""
    monkeypatch.setattr(robust_cells, "MAX_CIRCUMRADIUS_M", 6.0)
    shorter = robust_cells.facet_reach_m() + surface.noise_reach_cells(1.0) + 3.0
    passes = (
        *Dong2017(tins=1).passes[:-1],
        replace(NearGroundPass(), influence_radius_m=shorter),
    )
    monkeypatch.setattr(Dong2017, "passes", passes)
    whole, _, state = classify_tiled(small.points, SCALE, Dong2017(), None)
    assert 0.4 < (whole == 2).mean() < 0.9
    labels, marks, tiled = classify_tiled(small.points, SCALE, Dong2017(), 30.0, 25.0)
    assert np.array_equal(labels, whole)
    assert not marks.any()
    assert tiled == state


def test_decisions_are_reported(whole: Run) -> None:
    state = whole[2]
    told = "\n".join(state["notes"])
    steps = (
        "(Otsu)",
        "planar patches",
        "points in dense cells",
        "first TIN of seeds: distance",
        "TIN of 2 m",
    )
    assert all(words in told for words in steps)
    assert abs(state["sigma_m"] - SIGMA_M) < 0.01
    assert state["density_m2"] == 12.0


def after_two_passes(points: Points, scale: Scale, sigma_m: float | None) -> np.ndarray:
    """Labels of the second pass, in which seeds are 2."""
    state: dict[str, Any] = {"run": {"rgb": True, "sigma_m": sigma_m}}
    window = Window.everything()
    survey, seeds = PAPER.passes[:2]
    state = survey.reduce([survey.fit(points, window, window, scale, state).partial()], state)
    found: np.ndarray = seeds.fit(points, window, window, scale, state).label(points)[0]
    return found


def test_no_seed_on_houses_podiums_or_trees(scene: Town) -> None:
    labels = after_two_passes(scene.points, SCALE, SIGMA_M)
    assert (labels == 2).sum() > 40
    assert (scene.truth[labels == 2] == 2).all()
    assert (labels == 5)[(scene.truth == 3) | (scene.truth == TREE)].mean() > 0.99


@pytest.mark.parametrize("tile_m", [pytest.param(30.0, marks=pytest.mark.slow), 55.0])
def test_tiles_do_not_show(small: Town, quick: Run, tile_m: float) -> None:
    """The windows of the default halo decide everything, so there are no marks."""
    labels, marks, state = classify_tiled(small.points, SCALE, QUICK, tile_m, QUICK.halo_m)
    assert state == quick[2]
    assert np.array_equal(labels, quick[0])
    assert not marks.any()


def test_with_too_small_a_halo_marks_are_true(small: Town, quick: Run) -> None:
    """Measurements before ground grows from pass to pass are the same for any halo, and no unmarked label is wrong."""
    labels, marks, state = classify_tiled(small.points, SCALE, QUICK, 40.0, 0.0)
    assert state["notes"][:5] == quick[2]["notes"][:5]
    assert np.array_equal(labels[~marks], quick[0][~marks])
    assert marks.any()


def test_the_order_of_the_points_changes_nothing(small: Town, quick: Run) -> None:
    order = np.random.default_rng(0).permutation(len(small.points))
    labels, _, state = classify_tiled(small.points.take(order), SCALE, QUICK, None)
    assert np.array_equal(labels, quick[0][order])
    assert state == quick[2]


def test_the_frame_and_the_range_of_colours_change_nothing(small: Town, quick: Run) -> None:
    assert small.points.rgb is not None
    moved = small.points.xyz + np.array([[12_345], [-54_321], [0]], np.int32)
    origin = SCALE.origin[0] - 12_345, SCALE.origin[1] + 54_321
    wide = Points(moved, rgb=small.points.rgb * np.uint16(257))
    labels, _, state = classify_tiled(wide, replace(SCALE, origin=origin), QUICK, None)
    assert np.array_equal(labels, quick[0])
    assert state == quick[2]


def xyz_rgb(scene: Town) -> tuple[np.ndarray, np.ndarray]:
    assert scene.points.rgb is not None
    return scene.points.xyz.T / 100.0, scene.points.rgb.T


def test_without_colours_it_refuses(small: Town) -> None:
    xyz, rgb = xyz_rgb(small)
    with pytest.raises(ValueError, match="needs rgb"):
        classify(xyz, "dong2017")
    with pytest.raises(MethodRefusal, match="no point has a colour"):
        classify(xyz, "dong2017", rgb=np.zeros_like(rgb))


def test_without_facades_it_refuses(small: Town) -> None:
    xyz, rgb = xyz_rgb(small)
    bare = small.truth == 2
    line = r"no facade found: no cell of 1 m holds more than .* another method"
    with pytest.raises(MethodRefusal, match=line):
        classify(xyz[bare], "dong2017", rgb=rgb[bare])


def test_without_a_flat_place_beside_facades_it_refuses(small: Town) -> None:
    xyz, rgb = xyz_rgb(small)
    with pytest.raises(MethodRefusal, match="no seed found beside the facades"):
        classify(xyz, "dong2017", rgb=rgb, sigma=0.001)


def test_without_a_planar_patch_it_asks_for_sigma() -> None:
    rng = np.random.default_rng(1)
    xyz, rgb = rng.random((3000, 3)) * [20, 20, 9], rng.integers(1, 255, (3000, 3))
    with pytest.raises(MethodRefusal, match="--sigma"):
        classify(xyz, "dong2017", rgb=rgb)


def test_one_mode_of_colour_removes_nothing(small: Town) -> None:
    xyz, rgb = xyz_rgb(small)
    grey = np.full_like(rgb, 100)
    result = classify(xyz, "dong2017", PAPER, rgb=grey, sigma=SIGMA_M)
    assert "no two modes" in result.decisions["statistics"]["notes"][0]
    assert (result.classification[small.truth == 3] == 2).mean() > 0.9  # lawns are ground again


def test_thresholds_have_the_order_of_the_published_ones(whole: Run) -> None:
    """Table 4 has 0.35 m and 0.058 rad, 0.25 and 0.228, 0.22 and 0.35, at about twice this noise."""
    found = [text for text in whole[2]["notes"] if "angle" in text]
    angles = [float(text.split("angle ")[1].split()[0]) for text in found]
    distances = [float(text.split("distance ")[1].split()[0]) for text in found]
    assert angles == sorted(angles)
    assert all(0.1 <= d <= 0.4 for d in distances)


SPACINGS = [
    ((4.0, 2.0), (4.0, 2.0)),
    ((4.0, 1.0), (4.0, 2.0, 1.0)),
    ((4.0, 1.5), (4.0, 2.0, 1.5)),
    ((3.0, 3.0), (3.0,)),
]


@pytest.mark.parametrize(("limits", "spacings"), SPACINGS)
def test_densities_are_halved_down_to_the_last(
    limits: tuple[float, float], spacings: tuple[float, ...]
) -> None:
    params = replace(PAPER, first_spacing_m=limits[0], last_spacing_m=limits[1])
    assert params.spacings_m == spacings
    names = [step.name for step in params.passes]
    assert len(set(names)) == len(names) == 4 + 2 * len(spacings)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_a_few_points_end_in_a_clear_refusal(n: int) -> None:
    with pytest.raises(MethodRefusal):
        classify(np.zeros((n, 3)), "dong2017", rgb=np.full((n, 3), 9), sigma=0.1)


@pytest.mark.slow
def test_the_papers_comparison_between_facades() -> None:
    """Table 3: type I 0, total 1.53 % without vegetation; `classic` with its parameters loses most of the ground."""
    from tiler.simulate.catalogue import make_scene

    scene = make_scene("dim_area_city")
    result = classify(scene.xyz, "dong2017", PAPER, rgb=scene.rgb)
    papers = Classic(
        max_building_size_m=30.0,
        iteration_angle_deg=6.0,
        edge_length_reduce_m=0.0,
        rounds=0,
        thin_cell_m=0.0,
        label_pass=False,
    )
    lost = classify(scene.xyz, "classic", papers).classification != 2
    assert scene.rgb is not None
    grey = (
        gli_bins(np.ascontiguousarray(scene.rgb.T))
        < result.decisions["statistics"]["green_from"]
    )
    counts = np.rint((scene.xyz - scene.xyz.min(axis=0)) * 1000).astype(np.int32).T
    points = Points(np.ascontiguousarray(counts), rgb=np.ascontiguousarray(scene.rgb.T))
    seeds = scene.xyz[after_two_passes(points, Scale(), None) == 2]
    judged = grey & (Delaunay(seeds[:, :2]).find_simplex(scene.xyz[:, :2]) >= 0)
    ground, found = scene.classification[judged] == 2, result.classification[judged] == 2
    assert (ground & ~found).sum() <= 0.005 * ground.sum()
    assert (ground != found).mean() < 0.02
    assert (lost & judged & (scene.classification == 2)).sum() > 0.5 * ground.sum()
