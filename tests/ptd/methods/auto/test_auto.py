"""`auto`: what it finds, what it decides, and that neither tiles nor the order of points show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ptd
from ptd.frame import Window
from ptd.ground import morphology
from ptd.ground.labelling import GROUND
from ptd.ground.noise_sums import Roughness
from ptd.methods.auto.cells import OBJECT, ROOF
from ptd.methods.auto.method import (
    Auto,
    ReturnStatistics,
    decided,
    label_bands,
    label_thresholds,
)
from ptd.methods.auto.params import Reaches
from ptd.passes import Points
from ptd.places import value_at
from tests.ptd.alike import alike
from tests.ptd.scenes import SCENES
from tests.ptd.tiling import classify_tiled
from tests.scenes.windows import SCALE

HELD = [[8.0, 0.066, 0.07, 1.0, 0.0]]
"""Figures of the places of a run."""


class Near(Auto):
    """Rules that see less far, for scenes that are small."""

    reaches = Reaches(slope_m=2.0, around_m=4.0, object_trend_m=5.0, bump_trend_m=5.0)


SMALL = Near(
    max_building_size_m=10.0, object_size_m=6.0, low_radius_m=2.0, rounds=2, roof_size_m=20.0
)


RASTERS = ("survey", "noise", "seeds", "summits", "refine", "roofs", "treetops", "annexes")
"""Passes on rasters that find a hall and what is built beside it."""


def scene(n: int = 30_000) -> tuple[np.ndarray, np.ndarray]:
    """A slope with two roofs, a bush, a wall and low noise: metres, and the true classes."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, 120, (2, n))
    z = 0.15 * x + rng.normal(0, 0.03, n)
    house = (abs(x - 40) < 8) & (abs(y - 40) < 12)
    shed = (abs(x - 90) < 6) & (abs(y - 80) < 6)
    bush = np.hypot(x - 30, y - 90) < 3
    wall = (abs(x - 60) < 20) & (abs(y - 55) < 0.7)
    z[house] = 6.0 + 0.15 * 48
    z[shed] += 3.0
    z[bush] += rng.uniform(1.0, 3.0, int(bush.sum()))
    z[wall] += 1.2
    x[:2], y[:2], z[:2] = 60.0, (60.0, 60.5), -9.0
    truth = np.where(house | shed | bush | wall, 1, 2)
    truth[:2] = 7
    return np.stack([x, y, z], axis=1), truth


def test_roofs_bushes_walls_and_low_noise_are_no_ground() -> None:
    xyz, truth = scene()
    result = ptd.classify(xyz, "auto")
    found = result.classification
    assert (found[truth == 1] == 2).mean() < 0.03
    assert (found[truth == 2] == 2).mean() > 0.99
    assert found[:2].tolist() == [7, 7]
    assert result.stats["noise"]["low_noise"] == 2
    unsearched = ptd.classify(xyz, "auto", Auto(low_group=0))
    assert unsearched.stats["noise"]["low_noise"] == 0
    assert 7 not in unsearched.classification
    roofs = [f"roofs{n}" for n in ("", 2, 3, 4)]
    before = ["survey", "noise", "seeds", "summits", "densify", "refine"]
    assert list(result.stats) == [*before, *roofs, "treetops", "annexes", "label"]


@pytest.mark.parametrize(
    ("code", "rise_m", "back"), [(OBJECT, 0.5, True), (OBJECT, 1.0, False), (ROOF, 0.5, False)]
)
def test_the_last_tin_takes_back_edges_that_fit_and_no_roofs(
    code: int, rise_m: float, back: bool
) -> None:
    """A bank 6 m wide in level ground, half as high and as steep as ground may grow, or higher, or a roof."""
    x, y = (c.reshape(-1) for c in np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5))
    bank = abs(x - 20) < 3
    z = np.where(abs(x - 20) < 1, rise_m, np.where(bank, 0.5 * rise_m, 0.0))
    counts = np.round(np.stack([x, y, z]) * 100).astype(np.int32)
    cloud = Points(counts, np.where(bank, code, GROUND).astype(np.uint8))
    state = {"run": {"sigma_m": None}, "survey": {"kind": "lidar"}, "places": alike(1.0)}
    window = Window.everything()
    label = next(p for p in Auto().passes if p.name == "label")
    labels, _ = label.fit(cloud, window, window, SCALE, state).label(cloud)
    assert (labels[~bank] == GROUND).all()
    assert ((labels == GROUND)[abs(x - 20) < 1] == back).all()


