"""Two stages: thresholds by scale, refusals, equality with classic, and independence of tiles."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from ptd import classify
from ptd.frame import Scale, Window
from ptd.methods.classic import Classic
from ptd.methods.dong2018.method import JOINED, Dong2018, MeasurePass, even_edge_m
from ptd.methods.dong2018.surfaces import BINS, EvenTin
from ptd.passes import MethodRefusal, Points
from tests.ptd.tiling import classify_tiled

DEFAULTS = Dong2018(robust_cells=False)
PAPER = Dong2018(
    robust_cells=False, iteration_angle_deg=6.0, density_k=10.0, max_building_size_m=30.0
)


def terrain(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Hills, and swells that blur a TIN of points 4 m apart."""
    return (
        2.0 * np.sin(x / 25)
        + 1.5 * np.cos(y / 18)
        + 0.03 * x
        + 0.3 * np.sin(x / 3.5) * np.sin(y / 3.1)
    )


def matched_cloud(
    seed: int, width: float = 120.0, height: float = 80.0, density: float = 12.0
) -> tuple[np.ndarray, np.ndarray]:
    """A matched cloud of houses on rolling ground, in metres float64 [n, 3], and a mask of the ground.

    It has noise of 0.066 m, walls, and clumps of blunders below the ground.
    """
    rng = np.random.default_rng(seed)
    n = round(width * height * density)
    x, y = rng.random((2, n)) * [[width], [height]]
    z = terrain(x, y)
    house = (x % 31 > 10) & (x % 31 < 21) & (y % 27 > 6) & (y % 27 < 17)
    z[house] = 6.0 + 0.3 * (x % 31)[house] + z[house]
    edge = house & ((x % 31 < 10.3) | (y % 27 < 6.3))
    z[edge] -= rng.random(edge.sum()) * 6.0
    z += 0.066 * rng.standard_normal(n)
    blunder = np.zeros(n, bool)
    for k in rng.integers(0, n, round(width * height / 150)):
        clump = np.hypot(x - x[k], y - y[k]) < rng.uniform(0.2, 0.9)
        z[clump] -= rng.uniform(0.8, 6.0)
        blunder |= clump
    return np.stack([x, y, z], axis=1), ~house & ~blunder


def errors(labels: np.ndarray, ground: np.ndarray) -> tuple[float, float, float]:
    """Type I, II and total, percent."""
    wrong = (labels == 2) != ground
    return tuple(100 * float(part.mean()) for part in (wrong[ground], wrong[~ground], wrong))


@pytest.mark.parametrize(("sigma", "density"), [(0.066, 4.9), (0.027, 29.2)])
def test_equation_3(sigma: float, density: float) -> None:
    assert PAPER.threshold_m2(sigma) == pytest.approx(density, abs=0.05)


def test_facets_as_dense_as_the_threshold() -> None:
    """Equilateral facets of 2 m have sqrt(3) m2 and half a vertex each."""
    assert even_edge_m(1 / (2 * math.sqrt(3))) == pytest.approx(2.0)


def test_stage_one_leaves_dense_facets_alone() -> None:
    xyz, _ = matched_cloud(10, 60.0, 40.0)
    few, many = (
        classify(
            xyz, "dong2018", replace(DEFAULTS, density_k=k, thin_cell_m=0.3), sigma=0.066
        ).stats["stage-one"]
        for k in (0.01, 1.0)
    )
    assert few["candidates"] == many["candidates"]
    assert few["vertices"] < many["vertices"]


def test_scales_and_passes() -> None:
    assert DEFAULTS.scales_m == (4.0, 2.0, 1.0)
    assert replace(DEFAULTS, first_scale_m=5.0, last_scale_m=1.0).scales_m == (5.0, 2.5, 1.25)
    steps = [f"{step}-{scale}" for scale in (4, 2, 1) for step in ("measure", "join")]
    assert [step.name for step in DEFAULTS.passes] == ["noise", "stage-one", *steps]


