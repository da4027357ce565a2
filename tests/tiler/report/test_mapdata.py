"""What the map draws: tiles of each stage with state and time, the times of earlier runs among them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.tiler.report import results
from tiler.report import html
from tiler.report.html import map_data, with_earlier_times


def test_times_of_earlier_runs_are_the_last_that_were_told(tmp_path: Path) -> None:
    waiting = results.tile(3, 2, 30.0, state="waiting", seconds=None)
    tiles = [results.tile(i, 2, 30.0, seconds=None, peak_rss_bytes=None) for i in range(2)]
    content = results.run(tiles={"filter0": [*tiles, results.tile(2, 2, 30.0), waiting]})
    done = [
        ("filter0", tiles[0]["key"], 9.0, 1),
        ("filter1", tiles[0]["key"], 8.0, 1),
        ("filter0", tiles[0]["key"], 7.5, 5),
        ("filter0", "t+002+000", 1e3, 1),
        ("filter0", waiting["key"], 1e3, 1),
    ]
    names = ("stage", "key", "seconds", "peak_rss_bytes")
    lines = [
        json.dumps({"event": "task_done", **dict(zip(names, row, strict=True))}) for row in done
    ]
    (tmp_path / "events.jsonl").write_text(
        "\n".join([lines[0], '{"event": "task_do', *lines[1:]])
    )
    found = with_earlier_times(content, tmp_path)["tiles"]["filter0"]
    assert [t["seconds"] for t in found] == [7.5, None, 1.02, None]
    assert found[0]["peak_rss_bytes"] == 5
    assert tiles[0]["seconds"] is None


def test_tiles_tell_their_state_and_why_they_failed() -> None:
    tiles = [
        results.tile(0, 2, 30.0, state="failed", seconds=None),
        results.tile(1, 2, 30.0, marked=3, tries=2),
    ]
    failed = [
        {"stage": "filter0", "key": tiles[0]["key"], "error": "no memory", "bounds": None}
    ]
    content = results.run(
        tiles={"filter0": [*tiles, results.tile(2, 2, 30.0, bounds=None)]}, failed_tasks=failed
    )
    (stage,) = map_data(content, None, {})["stages"]
    assert stage["title"] == "filter: seeds, densification, labels"
    assert stage["tiles"] == [
        [
            "t+000+000",
            500000,
            5399970,
            500030,
            5400000,
            "failed",
            1000,
            None,
            1,
            0,
            "no memory",
        ],
        ["t+001+000", 500030, 5399970, 500060, 5400000, "done", 1001, 1.01, 2, 3, ""],
    ]


def test_the_pass_that_labels_comes_first_and_what_does_not_fit_is_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stages = ("filter0", "filter1", "grid-density", "grid-dtm")
    content = results.run(
        tiles={s: [results.tile(i, 2, 30.0) for i in range(4)] for s in stages}
    )
    titles = [stage["title"] for stage in map_data(content, None, {})["stages"]]
    first = "filter: seeds, densification, labels"
    assert titles == ["filter, pass 2", first, "grid: terrain", "grid: density"]
    monkeypatch.setattr(html, "MAX_TILES", 11)
    assert [s["name"] for s in map_data(content, None, {})["stages"]] == ["filter1", "filter0"]


def test_files_and_checkpoints_are_on_the_map() -> None:
    point = {"name": "P1", "x": 1.0, "y": 2.0, "difference": -0.1, "outlier": False}
    check = {"accuracy": {"differences": [point], "unit": "metre", "all": {"p95_abs": 0.2}}}
    found = map_data(results.run(), None, check)
    assert found["files"][0] == ["a.laz", 500000.0, 5399960.0, 500060.0, 5400000.0]
    assert found["checkpoints"] == [["P1", 1.0, 2.0, -0.1, False]]
    assert (found["checkpoint_unit"], found["checkpoint_range"]) == ("metre", 0.2)