def test_a_window_without_ground_knows_nothing() -> None:
    """All points of a window may be objects' if what surrounds it is lower."""
    window = Window(0, 0, 10_000, 10_000)
    cloud = Points(np.full((3, 4), 500, np.int32), np.full(4, OBJECT, np.uint8))
    state = {"run": {"sigma_m": None}, "survey": {"kind": "lidar"}, "places": alike(1.0)}
    for name in ("densify", "label"):
        step = next(p for p in Auto().passes if p.name == name)
        for given, marked in ((window, True), (Window.everything(), False)):
            model = step.fit(cloud, given, given, SCALE, state)
            labels, marks = model.label(cloud)
            assert (labels == OBJECT).all()
            assert (marks == marked).all()


def test_image_matching_is_told_by_single_returns_and_what_is_not_seen_through() -> None:
    found = Roughness(8.0, 0.066, 50, 0.07)
    run = {"rgb": False, "sigma_m": None, "kind": None}
    survey, notes = decided(Auto(), found, ReturnStatistics(1000, 0, 500, 1), HELD, run)
    assert (survey["kind"], survey["cell_sigma_m"], survey["density_m2"]) == ("dim", 0.07, 8.0)
    assert notes == [
        "decided: image matching (88 % sure: no pulses passed through plants; "
        "returns, GPS times, angles and flight lines show no sensor); 8 points/m2, noise 0.07 m",
        "decided: ground is up to 0.15 m plus twice the local noise from the surface, after neighbours voted; "
        "noise of the place 0.07 m, cells of 1 m",
    ]
    assert (
        decided(Auto(), found, ReturnStatistics(0, 0, 500, 1), HELD, run)[0]["kind"] == "dim"
    )  # returns are not known
    for several, through, why in (
        (10, 0, "some pulses have several returns"),
        (1000, 0, "some pulses have several returns"),
        (0, 2, "pulses passed through plants in 0.4 % of the area"),
    ):
        survey, notes = decided(
            Auto(), found, ReturnStatistics(1000, several, 500, through), HELD, run
        )
        assert survey["kind"] == "lidar"
        assert notes[0].startswith("decided: laser scanning (")
        assert f"% sure: {why})" in notes[0]
    for density, seen, kind in (
        (
            3.9,
            ReturnStatistics(0, 0, 5000, 19, 2000, 99, 100),
            "dim",
        ),  # nearly 5 % of wide cells: walls and chance
        (3.9, ReturnStatistics(0, 0, 5000, 19, 2000, 100, 100), "lidar"),
        (3.9, ReturnStatistics(0, 0, 5000, 20, 2000, 0, 100), "lidar"),
        # next to nothing stands there
        (3.9, ReturnStatistics(0, 0, 5000, 0, 2000, 0, 99), "lidar"),
        (0.9, ReturnStatistics(0, 0, 5000, 0, 2000, 0, 100), "lidar"),
        # dense: wide cells have no say
        (4.0, ReturnStatistics(0, 0, 5000, 0, 2000, 110, 0), "dim"),
    ):
        for rgb in (False, True):  # colours have no part in it
            found, _ = decided(
                Auto(), Roughness(density, 0.066, 50, 0.07), seen, HELD, run | {"rgb": rgb}
            )
            assert found["kind"] == kind
    # below, few quarters of patches have enough points
    for density, noise in ((2.9, 0.066), (3.0, 0.1)):
        found = Roughness(density, 0.066, 50, 0.1)
        survey, _ = decided(
            Auto(), found, ReturnStatistics(0, 0, 0, 0), HELD, run | {"kind": "dim"}
        )
        assert survey["cell_sigma_m"] == noise


