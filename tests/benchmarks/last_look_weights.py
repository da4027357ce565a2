"""Fits the trees of `ptd.matched.last_look` to scenes with known labels, and scores each scene without its own part.

``python -m tests.benchmarks.last_look_weights [--write] [--leave-one-out]``

The scenes are the semi-real matched clouds and those made of laser scans
(`tests.benchmarks.scan_scenes`) but for the field, where no label is right. Each semi-real
scene weighs 1, each of the others `SCAN_WEIGHT`: a point of a scene weighs as much as it counts
in the scene's total error, times a factor that is larger where little around is ground
(`SPARSE`). ``--write`` replaces the file beside the code. It needs LightGBM (``pip install
lightgbm``), which neither the package nor any other script uses. One thread, a fixed seed and
features of whole numbers make the file the same in each run of one version of LightGBM
(`VERSION`).
"""

from __future__ import annotations

import argparse
import io
import sys
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import Any
from unittest import mock

import numpy as np

import ptd
from ptd.arrays import Int32
from ptd.matched import last_look
from ptd.matched.last_look import DEPTH, LEAVES, NODES, UNIT, DecisionTrees, scores
from tests.benchmarks.measuring import GROUND, dtm_rmse_m
from tests.benchmarks.scan_scenes import scan_scenes
from tests.benchmarks.scorecard import DATA
from tests.benchmarks.scorecard_scenes import SEMI_REAL, BenchScene, Cloud, semi_real_scenes
from tiler.apps.evaluate import IGNORED, evaluate_labels

VERSION = "4.7.0"
WEIGHTS = Path(last_look.__file__).with_name("last_look.npz")
WITHOUT_TRUTH = "field"
SCAN_WEIGHT = 0.5
POINTS = 60_000
"""Points of a scene that are fitted to, at most."""
SPARSE = 0.1
"""Addition to the share of ground within 5 m, by which weights are divided: where ground is
rare, each of its points carries more of the terrain."""
SETTINGS: dict[str, Any] = {
    "objective": "binary", "num_leaves": LEAVES, "max_depth": DEPTH, "learning_rate": 0.15, "min_data_in_leaf": 400,
    "lambda_l2": 20.0, "max_bin": 63, "seed": 1, "num_threads": 1, "deterministic": True, "force_row_wise": True,
    "verbosity": -1,
}  # fmt: skip
TREES = 100


