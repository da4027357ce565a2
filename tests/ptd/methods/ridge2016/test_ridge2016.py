"""The method as a whole: points found and dropped, the last round, tiles, the ISPRS samples."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ptd
from ptd.frame import OPEN, Scale, Window
from ptd.methods import make_params
from ptd.methods.ridge2016.method import SEED, Ridge2016, last_round
from ptd.passes import Points
from ptd.tin.mesh import Tin
from tests.ptd.scenes import CM, SCENES, Cloud
from tests.ptd.tiling import classify_tiled
from tests.scenes.windows import cut, opened

EVERYTHING = Window.everything()
SCALE = Scale(Fraction(1, CM), Fraction(1, CM), (-7_123_456, 93_000_017))
DEFAULTS = Ridge2016(robust_cells=False)
SMALL = Ridge2016(
    robust_cells=False, max_building_size_m=6.0, rounds=4, low_radius_m=2.5, low_depth_m=2.0
)


def labels_of(cloud: Cloud, params: Ridge2016) -> np.ndarray:
    return classify_tiled(Points(cloud), SCALE, params, None)[0]


def test_the_last_round_by_hand() -> None:
    """A share of 0.001 of 10000 points is 10."""
    gained = [500, 60, 11, 10, 9]
    last, note = last_round(10_000, gained, [0] * 5, 0.001)
    assert last == 4
    told = "densification ends after 4 rounds, the last of which added 0.10 % of all points to the terrain"
    assert note == told
    assert last_round(11_000, gained, [0] * 5, 0.001)[0] == 3
    last, note = last_round(10_000, gained, [0] * 5, 0.0008)
    assert last == 5
    assert note.endswith("still more than 0.08 %, but no more rounds were allowed")


def test_a_note_says_that_points_near_edges_could_change_the_last_round() -> None:
    gained = [500, 60, 11, 10]
    assert "wider halo" not in last_round(10_000, gained, [3, 0, 0, 0], 0.001)[1]
    assert "wider halo" in last_round(10_000, gained, [0, 1, 0, 0], 0.001)[1]
    assert "wider halo" in last_round(10_000, gained, [0, 0, 0, 1], 0.001)[1]
    assert "wider halo" not in last_round(11_000, gained, [0, 0, 0, 1], 0.001)[1]


def test_partials_add_up_in_any_order() -> None:
    step = Ridge2016(rounds=2, robust_cells=False).passes[0]
    parts = [
        {"points": 700, "gained": [200, 1], "unsure": [1, 1]},
        {"points": 300, "gained": [100, 0], "unsure": [0, 0]},
    ]
    state = step.reduce(parts, {"run": {}, "notes": ["before"]})
    assert state == step.reduce(parts[::-1], {"run": {}, "notes": ["before"]})
    assert state["ridge2016"] == {
        "rounds": 2,
        "points": 1000,
        "gained": [300, 1],
        "unsure": [1, 1],
    }
    assert state["notes"][0] == "before"
    assert len(state["notes"]) == 2


def test_a_count_near_the_edge_of_a_window_is_not_certain() -> None:
    cloud = SCENES["plane"](np.random.default_rng(1))
    core = Window(7_000, 5_000, 9_000, 7_000)
    for window, certain in ((EVERYTHING, True), (Window(5_000, 4_000, 11_000, 9_000), False)):
        part = np.ascontiguousarray(cloud[:, cut(cloud, window)])
        model = SMALL.passes[0].fit(Points(part), window, core, SCALE, {})
        assert (model.uncertain() == 0) == certain
        assert model.partial()["points"] == cut(cloud, core).sum()
        assert max(model.partial()["unsure"]) == model.uncertain()


def test_without_a_growth_to_watch_there_is_one_pass() -> None:
    (only,) = Ridge2016(growth=0.0, rounds=3, robust_cells=False).passes
    model = only.fit(
        Points(SCENES["plane"](np.random.default_rng(1))), EVERYTHING, EVERYTHING, SCALE, {}
    )
    assert model.stats["rounds"] <= 3
    assert only.reduce([model.partial()], {"kept": 1}) == {"kept": 1}


def test_the_last_pass_has_the_tin_of_the_round_that_was_decided() -> None:
    cloud = SCENES["hills_with_houses"](np.random.default_rng(7))
    params = Ridge2016(growth=0.01, robust_cells=False)
    result = ptd.classify(cloud.T / CM, "ridge2016", params)
    statistics = result.decisions["statistics"]["ridge2016"]
    last = statistics["rounds"]
    assert result.stats["ridge2016"]["rounds"] == last < result.stats["growth"]["rounds"]
    one = ptd.classify(
        cloud.T / CM, "ridge2016", Ridge2016(growth=0.0, rounds=last, robust_cells=False)
    )
    assert np.array_equal(one.classification, result.classification)
    assert one.stats["ridge2016"]["vertices"] == result.stats["ridge2016"]["vertices"]
    assert one.stats["ridge2016"]["seeds"] == result.stats["growth"]["seeds"]
    assert len(statistics["gained"]) == statistics["rounds"]
    assert (
        statistics["gained"][-1] <= 0.01 * statistics["points"] < min(statistics["gained"][:-1])
    )
    assert statistics["points"] == cloud.shape[1]


def test_codes_of_vertices_are_the_rounds_in_which_they_became_such() -> None:
    cloud = SCENES["hills_with_houses"](np.random.default_rng(7))
    model = SMALL.passes[0].fit(Points(cloud), EVERYTHING, EVERYTHING, SCALE, {})
    codes, marked = model.label(Points(cloud))
    assert not marked.any()
    assert set(codes.tolist()) == {1, 7, SEED, SEED + 1, SEED + 2, SEED + 3}
    found = model.stats["seeds"] + model.stats["ridge_points"] - model.stats["dropped_seeds"]
    assert (codes == SEED).sum() == found
    order = np.random.default_rng(0).permutation(cloud.shape[1])
    assert np.array_equal(
        model.label(Points(np.ascontiguousarray(cloud[:, order])))[0], codes[order]
    )
    stranger = cloud[:, :1] + np.array([[0], [0], [1]], np.int32)
    assert model.label(Points(stranger.astype(np.int32)))[0].tolist() == [1]


@pytest.mark.parametrize(
    "scene", [pytest.param("hills_with_houses", marks=pytest.mark.slow), "voids", "blunders"]
)
def test_tiles_do_not_show(scene: str) -> None:
    """Unmarked labels are equal; with a wide halo all are, and the figures of the run are identical."""
    cloud = SCENES[scene](np.random.default_rng(5))
    whole, none, state = classify_tiled(Points(cloud), SCALE, SMALL, None)
    assert not none.any()
    labels, marks, _ = classify_tiled(Points(cloud), SCALE, SMALL, 60.0, 20.0)
    assert np.array_equal(labels[~marks], whole[~marks])
    labels, marks, counted = classify_tiled(Points(cloud), SCALE, SMALL, 60.0, 140.0)
    assert np.array_equal(labels, whole)
    assert not marks.any()
    assert counted == state
    back = Points(cloud[:, ::-1].copy())
    assert np.array_equal(classify_tiled(back, SCALE, SMALL, 60.0, 140.0)[0], whole[::-1])


SIDE = 30_000


def rough_roofs(seed: int) -> tuple[np.random.Generator, Cloud, Ridge2016]:
    """Small cells, sharp ridges and steps, and thresholds at which much is found and dropped."""
    rng = np.random.default_rng(seed)
    step = int(rng.choice([1, 1, 100, 250]))
    cloud = (rng.integers(0, SIDE, (3, 5000)) // step * step).astype(np.int32)
    x, y = cloud[:2] / CM
    z = rng.choice([0, 8]) * (x // 17 % 2)
    z = z + rng.choice([1, 6]) * np.abs((x + 0.3 * y) % rng.choice([18, 30]) - 9)
    z += rng.choice([0.05, 0.3, 1.5]) * rng.random(x.size)
    z[rng.random(x.size) < 0.02] -= rng.uniform(2, 9)
    z[rng.random(x.size) < 0.2] += rng.uniform(2, 9)
    cloud[2] = np.rint(z * CM)
    params = Ridge2016(
        max_building_size_m=float(rng.choice([5.0, 6.0, 8.5])),
        thin_cell_m=float(rng.choice([0.7, 1.0, 3.0])),
        terrain_angle_deg=float(rng.choice([30, 88])),
        iteration_angle_deg=float(rng.choice([6, 15, 30])),
        ridge_side=float(rng.choice([0.5, 1.0, 1.5])),
        ridge_angle_deg=float(rng.choice([2, 10, 25])),
        ridge_radius_m=float(rng.choice([0.5, 2.0, 5.0])),
        seed_confidence=float(rng.choice([0.5, 0.8, 0.98])),
        low_radius_m=2.5,
        low_depth_m=2.0,
        low_group=int(rng.choice([0, 1, 5])),
        label_floor_m=float(rng.choice([0.0, 0.3])),
        growth=0.0,
        rounds=int(rng.choice([1, 2, 3, 5])),
        robust_cells=False,
    )
    return rng, cloud, params


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_unmarked_labels_of_any_window_are_those_of_the_untiled_run(seed: int) -> None:
    rng, cloud, params = rough_roofs(seed)
    truth = labels_of(cloud, params)
    (west, south), (wide, high) = (
        rng.integers(-SIDE // 3, SIDE // 2, 2),
        rng.integers(SIDE // 2, SIDE, 2),
    )
    window = opened(cloud, Window(int(west), int(south), int(west + wide), int(south + high)))
    inside = cut(cloud, window)
    part = np.ascontiguousarray(cloud[:, inside])
    labels, marked = (
        params.passes[-1].fit(Points(part), window, window, SCALE, {}).label(Points(part))
    )
    assert not (~marked & (labels != truth[inside])).any()
    first, last = replace(params, growth=0.001).passes
    whole = first.fit(Points(cloud), EVERYTHING, EVERYTHING, SCALE, {})
    state = first.reduce([whole.partial()], {})
    codes, _ = whole.label(Points(cloud))
    labels, marked = first.fit(Points(part), window, window, SCALE, {}).label(Points(part))
    assert not (~marked & (labels != codes[inside])).any()
    truth = labels_of(cloud, replace(params, rounds=state["ridge2016"]["rounds"]))
    given = Points(part, codes[inside])
    labels, marked = last.fit(given, window, window, SCALE, state).label(given)
    assert not (~marked & (labels != truth[inside])).any()


def test_a_part_of_such_windows_is_certain() -> None:
    """This gives the test above its meaning: ridges are found, seeds are dropped, labels are unmarked."""
    _, cloud, params = rough_roofs(4)
    window = Window(-OPEN, -OPEN, 28_000, OPEN)
    part = np.ascontiguousarray(cloud[:, cloud[0] < 28_000])
    model = params.passes[-1].fit(Points(part), window, window, SCALE, {})
    assert model.stats["ridge_points"] > 20
    assert model.stats["dropped_seeds"] > 20
    assert 0.3 < model.label(Points(part))[1].mean() < 0.9


@pytest.mark.slow
def test_on_a_mountain_beside_a_settlement_the_terrain_is_better_than_that_of_classic() -> None:
    """The paper's comparison (25 % less RMSE than `classic`), with its parameters and with our defaults."""
    from tiler.simulate.catalogue import make_scene

    scene = make_scene("als_mountain")
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(10.5, 290), np.arange(10.5, 290)))
    truth = scene.truth(x, y)

    def rmse(method: str, **texts: str) -> float:
        found = ptd.classify(scene.xyz, method, make_params(method, texts)).classification == 2
        tin = Tin.build(*np.rint(scene.xyz[found].T * 1000).astype(np.int32))
        heights = tin.heights((x * 1000).astype(np.int32), (y * 1000).astype(np.int32)) / 1000
        return float(np.sqrt(np.nanmean((heights - truth) ** 2)))

    paper = {"iteration_angle": "6", "edge_length_reduce": "0", "edge_length_stop": "1"}
    ours = rmse("ridge2016", **paper, label_floor="0", rounds="60")
    assert ours < 0.75 * rmse("classic", **paper, label_pass="no", rounds="0")
    assert rmse("ridge2016") < 0.75 * min(rmse("classic"), ours)