@pytest.mark.parametrize("kind", ["dim", "lidar"])
def test_what_the_user_says_of_the_source_is_obeyed(kind: str) -> None:
    for seen in (ReturnStatistics(1000, 500, 500, 100), ReturnStatistics(1000, 0, 500, 0)):
        run = {"rgb": True, "sigma_m": None, "kind": kind}
        survey, notes = decided(Auto(), Roughness(8.0, 0.066, 50, 0.07), seen, HELD, run)
        assert survey["kind"] == kind
        assert "given by --kind or the preset" in notes[0]


@pytest.mark.parametrize(
    ("density", "sigma", "floor", "slope"),
    [
        (0.7, 0.02, 0.24, 1.0),
        (1.5, 0.02, 0.18, 0.75),
        (2.0, 0.02, 0.12, 0.5),
        (9.0, 0.05, 0.2, 0.5),
        (9.0, 0.2, 0.24, 0.5),
        (9.0, None, 0.12, 0.5),
    ],
)
def test_the_last_pass_is_narrower_where_points_are_dense(
    density: float, sigma: float | None, floor: float, slope: float
) -> None:
    assert label_thresholds(Auto(), density, sigma) == pytest.approx((floor, slope))


@pytest.mark.parametrize(("said", "floor"), [(None, 0.12), (0.04, 0.17)])
def test_the_last_pass_allows_for_the_noise_that_the_user_says_alone(
    said: float | None, floor: float
) -> None:
    """A place has a noise of 0.09 m as measured."""
    state = {"run": {"sigma_m": said}, "places": alike(8.0, 0.09)}
    bands = label_bands(Auto(), state, SCALE)
    assert value_at(bands.floor, 5, -7) == pytest.approx(100 * floor)
    assert value_at(bands.per_slope, 5, -7) == pytest.approx(50)


def test_a_hall_wider_than_the_openings_is_no_ground() -> None:
    """60 m x 50 m, 8 m tall, on land that a ramp of 30 m leads up to as high beside it."""
    random = np.random.default_rng(3)
    x, y = 160 * random.random((2, 60_000))
    z = 0.02 * x
    ramp = (x > 120) & (y < 40)
    z[ramp] += np.clip((40 - y[ramp]) / 5, 0, 8)
    hall = (abs(x - 70) < 30) & (abs(y - 90) < 25)
    z[hall] = 9.4
    found = ptd.classify(np.stack([x, y, z], axis=1), "auto").classification == 2
    assert found[hall].mean() < 0.01
    assert found[~hall].mean() > 0.97


@pytest.mark.parametrize("parapet_m", [0.0, 1.2])
def test_two_flat_roofs_that_differ_by_little_are_no_ground(parapet_m: float) -> None:
    """56 m wide, 10 m tall, with a parapet, and an annexe 1.2 m lower: neither is terrain for the other."""
    random = np.random.default_rng(1)
    x, y = 200 * random.random((2, 120_000))
    u, v = abs(x - 100), abs(y - 100)
    z, roof = 0.01 * x, np.maximum(u, v) < 28
    z[roof] = 11.0
    z[roof & (np.maximum(u, v) > 27.5)] += parapet_m
    annexe = (abs(x - 140) < 12) & (v < 28)
    z[annexe] = 9.8
    found = ptd.classify(np.stack([x, y, z], axis=1), "auto", kind="lidar").classification == 2
    assert found[roof | annexe].mean() < 0.01
    assert found[~(roof | annexe)].mean() > 0.99


