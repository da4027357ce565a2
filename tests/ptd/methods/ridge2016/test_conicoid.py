"""The t-test of the conicoid, compared with numpy's least squares and with results by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay
from scipy.stats import t as student

from ptd.frame import Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.methods.ridge2016.conicoid import conicoid_outliers
from ptd.tin.mesh import Tin

EVERYTHING = Window.everything()
NONE = np.zeros(0, np.bool_)
STEP = 20_000


def judge(
    xyz: np.ndarray, confidence: float = 0.98, least: float = 0.0, data: np.ndarray = NONE
) -> set[tuple[int, int]]:
    """Positions of the contradicted seeds among points [n, 3]; `data` is False for virtual seeds."""
    tin = Tin.build(*xyz.T.astype(np.int32))
    flags = np.ones(len(xyz), np.bool_) if data.size == 0 else data
    real = {(int(x), int(y)) for x, y in xyz[flags][:, :2]}
    vertices = np.array([(int(x), int(y)) in real for x, y, _ in tin.vertices])
    region = UncertifiedRegion(EVERYTHING, EVERYTHING, (0, 0, 1, 1), Scale())
    wrong = conicoid_outliers(tin, vertices, float(STEP), confidence, least, region)
    return {(int(x), int(y)) for x, y, _ in tin.vertices[wrong]}


def reference(xyz: np.ndarray, confidence: float, data: np.ndarray) -> set[tuple[int, int]]:
    """Equations 3-10 with Qhull, numpy and scipy's distribution."""
    indptr, indices = Delaunay(xyz[:, :2].astype(float)).vertex_neighbor_vertices
    around = [
        {int(k) for k in indices[indptr[v] : indptr[v + 1]] if data[k]} for v in range(len(xyz))
    ]
    found = set()
    for v in np.flatnonzero(data):
        near = set().union(around[v], *(around[k] for k in around[v])) - {int(v)}
        if len(near) < 10:
            continue
        rows = [int(v), *near]
        x, y, z = ((xyz[rows] - xyz[v]) / STEP).T
        design = np.column_stack([np.ones(len(rows)), x, y, x * x, x * y, y * y])
        hat = design @ np.linalg.pinv(design)
        residuals = hat @ z - z
        freedom = len(rows) - 6 - 1
        sigma = np.sqrt((residuals**2).sum() / freedom)
        if abs(residuals[0]) / (sigma * np.sqrt(1 - hat[0, 0])) > student.ppf(
            (1 + confidence) / 2, freedom
        ):
            found.add((int(xyz[v, 0]), int(xyz[v, 1])))
    return found


def hill(seed: int, rough: float, n: int = 9) -> np.ndarray:
    """n x n seeds about a step apart on a conicoid with noise, counts."""
    rng = np.random.default_rng(seed)
    xy = np.stack(np.meshgrid(np.arange(n), np.arange(n))).reshape(2, -1) * STEP
    x, y = xy = xy + rng.integers(-STEP // 3, STEP // 3, xy.shape)
    u, v = x / STEP, y / STEP
    z = 1000 * (50 + 3 * u - 2 * v + 0.3 * u * u - 0.2 * u * v + 0.4 * v * v) + rng.normal(
        0, rough, x.size
    )
    return np.column_stack([x, y, np.rint(z)]).astype(np.int64)


def test_a_seed_on_a_roof_or_in_a_pit_is_rejected_and_its_neighbours_on_the_roof_are_kept() -> (
    None
):
    """The seed lies five metres above ground that is even to 5 cm; seeds whose fits it spoils pass."""
    for height in (5000, -5000):
        points = hill(3, 50.0)
        points[40, 2] += height
        odd = {(int(points[40, 0]), int(points[40, 1]))}
        assert judge(points) == odd if height > 0 else judge(points) >= odd


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rough=st.sampled_from([20.0, 500.0]),
    confidence=st.sampled_from([0.7, 0.9, 0.98]),
    virtual=st.booleans(),
    blunders=st.integers(0, 3),
)
def test_results_equal_those_of_numpy(
    seed: int, rough: float, confidence: float, virtual: bool, blunders: int
) -> None:
    points = hill(seed, rough)
    rng = np.random.default_rng(seed + 1)
    points[rng.integers(0, len(points), blunders), 2] += 3000
    data = np.ones(len(points), np.bool_)
    if virtual:
        data[rng.integers(0, len(points), 15)] = False
    assert judge(points, confidence, data=data) == reference(points, confidence, data)


