"""The committed scenes: there, as described, and not changed by accident."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tiler.errors import ConfigError
from tiler.simulate import SCENES, SITES, make_scene, make_site
from tiler.simulate.catalogue import SENSORS

COUNTS = [233, 26993, 8133, 27734, 1882]
"""Points of classes 1, 2, 3, 5 and 6 of ``als_sparse``."""

MEANS = [146.516, 148.778, 257.595]
"""Mean x, y, z of its points, metres."""


def test_names_kinds_and_sites_belong_together():
    for name, spec in SCENES.items():
        assert name == spec.name
        assert re.fullmatch(f"{spec.kind}_[a-z_]+", name)
        assert spec.kind in SENSORS
        assert spec.site in SITES
        assert spec.scene_class.startswith(spec.kind)
        assert 100 <= spec.side_m <= 300
    assert len({(spec.site, spec.seed) for spec in SCENES.values()}) == len(SCENES)


def test_a_scene_has_its_truth_and_has_not_changed():
    scene = make_scene("als_sparse")
    ground = scene.classification == 2
    off = scene.xyz[ground, 2] - scene.truth(scene.xyz[ground, 0], scene.xyz[ground, 1])
    assert off.std() == pytest.approx(0.03, rel=0.1)
    assert scene.rgb is None
    assert scene.returns.shape == (len(scene.xyz), 2)
    assert np.all(scene.returns[:, 0] <= scene.returns[:, 1])
    # What methods were tuned on; another numpy may move a point by a millimetre, not more.
    assert np.bincount(scene.classification)[[1, 2, 3, 5, 6]] == pytest.approx(COUNTS, rel=1e-3)
    assert scene.xyz.mean(axis=0) == pytest.approx(MEANS, abs=0.02)


def test_unknown_names_are_refused():
    with pytest.raises(ConfigError, match="unknown scene 'moon': choose one of als_city, "):
        make_scene("moon")
    with pytest.raises(ConfigError, match="unknown scene 'moon': choose one of city, suburb, "):
        make_site("moon", 1, 100.0)
