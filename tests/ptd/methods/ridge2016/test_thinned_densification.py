"""Densification with one vertex per cell, compared with a naive version and by hand."""

from __future__ import annotations

from itertools import islice

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.criteria import FacetLimits
from ptd.ground.labelling import LabelRule, label_points
from ptd.methods.ridge2016.ridges import Stacks
from ptd.methods.ridge2016.thinned_densification import GrowthCounter, densify_thinned
from ptd.tin.mesh import Locator, Tin
from tests.scenes.densification import CORNERS, EVERYTHING, passes, scene

Points = list[tuple[int, ...]]


def tins(
    points: np.ndarray, n_seeds: int, limits: FacetLimits, rounds: int, cell_m: float
) -> tuple[list[Tin], Stacks]:
    """The TINs of several rounds; the first points are the seeds, `CORNERS` the virtual ones."""
    x, y, z = np.ascontiguousarray(points.T.astype(np.int32))
    stacks = Stacks(x, y, z, CellLattice.of(cell_m, Scale()))
    seeds = {tuple(p) for p in points[:n_seeds].tolist()}
    own = np.array(
        [tuple(p) in seeds for p in np.column_stack([stacks.x, stacks.y, stacks.z]).tolist()]
    )
    region = UncertifiedRegion(EVERYTHING, EVERYTHING, (0, 0, 1, 1), Scale())
    chosen = np.flatnonzero(own).astype(np.int32)
    steps = densify_thinned(stacks, chosen, CORNERS.astype(np.int32), limits, region)
    return [step.tin for step in islice(steps, rounds)], stacks


def rows(tin: Tin) -> set[tuple[int, ...]]:
    return {tuple(v) for v in tin.vertices.tolist()} - {tuple(v) for v in CORNERS.tolist()}


