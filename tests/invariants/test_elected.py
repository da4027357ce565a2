"""Passes that elect points, passes on these, and labels from neighbours: tiles show nowhere, nothing stale is left."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ptd
from ptd.methods import METHODS
from ptd.passes import Pass
from tests.invariants import clouds
from tests.invariants.clouds import CORNER, Cloud
from tests.invariants.forked import ended, forked
from tests.invariants.runs import computed, do, settings, stored_labels, the_store
from tests.ptd.medians import (
    METHOD,
    Census,
    LidarPass,
    MeanPass,
    MedianPass,
    Parameters,
    RisingPass,
    SplitPass,
    SpreadPass,
)
from tests.scenes.damages import DAMAGES
from tests.scenes.small_stores import small_stores
from tiler.errors import ConfigError, ProcessingError
from tiler.filter.reading import TileReader
from tiler.plan import make_plan, plan_lines
from tiler.plan.estimates import filter_peak
from tiler.store import TileStore

NOISE = 7
STAGES = [f"filter{number}" for number in (0, 3, 4, 5, 6)]


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "medians", METHOD)
    small_stores(monkeypatch, 500)  # buckets of 16 m


@pytest.fixture(scope="module")
def scene() -> tuple[Cloud, np.ndarray, np.ndarray]:
    """A town, points on the borders of buckets, and noise high above that takes no part; its classes, and the truth."""
    cloud = clouds.city(47.0, 2.0)
    x, y = np.meshgrid(np.arange(0.0, 47.0, 16), np.arange(0.0, 47.0, 16))
    border = np.stack([x.ravel(), y.ravel(), np.full(x.size, cloud.xyz[:, 2].mean())], axis=1)
    edge = border + [-0.001, 0.0, 0.5]
    noise = cloud.xyz[::40] + [0.05, 0.05, 30.0]
    xyz = np.round(np.concatenate([cloud.xyz, border, edge[edge[:, 0] > 0], noise]), 3)
    classes = np.ones(len(xyz), np.uint8)
    classes[-len(noise) :] = NOISE
    part = classes == 1
    expected = np.zeros(len(xyz), np.uint8)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(METHODS, "medians", METHOD)
        expected[part] = ptd.classify(
            xyz[part] + [*CORNER, 0], "medians", kind="dim"
        ).classification
    return Cloud(xyz, classes), classes, expected


@pytest.fixture(scope="module")
def file(scene: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    cloud, classes, _ = scene
    return clouds.write(tmp_path_factory.mktemp("clouds") / "town.laz", cloud, classes=classes)


def filtered(path: Path, out: Path, **changes: Any) -> Any:
    values: dict[str, Any] = {
        "method": "medians",
        "kind": "dim",
        "tile_size": "32",
        "halo": None,
        **changes,
    }
    return do(path, out, "filter", **values)


def check(out: Path, scene: Any) -> None:
    labels, marks = stored_labels(out)
    assert np.array_equal(labels, scene[2])
    assert not marks.any()


@pytest.mark.parametrize("tile", ["16", "512"])
def test_tiles_do_not_show(tile: str, scene: Any, file: Path, tmp_path: Path) -> None:
    assert 0.2 < (scene[2] == 2).mean() < 0.9
    result = filtered(file, tmp_path / "out", tile_size=tile)
    check(tmp_path / "out", scene)
    assert [s for s in result.summary["stages"] if s.startswith("filter")] == STAGES
    assert list(result.summary["statistics"]) == [
        "census",
        "medians",
        "rising",
        "spread",
        "mean",
    ]
    assert result.summary["filter"]["kept"] == np.count_nonzero(scene[1] == NOISE)


def test_order_frame_and_rows_do_not_show(
    scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Buckets of several rows; little is kept for neighbours."""
    cloud, classes, expected = scene
    small_stores(monkeypatch, 500, row_points=64)
    monkeypatch.setattr("tiler.filter.tasks.passes.held_bytes", lambda memory: 20_000)
    monkeypatch.setattr(
        "tiler.plan.sizes.origin_of", lambda extent: (499_876_543, 5_400_000_077)
    )
    order = np.random.default_rng(0).permutation(len(cloud))
    path = clouds.write(tmp_path / "shuffled.laz", cloud.take(order), classes=classes[order])
    filtered(path, tmp_path / "out")
    labels, _ = stored_labels(tmp_path / "out")
    assert np.array_equal(labels, expected[order])
    store = the_store(tmp_path / "out")
    assert max(info.n for info in store.buckets().values()) > 3 * 64


class Wary(RisingPass):
    """Not certain until it sees 12 m: tiles are done a second time."""

    influence_radius_m, halo_m = None, 6.0

    def fit(self, points: Any, window: Any, core: Any, scale: Any, state: Any) -> Any:
        model = super().fit(points, window, core, scale, state)
        near = (
            core.west - window.west < 20_000
            and core.south - window.south < 20_000
            and window.closed
        )
        model.uncertain = lambda: int(near)  # type: ignore[method-assign]
        return model


