"""The fine surface of dense laser scans: what it keeps and takes out, its slow twin, and how far it sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from ptd.cells import Xyz
from ptd.frame import Scale
from ptd.ground import fine_planes
from ptd.ground import fine_surface as fine
from ptd.ground.fine_surface import fine_ground
from ptd.ground.labelling import CROP, FAR, NEAR, ON

SCALE = Scale(origin=(123_456, -98_765))


@dataclass
class Cloud:
    """Points in metres, their heights above a level TIN at 0, and what that takes for ground."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray

    def points(self, which: np.ndarray) -> Xyz:
        return Xyz(
            *(np.round(1000 * c[which]).astype(np.int32) for c in (self.x, self.y, self.z))
        )

    def judged(
        self, which: np.ndarray | None = None, marked: np.ndarray | None = None
    ) -> tuple:
        which = np.arange(self.x.size) if which is None else which
        z = np.round(1000 * self.z[which]) / 1000
        close = (abs(z) <= 0.4).astype(np.uint8) * CROP
        close[abs(z) <= 0.2], close[abs(z) <= 0.1] = NEAR, ON
        marked = np.zeros(which.size, bool) if marked is None else marked[which]
        return fine_ground(self.points(which), close, abs(z) <= 0.12, marked, SCALE)


def cloud(density_m2: float, seed: int = 1, side_m: float = 40.0) -> Cloud:
    """Rough ground with waves, tufts of grass, a kerb, and crops in a corner."""
    random = np.random.default_rng(seed)
    x, y = random.uniform(-side_m / 2, side_m / 2, (2, int(density_m2 * side_m**2)))
    z = 0.08 * np.sin(1.7 * x) * np.cos(1.3 * y) + 0.08 + random.normal(0, 0.02, x.size)
    tufts = np.sin(3 * x) + np.sin(3 * y + 1) > 1.2
    z[tufts] += random.uniform(0, 0.4, int(tufts.sum()))
    z[x > 12] += 0.1
    crops = (x < -8) & (y < -8)
    z[crops] += random.uniform(0, 0.5, int(crops.sum()))
    return Cloud(x, y, z)


