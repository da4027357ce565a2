"""What each command prints, and what it asks of the library."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from cli.commands.methods import range_text
from cli.main import main
from cli.output import fact_lines, map_lines
from cli.summary import score_lines, summary_lines
from tiler.apps.warm import WarmResult
from tiler.config import RunConfig
from tiler.observe.events import Note, Warned

SUMMARY: dict[str, Any] = {
    "inputs": [{}, {}],
    "counts": {"stored": 3_000_000, "dropped": {"outside the area": 12}},
    "seconds": 90.0,
    "filter": {"ground": 2_000_000, "tiles": 6, "marked": 3, "low_noise": 1_200},
    "outputs": {"dtm.tif": 1000},
    "dtm": {"width": 1200, "height": 600, "resolution_m": 0.5},
    "peak_rss_bytes": 300 << 20,
    "quarantined": [{"path": "bad.laz", "error": "bad.laz: cut short"}],
    "failed_tasks": [{"stage": "filter0", "key": "t+1", "error": "no memory"}],
}


@dataclass
class Result:
    exit_code: int = 5
    summary: dict[str, Any] = field(default_factory=lambda: SUMMARY)
    did_nothing: bool = False
    others: tuple[Any, ...] = ()


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Calls of `tiler.pipeline.run`, which is replaced."""
    seen: list[dict[str, Any]] = []

    def run(inputs: Any, out: Any, config: RunConfig, listener: Any, until: str) -> Result:
        listener(Note("a note"))
        listener(Warned("a warning"))
        seen.append({"inputs": inputs, "out": out, "config": config, "until": until})
        return Result()

    monkeypatch.setattr("tiler.apps.resolutions.run", run)
    return seen


@pytest.mark.processes
@pytest.mark.parametrize(
    ("command", "until"),
    [
        ("run", "export"),
        ("ingest", "ingest"),
        ("filter", "filter"),
        ("grid", "grid"),
        ("export", "export"),
    ],
)
def test_stages_are_the_run_up_to_there(
    command: str, until: str, calls: list[dict[str, Any]]
) -> None:
    assert main([command, "a.laz", "b/*.las", "-o", "OUT", "--workers", "2"]) == 5
    inputs = ("a.laz", "b/*.las")
    assert calls == [
        {"inputs": inputs, "out": "OUT", "config": RunConfig(workers=2), "until": until}
    ]


def test_summary_to_stdout_progress_to_stderr(
    calls: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "a.laz", "-o", "OUT"]) == 5
    captured = capsys.readouterr()
    assert captured.err == "a note\nwarning: a warning\n"
    assert captured.out.splitlines() == [
        "points      3,000,000 of 2 files, 12 dropped",
        "ground      2,000,000 points, in 6 tiles, 3 labels not certified",
        "low noise   1,200 points below the ground",
        f"DTM         OUT{os.sep}dtm.tif, 1,200 x 600 pixels of 0.5 m",
        "time        1:30 min, 33.3 k points/s",
        "memory      300.0 MiB at most in one process",
        "left out    bad.laz: cut short",
        "failed      filter0 t+1: no memory",
    ]


def test_quiet_prints_nothing_but_trouble_and_json(
    calls: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "a.laz", "-o", "OUT", "-q"]) == 5
    assert capsys.readouterr() == ("", "warning: a warning\n")
    assert main(["run", "a.laz", "-o", "OUT", "--json", "-q"]) == 5
    captured = capsys.readouterr()
    assert json.loads(captured.out) == SUMMARY
    assert captured.err == "warning: a warning\n"


def test_a_finished_job_says_that_it_did_nothing() -> None:
    lines = summary_lines(SUMMARY, "OUT", did_nothing=True)
    assert lines[0].startswith("nothing to do")
    assert "points/s" not in "\n".join(lines)


MADE: dict[str, Any] = {
    "plan": {"metres_per_unit": {"horizontal": 0.3048, "vertical": 0.3048}},
    "dtm": {"width": 12, "height": 6, "resolution_m": 0.6096},
    "outputs": dict.fromkeys(
        ("dtm.tif", "contours.gpkg", "spots.gpkg", "outline.gpkg", "sheets.gpkg"), 1
    )
    | {"classified/a.laz": 1},
    "classes": {"written": {"1": 5, "2": 1_999_900}, "ground": 1_999_000},
    "contours": {"lines": 12, "interval": 5.0},
    "spots": {"highs": 1, "lows": 2},
    "water": [],
    "bridges": [],
    "outline": {"polygons": 1},
    "sheets": 3,
    "problems": [
        {"what": "void inside the survey"},
        {"what": "void inside the survey"},
        {"what": "class that is not filtered"},
    ],
    "edits": [
        {
            "number": 1,
            "action": "not_ground",
            "points": 9,
            "ground_before": 7,
            "ground_after": 0,
            "holes": 94_637,
        },
        {"number": 2, "action": "flat", "pixels": 1, "holes": 0},
    ],
}


