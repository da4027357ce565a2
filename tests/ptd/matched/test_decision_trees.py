"""Boosted trees: a slow walk gives the same sums, and those of the package are small."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ptd.matched import last_look
from ptd.matched.last_look import LEAVES, NODES, UNIT, DecisionTrees, last_look_trees, scores


def random_trees(seed: int, n: int = 30) -> DecisionTrees:
    rng = np.random.default_rng(seed)
    feature, threshold = rng.integers(0, 5, NODES * n), rng.integers(-50, 50, NODES * n)
    leaf = rng.integers(-UNIT, UNIT, LEAVES * n)
    return DecisionTrees(*(part.astype(np.int32) for part in (feature, threshold, leaf)))


def slow_score(row: np.ndarray, found: DecisionTrees) -> int:
    """Numbers of nodes are written in binary: 1 at the root, then a digit for each side that is taken."""
    score = 0
    for t in range(found.leaf.size // LEAVES):
        path = "1"
        while int(path, 2) <= NODES:
            node = t * NODES + int(path, 2) - 1
            path += "1" if row[found.feature[node]] > found.threshold[node] else "0"
        score += int(found.leaf[t * LEAVES + int(path, 2) - LEAVES])
    return score


def test_a_slow_walk_gives_the_same_sums() -> None:
    found = random_trees(1)
    rows = np.random.default_rng(2).integers(-60, 60, (300, 5)).astype(np.int32)
    assert scores(rows, found).tolist() == [slow_score(row, found) for row in rows]


def test_one_tree_of_known_answers() -> None:
    tree = DecisionTrees(
        *(
            np.array(v, np.int32)
            for v in ([0, 1, 1, 0, 0, 0, 0], [9, 5, 5, 3, 3, 20, 20], range(8))
        )
    )
    rows = np.array([[9, 5], [3, 5], [9, 6], [10, 5], [21, 6]], np.int32)
    assert scores(rows, tree).tolist() == [1, 0, 3, 4, 7]


def test_trees_of_the_last_look_are_small_and_know_its_features() -> None:
    found = last_look_trees()
    assert last_look_trees() is found
    assert Path(last_look.__file__).with_name("last_look.npz").stat().st_size < 20_000
    assert 0 <= found.feature.min() <= found.feature.max() < len(last_look.FEATURES)
    assert found.leaf.size * NODES == found.feature.size * LEAVES
