"""A method of several passes: statistics of the whole run, labels of neighbours; the same for any tiles."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from ptd.frame import CellLattice, Scale, Window
from ptd.methods import METHODS
from ptd.passes import Method, MethodRefusal, Model, Pass, Points, State, StatisticsModel
from tests.invariants import clouds
from tests.invariants.runs import computed, do, settings, stored_labels
from tests.ptd import medians
from tests.ptd.medians import HIGH, LOW, Census, Split
from tests.ptd.tiling import inside
from tiler.errors import ConfigError
from tiler.plan import Plan, make_plan, plan_json, plan_lines, projected_memory
from tiler.plan.estimates import overlap_of, widest_halo_m
from tiler.store import open_store


class MeanHeight(Census):
    """The mean of all heights, told with the number of points; of some clouds it refuses."""

    name = "mean"

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> StatisticsModel:
        assert points.labels is None
        assert window == core
        assert inside(points, core).all()
        return super().fit(points, window, core, scale, state)

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        if state["run"]["sigma_m"] == 9:
            raise MethodRefusal("nine is too much")
        found = list(partials)
        return {
            **super().reduce(found, state),
            "notes": [f"{sum(p['n'] for p in found)} points were seen"],
        }


class SplitByMean(Pass):
    name = "split"

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        return Split(state["mean"], (HIGH, LOW))


class Lonely(Model):
    """Ground is what is low in a cell of 8 m without a high point."""

    def __init__(self, points: Points, scale: Scale) -> None:
        assert points.labels is not None
        self.cells, self.stats = CellLattice.of(8.0, scale), {}
        high = points.labels == HIGH
        self.taken = set(self.places(points.xyz[:, high]))

    def places(self, xyz: np.ndarray) -> list[tuple[int, int]]:
        return [(self.cells.column(int(x)), self.cells.row(int(y))) for x, y in xyz[:2].T]

    def label(self, points: Points) -> Any:
        assert points.labels is not None
        alone = np.array([place not in self.taken for place in self.places(points.xyz)])
        return np.where(alone & (points.labels == LOW), 2, 1).astype(np.uint8), np.zeros(
            len(points), bool
        )


class LonelyLow(Pass):
    """The cell of a point reaches no farther than its side."""

    name, columns, every_point, influence_radius_m = "lonely", ("labels",), True, 8.0

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        return Lonely(points, scale)


class Parameters(medians.Parameters):
    @property
    def passes(self) -> tuple[Pass, ...]:
        return (MeanHeight(), SplitByMean(), LonelyLow())


@pytest.fixture(autouse=True)
def lonely(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "lonely", Method("lonely", "three passes", Parameters))


def distinct(cloud: clouds.Cloud) -> np.ndarray:
    """The positions of the points in millimetres, each once, as the points of a position count once."""
    return np.unique(np.round(cloud.xyz * 1000).astype(np.int64), axis=0)


def expected(cloud: clouds.Cloud) -> np.ndarray:
    z, counted = np.round(cloud.xyz[:, 2] * 1000).astype(np.int64), distinct(cloud)[:, 2]
    high = z > int(counted.sum()) // len(counted)
    corner = np.array(clouds.CORNER)
    places = np.floor((np.round(cloud.xyz[:, :2], 3) + corner) / 8).astype(int)
    taken = {tuple(p) for p in places[high]}
    alone = np.array([tuple(p) not in taken for p in places])
    return np.where(alone & ~high, 2, 1)


def test_tiles_do_not_show(tmp_path: Path) -> None:
    cloud = clouds.city(150.0)
    path = clouds.write(tmp_path / "city.laz", cloud)
    for name, tile, halo in (("many", "32", "0"), ("wide", "32", "40"), ("one", "512", None)):
        result = do(path, tmp_path / name, "filter", method="lonely", tile_size=tile, halo=halo)
        labels, marks = stored_labels(tmp_path / name)
        assert np.array_equal(labels, expected(cloud))
        assert not marks.any()
        if tile == "32":
            assert result.summary["filter"]["overlap_work"] == pytest.approx(
                48**2 / 32**2, rel=0.1
            )
    told = result.summary["statistics"]["mean"]["notes"]
    assert told == [f"{len(distinct(cloud))} points were seen"]


def test_the_plan_says_how_far_each_pass_sees(tmp_path: Path) -> None:
    path = clouds.write(tmp_path / "city.laz", clouds.city(150.0))

    def plan(**changes: Any) -> Plan:
        return make_plan([str(path)], settings(method="lonely", tile_size="32", **changes))

    ours = plan(halo=None)
    assert [step.halo_m for step in ours.method.passes] == [0.0, 8.0, 8.0]
    line = "method      lonely, 3 passes: mean (halo 0 m), split (halo 8 m), lonely (halo 8 m)"
    assert line in plan_lines(ours)
    assert plan_json(ours)["halos_m"] == {"mean": 0.0, "split": 8.0, "lonely": 8.0}
    assert overlap_of(ours, ours.method.steps) == pytest.approx(48**2 / 32**2)
    assert [widest_halo_m(ours, step) for step in ours.method.passes] == [0.0, 32.0, 8.0]
    assert not any("--halo" in note for note in ours.notes)
    wider = plan(halo="40")
    assert [step.halo_m for step in wider.method.passes] == [0.0, 40.0, 8.0]
    assert overlap_of(wider, wider.method.steps) == pytest.approx(112**2 / 32**2)
    assert any("with a fixed radius: mean 0 m, lonely 8 m" in note for note in wider.notes)
    assert projected_memory(wider)["filter"] > projected_memory(ours)["filter"]


class Wary(StatisticsModel):
    """Not certain with less than 20 m around its core."""

    def uncertain(self) -> int:
        return int(self.partial()["beyond"] < 20_000)


class HowFar(Pass):
    name, gives_labels = "far", False

    def fit(
        self, points: Points, window: Window, core: Window, scale: Scale, state: State
    ) -> Model:
        return Wary({"beyond": min(core.west - window.west, core.south - window.south)})

    def reduce(self, partials: Iterable[dict[str, Any]], state: State) -> dict[str, Any]:
        return {**state, "mean": 0, "beyond": min(p["beyond"] for p in partials)}


@dataclass(frozen=True)
class WaryParameters(Parameters):
    @property
    def passes(self) -> tuple[Pass, ...]:
        return (HowFar(), SplitByMean())


def test_a_pass_that_only_measures_is_done_again_until_it_is_certain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Halos of 8, 16, 32 m."""
    monkeypatch.setitem(METHODS, "wary", Method("wary", "two passes", WaryParameters))
    path = clouds.write(tmp_path / "city.laz", clouds.city(150.0))
    result = do(path, tmp_path / "out", "filter", method="wary", tile_size="32", halo=None)
    assert result.summary["statistics"]["far"]["beyond"] == 32_000