def test_order_and_place_change_no_bit() -> None:
    """This includes borderline seeds: every seed at a confidence of one half."""
    points = hill(5, 300.0)
    whole = judge(points, 0.5)
    assert len(whole) > 20
    order = np.random.default_rng(0).permutation(len(points))
    assert judge(points[order], 0.5) == whole
    moved = judge(points[order] + np.array([7_000_001, -3_000_017, 123]), 0.5)
    assert moved == {(x + 7_000_001, y - 3_000_017) for x, y in whole}


def fan(n: int, height: int) -> np.ndarray:
    """A seed in the middle of n others on a circle, at another height."""
    angle = 2 * np.pi * (np.arange(n) + 0.3) / n
    ring = np.column_stack([STEP * np.cos(angle), STEP * np.sin(angle), np.arange(n) % 2 * 100])
    return np.rint(np.vstack([[0, 0, height], ring])).astype(np.int64)


def test_fewer_than_ten_neighbours_reject_nothing() -> None:
    assert judge(fan(9, 90_000), 0.5) == set()


def test_neighbours_on_one_conic_reject_nothing() -> None:
    """For 16 points on a circle, x2 + y2 is constant. The middle alone determines it and has no residual."""
    assert (0, 0) not in judge(fan(16, 90_000), 0.5)


def test_an_undetermined_conicoid_rejects_nothing() -> None:
    """For two rows, y2 is a multiple of y."""
    points = np.array(
        [(x * STEP, y * STEP, 100 * (x * 7919 % 13)) for x in range(12) for y in (0, 1)]
    )
    assert judge(points, 0.5) == set()


def test_no_seed_on_exact_ground_is_rejected() -> None:
    """All residuals come from rounding to counts."""
    assert (
        judge(np.array([(x * STEP, y * STEP, 0) for x in range(8) for y in range(8)]), 0.5)
        == set()
    )


def test_confidence_and_least_residual() -> None:
    points = hill(3, 50.0)
    points[40, 2] += 5000
    assert judge(points, 1.0) == set()
    assert judge(points, 0.98, least=6000.0) == set()
    assert len(judge(points, 0.98, least=3000.0)) == 1


@pytest.mark.parametrize("n", [15, 16])
def test_fifteen_observations_cannot_reject_at_98_percent(n: int) -> None:
    """A normalised residual is at most the root of n - 7: 2.83 < 2.90 for 15 observations, 3 > 2.82 for 16."""
    bound, limit = np.sqrt(n - 7), student.ppf(0.99, n - 7)
    assert (bound > limit) == (n == 16)


def test_seeds_within_reach_of_the_uncertified_region_are_uncertified() -> None:
    points = hill(3, 50.0, 15).astype(np.int32)
    tin = Tin.build(*points.T)
    known = Window(-STEP, -STEP, 15 * STEP, 15 * STEP)
    region = UncertifiedRegion(known, known, (-STEP, -STEP, 15 * STEP, 15 * STEP), Scale())
    conicoid_outliers(tin, np.ones(tin.n_vertices, np.bool_), float(STEP), 0.98, 0.0, region)
    x, y = (np.array([v], np.int32) for v in points[7 * 15 + 7, :2])
    assert not region.covers(x, y).any()
    for place in (15 * 1 + 7, 15 * 7 + 13):
        x, y = (np.array([v], np.int32) for v in points[place, :2])
        assert region.covers(x, y).all()