@dataclass(frozen=True)
class Asked:
    """A scene as the last look sees it.

    Attributes
    ----------
    name : str
    semi_real : bool
    labels : uint8 [n]
        Without a last look.
    index : int32 [m]
        The points that it may change.
    features : int32 [m, features]
    classes : uint8 [n]
        The true ones.
    """

    name: str
    semi_real: bool
    labels: np.ndarray
    index: np.ndarray
    features: np.ndarray
    classes: np.ndarray

    @property
    def counts(self) -> np.ndarray:
        """Which points count: bool [n]."""
        return ~np.isin(self.classes, IGNORED)

    def sample(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Features, whether they are of ground, and weights of some points that count."""
        own = np.flatnonzero(self.counts[self.index])
        chosen = np.sort(
            np.random.default_rng(7).choice(own, min(POINTS, own.size), replace=False)
        )
        weight = (
            (1.0 if self.semi_real else SCAN_WEIGHT)
            * own.size
            / chosen.size
            / self.counts.sum()
        )
        truth = self.classes[self.index[chosen]] == GROUND
        features = self.features[chosen]
        rare = 1.0 / (SPARSE + features[:, last_look.FEATURES.index("ground_5")] / 1000)
        return features, truth, weight * rare

    def after(self, trees: DecisionTrees) -> np.ndarray:
        """Labels with a last look."""
        labels = self.labels.copy()
        labels[self.index] = last_look.decided(labels[self.index], scores(self.features, trees))
        return labels


def asked(scene: BenchScene, cloud: Cloud) -> Asked:
    """What `auto` makes of a scene before the last look, and what this one would see."""
    found: list[tuple[Int32, Int32]] = []

    def seen(heights: last_look.Heights, *rest: Any) -> np.ndarray:
        found.extend(last_look.features_by_block(heights, *rest[:-1]))
        return heights.labels

    with mock.patch.object(last_look, "relabelled", seen):
        labels = ptd.classify(cloud.xyz, "auto", kind="dim").classification
    index, features = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.argsort(index)
    return Asked(
        scene.name,
        scene.group == SEMI_REAL,
        labels,
        index[order],
        features[order],
        cloud.classification,
    )


def fitted(scenes: Sequence[Asked]) -> DecisionTrees:
    """The trees that suit some scenes best."""
    import lightgbm

    features, truth, weight = (
        np.concatenate(parts) for parts in zip(*(s.sample() for s in scenes), strict=True)
    )
    data = lightgbm.Dataset(features.astype(np.float64), truth, weight=weight / weight.mean())
    return trees_of(lightgbm.train(SETTINGS, data, TREES).dump_model())


def trees_of(model: dict[str, Any]) -> DecisionTrees:
    """LightGBM's trees with thresholds and leaves of whole numbers; features are whole, so no decision changes."""
    roots = [tree["tree_structure"] for tree in model["tree_info"]]
    feature, threshold = (np.zeros((len(roots), NODES), np.int32) for _ in range(2))
    leaf = np.zeros((len(roots), LEAVES), np.int32)

    def place(tree: int, at: int, node: dict[str, Any]) -> None:
        if at >= NODES:
            leaf[tree, at - NODES] = round(UNIT * node["leaf_value"])
            return
        if "leaf_value" not in node:
            feature[tree, at], threshold[tree, at] = (
                node["split_feature"],
                int(np.floor(node["threshold"])),
            )
        for side, child in enumerate(("left_child", "right_child")):
            # a leaf near the root is on both sides
            place(tree, 2 * at + 1 + side, node.get(child, node))

    for tree, root in enumerate(roots):
        place(tree, 0, root)
    return DecisionTrees(feature.ravel(), threshold.ravel(), leaf.ravel())


def file_of(trees: DecisionTrees) -> bytes:
    """Decision trees as an .npz with the same bytes each time."""
    kept = io.BytesIO()
    with zipfile.ZipFile(kept, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in trees._asdict().items():
            array = io.BytesIO()
            np.save(array, values.astype("<i4"))
            archive.writestr(
                zipfile.ZipInfo(f"{name}.npy"), array.getvalue(), zipfile.ZIP_DEFLATED
            )
    return kept.getvalue()


def all_scenes() -> list[BenchScene]:
    """Those that are fitted to."""
    found = [*semi_real_scenes(DATA), *scan_scenes(DATA)]
    return [scene for scene in found if scene.name != WITHOUT_TRUTH]


def row(scene: Asked, cloud: Cloud, labels: np.ndarray) -> tuple[list[float], str]:
    """Total error in percent and RMSE of the terrain in metres, before and after, and a line with them."""
    found, words = [], []
    for which in (scene.labels, labels):
        errors = evaluate_labels(
            np.where(which == GROUND, GROUND, 1).astype(np.uint8), scene.classes, IGNORED
        )
        rmse = dtm_rmse_m(cloud, which == GROUND)
        found += [100 * errors["total"], float("nan") if rmse is None else rmse]
        words.append(
            " / ".join(f"{100 * errors[k]:.2f}" for k in ("type_1", "type_2", "total"))
            + f", {rmse:.3f} m"
        )
    return found, f"| {scene.name} | " + " | ".join(words) + " |"


def main() -> None:
    """Fit, score, write."""
    parser = argparse.ArgumentParser(
        description="Fit the trees of the last look at points of matched clouds."
    )
    parser.add_argument(
        "--write", action="store_true", help=f"replace {WEIGHTS.name} beside the code"
    )
    parser.add_argument(
        "--leave-one-out", action="store_true", help="score each scene with trees of the others"
    )
    given = parser.parse_args()
    scenes = []
    for scene in all_scenes():
        scenes.append(asked(scene, scene.load()))
        print(f"{scene.name}: {scenes[-1].index.size:,} points", file=sys.stderr, flush=True)
    if given.write:
        WEIGHTS.write_bytes(file_of(fitted(scenes)))
    if given.leave_one_out:
        rows = []
        for scene, one in zip(all_scenes(), scenes, strict=True):
            trees = fitted([other for other in scenes if other is not one])
            found, line = row(one, scene.load(), one.after(trees))
            rows.append((one.semi_real, found))
            print(line, flush=True)
        for kind in (True, False):
            figures = [found for semi_real, found in rows if semi_real == kind]
            print(
                "mean",
                " ".join(f"{mean(column):.3f}" for column in zip(*figures, strict=True)),
                flush=True,
            )


if __name__ == "__main__":
    main()