def test_even_tin_by_hand() -> None:
    """One point per cell of 4 m is a vertex; the others are measured against these facets only."""
    steps = np.arange(100, 4000, 400, dtype=np.int32)
    x, y = (np.ascontiguousarray(a.ravel()) for a in np.meshgrid(steps, steps))
    z = np.zeros(x.size, np.int32)
    scale = Scale(Fraction(1, 100), Fraction(1, 100))
    # A second point lies in the cell of (21, 21), half a metre beside and 0.31 m above it. The
    # hash picks one of them.
    x, y, z = (np.append(a, b).astype(np.int32) for a, b in ((x, 2150), (y, 2100), (z, 31)))
    even = EvenTin(x, y, z, np.ones(x.size, bool), 4.0, Window.everything(), scale)
    left = np.flatnonzero(even.left_out)
    assert even.vertices == 100
    assert left.size == 1
    assert {int(left[0])} <= {55, 100}
    ground = np.ones(x.size, bool)
    ground[100] = False
    even = EvenTin(x, y, z, ground, 4.0, Window.everything(), scale)
    counts = even.histogram(x, y, z, ~ground)
    assert np.argwhere(counts).tolist() == [[15, int(np.degrees(np.arctan2(0.31, 0.5)))]]
    assert counts.shape == (BINS.distances, BINS.angles)
    passed, _ = even.near(x, y, z, ~ground, 0.32, 32.0)
    assert passed[100]
    for distance, angle in ((0.30, 32.0), (0.32, 31.0)):
        assert not even.near(x, y, z, ~ground, distance, angle)[0].any()


def test_a_matched_cloud() -> None:
    """Type I, II and total error beside those of classic; thresholds as in figure 12."""
    xyz, ground = matched_cloud(1)
    result = classify(xyz, "dong2018", DEFAULTS)
    state = result.decisions["statistics"]
    assert set(np.unique(result.classification)) <= {1, 2, 7}
    assert state["dense"]
    assert state["sigma_m"] == pytest.approx(0.066, abs=0.015)
    one, two, total = errors(result.classification, ground)
    assert one < 4.0
    assert two < 6.0
    assert total < 4.0
    for params in (Classic(iteration_angle_deg=6.0, max_building_size_m=30.0), Classic()):
        assert total < errors(classify(xyz, "classic", params).classification, ground)[2] - 2.0
    scales = state["scales"]
    assert [found["scale_m"] for found in scales] == [4.0, 2.0, 1.0]
    angles, distances = (
        [found[name] for found in scales] for name in ("angle_deg", "distance_m")
    )
    assert angles == sorted(angles)
    assert distances[0] > max(distances[1:])
    assert any("scale 2 m" in note for note in state["notes"])
    json.dumps(state)


def test_blunders_are_low_noise() -> None:
    xyz, ground = matched_cloud(2)
    found = classify(xyz, "dong2018", DEFAULTS).classification
    low = ~ground & (xyz[:, 2] < terrain(xyz[:, 0], xyz[:, 1]) - 0.7)
    assert (found[low] == 7).mean() > 0.95
    assert (found[ground] == 7).mean() < 0.002


@pytest.mark.parametrize(
    ("density", "sigma", "settings"),
    [
        (0.6, None, {}),  # no search for patches below a point per square metre
        (4.0, 0.02, {"thin_cell_m": 0.7, "edge_length_reduce_m": 5.0, "rounds": 4}),
    ],
)
def test_a_sparse_cloud_is_labelled_as_by_classic(
    density: float, sigma: float | None, settings: dict[str, Any]
) -> None:
    xyz, _ = matched_cloud(3, density=density)
    params = replace(DEFAULTS, **settings)
    result = classify(xyz, "dong2018", params, sigma=sigma)
    classic = classify(xyz, "classic", Classic(**{"edge_length_reduce_m": 0.0, **settings}))
    assert np.array_equal(result.classification, classic.classification)
    notes = result.decisions["statistics"]["notes"]
    assert len(notes) == 1
    assert "the result is classic's" in notes[0]


def rough_cloud(density: float) -> np.ndarray:
    xyz, _ = matched_cloud(4, 60.0, 60.0, density)
    xyz[:, 2] += np.random.default_rng(5).random(len(xyz)) * 4.0
    return xyz


def test_no_planar_patch_is_refused_where_noise_matters() -> None:
    with pytest.raises(MethodRefusal, match=r"planar patches .* too few.* --sigma"):
        classify(rough_cloud(12.0), "dong2018", DEFAULTS)
    assert classify(rough_cloud(0.8), "dong2018", DEFAULTS).classification.size
    assert classify(rough_cloud(12.0), "dong2018", DEFAULTS, sigma=0.1).decisions["statistics"][
        "dense"
    ]


