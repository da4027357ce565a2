"""The script of laser scans on one tiny scene, and its peers as far as they are installed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks import laser, peers
from tests.benchmarks.scorecard_scenes import ISPRS_SAMPLES, BenchScene, Cloud
from tiler.simulate.catalogue import SceneSpec
from tiler.simulate.points import survey


def tiny() -> Cloud:
    """A suburb of 60 m as a laser scan."""
    spec = SceneSpec("tiny", "als", "a small suburb", "tiny", "suburb", 3, 60.0, {})
    points = survey(spec.make_site(), spec.make_sensor())
    return Cloud(points.xyz, points.label, None, None)


def test_one_tiny_scene(capsys: pytest.CaptureFixture[str]) -> None:
    scenes = [BenchScene(name, ISPRS_SAMPLES, ISPRS_SAMPLES, tiny) for name in ("one", "other")]
    laser.main(["--methods", "auto", "--scenes", "one"], scenes)
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "| filter | type I | type II | total | kappa | IoU | MCC | one |"
    figures = [float(text) for text in printed[2].split("|")[2:-1]]
    type_1, type_2, total, kappa, iou, mcc, of_scene = figures
    assert min(type_1, type_2) <= total <= max(type_1, type_2)
    assert total == of_scene
    assert 50 < kappa <= mcc + 5 < 110
    assert total < 20 < iou < 100


def test_a_figure_that_a_sample_lacks_has_no_mean() -> None:
    assert laser._mean([0.5, 0.25]) == "37.50"
    assert laser._mean([0.5, None]) == "-"


@pytest.mark.parametrize("name", peers.LASER_PEERS)
def test_peers_find_the_ground_of_a_plane_with_a_box(name: str) -> None:
    if name not in peers.laser_peers():
        pytest.skip(peers.missing_laser_peers()[name.removesuffix(f" {peers.PEER}")])
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 60, 0.8), np.arange(0, 60, 0.8)))
    is_box = (np.abs(x - 30) < 5) & (np.abs(y - 30) < 5)
    xyz = np.stack((x, y, 100 + 0.02 * x + 6.0 * is_box), axis=1)
    shuffled = np.random.default_rng(3).permutation(len(xyz))
    ground = peers.LASER_PEERS[name][2](xyz[shuffled])
    assert not ground[is_box[shuffled]].any()
    assert ground[~is_box[shuffled]].mean() > 0.9
