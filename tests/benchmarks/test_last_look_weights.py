"""The trees of the last look are those that the script fits, to the byte, and decide as LightGBM's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ptd.matched.last_look import FEATURES, UNIT, scores
from tests.benchmarks import last_look_weights
from tests.benchmarks.last_look_weights import (
    SETTINGS,
    VERSION,
    WEIGHTS,
    Asked,
    asked,
    file_of,
    fitted,
    trees_of,
)

lightgbm = pytest.importorskip(
    "lightgbm", reason="LightGBM, which fits the trees, is not installed"
)


def made_up(seed: int, n: int = 20_000) -> Asked:
    rng = np.random.default_rng(seed)
    features = rng.integers(-1000, 1000, (n, len(FEATURES))).astype(np.int32)
    features[:, FEATURES.index("ground_5")] = rng.integers(0, 1001, n)  # a share
    odds = features[:, 0] / 300 + (features[:, 3] > 200) * features[:, 5] / 400
    truth = np.where(rng.logistic(size=n) < odds, 2, 5).astype(np.uint8)
    return Asked(
        "made up", True, np.ones(n, np.uint8), np.arange(n, dtype=np.int32), features, truth
    )


def test_two_fits_give_the_same_bytes() -> None:
    first, again = (file_of(fitted([made_up(1), made_up(2)])) for _ in range(2))
    assert first == again


def test_trees_decide_as_those_of_the_library() -> None:
    scene = made_up(3)
    features, truth, _ = scene.sample()
    model = lightgbm.train(SETTINGS, lightgbm.Dataset(features.astype(np.float64), truth), 20)
    found = scores(scene.features, trees_of(model.dump_model())) / UNIT
    expected = model.predict(scene.features.astype(np.float64), raw_score=True, num_threads=1)
    np.testing.assert_allclose(found, expected, atol=20 / UNIT)
    after = scene.after(trees_of(model.dump_model()))
    assert ((after == 2) == (scene.classes == 2)).mean() > 0.75


@pytest.mark.slow
def test_the_file_beside_the_code_is_what_the_script_gives(shared_data: Path) -> None:
    if lightgbm.__version__ != VERSION:
        pytest.skip(
            f"the trees were fitted with LightGBM {VERSION}, this is {lightgbm.__version__}"
        )
    scenes = last_look_weights.all_scenes()
    if len(scenes) != 17:
        pytest.skip("some of the scenes are not there")
    found = file_of(fitted([asked(scene, scene.load()) for scene in scenes]))
    assert found == WEIGHTS.read_bytes(), (
        "run python -m tests.benchmarks.last_look_weights --write"
    )
