"""The wrapper for one tile: columns reach the passes, and unfit arguments are refused in one line."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Literal

import laspy
import numpy as np
import pytest

import ptd
from ptd.frame import Scale, Window
from ptd.methods import METHODS
from ptd.passes import Method, Model, Pass, Points, RunHints, State

N = 50
XYZ = np.random.default_rng(1).random((N, 3)) * 30
RGB = np.random.default_rng(2).integers(0, 65536, (N, 3))
RETURNS = np.random.default_rng(3).integers(1, 6, (N, 2))


class Echo(Model):
    def __init__(self, points: Points, name: str) -> None:
        self.stats, self.name = {"given": len(points)}, name

    def label(self, points: Points) -> Any:
        if self.name == "first":
            assert points.rgb is not None
            assert points.labels is None
            return (points.rgb[0] % 100).astype(np.uint8), np.zeros(len(points), bool)
        assert points.labels is not None
        assert points.returns is not None
        assert points.rgb is None
        return points.labels + points.returns[1], np.zeros(len(points), bool)

    def partial(self) -> dict[str, Any]:
        return {"n": self.stats["given"]}


class First(Pass):
    name, columns, influence_radius_m = "first", ("rgb",), 0.0

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        return Echo(points, self.name)

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        return {**state, "n": sum(p["n"] for p in partials)}


class Second(First):
    name, columns = "second", ("labels", "returns")


@dataclass(frozen=True)
class Parameters:
    candidate_cell_m = 0.0
    passes = (First(), Second())


@dataclass(frozen=True)
class Derived(Parameters):
    """Parameters of another method."""


@pytest.fixture(autouse=True)
def echo(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        METHODS, "echo", Method("echo", "two passes", Parameters, needs=("rgb",))
    )


def test_columns_and_labels_go_from_pass_to_pass() -> None:
    result = ptd.classify(XYZ, "echo", rgb=RGB, returns=RETURNS, sigma=0.05)
    assert np.array_equal(result.classification, RGB[:, 0] % 100 + RETURNS[:, 1])
    assert result.decisions["statistics"] == {"run": asdict(RunHints(0.05)), "n": N}
    assert result.stats == {"first": {"given": N}, "second": {"given": N}}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "^method echo needs rgb$"),
        (
            {"rgb": RGB[1:]},
            r"^rgb has shape \(49, 3\), must be \(50, 3\), a row for each point$",
        ),
        ({"rgb": RGB, "returns": RGB}, r"^returns has shape \(50, 3\), must be \(50, 2\)"),
        ({"rgb": RGB, "params": 3}, "^params is int, method echo takes Parameters$"),
        (
            {"rgb": RGB, "params": Derived()},
            "^params is Derived, method echo takes Parameters$",
        ),
        ({"rgb": RGB / 2.5}, "^rgb must be whole numbers from 0 to 65535$"),
        ({"rgb": RGB.astype(int) - 65_536}, "^rgb must be whole numbers from 0 to 65535$"),
        ({"rgb": np.full(RGB.shape, np.nan)}, "^rgb must be whole numbers from 0 to 65535$"),
        (
            {"rgb": RGB, "returns": RETURNS.astype(int) + 255},
            "^returns must be whole numbers from 0 to 255$",
        ),
        (
            {"rgb": RGB, "returns": np.full(RETURNS.shape, None)},
            "^returns must be whole numbers from 0 to 255$",
        ),
        (
            {"rgb": RGB, "returns": np.full(RETURNS.shape, 2**70)},
            "^returns must be whole numbers from 0 to 255$",
        ),
        ({"rgb": RGB, "sigma": 0.0}, r"^sigma 0\.0: must be 1e-06 to 1000 m$"),
        ({"rgb": RGB, "sigma": np.nan}, "^sigma nan: must be 1e-06 to 1000 m$"),
    ],
)
def test_unfit_arguments_are_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ptd.classify(XYZ, "echo", **arguments)


@pytest.mark.parametrize(
    ("place", "message"),
    [
        (
            [0.0, 0.0, 2.5e6],
            r"^xyz has heights of 2.5e\+06 m above or below 0; up to 2000 km are allowed$",
        ),
        ([0.0, 0.0, -2.5e6], "^xyz has heights of 2.5e"),
        ([0.0, 70_000.0, 0.0], "^xyz extends over 70 km; above 60 km use tiles$"),
        ([0.0, np.nan, 0.0], "^xyz has values that are not finite; leave those points out$"),
        ([-np.inf, 0.0, 0.0], "^xyz has values that are not finite"),
    ],
)
def test_values_beyond_counts_are_refused(place: list[float], message: str) -> None:
    """The last of 20,000 points is wrong; it lies in another block than the first."""
    xyz = np.zeros((20_000, 3))
    xyz[-1] = place
    with pytest.raises(ValueError, match=message):
        ptd.classify(xyz, "classic")


@pytest.mark.parametrize("order", ["C", "F"])
def test_the_given_points_are_not_changed(order: Literal["C", "F"]) -> None:
    xyz = np.asarray(np.random.default_rng(1).uniform(0, 20, (500, 3)), order=order)
    before = xyz.copy()
    ptd.classify(xyz, "classic")
    assert np.array_equal(xyz, before)


def test_a_matched_cloud_whose_points_lie_far_apart_is_refused() -> None:
    """A raster of its extent would need tens of gigabytes."""
    near = np.random.default_rng(1).uniform(0, 20, (2000, 3)) * [1, 1, 0.01]
    with pytest.raises(
        ValueError, match=r"^xyz extends over 300\d\d x 300\d\d m, too much for a raster of 1 m"
    ):
        ptd.classify(np.concatenate([near, near + [30_000, 30_000, 0]]), kind="dim")


def test_coordinates_that_are_not_exact_are_refused() -> None:
    near = np.random.default_rng(1).uniform(0, 20, (50, 3))
    ptd.classify(near + [8e12, 0, 0], "classic")
    with pytest.raises(
        ValueError, match=r"^xyz has x or y of 1e\+16 m; up to 9e\+12 m from 0 are exact"
    ):
        ptd.classify(near + [0, -1e16, 0], "classic")


@pytest.mark.parametrize("sigma", [1e-6, 1e3])
def test_the_method_works_with_any_permitted_noise(sigma: float) -> None:
    """In a dense cloud, the longest edges of `dong2018` follow from its noise."""
    near = np.random.default_rng(1).uniform(0, 20, (4000, 3)) * [1, 1, 0.01]
    assert (ptd.classify(near, "dong2018", sigma=sigma).classification == 2).any()


def test_objects_of_laspy_are_refused_with_the_remedy() -> None:
    cloud = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    cloud.x = cloud.y = cloud.z = np.arange(4.0)
    for given in (cloud, cloud.points):
        with pytest.raises(
            TypeError, match=r"must be an array \(n, 3\) in metres: pass las\.xyz$"
        ):
            ptd.classify(given)
    assert ptd.classify(cloud.xyz, "classic").classification.shape == (4,)
