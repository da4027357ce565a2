"""The report of real runs: beside their results, and never in the way of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cli.main import main
from tests.invariants import clouds
from tests.invariants.runs import do
from tests.scenes.finished import Finished
from tests.tiler.report import results
from tiler.report.html import write_report
from tiler.simulate import DemoScene


def test_it_says_what_run_json_says(finished_run: Finished) -> None:
    out, result = finished_run
    page = results.read(out / "report.html")
    run = json.loads((out / "run.json").read_text())
    assert run["report"] == "report.html"
    assert f"read {run['counts']['read']:,}" in page.texts["counts"]
    assert f"ground, before edits and water {run['filter']['ground']:,}" in page.texts["counts"]
    assert run["crs_code"] in page.texts["specification"]
    assert run["dates"]["first"] in page.texts["specification"]
    for note in [*run["plan"]["notes"], *run["notes"]]:
        assert note in page.texts["decisions"]
    for source in run["inputs"]:
        assert source["path"] in page.texts["inputs"]
    tiles = {stage["name"]: stage["tiles"] for stage in page.data["stages"]}
    assert {"filter0", "grid-dtm", "grid-occupancy", "grid-survey", "grid-dtm-outlined"} <= set(
        tiles
    )
    assert len(tiles["filter0"]) == run["filter"]["tiles"]
    assert all(tile[5] == "done" and tile[7] >= 0 for stage in tiles.values() for tile in stage)
    west, south, east, north = page.data["extent"]
    assert all(
        t[1] < east and t[3] > west and t[2] < north and t[4] > south for t in tiles["filter0"]
    )


def stages_of(out: Path) -> list[dict[str, Any]]:
    return sorted(
        results.read(out / "report.html").data["stages"], key=lambda stage: str(stage["name"])
    )


def test_a_second_run_knows_the_times_of_the_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cloud = clouds.write(tmp_path / "hill.laz", clouds.city(100.0, 1.0))
    out = tmp_path / "out"
    do(cloud, out)
    first = stages_of(out)
    assert do(cloud, out).did_nothing
    assert stages_of(out) == first
    (out / "report.html").unlink()
    assert main(["report", str(out), "--title", "Survey of the hill"]) == 0
    assert capsys.readouterr().out == f"{out / 'report.html'}\n"
    assert stages_of(out) == first
    do(cloud, out)
    assert "Survey of the hill" in results.read(out / "report.html").texts[""]


def test_a_report_that_fails_is_told_and_costs_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cloud = clouds.write(tmp_path / "hill.laz", clouds.city(100.0, 1.0))

    def fail(*arguments: object) -> None:
        raise ZeroDivisionError("no luck")

    monkeypatch.setattr("tiler.pipeline.write_report", fail)
    result = do(cloud, tmp_path / "out")
    assert result.exit_code == 0
    assert result.summary["report"] is None
    assert result.summary["notes"][-1].startswith(
        "report.html could not be drawn: no luck; run `tiler report"
    )
    assert result.summary == json.loads((tmp_path / "out" / "run.json").read_text())
    assert (tmp_path / "out" / "dtm.tif").is_file()
    monkeypatch.undo()
    write_report(tmp_path / "out")


def test_tiles_without_number_are_counted(
    demo: DemoScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiler.runs.record.LISTED_TILES", 1)
    summary = do(list(demo.paths), tmp_path / "out", tile_size="128").summary
    assert {"grid-dtm", "grid-survey"} <= set(summary["tiles"])
    assert "filter0" not in summary["tiles"]
    assert summary["stages"]["filter0"]["tasks"] > 1
    assert summary["report"] == "report.html"
