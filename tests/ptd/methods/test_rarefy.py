"""`rarefy`: thinned, densified as in `classic`, labelled by the height above the DTM alone."""

from __future__ import annotations

import numpy as np
import pytest

import ptd
from ptd.frame import Window
from ptd.methods.classic import Classic
from ptd.methods.rarefy import Rarefy
from ptd.passes import Points
from tests.ptd.scenes import SCENES
from tests.ptd.tiling import classify_tiled
from tests.ptd.tin.meshes import real_triangles
from tests.scenes.windows import SCALE

FIELD = np.array([[x + 0.5, y + 0.5] for x in range(60) for y in range(60)])


def labels_above(slope: float, heights: list[float], params: Rarefy) -> list[int]:
    """Labels of points at given heights above the middle of a plane's cells, where the candidate lies on the plane."""
    ground = np.column_stack([FIELD, slope * FIELD[:, 0]])
    x = 34.5 + np.arange(len(heights))  # not where a seed cell is lowest
    odd = np.column_stack([x, np.full(x.size, 30.7), slope * x + np.array(heights)])
    found = ptd.classify(np.concatenate([ground, odd]), "rarefy", params).classification
    return found[len(ground) :].tolist()


def test_points_near_the_dtm_are_ground_at_any_angle() -> None:
    """A point 0.49 m above a vertex 0.2 m away makes an angle of 68 degrees."""
    assert labels_above(0.0, [0.49, 0.51, 0.1], Rarefy()) == [2, 1, 2]


@pytest.mark.parametrize("slope", [0.3, 1.0])
def test_the_distance_is_vertical(slope: float) -> None:
    """On a slope of 45 degrees, 0.6 m above is 0.42 m from the plane; the candidate lies on the plane."""
    assert labels_above(slope, [0.49, 0.6], Rarefy()) == [2, 1]


def test_distances_below_the_dtm_count_as_well() -> None:
    """The lowest point of the middle cell fails the rounds at 1 degree and is judged by its height as well."""
    strict = Rarefy(iteration_angle_deg=1.0, label_floor_m=0.3)
    assert labels_above(0.2, [-0.29, 0.0], strict) == [2, 2]
    assert labels_above(0.2, [-0.6, 0.0], strict) == [1, 2]


def test_without_the_last_step_only_vertices_are_ground() -> None:
    ground = np.column_stack([FIELD, 0 * FIELD[:, 0]])
    more = ground + [0.2, 0.2, 0.1]
    labels = ptd.classify(
        np.concatenate([ground, more]), "rarefy", Rarefy(label_pass=False)
    ).classification
    assert (labels[len(ground) :] == 1).all()
    assert (labels[: len(ground)] == 2).all()


def test_its_tin_is_that_of_classic_on_the_thinned_cloud() -> None:
    cloud = SCENES["hills_with_houses"](np.random.default_rng(1))
    window = Window.everything()
    tins = []
    for params in (Rarefy(thin_cell_m=2.0), Classic(thin_cell_m=2.0)):
        model = params.passes[0].fit(Points(cloud), window, window, SCALE, {})
        tin = model.tin  # type: ignore[attr-defined]
        tins.append(tin.vertices[real_triangles(tin)])
    assert np.array_equal(*tins)


def test_tiles_agree_with_the_whole() -> None:
    cloud = SCENES["hills_with_houses"](np.random.default_rng(4))
    params = Rarefy(rounds=3)
    truth, _, _ = classify_tiled(Points(cloud), SCALE, params, None)
    labels, marks, _ = classify_tiled(Points(cloud), SCALE, params, 70.0, 60.0)
    assert np.array_equal(labels[~marks], truth[~marks])
    assert marks.mean() < 0.5
    assert set(truth.tolist()) >= {1, 2}