def test_a_summary_tells_what_was_made() -> None:
    lines = summary_lines({**SUMMARY, **MADE}, "OUT")
    assert lines[1:15] == [
        "ground      1,999,000 points, in 6 tiles, 3 labels not certified",
        "low noise   1,200 points below the ground",
        f"DTM         OUT{os.sep}dtm.tif, sheets cut from 12 x 6 pixels of 2 ft",
        f"contours    12 lines every 5 ft, OUT{os.sep}contours.gpkg",
        f"spots       1 top, 2 bottoms, OUT{os.sep}spots.gpkg",
        "water       none found",
        "bridges     none found",
        f"outline     1 polygon, OUT{os.sep}outline.gpkg",
        f"clouds      1 classified cloud, OUT{os.sep}classified",
        f"sheets      3 sheets, OUT{os.sep}sheets.gpkg",
        "edit        1 (not_ground): 7 of 9 points were ground before, none after; 94,637 pixels without a height",
        "edit        2 (flat): 1 pixel",
        "problems    3: void inside the survey (2), class that is not filtered",
        "time        1:30 min, 33.3 k points/s",
    ]
    voids = {"surveyed_pixels": 40, "pixels": 3, "asked_pixels": 0}
    lines = summary_lines({**SUMMARY, **MADE, "voids": voids}, "OUT")
    assert lines[3].endswith(
        "12 x 6 pixels of 2 ft, 92.5 % of the area that was read has a height"
    )
    found = {"water": [{"kind": "lake"}, {"kind": "river"}, {"kind": "river"}], "bridges": [{}]}
    found["outputs"] = {"water.gpkg": 1, "bridges.gpkg": 1}
    lines = summary_lines({**SUMMARY, **found}, "OUT")
    assert f"water       1 lake, 2 rivers, OUT{os.sep}water.gpkg" in lines
    assert f"bridges     1 bridge left out, OUT{os.sep}bridges.gpkg" in lines
    many = [{"path": f"{n}.laz", "error": f"{n}.laz: cut short"} for n in range(40)]
    lines = summary_lines({**SUMMARY, **MADE, "quarantined": many}, "OUT")
    left_out = [line for line in lines if line.startswith("left out")]
    assert left_out[2:] == [
        "left out    2.laz: cut short",
        "left out    37 more, listed in run.json",
    ]


def test_a_summary_tells_points_that_are_in_several_files() -> None:
    counts: dict[str, Any] = {"stored": 30, "dropped": {}, "duplicates_within_files": 0}
    lines = summary_lines({**SUMMARY, "counts": counts}, "OUT")
    assert lines[0] == "points      30 of 2 files"
    counts["duplicates_between_files"] = 1200
    lines = summary_lines({**SUMMARY, "counts": counts}, "OUT")
    assert lines[0] == "points      30 of 2 files, 1,200 duplicates between files"
    counts["duplicates_between_files"] = 1
    lines = summary_lines({**SUMMARY, "counts": counts}, "OUT")
    assert lines[0] == "points      30 of 2 files, 1 duplicate between files"


def test_summary_of_an_early_stage() -> None:
    early = {k: v for k, v in SUMMARY.items() if k not in ("filter", "dtm", "outputs")}
    names = [line.split()[0] for line in summary_lines(early, "OUT")]
    assert names == ["points", "time", "memory", "left", "failed"]


