"""Rounds of densification against the naive way: Qhull, and every candidate tested in every round."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ptd.cells import Xyz
from ptd.frame import Scale
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.criteria import FacetLimits
from ptd.ground.densify import REFUSED, VERTEX, densify
from ptd.tin.mesh import Tin
from tests.ptd.tin.meshes import real_triangles
from tests.scenes.densification import EVERYTHING, naive, scene


def run(
    seeds: np.ndarray, candidates: np.ndarray, limits: FacetLimits, rounds: int
) -> tuple[np.ndarray, Tin, int]:
    tin = Tin.build(*seeds.T, max_vertices=len(seeds) + len(candidates))
    x, y, z = np.ascontiguousarray(candidates.T.astype(np.int32))
    state = np.zeros(x.size, np.uint8)
    region = UncertifiedRegion(EVERYTHING, EVERYTHING, (0, 0, 1, 1), Scale())
    is_uncertified, done = densify(tin, Xyz(x, y, z), state, limits, rounds, region)
    assert not is_uncertified.any()
    return state == VERTEX, tin, done


@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rough=st.sampled_from([50, 800, 4000]),
    rounds=st.sampled_from([0, 1, 2, 5]),
    angle=st.sampled_from([8.0, 25.0, 50.0]),
    terrain=st.sampled_from([5.0, 20.0, 88.0]),
    reduce=st.sampled_from([0.0, 15.0]),
    stop=st.sampled_from([0.0, 4.0]),
)
def test_the_vertices_are_those_of_the_naive_way(
    seed: int, rough: int, rounds: int, angle: float, terrain: float, reduce: float, stop: float
) -> None:
    seeds, candidates = scene(seed, 80, rough)
    edges = {"reduce_m": reduce, "stop_m": stop}
    limits = FacetLimits.of(
        Scale(), distance_m=4.0, angle_deg=angle, terrain_deg=terrain, **edges
    )
    got, tin, _ = run(seeds, candidates, limits, rounds)
    assert np.array_equal(got, naive(seeds, candidates, limits, rounds))
    assert tin.n_vertices == len(seeds) + got.sum()


LIMITS = FacetLimits.of(Scale(), distance_m=4.0, angle_deg=25.0, terrain_deg=20.0)


def test_stamps_skip_no_test() -> None:
    """A second run on the TIN of the first starts by testing everything: nothing more passes."""
    rng = np.random.default_rng(3)
    for step in (1, 500):
        seeds, candidates = scene(7, 3000, 900)
        candidates = np.unique(candidates // step * step, axis=0)
        rng.shuffle(candidates)
        got, tin, done = run(seeds, candidates, LIMITS, 0)
        assert done > 5
        assert 100 < got.sum() < len(candidates)
        more, _, again = run(np.vstack([seeds, candidates[got]]), candidates[~got], LIMITS, 0)
        assert not more.any()
        assert again == 1


@pytest.mark.parametrize("step", [1, 500, 2000])
def test_the_order_of_the_candidates_changes_nothing(step: int) -> None:
    seeds, candidates = scene(11, 800, 900)
    candidates = candidates // step * step
    order = np.random.default_rng(0).permutation(len(candidates))
    one, tin, _ = run(seeds, candidates, LIMITS, 4)
    other, shuffled, _ = run(seeds, candidates[order], LIMITS, 4)
    assert np.array_equal(one[order], other)
    assert np.array_equal(
        tin.vertices[real_triangles(tin)], shuffled.vertices[real_triangles(shuffled)]
    )


def test_refused_candidates_stay_out() -> None:
    seeds, candidates = scene(2, 50, 50)
    tin = Tin.build(*seeds.T, max_vertices=100)
    x, y, z = np.ascontiguousarray(candidates.T.astype(np.int32))
    state = np.full(x.size, REFUSED, np.uint8)
    region = UncertifiedRegion(EVERYTHING, EVERYTHING, (0, 0, 1, 1), Scale())
    assert densify(tin, Xyz(x, y, z), state, LIMITS, 0, region)[1] == 1
    assert tin.n_vertices == len(seeds)
    assert (state == REFUSED).all()


class Spreading(UncertifiedRegion):
    """Report three times that the region has grown."""

    left = 3

    def add_points(self, x: np.ndarray, y: np.ndarray, which: np.ndarray) -> bool:
        self.left -= 1
        return self.left >= 0


@pytest.mark.parametrize(("rounds", "done"), [(0, 4), (2, 2)])
def test_while_the_uncertified_region_grows_there_are_rounds_though_nothing_passes(
    rounds: int, done: int
) -> None:
    seeds, _ = scene(2, 50, 50)
    tin = Tin.build(*seeds.T, max_vertices=100)
    x, y, z = (np.array([v], np.int32) for v in (50_000, 50_000, 90_000))
    region = Spreading(EVERYTHING, EVERYTHING, (0, 0, 1, 1), Scale())
    assert densify(tin, Xyz(x, y, z), np.zeros(1, np.uint8), LIMITS, rounds, region)[1] == done
