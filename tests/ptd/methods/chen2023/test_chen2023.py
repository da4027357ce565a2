"""`chen2023` as a whole: the points that its steps keep and remove, its refusals, its errors on real samples."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ptd
from ptd.frame import Scale, Window
from ptd.methods import make_params
from ptd.methods.chen2023 import method as chen2023
from ptd.methods.chen2023.method import Chen2023
from ptd.passes import Points

SAMPLES = ("11", "12", "22", "24", "31", "42", "51", "53")
RNG = np.random.default_rng(6)


def town() -> tuple[np.ndarray, np.ndarray]:
    """A slope with two houses, a hall of 25 m and a terrain step, and a mask of the ground."""
    x, y = RNG.uniform(0, 120, (2, 9000))
    z = 0.15 * x + RNG.normal(0, 0.03, x.size)
    z += 2.0 * np.clip((y - 90) / 3, 0, 1)  # a bank of 2 m in 3 m
    objects = np.zeros(x.size, bool)
    for west, south, wide, high, up in (
        (20, 20, 10, 14, 6.0),
        (60, 15, 12, 9, 6.0),
        (70, 50, 25, 25, 9.0),
    ):
        roof = (x > west) & (x < west + wide) & (y > south) & (y < south + high)
        z[roof], objects[roof] = 0.15 * west + up, True
    return np.column_stack([x, y, z]), ~objects


def test_a_town_on_a_slope() -> None:
    xyz, ground = town()
    found = ptd.classify(xyz, "chen2023").classification
    assert (found[~ground] != 2).mean() > 0.99
    assert (found[ground] == 2).mean() > 0.99


def test_a_roof_wider_than_the_largest_building_stays() -> None:
    xyz, _ = town()
    hall = (abs(xyz[:, 0] - 82.5) < 8) & (abs(xyz[:, 1] - 62.5) < 8)
    params = Chen2023(max_building_size_m=20.0)
    assert (ptd.classify(xyz, "chen2023", params).classification[hall] == 2).mean() > 0.9


def test_tails_and_isolated_points_and_low_groups_are_not_ground() -> None:
    xyz, _ = town()
    tails = [[30.0, 70.0, -400.0], [31.0, 70.0, -401.0], [130.0, 130.0, 900.0]]
    isolated = [[50.2, 80.0, 40.0], [100.0, 100.0, -2.0], [110.0, 20.0, 2.0]]  # above and below
    # a cell each
    group = np.array([[15.5 + i, 60.5 + j, -8.0 + 0.1 * i] for i in (0, 1) for j in (0, 1)])
    result = ptd.classify(
        np.concatenate([xyz, tails, isolated, group]), "chen2023", kind="lidar"
    )
    classes = result.classification[len(xyz) :]
    assert classes.tolist() == [7, 7, 1, 1, 7, 7, 7, 7, 7, 7]
    notes = result.decisions["statistics"]["notes"]
    assert [note.split(":")[0] for note in notes] == [
        "2 candidates below -8 m are outliers",
        "1 candidates above 20 m are outliers",
    ]
    assert result.stats["chen2023"]["low_outliers"] >= 5


def test_without_a_gap_parameter_no_tails_are_cut() -> None:
    xyz, _ = town()
    result = ptd.classify(xyz, "chen2023", Chen2023(tail_gap_m=0.0))
    assert result.decisions["statistics"]["tails"] is None


def test_noise_among_the_seeds_goes_and_densification_may_take_it_back() -> None:
    """Wide thresholds leave seeds on a shed, a cluster behind narrow facets. Without refinement it is ground."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.5, 60), np.arange(0.5, 60)))
    z = 0.02 * np.sin(7 * x + 3 * y)
    shed = (abs(x - 30) < 3) & (abs(y - 30) < 3)
    z[shed] = 5.0
    xyz = np.column_stack([x + 0.02 * np.sin(9 * y), y + 0.02 * np.sin(5 * x), z])
    wide = {"initial_drop_m": 6.0, "largest_drop_m": 6.0}
    kept = ptd.classify(xyz, "chen2023", Chen2023(**wide, cluster_seeds=0))
    assert (kept.classification == 2).all()
    clean = ptd.classify(xyz, "chen2023", Chen2023(**wide, narrow_angle_deg=20.0))
    assert clean.stats["chen2023"]["noisy_seeds"] == shed.sum()
    assert np.array_equal(clean.classification == 2, ~shed)


def test_a_cloud_of_outliers_alone_has_no_ground() -> None:
    """Heights of 0, 10, 20, 30, 40 a metre apart, each far from all others."""
    cloud = np.array([[k, 0.5 * k, 10.0 * k] for k in range(5)])
    assert ptd.classify(cloud, "chen2023").classification.tolist() == [1] * 5
    window, nothing = Window(0, 0, 9, 9), Points(np.zeros((3, 0), np.int32))
    model = (
        Chen2023(robust_cells=False)
        .passes[1]
        .fit(nothing, window, window, Scale(), {"tails": None})
    )
    assert model.label(Points(np.zeros((3, 1), np.int32)))[1].tolist() == [True]


def test_the_papers_six_parameters_are_the_tables_first() -> None:
    table = (chen2023.__doc__ or "").split("reason")[1].splitlines()
    names = [line.split()[0] for line in table if line[:1].islower()]
    six = "max_building_size initial_window terrain_angle rounds iteration_angle iteration_distance"
    assert " ".join(names[:6]) == six


def test_exponential_windows_need_an_initial_window_of_2() -> None:
    line = "initial_window 1: exponential windows never grow from 1; use 2 or more"
    with pytest.raises(ValueError, match=line):
        make_params("chen2023", {"exponential_windows": "true"})
    assert Chen2023(exponential_windows=True, initial_window=2).widths == [5, 9, 17, 31]


def test_cells_larger_than_the_largest_building_are_refused() -> None:
    """Otherwise an opening would reach beyond the cells to which a window is widened."""
    with pytest.raises(
        ValueError, match=r"thin_cell_m 4: .* use at most max_building_size_m, 3 m"
    ):
        Chen2023(thin_cell_m=4.0, max_building_size_m=3.0)


def test_limits_in_counts() -> None:
    params, feet = Chen2023(max_building_size_m=20.0), Scale()
    assert params.widths[-1] == 21
    assert params.opening(feet).drops == pytest.approx([300.0] + [900.0] * 9)
    clusters = params.clusters(feet)
    assert clusters.long_side == 30_000.0
    assert clusters.narrow_cos == pytest.approx(math.cos(math.pi / 12))
    assert clusters.prominence == 1000.0
