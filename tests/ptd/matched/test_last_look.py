"""The last look at points of matched clouds: a slow twin of its features, its limits, its reach."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import ptd
from ptd.frame import CellLattice, Scale
from ptd.matched import last_look
from ptd.matched.last_look import (
    CELL_FEATURES,
    FEATURES,
    NO_GROUND_MM,
    REACH_M,
    Around,
    DecisionTrees,
    Heights,
)
from ptd.methods.auto.method import Auto
from tests.scenes.village import village

GROUND, UNCLASSIFIED, LOW_NOISE = 2, 1, 7
COLUMNS = 1 + len(CELL_FEATURES)


def scene(seed: int, n: int = 900, side_m: float = 12.0) -> Heights:
    rng = np.random.default_rng(seed)
    x, y = rng.integers(-round(500 * side_m), round(500 * side_m), (2, n)).astype(np.int32)
    voted = np.where(rng.random(n) < 0.7, rng.normal(0, 100, n), rng.uniform(-2000, 2000, n))
    voted = voted.astype(np.int32)
    own = np.clip(voted + rng.integers(-60, 60, n), -2000, 2000).astype(np.int32)
    labels = np.where(
        abs(voted) < 150, GROUND, np.where(voted < -1500, LOW_NOISE, UNCLASSIFIED)
    )
    return Heights(x, y, own, voted, labels.astype(np.uint8))


def surroundings(seed: int, cells: int) -> Around:
    rng = np.random.default_rng(seed)
    return Around(rng.integers(1, 900, (cells, COLUMNS)).astype(np.int32), cells)


def thousandths(which: np.ndarray) -> int:
    return 1000 * int(which.sum()) // which.size


def slow_window(heights: Heights, near: np.ndarray, voted: int) -> list[int]:
    v = heights.voted[near].astype(np.int64)
    spread = np.sqrt(max((v**2).sum() / v.size - (v.sum() / v.size) ** 2, 0.0))
    ground = heights.labels[near] == GROUND
    above = (
        int(np.floor(voted - v[ground].sum() / ground.sum())) if ground.any() else NO_GROUND_MM
    )
    return [thousandths(ground), int(np.floor(v.sum() / v.size)), int(np.floor(spread)), above]


def slow_features(
    heights: Heights, cell: np.ndarray, around: Around, scale: Scale
) -> dict[int, list[int]]:
    columns, rows = CellLattice.of(0.25, scale).cell_indices(heights.x, heights.y)
    found = {}
    for k in range(heights.x.size):
        ground, v = heights.labels[k] == GROUND, int(heights.voted[k])
        if not (ground or (heights.labels[k] == UNCLASSIFIED and abs(v) < 500)):
            continue
        away = np.maximum(abs(columns - columns[k]), abs(rows - rows[k]))
        r = next((r for r in range(1, 5) if (away <= r).sum() >= 20), 5)
        narrow, wide = (
            slow_window(heights, away <= r, v),
            slow_window(heights, away <= 2 * r, v),
        )
        near = heights.voted[away <= r]
        plants = [thousandths((near > 200) & (near < 1000)), thousandths(near >= 1000)]
        of_ground = heights.labels[away <= 2 * r] == GROUND
        if of_ground.all() if ground else not of_ground.any():
            continue
        band, *rest = around.features[cell[k]].tolist()
        found[k] = [
            v,
            int(heights.own[k]) - v,
            int(np.floor(1000.0 * v / band)),
            *narrow,
            *wide,
            *plants,
            *rest,
        ]
    return found


@pytest.mark.parametrize("n", [60, 900])
@pytest.mark.parametrize(
    "scale", [Scale(), Scale(Fraction(1, 1000), Fraction(1, 1000), (640_123, -64_321))]
)
def test_a_slow_search_finds_the_same_features(n: int, scale: Scale) -> None:
    heights, around = scene(1, n), surroundings(2, 40)
    cell = np.random.default_rng(3).integers(0, 40, n).astype(np.int32)
    expected = slow_features(heights, cell, around, scale)
    blocks = list(last_look.features_by_block(heights, cell, around, scale))
    found = {
        int(k): row.tolist()
        for index, rows in blocks
        for k, row in zip(index, rows, strict=True)
    }
    assert len(found) == sum(len(index) for index, _ in blocks) > 10
    assert found == expected
    assert len(next(iter(found.values()))) == len(FEATURES)


def by_ground_share(limit: int) -> DecisionTrees:
    """One tree: ground where the share of ground in the narrow window is above a limit."""
    leaf = np.array([-(2**17)] * 4 + [2**17] * 4, np.int32)
    return DecisionTrees(np.full(7, 3, np.int32), np.array([limit] + [0] * 6, np.int32), leaf)


def look(heights: Heights, limit: int = 500, scale: Scale | None = None) -> np.ndarray:
    cell = np.zeros(heights.x.size, np.int32)
    return last_look.relabelled(
        heights, cell, surroundings(2, 1), scale or Scale(), by_ground_share(limit)
    )


def test_low_noise_and_what_lies_far_from_the_surface_stay() -> None:
    heights = scene(4, 3000)
    labels = look(heights)
    changed = labels != heights.labels
    assert (changed & (labels == GROUND)).any()
    assert (changed & (labels == UNCLASSIFIED)).any()
    assert not changed[heights.labels == LOW_NOISE].any()
    assert not changed[(heights.labels != GROUND) & (abs(heights.voted) >= 500)].any()


def test_nothing_farther_than_the_reach_has_a_part() -> None:
    heights = scene(5, 6000, 40.0)
    whole, east = look(heights), heights.x < 3000
    seen = heights.x < 3000 + 1000 * REACH_M
    part = Heights(
        *(
            column[seen]
            for column in (heights.x, heights.y, heights.own, heights.voted, heights.labels)
        )
    )
    assert np.array_equal(look(part)[east[seen]], whole[east])
    assert (whole != heights.labels)[east].any()


def test_the_order_of_points_changes_nothing() -> None:
    heights = scene(6, 2000)
    order = np.random.default_rng(0).permutation(2000)
    mixed = Heights(
        *(
            column[order]
            for column in (heights.x, heights.y, heights.own, heights.voted, heights.labels)
        )
    )
    assert np.array_equal(look(mixed), look(heights)[order])


def test_heights_are_cut_off_and_missing_ones_are_high() -> None:
    x = np.zeros(5, np.int32)
    metres = np.array([np.nan, 7.0, -7.0, 0.0126, -1.9996])
    heights = Heights.of(x, x, metres, metres, x.astype(np.uint8))
    assert heights.own.tolist() == [2000, 2000, -2000, 13, -2000]


def test_the_parameter_turns_it_off() -> None:
    xyz, truth = village()
    plants = np.hypot(xyz[:, 0] - 50.0, xyz[:, 1] - 80.0) < 6.0
    xyz[plants, 2] += np.random.default_rng(5).uniform(0.0, 0.6, plants.sum())
    truth[plants] = 3
    with_look, without = (
        ptd.classify(xyz, "auto", Auto(refine=refine), kind="dim").classification
        for refine in (True, False)
    )
    changed = with_look != without
    assert 0 < changed.mean() < 0.05
    assert not changed[without == LOW_NOISE].any()
    right = (with_look == GROUND) == (truth == GROUND)
    assert right.mean() > 0.98