def test_a_new_file_with_the_statistics_of_before_changes_only_its_surroundings(
    tmp_path: Path,
) -> None:
    west, east = clouds.city(96.0), clouds.city(32.0, seed=2)
    clouds.write(tmp_path / "in" / "west.laz", west)
    how: dict[str, Any] = {"method": "lonely", "tile_size": "32", "halo": "8"}
    first = do(tmp_path / "in", tmp_path / "out", "filter", **how)
    clouds.write(
        tmp_path / "in" / "east.laz", clouds.Cloud(east.xyz + [320.0, 0, 500.0], east.truth)
    )
    again = do(
        tmp_path / "in", tmp_path / "out", "filter", statistics=str(tmp_path / "out"), **how
    )
    assert again.summary["statistics"] == first.summary["statistics"]
    assert computed(again)["filter1"] < computed(first)["filter1"] / 2
    whole = do(tmp_path / "in", tmp_path / "out", "filter", **how)
    assert (
        whole.summary["statistics"]["mean"]["mean"]
        > first.summary["statistics"]["mean"]["mean"]
    )
    assert computed(whole)["filter1"] > computed(first)["filter1"]


def test_statistics_of_another_run_are_refused(tmp_path: Path) -> None:
    path = clouds.write(tmp_path / "city.laz", clouds.city(64.0))
    do(path, tmp_path / "out", "filter", method="lonely")
    with pytest.raises(ConfigError, match="its method or parameters differ"):
        do(path, tmp_path / "other", statistics=str(tmp_path / "out"))
    with pytest.raises(ConfigError, match=r"no run\.json"):
        do(path, tmp_path / "other", method="lonely", statistics=str(tmp_path))
    text = (tmp_path / "out" / "run.json").read_text()
    (tmp_path / "out" / "run.json").write_text(
        json.dumps({**json.loads(text), "state": "running"})
    )
    with pytest.raises(ConfigError, match="not finished"):
        do(path, tmp_path / "other", method="lonely", statistics=str(tmp_path / "out"))


def test_a_refusal_is_one_line(tmp_path: Path) -> None:
    path = clouds.write(tmp_path / "city.laz", clouds.city(64.0))
    with pytest.raises(ConfigError, match="^--method lonely: nine is too much$"):
        do(path, tmp_path / "out", method="lonely", sigma="9")


def test_what_the_user_says_of_the_cloud_reaches_the_passes(tmp_path: Path) -> None:
    path = clouds.write(tmp_path / "city.laz", clouds.city(64.0))
    # its returns say it
    for kind, known in (("als", "lidar"), ("dim", "dim"), (None, "lidar")):
        result = do(path, tmp_path / "out", "filter", method="lonely", kind=kind, sigma="0.1")
        run = result.summary["statistics"]["mean"]["run"]
        assert (run["sigma_m"], run["kind"]) == (0.1, known)
        assert computed(result)["filter0"] == result.summary["stages"]["filter0"]["tasks"]
    with pytest.raises(ConfigError, match="kind 'sonar': choose one of als, dim"):
        do(path, tmp_path / "out", kind="sonar")


def test_colours_that_a_method_needs_are_asked_for_in_the_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(
        METHODS, "lonely", Method("lonely", "three passes", Parameters, needs=("rgb",))
    )
    path = clouds.write(tmp_path / "city.laz", clouds.city(64.0))
    with pytest.raises(ConfigError, match="needs colours"):
        do(path, tmp_path / "out", method="lonely")


def test_a_store_keeps_colours_for_a_method_that_needs_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    las = laspy.read(clouds.write(tmp_path / "plain.laz", clouds.city(64.0)))
    laspy.convert(las, point_format_id=7).write(tmp_path / "coloured.laz")
    path, out = tmp_path / "coloured.laz", tmp_path / "out"
    do(path, out, "filter", method="lonely")
    assert open_store(str(out / "store.zarr")).meta.has_rgb is False
    monkeypatch.setitem(
        METHODS, "lonely", Method("lonely", "three passes", Parameters, needs=("rgb",))
    )
    with pytest.raises(
        ConfigError,
        match=r"store.zarr: contains no colours, which --method lonely needs; use --ov",
    ):
        do(path, out, "filter", method="lonely")
    do(path, out, "filter", method="lonely", overwrite=True)
    assert open_store(str(out / "store.zarr")).meta.has_rgb is True