def test_plan(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("tiler.apps.resolutions.make_plan", lambda inputs, config, out: 4)
    monkeypatch.setattr("tiler.plan.plan_lines", lambda plan: ["inputs  1", f"tiles   {plan}"])
    monkeypatch.setattr("tiler.plan.plan_json", lambda plan: {"tiles": plan})
    assert main(["plan", "a.laz"]) == 0
    assert capsys.readouterr().out == "inputs  1\ntiles   4\n"
    assert main(["plan", "a.laz", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"tiles": 4}


def test_classify(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def classify_file(
        source: str, target: str, config: RunConfig, listener: Any
    ) -> dict[str, Any]:
        listener(Note("metres assumed"))
        assert (source, target, config) == ("a.las", "b.laz", RunConfig(keep_classes=()))
        code = 5 if failed else 0
        parameters = {"rounds": 1}
        return {
            "points": 7,
            "parameters": parameters,
            "failed_tasks": failed,
            "exit_code": code,
        }

    failed: list[dict[str, Any]] = []

    monkeypatch.setattr("tiler.apps.classify.classify_file", classify_file)
    call = ["classify", "a.las", "b.laz", "--keep-classes", ""]
    assert main(call) == 0
    assert capsys.readouterr() == ("points  7\n", "metres assumed\n")
    assert main([*call, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["parameters"] == {"rounds": 1}
    bounds = [0.0, 5.4e6, 64.5, 5400064.0]
    failed.append({"stage": "filter0", "key": "t+1-2", "error": "no memory", "bounds": bounds})
    assert main(call) == 5
    (line,) = capsys.readouterr().out.splitlines()[1:]
    assert line == "failed      filter0 t+1-2 (--bounds 0 5400000 64.5 5400064): no memory"
    assert main([*call, "--json"]) == 5


def test_methods_tells_every_parameter(capsys: pytest.CaptureFixture[str]) -> None:
    from ptd.methods import METHODS

    assert main(["methods", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told) == set(METHODS)
    for name, method in METHODS.items():
        parameters = {p["name"]: p for p in told[name]["parameters"]}
        for parameter, value in vars(method.params()).items():
            assert parameters[parameter]["default"] == value
            assert parameters[parameter]["help"]
    assert main(["methods", "classic"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("classic: ")
    assert any("iteration_angle_deg" in line and " deg " in line for line in lines)
    assert "\x1b" not in "".join(lines)


@pytest.mark.parametrize(
    ("minimum", "maximum", "text"),
    [(None, None, ""), (0.0, None, ">= 0"), (None, 5, "<= 5"), (0.1, 89.0, "0.1 to 89")],
)
def test_ranges(minimum: float | None, maximum: float | None, text: str) -> None:
    assert range_text(minimum, maximum) == text


SCORES = {
    "points": 1000,
    "ignored": 7,
    "type_1": 0.0125,
    "type_2": None,
    "total": 0.01,
    "kappa": 0.975,
    "unmatched_reference": 0,
    "unmatched_cloud": 3,
}


def test_scores() -> None:
    dtm = {"unit": "metre", "rmse": 0.1234, "bias": -0.01, "pixels": 360_000}
    assert score_lines(SCORES, dtm) == [
        "type I  1.25 %  (ground lost)",
        "type II -  (objects classified as ground)",
        "total   1.00 %  of 1,000 points, kappa 97.50 %",
        "ignored 7 points of ignored classes",
        "without a partner: 0 points of the reference, 3 of the cloud",
        "DTM     RMSE 0.123 m, bias -0.010 m over 360,000 pixels",
    ]


@pytest.fixture
def evaluations(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """What is asked of `tiler.apps.evaluate`, which is replaced."""
    seen: list[tuple[Any, ...]] = []

    def answer(*arguments: Any) -> dict[str, Any]:
        seen.append(arguments)
        return {
            **SCORES,
            "classes": {"6": {"points": 10, "labelled_ground": 1, "error": 0.1}},
            "scenes": [],
        }

    monkeypatch.setattr(
        "tiler.apps.evaluate.find_scenes", lambda clouds, references: [*clouds, *references]
    )
    monkeypatch.setattr("tiler.apps.evaluate.evaluate_scenes", answer)
    monkeypatch.setattr("tiler.apps.evaluate.filter_and_evaluate", answer)
    monkeypatch.setattr(
        "tiler.apps.evaluate.evaluate_dtm", lambda *_: {"unit": "metre", "rmse": None}
    )
    monkeypatch.setattr(
        "tiler.schedule.call_isolated", lambda work, *arguments, **how: work(*arguments)
    )
    return seen


def test_evaluate_asks_with_the_ignored_classes(
    evaluations: list[tuple[Any, ...]], capsys: pytest.CaptureFixture[str]
) -> None:
    from tiler.apps.evaluate import IGNORED

    assert main(["evaluate", "a.laz", "--reference", "b.laz", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["type_1"] == SCORES["type_1"]
    for text in ("9,7", "none"):
        assert main(["evaluate", "a.laz", "--reference", "b.laz", "--ignore", text]) == 0
    assert [call[0] for call in evaluations] == [["a.laz", "b.laz"]] * 3
    assert [call[1] for call in evaluations] == [IGNORED, (7, 9), ()]


def test_evaluate_filters_labelled_clouds(
    evaluations: list[tuple[Any, ...]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", "a.laz", "b.laz", "--method", "classic", "--set", "rounds=3"]) == 0
    clouds, config, *_ = evaluations[0]
    assert clouds == ("a.laz", "b.laz")
    assert config == RunConfig(method="classic", parameters=(("rounds", "3"),))
    assert capsys.readouterr().out.splitlines()[-2:] == [
        "  class  points  classified as ground  error",
        "  6      10      1                     10.00 %",
    ]


def test_evaluate_of_a_dtm_alone(
    evaluations: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", "--dtm", "a.tif", "--true-dtm", "b.tif", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"dtm": {"unit": "metre", "rmse": None}}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "nothing to evaluate"),
        (["a.laz"], "give either --reference REF, or --method NAME"),
        (
            ["a.laz", "--reference", "b.laz", "--method", "classic"],
            "give either --reference REF",
        ),
        (["--dtm", "a.tif"], "--dtm and --true-dtm need each other; give both"),
        (["a.laz", "--reference", "b", "--difference", "d.tif"], "--difference needs --dtm"),
        (["a.laz", "--reference", "b", "--map-cell", "0"], "must be above 0"),
    ],
)
def test_evaluate_refuses(
    arguments: list[str], message: str, evaluations: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_preview_refuses_windows_of_no_size(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["preview", "a.laz", "--size", "0"]) == 2
    assert "--size 0: must be above 0" in capsys.readouterr().err


def test_the_help_of_evaluate_names_the_classes_that_the_library_ignores() -> None:
    from cli.commands.evaluate import command
    from tiler.apps.evaluate import IGNORED

    told = next(p for p in command.params if p.name == "ignore").help  # type: ignore[attr-defined]
    assert ",".join(str(c) for c in IGNORED) in told


def test_facts_are_aligned_and_nested() -> None:
    facts = {
        "kind": "cloud",
        "size_bytes": 1234567,
        "crs": None,
        "bounds": [0.5, 2.0],
        "classes": {"2": 10, "17": 3},
        "has_rgb": False,
        "notes": [],
        "outputs": {"a_b.tif": 1, "A_B": 2},
    }
    assert fact_lines(facts) == [
        "kind        cloud",
        "size bytes  1,234,567",
        "bounds      0.5, 2",
        "classes",
        "  2   10",
        "  17  3",
        "has rgb     no",
        "notes       none",
        "outputs",
        "  a_b.tif  1",
        "  A_B      2",
    ]


def test_simulate_says_what_it_wrote(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a.laz"
    arguments = [
        "--scene",
        "hills",
        "--size",
        "6000cm",
        "--density",
        "0.5",
        "--seed",
        "2",
        "--sigma",
        "1cm",
    ]
    assert main(["simulate", str(out), *arguments, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert list(facts) == [
        "cloud", "dtm", "scene", "kind", "seed", "side_m", "north_m", "points", "points_per_m2", "classes",
    ]  # fmt: skip
    assert facts["side_m"] == 60.0
    assert facts["classes"]["2 ground"] > 1000
    assert out.is_file()
    assert Path(facts["dtm"]) == tmp_path / "a_dtm.tif"
    assert main(["simulate", str(out), *arguments, "-q"]) == 0
    assert capsys.readouterr() == ("", "")


def test_simulate_lists_its_scenes_and_refuses_others(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["simulate", "--list"]) == 0
    shown = capsys.readouterr().out
    assert "  quarry " in shown
    assert "  dim_park " in shown
    assert main(["simulate", "a.laz", "--scene", "moon"]) == 2
    assert "unknown scene 'moon'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("encoding", "shades"), [("utf-8", "░▒▓█"), ("ascii", ".:*#"), (None, ".:*#")]
)
def test_a_map_of_density_in_shades(encoding: str | None, shades: str) -> None:
    density = {"width_m": 5.0, "height_m": 10.0, "per_m2": [[0, 4, 4, 4], [1, 2, 8, 0]]}
    head, *rows = map_lines(density, encoding)
    light, medium, dark, full = shades
    assert rows == [f"   {dark * 3}", f"  {light}{medium}{full}"]
    assert f"{light} below 1.2, {medium} below 3, {dark} below 6, {full} more" in head
    assert "a character is 5 x 10 m, north is up" in head
    assert map_lines({**density, "per_m2": [[0, 0]]}, encoding) == []


def test_warm_prints_its_result_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tiler.apps.warm.warm", lambda methods: WarmResult("cache", 7, 2))
    assert main(["warm", "classic", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "folder": "cache",
        "kernels": 7,
        "compiled": 2,
    }


def test_warm_warns_of_a_refused_folder(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    result = WarmResult("cache", 7, 2, "/open: other users can write to it")
    monkeypatch.setattr("tiler.apps.warm.warm", lambda methods: result)
    assert main(["warm", "classic"]) == 0
    told = capsys.readouterr()
    assert told.err == "tiler: warning: /open: other users can write to it\n"
    assert told.out.startswith("compiled  2 kernels")
