"""Boosted decision trees on whole numbers, which decide the same on each machine and in any order of the points."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from ptd.cells import Int32
from ptd.kernel import kernel

UNIT = 2**16
"""Fixed-point scale: leaves are log-odds multiplied by this number."""
DEPTH = 3
"""Number of questions between the root of a decision tree and each leaf."""
NODES, LEAVES = 2**DEPTH - 1, 2**DEPTH


class DecisionTrees(NamedTuple):
    """Decision trees whose sum is the log-odds multiplied by `UNIT`.

    Attributes
    ----------
    feature, threshold : int32 [trees * NODES]
        Feature and threshold of each node. After node n of a tree comes node 2 n + 1 if the feature is at most the
        threshold, else node 2 n + 2.
    leaf : int32 [trees * LEAVES]
        Log-odds of the leaves, which are the nodes from `NODES` on.
    """

    feature: Int32
    threshold: Int32
    leaf: Int32


@cache
def last_look_trees() -> DecisionTrees:
    """Read the decision trees of `ptd.matched.last_look` from the file next to this module."""
    with files(__package__).joinpath("last_look.npz").open("rb") as file, np.load(file) as kept:
        return DecisionTrees(*(kept[name].astype(np.int32) for name in DecisionTrees._fields))


@kernel
def scores(features: Int32, trees: DecisionTrees) -> Int32:
    """Return the sum of the leaves of each point, from its row of features: int32 [n].

    All seven questions of a tree are evaluated, for several points at a time. Without branches
    this is faster than evaluating the three that matter.
    """
    feature, threshold, leaf = trees
    columns = features.T.copy()
    sums = np.zeros(features.shape[0], np.int32)
    for t in range(leaf.size // LEAVES):
        f, limit, value = feature[t * NODES :], threshold[t * NODES :], leaf[t * LEAVES :]
        x0, x1, x2, x3 = columns[f[0]], columns[f[1]], columns[f[2]], columns[f[3]]
        x4, x5, x6 = columns[f[4]], columns[f[5]], columns[f[6]]
        t0, t1, t2, t3, t4, t5, t6 = (
            limit[0],
            limit[1],
            limit[2],
            limit[3],
            limit[4],
            limit[5],
            limit[6],
        )
        v0, v1, v2, v3, v4, v5, v6, v7 = (
            value[0],
            value[1],
            value[2],
            value[3],
            value[4],
            value[5],
            value[6],
            value[7],
        )
        for k in range(sums.size):
            a, b, c = x0[k] <= t0, x1[k] <= t1, x2[k] <= t2
            d, e, g, h = x3[k] <= t3, x4[k] <= t4, x5[k] <= t5, x6[k] <= t6
            first, second = v0 if d else v1, v2 if e else v3
            third, fourth = v4 if g else v5, v6 if h else v7
            below, beyond = first if b else second, third if c else fourth
            sums[k] += below if a else beyond
    return sums
