"""Passes that only some runs need, points that a pass elects for later ones, and labels from neighbours."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pytest

import ptd
from ptd.frame import Scale
from ptd.methods import METHODS
from ptd.passes import Method, Points, RunHints
from tests.ptd import medians
from tests.ptd.medians import METHOD, Parameters
from tests.ptd.tiling import classify_tiled


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "medians", METHOD)


@pytest.fixture(scope="module")
def xyz() -> np.ndarray:
    """A slope of 24 m with a flat roof, and noise."""
    rng = np.random.default_rng(5)
    x, y = 24 * rng.random((2, 3000))
    z = (
        100
        + 0.05 * x
        + rng.normal(0, 0.2, x.size)
        + 5.0 * ((abs(x - 12) < 4) & (abs(y - 9) < 3))
    )
    return np.stack([500_000 + x, 5_400_000 + y, z], axis=1)


def expected(xyz: np.ndarray) -> np.ndarray:
    """The passes for images, written a second time, point by point."""
    x, y, z = np.rint(1000 * xyz).astype(np.int64).T
    cells: dict[tuple[int, int], list[int]] = {}
    for place, height in zip(zip(x // 1000, y // 1000, strict=True), z, strict=True):
        cells.setdefault(place, []).append(int(height))
    ex, ey = np.array(list(cells)).T * 1000 + 500
    ez = np.array([sorted(heights)[(len(heights) - 1) // 2] for heights in cells.values()])

    def near(i: int, metres: float) -> np.ndarray:
        return np.maximum(abs(ex - ex[i]), abs(ey - ey[i])) <= 1000 * metres

    high = np.array([ez[i] - ez[near(i, medians.SEEN_M)].min() > 1000 for i in range(len(ez))])
    low = np.array([not high[near(i, medians.SPREAD_M)].any() for i in range(len(ez))])
    labels = []
    for px, py in zip(x, y, strict=True):
        terrain = low & (np.maximum(abs(ex - px), abs(ey - py)) <= 1000 * medians.TERRAIN_M)
        own = np.maximum(abs(x - px), abs(y - py)) <= 1000 * medians.MEAN_M
        rise = (
            z[own].sum() // own.sum() - ez[terrain].sum() // terrain.sum()
            if terrain.any()
            else 1000
        )
        labels.append(2 if abs(rise) < 400 else 1)
    return np.array(labels)


def test_later_passes_see_and_label_elected_points(xyz: np.ndarray) -> None:
    result = ptd.classify(xyz, "medians", kind="dim")
    assert np.array_equal(result.classification, expected(xyz))
    assert 0.2 < (result.classification == 2).mean() < 0.95
    assert list(result.stats) == ["census", "medians", "rising", "spread", "mean"]
    assert 550 < result.stats["medians"]["cells"] == result.stats["rising"]["elected"] <= 24**2
    assert result.decisions["statistics"]["run"] == asdict(RunHints(kind="dim"))


@pytest.mark.parametrize("tile_m", [None, 3.0, 8.0, 11.0])
def test_tiles_in_memory_do_not_show(tile_m: float | None, xyz: np.ndarray) -> None:
    scale = Scale(origin=(500_000_000, 5_400_000_000))
    counts = (np.rint(1000 * xyz).astype(np.int64) - [500_000_000, 5_400_000_000, 0]).astype(
        np.int32
    )
    points = Points(np.ascontiguousarray(counts.T))
    labels, marks, _ = classify_tiled(points, scale, Parameters(), tile_m, kind="dim")
    assert np.array_equal(labels, expected(xyz))
    assert not marks.any()
    labels, _, state = classify_tiled(points, scale, Parameters(), tile_m, kind="lidar")
    assert np.array_equal(labels, np.where(counts[:, 2] > state["mean"], 1, 2))


@pytest.mark.parametrize("kind", [None, "lidar"])
def test_passes_that_do_not_apply_are_skipped(kind: str | None, xyz: np.ndarray) -> None:
    result = ptd.classify(xyz, "medians", kind=kind)
    z = np.rint(1000 * xyz[:, 2]).astype(np.int64)
    assert np.array_equal(result.classification, np.where(z > z.sum() // len(z), 1, 2))
    assert list(result.stats) == ["census", "split", "laser"]


def test_an_unknown_kind_is_refused(xyz: np.ndarray) -> None:
    with pytest.raises(ValueError, match="^no kind 'sonar'; there are lidar, dim$"):
        ptd.classify(xyz, "medians", kind="sonar")


def test_elected_points_need_a_pass_that_elects(
    xyz: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    @dataclass(frozen=True)
    class Without(Parameters):
        @property
        def passes(self) -> Any:
            return [step for step in Parameters().passes if not step.elects]

    monkeypatch.setitem(METHODS, "medians", Method("medians", "", Without))
    with pytest.raises(
        ValueError, match="rising works on elected points, but no earlier pass elected any"
    ):
        ptd.classify(xyz, "medians", kind="dim")