def twin(points: Xyz, close: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """`fine_ground` as its rules say, one cell and one point after the other."""
    x, y, z = (c.astype(np.int64) for c in points)
    column, row = (x + SCALE.origin[0]) // 400, (y + SCALE.origin[1]) // 400
    lowest: dict[tuple[int, int], int] = {}
    blocks: dict[tuple[int, int], list[int]] = {}
    for i in np.lexsort((y, x, z)):
        if close[i] != FAR:
            blocks.setdefault((column[i] // 5, row[i] // 5), []).append(i)
        if close[i] >= NEAR:
            lowest.setdefault((column[i], row[i]), i)

    def settled(block: tuple[int, int]) -> bool:
        return all(close[i] != NEAR for i in blocks[block])

    def dense(block: tuple[int, int]) -> bool:
        return sum((c // 5, r // 5) == block for c, r in lowest) >= 9

    looked_at = {block for block in blocks if not settled(block) and dense(block)}

    def plane(cell: tuple[int, int], cells: dict[tuple[int, int], int]) -> tuple | None:
        for steps, enough in ((1, 6), (2, 9)):
            around = [
                i
                for (c, r), i in cells.items()
                if abs(c - cell[0]) <= steps and abs(r - cell[1]) <= steps
            ]
            j = lowest[cell]
            if len(around) < enough:
                continue
            a = np.stack([x[around] - x[j], y[around] - y[j], np.ones(len(around))], axis=1)
            (east, north, height), *_ = np.linalg.lstsq(
                a, (z[around] - z[j]).astype(float), rcond=None
            )
            off = z[around] - z[j] - a @ (east, north, height)
            return east, north, height, np.sqrt((off**2).sum() / (len(around) - 3))
        return None

    cells = [cell for cell in lowest if (cell[0] // 5, cell[1] // 5) in looked_at]
    first = {cell: plane(cell, lowest) for cell in cells}
    spikes = {cell for cell, found in first.items() if found is not None and -found[2] > 70}
    kept = {cell: i for cell, i in lowest.items() if cell not in spikes}
    planes = {cell: plane(cell, kept) for cell in cells}
    above, most = np.full(x.size, np.nan), np.zeros(x.size)
    for i in np.flatnonzero(close != FAR):
        found = planes.get((column[i], row[i]))
        if found is not None and found[3] <= 100:
            j = lowest[column[i], row[i]]
            above[i] = (
                z[i] - z[j] - found[2] - found[0] * (x[i] - x[j]) - found[1] * (y[i] - y[j])
            )
            most[i] = 100 + 100 * np.hypot(found[0], found[1])
    seen, on = {}, {}
    for block, members in blocks.items():
        if settled(block):
            seen[block], on[block] = len(members), sum(close[i] == ON for i in members)
            continue
        of = above[members]
        seen[block], on[block] = ((of >= -100) & (of <= 400)).sum(), (abs(of) <= 50).sum()
    found = ground.copy()
    for i in np.flatnonzero(~np.isnan(above)):
        fits = close[i] >= NEAR and -250 <= above[i] <= most[i]
        c, r = column[i] // 5, row[i] // 5
        near = [(c + dc, r + dr) for dc in (-1, 0, 1) for dr in (-1, 0, 1)]
        open_ground = 2 * sum(on.get(b, 0) for b in near) >= sum(seen.get(b, 0) for b in near)
        found[i] = fits and (bool(ground[i]) or open_ground)
    return found


@pytest.mark.parametrize("density_m2", [2.0, 4.0, 12.0])
def test_rules_are_kept_cell_by_cell(density_m2: float) -> None:
    scene = cloud(density_m2, side_m=16.0)
    every = np.arange(scene.x.size)
    z = np.round(1000 * scene.z) / 1000
    close = (abs(z) <= 0.4).astype(np.uint8) * CROP
    close[abs(z) <= 0.2], close[abs(z) <= 0.1] = NEAR, ON
    expected = twin(scene.points(every), close, abs(z) <= 0.12)
    found, _ = scene.judged()
    assert (found == expected).mean() > 0.999  # floats of another order may differ at a limit
    assert density_m2 < 3 or (found != (abs(z) <= 0.12)).any()


def test_sums_of_sums_are_those_of_all_cells_around() -> None:
    sums = fine_planes._no_sums()
    patch = np.random.default_rng(4).integers(-(10**6), 10**6, (9, 9, 10))
    sums.patch[:] = patch.ravel()
    fine_planes._add_up(sums)
    for name, steps in (("three", 1), ("five", 2)):
        found = getattr(sums, name).reshape(5, 5, 10)
        for row in range(5):
            for column in range(5):
                rows, columns = (slice(at + 2 - steps, at + 3 + steps) for at in (row, column))
                assert (found[row, column] == patch[rows, columns].sum(axis=(0, 1))).all()


def test_relief_is_ground_and_what_stands_on_it_is_not() -> None:
    """A bump of 0.18 m, whole, above a TIN that runs below it; sparse stalks that rise 0.15 m from level ground."""
    random = np.random.default_rng(2)
    x, y = random.uniform(0, 20, (2, 6000))
    z = 0.18 * np.exp(-((x - 5) ** 2 + (y - 10) ** 2) / 4) + random.normal(0, 0.01, x.size)
    stalks = (abs(x - 15) < 3) & (random.random(x.size) < 0.2)
    z[stalks] += 0.11
    scene = Cloud(x, y, z)
    found, marked = scene.judged()
    assert found[~stalks].mean() > 0.99
    assert found[stalks].mean() < 0.3
    assert (abs(z[stalks]) <= 0.12).mean() > 0.7  # the TIN took them
    assert not marked.any()


def test_nothing_joins_where_something_grows() -> None:
    """Crops show no surface: few points lie on any plane."""
    random = np.random.default_rng(3)
    x, y = random.uniform(0, 20, (2, 8000))
    scene = Cloud(x, y, random.uniform(-0.15, 0.4, x.size))
    found, _ = scene.judged()
    assert not (found & (abs(np.round(1000 * scene.z) / 1000) > 0.12)).any()


def test_sparse_points_are_left_to_the_tin() -> None:
    scene = cloud(1.0)
    assert (scene.judged()[0] == (abs(np.round(1000 * scene.z) / 1000) <= 0.12)).all()


def test_a_sparse_strip_is_judged_as_without_a_dense_one_beside_it() -> None:
    dense, sparse = cloud(15.0, seed=5), cloud(1.0, seed=6)
    both = Cloud(
        *(
            np.concatenate([a, b])
            for a, b in zip(vars(dense).values(), vars(sparse).values(), strict=True)
        )
    )
    both.x[dense.x.size :] += 40.0  # whole blocks
    far = sparse.x > fine.REACH_M - 20.0
    assert (both.judged()[0][dense.x.size :][far] == sparse.judged()[0][far]).all()


@pytest.mark.parametrize("density_m2", [3.0, 10.0])
def test_what_lies_beyond_the_reach_has_no_part_and_neither_has_the_order(
    density_m2: float,
) -> None:
    scene, random = cloud(density_m2), np.random.default_rng(7)
    everything, _ = scene.judged()
    for _ in range(12):
        west, south = random.uniform(-18, 8, 2)
        wide = fine.REACH_M

        def within(margin: float, west: float = west, south: float = south) -> np.ndarray:
            across = (scene.x >= west - margin) & (scene.x < west + 9 + margin)
            return np.flatnonzero(
                across & (scene.y >= south - margin) & (scene.y < south + 9 + margin)
            )

        seen, core = random.permutation(within(wide + 0.001)), within(0.0)
        found = np.zeros(scene.x.size, bool)
        found[seen] = scene.judged(seen)[0]
        assert (found[core] == everything[core]).all()


def test_uncertified_points_affect_labels_as_far_as_a_point_has_a_part() -> None:
    """Whatever the heights of uncertified points: what is certified keeps its label."""
    scene, random = cloud(8.0), np.random.default_rng(8)
    everything, _ = scene.judged()
    is_uncertified = np.hypot(scene.x - 3, scene.y + 2) < 3.0
    changed = Cloud(
        scene.x,
        scene.y,
        np.where(is_uncertified, random.uniform(-0.5, 0.6, scene.x.size), scene.z),
    )
    found, marked = changed.judged(marked=is_uncertified)
    assert marked[is_uncertified].all()
    assert (found == everything)[~marked].all()
    assert (found != everything)[marked & ~is_uncertified].any()
    assert not marked[np.hypot(scene.x - 3, scene.y + 2) > 13].any()
