"""Sparse clouds: a task holds some work, whatever area that takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.runs import do, stored_labels
from tiler.config import RunConfig
from tiler.plan import make_plan


@pytest.fixture(scope="module")
def sparse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """400 points over 4 km x 4 km, on a slope with a hill."""
    x, y = np.random.default_rng(5).uniform(0, 4000.0, (2, 400))
    z = 0.01 * x + 30 * np.exp(-((x - 2000) ** 2 + (y - 2000) ** 2) / 1e6)
    xyz = np.round(np.column_stack([x, y, z]), 3)
    return clouds.write(
        tmp_path_factory.mktemp("sparse") / "sparse.las",
        clouds.Cloud(xyz, np.ones(400, np.uint8)),
    )


def test_few_tiles_and_buckets(sparse: Path) -> None:
    plan = make_plan([str(sparse)], RunConfig(in_process=True))
    assert plan.grid.bucket_m == 1024
    assert plan.method.tile == 4096


@pytest.mark.slow
def test_no_result_depends_on_it(
    sparse: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = {"until": "filter", "method": "classic", "resolution": "50"}
    do(sparse, tmp_path / "few", **settings)
    monkeypatch.setattr("tiler.plan.sizes.BUCKETS_M", (256,))
    many = do(sparse, tmp_path / "many", tile_size="1024", halo=2000, **settings)
    assert many.summary["filter"]["tiles"] > 9
    (labels, marks), (others, other_marks) = (
        stored_labels(tmp_path / "few"),
        stored_labels(tmp_path / "many"),
    )
    assert not marks.any()
    assert np.array_equal(labels[~other_marks], others[~other_marks])
    assert not other_marks.any()
