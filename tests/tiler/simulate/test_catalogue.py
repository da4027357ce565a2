"""The committed scenes exist, are as described, and have not changed by accident."""

from __future__ import annotations

import re
from functools import partial

import numpy as np
import pytest

from tiler.errors import ConfigError
from tiler.simulate import SCENES, SITES, make_scene, make_site
from tiler.simulate.catalogue import SENSORS
from tiler.simulate.points import survey_patch

COUNTS = [233, 26993, 8133, 27734, 1882]
"""Points of classes 1, 2, 3, 5 and 6 of ``als_sparse``."""

MEANS = [146.516, 148.778, 257.595]
"""Mean x, y, z of its points, metres."""


def test_names_kinds_and_sites_belong_together():
    for name, spec in SCENES.items():
        assert name == spec.name
        assert re.fullmatch(f"({spec.kind}|raw)_[a-z_]+", name)
        assert spec.kind in SENSORS
        assert spec.site in SITES
        assert spec.scene_class.startswith(spec.kind)
        assert 100 <= spec.side_m <= (1500 if spec.scene_class == "als water" else 300)
    assert len({(spec.site, spec.seed) for spec in SCENES.values()}) == len(SCENES)


def test_a_scene_has_its_truth_and_has_not_changed():
    scene = make_scene("als_sparse")
    ground = scene.classification == 2
    off = scene.xyz[ground, 2] - scene.truth(scene.xyz[ground, 0], scene.xyz[ground, 1])
    assert off.std() == pytest.approx(0.03, rel=0.1)
    assert scene.rgb is None
    assert scene.returns.shape == (len(scene.xyz), 2)
    assert np.all(scene.returns[:, 0] <= scene.returns[:, 1])
    # Methods were tuned on these points; another numpy may move a point by a millimetre at
    # most.
    assert np.bincount(scene.classification)[[1, 2, 3, 5, 6]] == pytest.approx(COUNTS, rel=1e-3)
    assert scene.xyz.mean(axis=0) == pytest.approx(MEANS, abs=0.02)


@pytest.mark.parametrize("name", ["dim_rows", "dim_forest"])
def test_rough_matched_scenes_are_cut_by_their_border_and_their_ground_lies_on_the_truth(
    name: str,
):
    spec = SCENES[name]
    site, sensor = spec.make_site(), spec.make_sensor()
    side = spec.side_m
    near = site.objects_near(0, 0, side, side)
    cut = [
        o
        for o in (*near.solids, *near.crowns)
        if any(abs(edge - o.x) < o.radius / 2 for edge in (0, side))
    ]
    assert cut
    points = survey_patch(site, sensor, 1, 1)
    assert (points.rgb is None) == (name == "dim_forest")
    ground = points.label == 2
    x, y, z = points.xyz[ground].T
    off = z - site.terrain.height_at(x, y)
    assert abs(np.median(off)) < 0.15
    assert off.std() < 5 * sensor.sigma_m


def test_unknown_names_are_refused():
    for make, first in (
        (make_scene, "als_city"),
        (partial(make_site, seed=1, side_m=100.0), "city"),
    ):
        with pytest.raises(ConfigError, match=f"unknown scene 'moon': choose one of {first}, "):
            make("moon")
