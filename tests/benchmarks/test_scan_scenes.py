"""Matched clouds of laser scans: their truth is that of the scan, and they are what matching gives."""

from __future__ import annotations

import numpy as np

from tests.benchmarks.scan_scenes import BLUNDER, BUILDING, GROUND, Site, matched


def test_a_house_on_a_slope_is_seen_with_noise_blunders_and_its_facades() -> None:
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, 24, (2, 3000))
    roof = (abs(x - 12) < 5) & (abs(y - 12) < 5)
    scan = np.stack([x, y, 0.1 * x + np.where(roof, 6.0, 0.0)], axis=1)
    cloud = matched(scan, np.where(roof, BUILDING, GROUND), Site("", 0.5, 7))
    assert cloud.truth is not None
    classes, above = cloud.classification, cloud.xyz[:, 2] - cloud.truth(*cloud.xyz[:, :2].T)
    assert 25 < classes.size / 24**2 < 50
    ground, house = above[classes == GROUND], above[classes == BUILDING]
    assert abs(np.nanmedian(ground)) < 0.1  # neighbours share noise
    assert 0.04 < np.nanstd(ground) < 0.2
    assert np.nanmin(house) > -0.7
    assert np.mean(abs(house - 6.0) < 0.5) > 0.3
    assert np.mean((house > 1.0) & (house < 5.0)) > 0.05  # facades
    assert np.nanmedian(above[classes == BLUNDER]) < -0.4