def test_a_thinning_cell_that_cannot_reach_the_density_is_refused() -> None:
    xyz, _ = matched_cloud(6, 60.0, 60.0)
    line = r"thin_cell 1 m .* than 1 points/m2 .*DEN_thr 4\.88.*thin_cell=0\.45"
    with pytest.raises(MethodRefusal, match=line):
        classify(xyz, "dong2018", replace(PAPER, thin_cell_m=1.0), sigma=0.066)
    found = classify(xyz, "dong2018", replace(PAPER, thin_cell_m=0.4), sigma=0.066)
    assert found.stats["stage-one"]["vertices"] > 0


def test_stage_two_ends_when_few_join() -> None:
    xyz, _ = matched_cloud(7, 70.0, 60.0)
    whole = classify(xyz, "dong2018", replace(DEFAULTS, first_scale_m=1.0))
    two = replace(DEFAULTS, first_scale_m=1.9, last_scale_m=0.9, min_joined=10**8)
    result = classify(xyz, "dong2018", two)
    first = classify(xyz, "dong2018", replace(DEFAULTS, first_scale_m=1.9, last_scale_m=1.0))
    assert np.array_equal(result.classification, first.classification)
    assert not np.array_equal(result.classification, whole.classification)
    state = result.decisions["statistics"]
    assert [found["scale_m"] for found in state["scales"]] == [1.9]
    assert result.stats["join-0.95"] == {}
    assert "stage two ends" in state["notes"][-1]


def measured(angle_bin: int, distance_bin: int) -> list[dict[str, Any]]:
    index = distance_bin * BINS.angles + angle_bin
    return [
        {"joined": 5000, "ground": 10, "bins": [[index, 40]]},
        {"joined": 0, "ground": 3, "bins": [[index, 60]]},
    ]


def test_thresholds_that_move_the_other_way_are_reported_and_kept() -> None:
    state: dict[str, Any] = {"dense": True, "cells": 1, "threshold_m2": 1.0}
    state = MeasurePass(DEFAULTS, DEFAULTS.scales_m[0], "measure").reduce(
        measured(10, 5), state
    )
    state = MeasurePass(DEFAULTS, DEFAULTS.scales_m[1], "measure").reduce(
        measured(12, 4), state
    )
    assert not any("warning" in note for note in state["notes"])
    state = MeasurePass(DEFAULTS, DEFAULTS.scales_m[2], "measure").reduce(measured(8, 7), state)
    told = [note.split("warning: ")[1] for note in state["notes"] if "warning" in note]
    assert [words[:17] for words in told] == ["the angle does no", "the distance does"]
    last = state["scales"][-1]
    assert last["angle_deg"] == pytest.approx(8.5 + 0.99)
    assert last["distance_m"] == pytest.approx(0.02 * (7.5 + 0.99))
    assert state["scales"][0]["joined"] == 5000


def test_no_points() -> None:
    assert classify(np.zeros((0, 3)), "dong2018").classification.size == 0


def test_tiles_give_what_one_window_gives() -> None:
    """Statistics are equal for any tiles, and so are unmarked labels; hardly any label is marked."""
    xyz, _ = matched_cloud(8, 330.0, 50.0, 6.0)
    scale = Scale(Fraction(1, 1000), Fraction(1, 1000), (2_345_678, -9_876_543))
    points = Points(np.ascontiguousarray(np.rint(xyz.T * 1000).astype(np.int32)))
    params = replace(DEFAULTS, rounds=4)
    truth, marks, state = classify_tiled(points, scale, params, None)
    assert state["dense"]
    assert len(state["scales"]) == 3
    assert not marks.any()
    order = np.random.default_rng(9).permutation(len(points))
    shuffled, _, again = classify_tiled(points.take(order), scale, params, None)
    assert np.array_equal(shuffled, truth[order])
    assert again == state
    for tile_m, halo_m in ((57.0, 40.0), (90.0, 60.0)):
        labels, marks, tiled = classify_tiled(points, scale, params, tile_m, halo_m)
        assert tiled == state
        assert np.array_equal(labels[~marks], truth[~marks])
        assert marks.mean() < 0.01
    labels, marks, _ = classify_tiled(points, scale, params, 57.0, 0.0)
    assert np.array_equal(labels[~marks], truth[~marks])
    assert (labels != JOINED).all()
