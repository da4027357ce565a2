"""The scorecard of two tiny scenes: true figures in every table, refusals with their reason."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ptd.methods.auto.method import Auto
from tests.benchmarks import kept, leave_one_out, measuring, scorecard
from tests.benchmarks.kept import Kept
from tests.benchmarks.published import PER_SAMPLE
from tests.benchmarks.scorecard_scenes import (
    RAW,
    BenchScene,
    Cloud,
    read_clouds,
    simulated_scenes,
)
from tests.benchmarks.scorecard_text import markdown, percent, table
from tiler.simulate import SCENES as SIMULATOR_SCENES


def plain() -> Cloud:
    """A plane with a house, noise and water."""
    rng = np.random.default_rng(1)
    xyz = np.column_stack((rng.uniform(0, 60, (3000, 2)), rng.normal(0, 0.03, 3000)))
    classes = np.full(3000, 2, np.uint8)
    house = np.all(np.abs(xyz[:, :2] - 30) < 5, axis=1)
    xyz[house, 2] += 6
    classes[house] = 6
    classes[:5] = 7
    classes[5:9] = 9
    return Cloud(xyz, classes, truth=lambda x, y: np.full(np.shape(x), 0.1), side_m=60.0)


SCENES = [BenchScene(name, "tiny", "simulated things", plain) for name in ("house", "again")]


def test_two_tiny_scenes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: object
) -> None:
    def refuses(cloud: Cloud) -> np.ndarray:
        raise ValueError("needs rgb")

    def everything(cloud: Cloud) -> np.ndarray:
        return np.ones(len(cloud.xyz), bool)

    own = scorecard.all_filters()["classic"]
    filters = {
        "classic": own,
        "all": scorecard.Entry(everything, ""),
        "picky": scorecard.Entry(refuses, ""),
    }
    monkeypatch.setattr(scorecard, "all_filters", lambda: filters)
    monkeypatch.setattr("os.sched_setaffinity", lambda *_: None, raising=False)
    arguments = [
        str(tmp_path / "card.md"),
        "--json",
        str(tmp_path / "card.json"),
        "--repeats",
        "1",
    ]
    scorecard.main(arguments, SCENES)
    cells = json.loads((tmp_path / "card.json").read_text())
    assert [(c["method"], c["scene"]) for c in cells] == [
        (m, s.name) for s in SCENES for m in filters
    ]
    best, worst, none = cells[:3]
    assert best["total"] < 0.01
    assert best["seconds"] > 0
    # the plane is at 0, its truth at 0.1
    assert best["dtm_rmse_m"] == pytest.approx(0.1, abs=0.02)
    assert worst["dtm_rmse_m"] > 0.9  # the house stands in it
    truth = plain().classification
    house, ground = (truth == 6).sum(), (truth == 2).sum()
    assert (worst["type_1"], worst["type_2"]) == (0.0, 1.0)
    assert worst["total"] == house / (house + ground)  # noise and water do not count
    assert (none["refusal"], none["total"], none["seconds"]) == ("needs rgb", None, None)
    text = (tmp_path / "card.md").read_text()
    share = f"0.00 / 100.00 / {100 * house / (house + ground):.2f} / 0.00"
    # both scenes; the means of the class, of the simulated, of all
    assert text.count(share) == 2 + 3
    assert f"**{100 * best['total']:.2f}**" in text
    assert "| tiny (2) |" in text
    assert f"{share}, {worst['dtm_rmse_m']:.3f} m" in text
    assert "refused 2 of 2" in text
    assert "- `picky` on house, again: needs rgb" in text
    assert "28.21" in text  # published


def test_low_points_of_raw_scenes_are_found_or_become_ground(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def classes(cloud: Cloud) -> np.ndarray:
        found = np.full(len(cloud.xyz), 1, np.uint8)
        found[:3], found[3:] = 7, np.where(np.arange(3, 3000) == 3, 1, 2)
        return found

    def only_ground(cloud: Cloud) -> np.ndarray:
        return np.arange(len(cloud.xyz)) >= 3

    filters = {
        "both": scorecard.Entry(classes, ""),
        "only ground": scorecard.Entry(only_ground, ""),
    }
    monkeypatch.setattr(scorecard, "all_filters", lambda: filters)
    monkeypatch.setattr("os.sched_setaffinity", lambda *_: None, raising=False)
    out = [str(tmp_path / "card.md"), "--json", str(tmp_path / "card.json"), "--repeats", "0"]
    scorecard.main(out, [BenchScene("raw", RAW, "simulated laser scanning", plain)])
    cells = json.loads((tmp_path / "card.json").read_text())
    # Of five low points three are noise, one is unclassified and one is ground.
    assert [(c["low_found"], c["low_as_ground"]) for c in cells] == [(0.6, 0.2), (None, 0.4)]
    assert cells[0]["type_1"] == 0.0
    text = (tmp_path / "card.md").read_text()
    assert "| raw | 60.00 / 20.00 | - / 40.00 |" in text
    overlap = " | ".join(f"{percent(c['iou'])} / {percent(c['mcc'])}" for c in cells)
    assert f"| {RAW} | {overlap} |" in text


def test_raw_scenes_of_the_simulator_are_in_the_family_whose_low_points_count() -> None:
    raw = [scene.name for scene in simulated_scenes() if scene.family == RAW]
    assert raw == [name for name in SIMULATOR_SCENES if name.startswith("raw_")]
    assert len(raw) == 5


def test_what_was_measured_is_measured_again_only_where_its_sources_changed(
    tmp_path: Path,
) -> None:
    asked: list[str] = []

    def entry(name: str, key: str) -> scorecard.Entry:
        def run(cloud: Cloud) -> np.ndarray:
            asked.append(name)
            return np.ones(len(cloud.xyz), bool)

        return scorecard.Entry(run, key)

    def card(scenes: list[BenchScene], **keys: str) -> list[measuring.Cell]:
        asked.clear()
        filters = {name: entry(name, key) for name, key in keys.items()}
        return scorecard.run_all(scenes, filters, 0, lambda line: None, Kept(tmp_path / "kept"))

    first = card(SCENES[:1], a="1", b="1")
    assert asked == ["a", "b"]
    assert card(SCENES[:1], a="1", b="1") == first
    assert asked == []
    assert card(SCENES, a="1", b="2")[0] == first[0]
    assert asked == ["b", "a", "b"]


def test_a_module_changes_with_what_it_imports_but_not_with_other_methods() -> None:
    found = {
        path.relative_to(kept.ROOT).as_posix()
        for path in kept.sources_of("ptd.methods.auto.method")
    }
    assert {
        "ptd/methods/auto/method.py",
        "ptd/matched/passes.py",
        "ptd/kernel.py",
        "ptd/tin/mesh.py",
    } <= found
    assert not any("dong" in path for path in found)


def test_each_sample_is_scored_with_what_is_best_on_the_others() -> None:
    errors = {
        ("a", 1): 0.3,
        ("a", 2): 0.0,
        ("b", 1): 0.1,
        ("b", 2): 0.2,
        ("c", 1): 0.1,
        ("c", 2): 0.1,
    }
    found = leave_one_out.leave_one_out(
        "abc",
        {"rounds": (8, 4)},
        None,
        lambda name, settings: errors[name, settings["rounds"] // 4],
    )
    assert [(f.sample, f.settings, f.total, f.default) for f in found.folds] == [
        ("a", {}, 0.3, 0.3),  # 4 rounds are better on b and c
        ("b", {"rounds": 8}, 0.2, 0.1),
        ("c", {"rounds": 8}, 0.1, 0.1),
    ]
    assert found.best == pytest.approx(0.1)
    text = markdown([], "classic", 1, {"ISPRS samples": found}, {"PDAL": "not installed"})
    assert "20.00 against 16.67 with the default, +3.33 points" in text
    assert "| b | rounds 8 | 10.00 | 20.00 |" in text
    assert "- PDAL: not installed" in text


def test_combinations_in_which_more_changes_than_is_allowed_are_left_out() -> None:
    seen = []
    found = leave_one_out.leave_one_out(
        "ab",
        {"rounds": (4, 8), "cell": (10, 20)},
        {"rounds": 8, "cell": 20},
        lambda name, settings: seen.append((name, *settings.values())) or 0.1,  # type: ignore[func-returns-value]
        most_changed=1,
    )
    assert seen == [(name, *c) for c in ((8, 20), (4, 20), (8, 10)) for name in "ab"]
    assert found.settings == 3
    text = markdown([], "classic", 1, {"ISPRS samples": found}, {})
    assert "All 3 settings of this grid with at most 1 value changed, declared" in text


def test_the_default_is_in_the_middle_of_the_grid() -> None:
    default = Auto()
    for name, values in leave_one_out.default_grid().items():
        assert values[1] == getattr(default, name)
        assert values[0] < values[1] < values[2]


def test_every_method_is_a_filter() -> None:
    from ptd.methods import METHODS

    names = list(scorecard.all_filters())
    assert names[0] == "classic"
    assert set(METHODS) <= set(names)


def test_published_samples_are_those_that_are_open() -> None:
    from tests.benchmarks.scorecard_scenes import ISPRS

    for entry in PER_SAMPLE:
        assert list(entry.samples) == [f"samp{n}" for n in ISPRS]


def test_tables_are_markdown() -> None:
    assert table(["a", "b"], [["x", "1"]]) == "| a | b |\n| --- | ---: |\n| x | 1 |\n"


def test_virtual_points_are_no_part_of_a_scene(shared_data: Path) -> None:
    path = shared_data / "ign/test_semis_2023_0292_6833.laz"
    cloud = read_clouds([path])
    assert len(cloud.xyz) == len(cloud.classification) == 289_055 - 12
    assert 66 not in cloud.classification
    assert cloud.returns is not None
    assert (cloud.returns[:, 0] <= cloud.returns[:, 1]).all()