@pytest.mark.parametrize("tiers_m", [(12.0, 8.0, 4.0), (4.0, 8.0, 12.0, 8.0, 4.0)])
def test_tiers_of_roofs_are_no_ground(tiers_m: tuple[float, ...]) -> None:
    """Each is 100 m x 45 m and leans on a higher one, so that each search takes out one more."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 220, 160_000), rng.uniform(0, 120 + 45 * len(tiers_m), 160_000)
    tier = np.floor((y - 60) / 45).astype(int)
    roof = (abs(x - 110) < 50) & (tier >= 0) & (tier < len(tiers_m))
    z = rng.normal(0, 0.02, x.size)
    z[roof] += np.array(tiers_m)[tier[roof]]
    found = ptd.classify(np.stack([x, y, z], axis=1), "auto", kind="lidar").classification == 2
    assert found[roof].mean() < 0.01
    assert found[~roof].mean() > 0.99


def hall_with_ramp(side_m: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """A hall of twice this length, a ramp that ends at its wall, where there is no ground, and a terrace as high."""
    rng = np.random.default_rng(8)
    x, y = rng.uniform(0, 200, (2, 160_000))
    z = 0.02 * x + rng.normal(0, 0.02, x.size)
    parts = {
        "hall": (abs(x - 100) < side_m) & (abs(y - 120) < 25),
        "ramp": (abs(x - 100) < 0.4 * side_m) & (y > 87) & (y <= 95),
        "terrace": y >= 145,
    }
    z[parts["hall"]] = 10.0
    z[parts["ramp"] | parts["terrace"]] += 1.4
    return np.stack([x, y, z], axis=1), parts


@pytest.mark.parametrize("side_m", [60.0, 24.0])
def test_a_ramp_beside_a_hall_is_no_ground_but_a_terrace_is(side_m: float) -> None:
    """The terrace is wider than an object."""
    xyz, parts = hall_with_ramp(side_m)
    result = ptd.classify(xyz, "auto", kind="lidar")
    is_ground = result.classification == 2
    assert is_ground[parts["hall"]].mean() == 0
    assert is_ground[parts["ramp"]].mean() < 0.02
    assert is_ground[parts["terrace"]].mean() > 0.97
    assert is_ground[~np.any(list(parts.values()), axis=0)].mean() > 0.99
    assert result.stats["annexes"]["annexes"] > 100


def halls_with_parts() -> np.ndarray:
    """Four halls on rolling land, and 60 blocks of 0.2 to 1.6 m, some of which lean on a hall: metres."""
    rng = np.random.default_rng(8)
    x, y = rng.uniform(0, 240, (2, 200_000))
    z = 1.5 * np.sin(x / 15) * np.cos(y / 19) + rng.normal(0, 0.03, x.size)
    halls = (abs(abs(x - 120) - 55) < 25) & (abs(abs(y - 120) - 55) < 25)
    for _ in range(60):
        east, north = rng.uniform(20, 220, 2)
        block = (abs(x - east) < rng.uniform(1, 8)) & (abs(y - north) < rng.uniform(1, 8))
        z[block] += rng.uniform(0.2, 1.6)
    z[halls] = 12
    return np.stack([x, y, z], axis=1)


def test_annexes_do_not_depend_on_tiles() -> None:
    """The pass sees exactly its reach around each tile. With less than a third, some points would differ."""
    cloud = Points(np.rint(halls_with_parts().T / float(SCALE.metres_xy)).astype(np.int32))

    class Before(Auto):
        passes = tuple(step for step in Auto().passes if step.name in RASTERS[:-1])

    class Annexes(Before):
        passes = tuple(step for step in Auto().passes if step.name in RASTERS)

    before, _, _ = classify_tiled(cloud, SCALE, Before(), None, kind="lidar")
    whole, _, _ = classify_tiled(cloud, SCALE, Annexes(), None, kind="lidar")
    tiled, marks, _ = classify_tiled(cloud, SCALE, Annexes(), 40.0, kind="lidar")
    assert np.count_nonzero((whole == ROOF) & (before != ROOF)) > 500
    assert not marks.any()
    assert np.array_equal(tiled, whole)


def test_the_decision_reaches_the_result() -> None:
    xyz, _ = scene(4000)
    result = ptd.classify(xyz, "auto", sigma=0.2, kind="dim")
    statistics = result.decisions["statistics"]
    assert (statistics["survey"]["kind"], statistics["survey"]["cell_sigma_m"]) == ("dim", 0.2)
    assert len(statistics["notes"]) == 2
    assert list(result.stats) == [
        "survey",
        "cells",
        "objects",
        "inner-objects",
        "canopy",
        "surface",
    ]


def test_reaches_are_those_of_the_rules() -> None:
    assert Auto().noise_reach == 4 * 3 + 5 + 2
    assert Auto().seed_reach == 2 * 18 + 2 * 9 + 5
    assert Auto().summit_reach == 18 + 3 + 8 + 2
    assert Auto().refine_reach == 20 + 2 * 6 + 15 + 2 * 6 + 2
    assert Auto().roof_reach == 2 * (100 + 12 + 1 + 1)
    assert Auto().annex_reach == 2 * (20 + 2 * 6)
    assert {step.name: step.influence_radius_m for step in Auto().passes} == {
        "survey": 24.0,
        "noise": 20.0,
        "seeds": 60.0,
        "summits": 32.0,
        "densify": None,
        "refine": 62.0,
        "roofs": 229.0,
        "roofs2": 229.0,
        "roofs3": 229.0,
        "roofs4": 229.0,
        "treetops": 181.0,
        "annexes": 65.0,
        "label": None,
        "cells": 4.0,
        "objects": 324.0,
        "inner-objects": 324.0,
        "canopy": 664.0,
        "surface": 678.0,
    }


@pytest.mark.parametrize("name", list(SCENES))
def test_tiles_agree_with_the_whole_and_marks_fall_with_the_halo(name: str) -> None:
    points = Points(SCENES[name](np.random.default_rng(11)))
    truth, marks, state = classify_tiled(points, SCALE, SMALL, None, kind="lidar")
    assert not marks.any()
    shares = []
    for halo in (40.0, 120.0):
        labels, marks, tiled = classify_tiled(points, SCALE, SMALL, 70.0, halo, kind="lidar")
        assert tiled == state
        assert np.array_equal(labels[~marks], truth[~marks])
        shares.append(marks.mean())
    assert shares[0] >= shares[1]
    assert shares[1] < 0.02


@pytest.mark.parametrize("tile_m", [33.0, 50.0])
@pytest.mark.parametrize("thin_cell_m", [0.7, 2.0])
def test_a_fixed_reach_leaves_no_mark_and_no_difference(
    tile_m: float, thin_cell_m: float
) -> None:
    """Each raster pass on tiles: cells that nest neither in tiles nor in one another."""
    cloud = SCENES["hills_with_houses"](np.random.default_rng(5))
    params = replace(SMALL, thin_cell_m=thin_cell_m)

    class Until:
        align_m, margin_m, candidate_cell_m = params.align_m, params.margin_m, thin_cell_m
        passes = params.passes[:4]

    truth, _, state = classify_tiled(Points(cloud), SCALE, Until, None, kind="lidar")
    labels, marks, tiled = classify_tiled(Points(cloud), SCALE, Until, tile_m, kind="lidar")
    assert not marks.any()
    assert np.array_equal(labels, truth)
    assert tiled == state

    class Refine(Until):
        passes = (*params.passes[:4], *params.passes[5:7], *params.passes[10:12])

    truth, _, _ = classify_tiled(Points(cloud), SCALE, Refine, None, kind="lidar")
    labels, marks, _ = classify_tiled(Points(cloud), SCALE, Refine, tile_m, kind="lidar")
    assert not marks.any()
    assert np.array_equal(labels, truth)
    assert 0.1 < (labels == 2).mean() < 0.95


def test_blocks_change_no_label(monkeypatch: pytest.MonkeyPatch) -> None:
    cloud = Points(SCENES["voids"](np.random.default_rng(2)))
    truth, _, _ = classify_tiled(cloud, SCALE, SMALL, None, kind="lidar")
    monkeypatch.setattr(morphology, "BLOCK_CELLS", 16)
    assert np.array_equal(classify_tiled(cloud, SCALE, SMALL, None, kind="lidar")[0], truth)
