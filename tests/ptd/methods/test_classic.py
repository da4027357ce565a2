"""The method as a whole: the objects that it keeps and removes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from ptd.frame import Scale, Window
from ptd.methods.classic import Classic
from ptd.passes import Points
from tests.ptd.scenes import CM, Cloud

EVERYTHING = Window.everything()
SCALE = Scale(Fraction(1, CM), Fraction(1, CM), (-7_123_456, 93_000_017))
DEFAULTS = Classic()


def labels_of(cloud: Cloud, params: Classic = DEFAULTS) -> np.ndarray:
    labels, marked = (
        params.passes[0]
        .fit(Points(cloud), EVERYTHING, EVERYTHING, SCALE, {})
        .label(Points(cloud))
    )
    assert not marked.any()
    return labels


def ground(slope: float = 0.0) -> np.ndarray:
    """Ground of 100 m with two points per square metre, in metres."""
    rng = np.random.default_rng(3)
    xy = rng.random((2, 20_000)) * 100
    return np.vstack([xy, slope * xy[0] + rng.normal(0, 0.03, 20_000)])


def counts(metres: np.ndarray) -> Cloud:
    return np.rint(metres * CM).astype(np.int32)


@pytest.mark.parametrize("slope", [0.0, 0.3, 1.0])
def test_bare_ground_is_kept_on_any_slope(slope: float) -> None:
    cloud = ground(slope)
    kept = labels_of(counts(cloud)) == 2
    inner = (abs(cloud[:2] - 50) < 40).all(axis=0)
    assert kept[inner].mean() > 0.999
    # At the upper and lower border the virtual seeds continue the slope as terraces.
    assert kept.mean() > 0.98


def test_a_flat_roof_of_15_m_is_removed_and_the_slope_around_it_kept() -> None:
    cloud = ground(0.2)
    x, y, _ = cloud
    roof = (abs(x - 50) < 7.5) & (abs(y - 50) < 7.5)
    cloud[2, roof] = 0.2 * 50 + 6 + cloud[2, roof] % 0.05
    labels = labels_of(counts(cloud))
    assert (labels[roof] == 1).all()
    assert (labels[~roof] == 2).mean() > 0.995


def test_a_part_of_a_roof_larger_than_the_cells_is_labelled_ground() -> None:
    """A seed lies on the roof, which the size of the largest building has to prevent."""
    cloud = ground()
    roof = (abs(cloud[0] - 50) < 25) & (abs(cloud[1] - 50) < 25)
    cloud[2, roof] += 8
    assert (labels_of(counts(cloud))[roof] == 2).mean() > 0.25
    assert (
        labels_of(counts(cloud), Classic(max_building_size_m=60.0))[roof] == 2
    ).mean() == 0.0


def test_low_points_are_low_noise_and_lower_no_other_labels() -> None:
    cloud = ground()
    low = np.flatnonzero(((cloud[:2] - 50) ** 2).sum(axis=0) < 0.7**2)[:4]
    cloud[2, low] -= 9
    labels = labels_of(counts(cloud))
    assert (labels[low] == 7).all()
    assert (labels[np.setdiff1d(np.arange(20_000), low)] == 2).mean() > 0.999


def test_figures_of_a_window() -> None:
    cloud = counts(ground())
    step = DEFAULTS.passes[0]
    model = step.fit(Points(cloud), EVERYTHING, EVERYTHING, SCALE, {})
    assert set(model.stats) == {"candidates", "rounds", "low_outliers", "vertices"}
    assert 8_000 < model.stats["candidates"] < 10_300
    assert model.partial() == {}
    assert step.reduce([{}, {}], {"kept": 1}) == {"kept": 1}


@pytest.mark.parametrize(
    ("params", "margin"),
    [
        (Classic(), 5.0),
        (Classic(low_group=0), 0.0),
        (Classic(low_radius_m=3.3), 4.0),
        (Classic(low_radius_m=3.5, thin_cell_m=0.7), 3.5),
        (Classic(low_radius_m=3.5, thin_cell_m=0.0), 4.0),
    ],
)
def test_the_margin_is_made_of_whole_cells(params: Classic, margin: float) -> None:
    assert params.margin_m == pytest.approx(margin, rel=1e-12)