def naive(
    points: np.ndarray, n_seeds: int, limits: FacetLimits, rounds: int, cell_m: float
) -> list[set[tuple[int, ...]]]:
    """Vertices of each round's TIN: steps 2 to 4 of section 2.3, point by point."""
    vertices = {tuple(p) for p in points[:n_seeds].tolist()}
    found = [vertices]
    while len(found) < rounds:
        nodes = np.array([*CORNERS.tolist(), *sorted(vertices)], float)
        mesh = Delaunay(nodes[:, :2])
        passed = (p for p in points.tolist() if passes(nodes, mesh, np.array(p, float), limits))
        terrain = vertices | set(map(tuple, passed))
        lowest: dict[tuple[int, int], tuple[int, ...]] = {}
        for p in sorted(terrain, key=lambda p: (p[2], p[0], p[1])):
            lowest.setdefault((int(p[0] // (cell_m * 1000)), int(p[1] // (cell_m * 1000))), p)
        if set(lowest.values()) == vertices:
            break
        vertices = set(lowest.values())
        found.append(vertices)
    return found


@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rough=st.sampled_from([50, 800, 4000]),
    rounds=st.sampled_from([2, 5]),
    angle=st.sampled_from([8.0, 25.0, 50.0]),
    cell=st.sampled_from([3.0, 15.0]),
)
def test_the_vertices_are_those_of_the_naive_way(
    seed: int, rough: int, rounds: int, angle: float, cell: float
) -> None:
    seeds, others = scene(seed, 60, rough)
    points = np.unique(np.vstack([seeds[4:], others]), axis=0)
    np.random.default_rng(seed).shuffle(points)
    limits = FacetLimits.of(
        Scale(), distance_m=4.0, angle_deg=angle, terrain_deg=88.0, reduce_m=5.0
    )
    got, _ = tins(points, 5, limits, rounds, cell)
    assert [rows(t) for t in got] == naive(points, 5, limits, rounds, cell)


def figure_5(cell_m: float) -> list[Points]:
    """Level ground with two points in one cell: A 1 m below the TIN, B 1.8 m; the limit is 1.4 m.

    The result holds the vertices of the first three rounds, without seeds.
    """
    ring: Points = [
        (x, y, 0) for x, y in ((2000, 2000), (98_000, 2000), (2000, 98_000), (98_000, 98_000))
    ]
    a, b = (50_300, 50_300, -1000), (50_600, 50_400, -1800)
    limits = FacetLimits.of(Scale(), distance_m=1.4, angle_deg=80.0, terrain_deg=88.0)
    got, _ = tins(np.array([*ring, a, b]), 4, limits, 5, cell_m)
    return [sorted(rows(t) - set(ring)) for t in got]


def test_a_higher_point_of_a_cell_makes_the_lowest_reachable() -> None:
    """Figure 5: a thinned cloud has only B, which never passes; here A passes, then B from A's facets."""
    assert figure_5(1.0) == [[], [(50_300, 50_300, -1000)], [(50_600, 50_400, -1800)]]


def test_close_points_of_different_cells_stay() -> None:
    a, b = (50_300, 50_300, -1000), (50_600, 50_400, -1800)
    assert figure_5(0.2) == [[], [a], [a, b]]


def test_at_most_one_vertex_a_cell() -> None:
    """Equation 12."""
    seeds, others = scene(3, 4000, 300)
    points = np.unique(np.vstack([seeds[4:], others]), axis=0)
    limits = FacetLimits.of(Scale(), distance_m=4.0, angle_deg=60.0, terrain_deg=88.0)
    got, _ = tins(points, 5, limits, 6, 4.0)
    cells = [(x // 4000, y // 4000) for x, y, _ in rows(got[-1])]
    assert 400 < len(cells) == len(set(cells)) <= 25 * 25


def test_the_tally_counts_what_labelling_gives() -> None:
    """The counts agree in each round, though only changed triangles are labelled again."""
    for step, steep in ((1, 88.0), (1, 15.0), (2500, 88.0)):
        seeds, others = scene(11, 3000, 900)
        points = np.unique(
            np.vstack([seeds[4:], others]) // [step, step, 1] * [step, step, 1], axis=0
        )
        limits = FacetLimits.of(
            Scale(), distance_m=4.0, angle_deg=25.0, terrain_deg=steep, reduce_m=5.0
        )
        got, stacks = tins(points, 40, limits, 7, 2.0)
        assert len(got) >= 5
        x, y, z = stacks.x, stacks.y, stacks.z
        tally = GrowthCounter(x, y, z, limits, 200.0, np.zeros(x.size, np.bool_))
        before, counts = np.zeros(x.size, np.uint8), []
        for tin in got:
            clear = np.zeros(tin.n_triangles, np.uint8)
            labels, _ = label_points(
                tin, Locator.of(tin), Xyz(x, y, z), clear, LabelRule(limits, 200.0)
            )
            counts.append(tally.count(tin, clear))
            assert counts[-1] == (((labels == 2) & (before != 2)).sum(), 0)
            before = labels
        assert counts[0] > counts[2] > counts[4]


def test_the_tally_counts_what_is_uncertified() -> None:
    seeds, others = scene(11, 500, 900)
    points = np.unique(np.vstack([seeds[4:], others]), axis=0)
    limits = FacetLimits.of(Scale(), distance_m=4.0, angle_deg=25.0, terrain_deg=88.0)
    (tin,), stacks = tins(points, 40, limits, 1, 2.0)
    uncertified = (np.arange(tin.n_triangles) % 3 == 0).astype(np.uint8)
    # On a vertex, the search may end in any of its triangles.
    off = [
        p not in rows(tin)
        for p in zip(stacks.x.tolist(), stacks.y.tolist(), stacks.z.tolist(), strict=True)
    ]
    x, y, z = stacks.x[off], stacks.y[off], stacks.z[off]
    _, marked = label_points(
        tin, Locator.of(tin), Xyz(x, y, z), uncertified, LabelRule(limits, 0.0)
    )
    tally = GrowthCounter(x, y, z, limits, 0.0, np.zeros(x.size, np.bool_))
    assert (
        tally.count(tin, uncertified)[1] == tally.count(tin, uncertified)[1] == marked.sum() > 0
    )
