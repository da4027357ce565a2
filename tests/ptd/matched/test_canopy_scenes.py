"""Closed canopy on whole clouds: the share told, the terrain, and that labels change beside what is covered alone."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ptd.api import _counts, do_passes
from ptd.frame import Window
from ptd.matched.canopy import AMID_M
from ptd.matched.cells import SPARSE_CELL_M
from ptd.matched.ground_model import REACH_M
from ptd.matched.last_look import CELL_REACH_M
from ptd.matched.passes import BORDER_M, CanopyPass
from ptd.matched.step import COVERED
from ptd.methods.auto.method import Auto
from ptd.passes import Model, Pass, RunHints
from tests.benchmarks.measuring import dtm_rmse_m
from tests.benchmarks.scan_scenes import scan_scenes
from tests.benchmarks.scorecard_scenes import Cloud, read_clouds, simulated
from tests.scenes.canopies import Canopy as Wood

BESIDE_M = np.sqrt(2.0) * (
    max(BORDER_M, AMID_M / 2) + CELL_REACH_M + REACH_M + 2 * SPARSE_CELL_M
)
"""A label hangs on the surface as far as the last look sees, and there on a canopy within the
border or the square around a pit."""


class Found(NamedTuple):
    """Labels without and with the pass, the share told, and the middles of the covered cells (metres)."""

    before: np.ndarray
    after: np.ndarray
    share: float
    covered: np.ndarray


def remembering(step: Pass) -> Pass:
    """The pass, which works once: later calls return the model of the first, as they are for the same points."""
    step = copy.copy(step)  # passes are shared by all that have the same parameters
    fit, models = step.fit, []

    def once(*given: Any) -> Model:
        if not models:
            models.append(fit(*given))
        return models[0]

    object.__setattr__(step, "fit", once)
    return step


def found(xyz: np.ndarray) -> Found:
    """What the pass makes of a matched cloud."""
    models: list[tuple[Model, Any, Any]] = []

    class Listening(CanopyPass):
        def fit(self, points: Any, window: Any, core: Any, scale: Any, state: Any) -> Any:
            model = super().fit(points, window, core, scale, state)
            models.append((model, points, scale))
            return model

    steps = Auto().passes
    first = [step.name for step in steps].index("canopy")
    before_it = tuple(remembering(step) for step in steps[:first])

    class Without(Auto):
        @property
        def passes(self) -> tuple[Pass, ...]:
            return (*before_it, *steps[first + 1 :])

    class With(Auto):
        @property
        def passes(self) -> tuple[Pass, ...]:
            return (*before_it, Listening(), *steps[first + 1 :])

    counts, scale = _counts(xyz)
    columns = {"rgb": None, "returns": None}
    whole, facts = Window.everything(), RunHints(kind="dim")
    before, _, _ = do_passes(Without(), counts, columns, scale, whole, facts)
    after, state, _ = do_passes(With(), counts, columns, scale, whole, facts)
    ((model, points, _),) = models
    covered = points.xyz[:2, model.label(points)[0] >= COVERED].T * float(scale.metres_xy)
    offset = xyz[:1, :2] - counts[:2, :1].T * float(scale.metres_xy)
    return Found(before, after, state["canopy"]["share"], covered + offset)


def changed_beyond(xyz: np.ndarray, labels: Found) -> int:
    """Points whose label the pass changed farther from the canopy than the border."""
    changed = xyz[labels.before != labels.after, :2]
    if not len(changed):
        return 0
    if not len(labels.covered):
        return len(changed)
    away, _ = cKDTree(labels.covered).query(changed)
    return int((away > BESIDE_M).sum())


def wrong(cloud: Cloud, labels: np.ndarray) -> float:
    """Share of wrong labels, noise apart."""
    told = ~np.isin(cloud.classification, (7, 9, 17, 18))
    return float(((labels == 2) != (cloud.classification == 2))[told].mean())


def assert_no_harm(cloud: Cloud, labels: Found) -> None:
    """Neither more labels are wrong nor is the terrain."""
    assert wrong(cloud, labels.after) <= wrong(cloud, labels.before)
    before, after = (dtm_rmse_m(cloud, found == 2) for found in (labels.before, labels.after))
    assert before is not None
    assert after is not None
    assert after <= before


@pytest.mark.slow
@pytest.mark.parametrize("clearings", [False, True])
@pytest.mark.parametrize("hilly", [False, True])
def test_simulated_woods_are_told_and_bridged(hilly: bool, clearings: bool) -> None:
    """The share is told within a third; the terrain is 0.05 to 0.56 times as wrong as without the pass."""
    wood = Wood(hilly, clearings)
    points = wood.points()
    cloud = Cloud(
        points.xyz, points.label, truth=wood.site().terrain.height_at, side_m=wood.side_m
    )
    labels = found(points.xyz)
    assert labels.share == pytest.approx(wood.share(), rel=1 / 3)
    before, after = (dtm_rmse_m(cloud, found == 2) for found in (labels.before, labels.after))
    assert before is not None
    assert after is not None
    assert after < 0.6 * before
    assert ((labels.after == 2) & (points.label != 2)).mean() < 0.06
    assert changed_beyond(points.xyz, labels) == 0


@pytest.mark.slow
def test_the_middle_of_a_wide_wood_is_no_ground() -> None:
    """No land is within 100 m there. Without it, 4 % of the points of crowns became ground."""
    points = Wood(hilly=False, clearings=False, side_m=440.0).points()
    labels = found(points.xyz).after
    in_wood = (np.abs(points.xyz[:, :2] - 220.0) < 170.0).all(axis=1) & (points.label != 2)
    assert in_wood.sum() > 100_000
    assert (labels[in_wood] == 2).mean() < 0.002


@pytest.mark.slow
def test_steep_ground_beside_woods_is_no_canopy() -> None:
    """The east of the simulated mountain, where the pass once took ground for crowns."""
    whole = simulated("dim_mountain")
    east = whole.xyz[:, 0] > 110.0
    cloud = Cloud(
        whole.xyz[east], whole.classification[east], truth=whole.truth, side_m=whole.side_m
    )
    labels = found(cloud.xyz)
    assert labels.share < 0.01
    assert_no_harm(cloud, labels)


@pytest.mark.slow
def test_rows_of_roofs_are_no_canopy(shared_data: Path) -> None:
    scenes = {scene.name: scene for scene in scan_scenes(shared_data)}
    if "station" not in scenes:
        pytest.skip("the scan of the station is absent")
    cloud = scenes["station"].load()
    labels = found(cloud.xyz)
    assert labels.share < 0.05
    assert_no_harm(cloud, labels)


@pytest.mark.slow
def test_bare_slopes_of_a_valley_are_no_canopy(shared_data: Path) -> None:
    path = shared_data / "dim/Churo_dim.laz"
    if not path.is_file():
        pytest.skip("the cloud of the valley is absent")
    xyz = read_clouds([path]).xyz
    labels = found(xyz)
    assert labels.share < 0.015
    assert (labels.before != labels.after).mean() < 0.01
    assert changed_beyond(xyz, labels) == 0
