"""What made a sparse cloud without plants, where nothing shows what is seen through: the noise of flat places."""

from __future__ import annotations

import numpy as np
import pytest

import ptd


@pytest.mark.parametrize(("sigma_m", "kind"), [(0.02, "laser scanning (sparse"), (0.07, "image matching")])
def test_flat_places_of_a_bare_town_tell_a_laser_from_a_matcher(sigma_m: float, kind: str) -> None:
    """120 m x 120 m at 2 points/m2: 16 houses of 14 m x 12 m on a slope, terraces of 1 m, single returns."""
    rng = np.random.default_rng(1)
    x, y = 120 * rng.random((2, 28_800))
    z = 0.05 * x + np.floor(y / 40)
    house = (x % 30 >= 8) & (x % 30 < 22) & (y % 30 >= 8) & (y % 30 < 20)
    xyz = np.stack([x, y, z + 7.0 * house + rng.normal(0, sigma_m, x.size)], axis=1)
    found = ptd.classify(xyz)
    assert f"decided: {kind}" in found.decisions["statistics"]["notes"][0]
    assert (found.classification[~house] == 2).mean() > 0.98
    assert not (found.classification[house] == 2).any()
