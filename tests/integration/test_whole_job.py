"""The whole job on a generated city, by the Python API and by the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import rasterio
from rio_cogeo.cogeo import cog_validate

import tiler as package
from cli.main import main
from ptd.matched.step import MatchedPass
from ptd.methods.auto.method import Auto
from tests.integration.command import tiler
from tests.invariants.runs import computed, do, output_digests
from tests.scenes.finished import Finished
from tiler.apps.evaluate import evaluate_dtm, evaluate_files
from tiler.simulate import DemoScene

PASSES = sum(not isinstance(step, MatchedPass) for step in Auto().passes)  # a laser scan
SURVEY = ("grid-occupancy", "grid-survey-open", "grid-survey")
WATER = (
    "grid-water-ground",
    "grid-domain-open",
    "grid-domain",
    "grid-water-planes",
    "grid-water-areas",
)
GRID = ("grid-dtm", *SURVEY, *WATER, "grid-dtm-outlined", "grid-dtm-above", "grid-dtm-left")


def test_it_succeeds_and_leaves_what_it_says(default_run: Finished, demo: DemoScene) -> None:
    out, result = default_run
    assert result.exit_code == 0
    assert not result.did_nothing
    files = {"dtm.tif", "outline.gpkg", "review.gpkg", "classified.vpc", "stac.json"}
    files.add("classified-overview.copc.laz")
    names = {*files, *(f"classified/{path.name}" for path in demo.paths)}
    assert result.summary["outputs"] == {name: (out / name).stat().st_size for name in names}
    others = {"classified", "store.zarr", "run.json", "events.jsonl", "report.html"}
    assert {p.name for p in out.iterdir()} == files | others
    assert not list(out.rglob("*.partial*"))
    assert not (out / "store.zarr" / "lock.json").exists()


def test_the_dtm_is_a_valid_cog_of_the_inputs_crs(default_run: Finished) -> None:
    path = default_run[0] / "dtm.tif"
    valid, errors, warnings = cog_validate(path, strict=True)
    assert (valid, errors, warnings) == (True, [], [])
    with rasterio.open(path) as raster:
        assert raster.crs.to_epsg() == 32632
        assert raster.dtypes == ("float32",)
        assert raster.nodata == -9999.0
        assert raster.transform.a == -raster.transform.e == 1.0
        assert raster.transform.c % 1 == raster.transform.f % 1 == 0
        tags = raster.tags()
    assert tags["TILER_VERSION"] == package.__version__
    assert tags["TILER_METHOD"] == "auto"
    assert json.loads(tags["TILER_PARAMETERS"])["max_building_size_m"] == 36.0
    assert len(tags["TILER_INPUTS"]) == 32


def test_the_terrain_is_the_true_one(default_run: Finished, demo: DemoScene) -> None:
    scores = evaluate_dtm(default_run[0] / "dtm.tif", demo.dtm_path)
    # Whole roofs of large buildings are the method's matter, see its own tests.
    assert abs(scores["median"]) < 0.02
    assert scores["nmad"] < 0.05
    for path, truth in zip(demo.paths, demo.truth_paths, strict=True):
        assert evaluate_files(default_run[0] / "classified" / path.name, truth)["total"] < 0.1


def test_run_json_tells_what_was_done(default_run: Finished, demo: DemoScene) -> None:
    out, result = default_run
    content = json.loads((out / "run.json").read_text())
    assert content == json.loads(json.dumps(result.summary))
    assert (content["state"], content["implausible"]) == ("done", [])
    assert content["version"] == package.__version__
    assert content["configuration"]["tile_size"] == "128"
    assert content["plan"]["parameters"]["rounds"] == 4
    assert {"numpy", "numba", "zarr", "laspy"} <= content["libraries"].keys()
    assert [i["path"] for i in content["inputs"]] == [p.as_posix() for p in sorted(demo.paths)]
    assert (
        sum(i["points"] for i in content["inputs"])
        == demo.points
        == content["counts"]["stored"]
    )
    assert all(len(i["content"]) == 32 for i in content["inputs"])
    passes = [f"filter{i}" for i in range(PASSES)]
    assert sorted(content["stages"]) == sorted(
        ["assemble", "catalogue", "export", *passes, *GRID, "spool"]
    )
    for stage in content["stages"].values():
        assert stage["computed"] == stage["tasks"] > 0
        assert stage["done"] == 0
    assert content["quarantined"] == content["failed_tasks"] == []
    assert content["filter"]["marked"] == 0
    assert content["seconds"] > 0
    assert content["peak_rss_bytes"] > 50 << 20


def test_events_tell_the_same(default_run: Finished) -> None:
    out, result = default_run
    events = [json.loads(line) for line in (out / "events.jsonl").read_text().splitlines()]
    names = [event["event"] for event in events]
    assert names[-1] == "run_finished"
    for stage, facts in result.summary["stages"].items():
        of_stage = [e for e in events if e.get("stage") == stage]
        assert of_stage[0]["event"] == "stage_started"
        assert of_stage[-1]["event"] == "stage_finished"
        done = [e["key"] for e in of_stage if e["event"] == "task_done"]
        assert len(done) == len(set(done)) == facts["tasks"]


@pytest.mark.processes
def test_the_command_line_does_the_same(
    default_run: Finished, demo: DemoScene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    said = "--workers 2 --resolution 1 --tile-size 128 --halo 80 --memory 1GiB"
    options = ["-o", out, *said.split()]
    first = tiler("run", *demo.paths, *options)
    assert first.returncode == 0, first.stderr
    assert str(out / "dtm.tif") in first.stdout
    assert "Traceback" not in first.stderr
    assert output_digests(out) == output_digests(default_run[0])
    capsys.readouterr()
    assert main([str(a) for a in ("run", *demo.paths, *options, "--json", "-q")]) == 0
    second = capsys.readouterr()
    assert all(line.startswith("warning: ") for line in second.err.splitlines())
    content = json.loads(second.out)
    assert content == json.loads((out / "run.json").read_text())
    assert {stage["computed"] for stage in content["stages"].values()} == {0}


def test_the_stages_one_by_one_are_the_whole_job(
    default_run: Finished, demo: DemoScene, tmp_path: Path
) -> None:
    passes = {f"filter{i}" for i in range(PASSES)}
    for until, stages in (
        ("ingest", {"spool", "assemble"}),
        ("filter", passes),
        ("grid", set(GRID)),
        ("export", {"export", "catalogue"}),
    ):
        result = do(
            list(demo.paths),
            tmp_path / "out",
            until=until,
            tile_size="128",
            method="auto",
            water="auto",
        )
        assert {stage for stage, n in computed(result).items() if n} == stages
    assert output_digests(tmp_path / "out") == output_digests(default_run[0])