def test_tiles_that_are_done_twice(
    scene: Any, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    passes = [Wary() if isinstance(step, RisingPass) else step for step in Parameters().passes]
    monkeypatch.setattr(Parameters, "passes", tuple(passes))
    filtered(file, tmp_path / "out")
    check(tmp_path / "out", scene)
    tries = [r["tries"] for _, r in the_store(tmp_path / "out").committed("filter4").values()]
    assert max(tries) > 1


def test_each_bucket_is_read_about_once(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[Any] = []
    before = TileReader._read

    def counted(self: TileReader, cell: Any) -> Any:
        read.append(cell)
        return before(self, cell)

    monkeypatch.setattr(TileReader, "_read", counted)
    filtered(file, tmp_path / "out", tile_size="512")
    buckets = len(the_store(tmp_path / "out").buckets())
    assert buckets == 9
    assert len(read) == 2 * buckets  # spread, mean; rising labels its window


def test_another_branch_leaves_nothing_stale(scene: Any, file: Path, tmp_path: Path) -> None:
    """Both branches write the final labels: what the other one did has to be done again."""
    out = tmp_path / "out"
    z = np.round(scene[0].xyz[:, 2] * 1000).astype(np.int64)
    part = scene[1] == 1
    laser = np.where(part, np.where(z > z[part].sum() // part.sum(), 1, 2), 0)
    for kind in ("dim", None, "dim"):
        result = filtered(file, out, kind=kind)
        labels, _ = stored_labels(out)
        assert np.array_equal(labels, scene[2] if kind else laser)
        done = {stage: n for stage, n in computed(result).items() if stage.startswith("filter")}
        assert list(done) == (STAGES if kind else ["filter0", "filter1", "filter2"])
        assert min(done.values()) > 0
        kept = {f"filter{n}" for n in range(7) if the_store(out).committed(f"filter{n}")}
        assert kept == done.keys()
        again = filtered(file, out, kind=kind)
        assert sum(computed(again).values()) == 0


class Killed(Exception):
    pass


@pytest.mark.parametrize(
    "at",
    [
        MedianPass,
        *(
            pytest.param(at, marks=pytest.mark.slow)
            for at in (RisingPass, SpreadPass, MeanPass)
        ),
    ],
)
def test_a_run_that_ended_on_the_way_goes_on(
    at: type[Pass], scene: Any, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    filtered(file, out, kind="als")
    with monkeypatch.context() as patch:
        calls, fit = [0], at.fit

        def failing(self: Any, *arguments: Any) -> Any:
            calls[0] += 1
            if calls[0] > 2:
                raise Killed
            return fit(self, *arguments)

        patch.setattr(at, "fit", failing)
        with pytest.raises(ProcessingError, match="--on-error skip"):
            filtered(file, out, on_error="stop")
    result = filtered(file, out)
    check(out, scene)
    again = result.summary["stages"]
    stage = f"filter{[type(step) for step in Parameters().passes].index(at)}"
    assert 0 < again[stage]["done"] < again[stage]["tasks"]


def killed_after_writing(path: Path, out: Path) -> None:
    """A run that ends between what a third task elects or labels and its commit."""
    METHODS["medians"] = METHOD
    small_stores(pytest.MonkeyPatch(), 500)
    write, calls = TileStore.write_elected, [0]

    def last(self: TileStore, *arguments: Any) -> None:
        write(self, *arguments)
        calls[0] += 1
        if calls[0] == 3:
            os.kill(os.getpid(), signal.SIGKILL)

    TileStore.write_elected = last  # type: ignore[method-assign]
    filtered(path, out, tile_size="16")


@pytest.mark.processes
def test_a_run_that_was_killed_while_it_elected(scene: Any, file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    filtered(file, out, kind="als", tile_size="16")
    assert ended(forked(killed_after_writing, file, out)) == -signal.SIGKILL
    assert len(the_store(out).committed("filter3")) == 2
    assert not the_store(out).committed("filter2")
    again = filtered(file, out, tile_size="16").summary["stages"]
    assert (again["filter3"]["done"], again["filter3"]["tasks"]) == (2, 9)
    check(out, scene)


def test_a_tile_that_fails_elects_nothing(
    file: Path, scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of elections and of labels of elected points; the next run makes good."""
    out, cores = tmp_path / "out", []
    with monkeypatch.context() as patch:
        for step in (MedianPass, RisingPass):
            fit = step.fit

            def failing(
                self: Any, points: Any, window: Any, core: Any, *more: Any, fit: Any = fit
            ) -> Any:
                cores.append(core)
                if core == cores[0]:
                    raise RuntimeError("no")
                return fit(self, points, window, core, *more)

            patch.setattr(step, "fit", failing)
        result = filtered(file, out)
        assert [f["stage"] for f in result.summary["failed_tasks"]][:2] == [
            "filter3",
            "filter4",
        ]
        assert result.exit_code == 5
    filtered(file, out)
    check(out, scene)


@pytest.mark.parametrize(
    ("what", "damage"),
    [
        ("elected/elected-3/c.*.0.0", "bomb"),
        *(
            pytest.param("elected/elected-3/c.*.0.0", d, marks=pytest.mark.slow)
            for d in ("gone", "flipped")
        ),
        ("elected/elected-3/zarr.json", "flipped"),
        ("labels/labels-4/c.*.0.0", "gone"),
        ("labels/labels-5/c.*.0.0", "flipped"),
    ],
)
def test_what_is_damaged_is_made_again(
    what: str, damage: str, scene: Any, file: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    store = the_store(out)
    store.clear("filter6")  # so that something reads them again
    if what.startswith("labels"):
        store.clear("filter5")
    if what.endswith(".json"):
        store.clear("filter4")
    DAMAGES[damage](max((out / "store.zarr").glob(what), key=lambda p: p.stat().st_size))
    result = filtered(file, out)
    check(out, scene)
    assert bool(result.summary.get("healed")) == ("labels-5" not in what)
    assert result.summary["stages"]["assemble"]["computed"] == 0


@pytest.fixture(scope="module")
def whole(file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "out"
    with pytest.MonkeyPatch.context() as patch:
        small_stores(patch, 500)
        patch.setitem(METHODS, "medians", METHOD)
        filtered(file, out)
    return out


def test_a_part_with_the_statistics_of_the_whole(
    scene: Any, file: Path, whole: Path, tmp_path: Path
) -> None:
    x, y = CORNER
    bounds = (x + 10, y + 12, x + 37, y + 30)
    result = filtered(file, tmp_path / "out", statistics=str(whole), bounds=bounds)
    assert [s for s in result.summary["stages"] if s.startswith("filter")] == STAGES
    store = the_store(tmp_path / "out")
    found: dict[int, int] = {}
    for cell in store.buckets():
        origin = store.read_bucket(cell, ("origin",)).origin
        assert origin is not None
        labels = store.read_labels("labels", cell)
        found |= dict(zip(origin.tolist(), labels.tolist(), strict=True))
    at = scene[0].xyz
    inside = (at[:, 0] >= 10) & (at[:, 0] < 37) & (at[:, 1] >= 12) & (at[:, 1] < 30)
    assert all(found[i] == scene[2][i] for i in np.flatnonzero(inside).tolist())
    laser = tmp_path / "laser"
    filtered(file, laser, kind="als")
    shutil.copytree(laser, tmp_path / "copy")
    result = filtered(file, tmp_path / "out", statistics=str(tmp_path / "copy"), kind="dim")
    assert "filter1" in result.summary["stages"]  # as that run decided
    assert any("--kind dim is not used" in note for note in result.summary["notes"])


def test_the_plan_knows_elected_points_and_margins(file: Path) -> None:
    plan = make_plan([str(file)], settings(method="medians", tile_size=None, halo=None))
    step = {step.name: step for step in plan.method.passes}
    assert step["spread"].pass_.label_margin_m == 3.0
    assert (step["mean"].pass_.elected, step["medians"].pass_.elected) == (True, False)
    assert (step["medians"].sometimes, step["census"].sometimes) == (True, False)
    assert "some of them only for some clouds" in " ".join(plan_lines(plan))
    assert filter_peak(plan, step["spread"], 64, 8) > filter_peak(plan, step["rising"], 64, 8)


def test_passes_of_another_branch_make_no_tile_smaller(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where memory cuts them, too."""

    def plans() -> list[Any]:
        found = []
        for memory in ("420MiB", "500MiB", "1GiB"):
            how = settings(method="medians", tile_size=None, halo=None, memory=memory)
            plan = make_plan([str(file)], how)
            found.append((float(plan.method.tile), plan.method.halo_m, plan.margin))
        return found

    with monkeypatch.context() as patch:
        wide = [SplitPass(), LidarPass()]
        for step in wide:
            step.influence_radius_m = 20.0
        patch.setattr(Parameters, "passes", (Census(), *wide))
        patch.setattr(Parameters, "candidate_cell_m", 0.0)
        laser = plans()
        assert laser[0][0] < laser[2][0] == 512
        images = (MedianPass(), RisingPass(), SpreadPass(), MeanPass())
        patch.setattr(Parameters, "passes", (Census(), *wide, *images))
        both = plans()
        assert all(b[0] >= a[0] and b[1:] == a[1:] for a, b in zip(laser, both, strict=True))


def test_statistics_of_a_run_that_did_other_passes(
    file: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Census, "name", "other")
    with pytest.raises(
        ConfigError, match="has no results of the pass other; use the --kind of the run"
    ):
        filtered(file, tmp_path / "out", statistics=str(whole))


def test_a_pass_with_another_name_is_done_again(
    file: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A later version may insert a pass, so that the number of a pass becomes that of another one."""
    out = tmp_path / "out"
    filtered(file, out)
    monkeypatch.setattr(MedianPass, "name", "other")
    again = computed(filtered(file, out))
    number = [step.name for step in Parameters().passes].index("other")
    assert again[f"filter{number}"] > 0


def test_statistics_need_no_results_of_passes_that_have_none(
    file: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An earlier version may not have had the pass."""
    monkeypatch.setattr(RisingPass, "name", "new")
    assert type(RisingPass()).reduce is Pass.reduce
    filtered(file, tmp_path / "out", statistics=str(whole))
