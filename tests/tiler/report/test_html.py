"""The report says what run.json says, whatever files are called, however many tiles there are."""

from __future__ import annotations

import hashlib
import json
import os
from base64 import b64encode
from pathlib import Path
from typing import Any

import pytest
from pyproj import CRS

from tests.tiler.report import results
from tiler.errors import InputError, LockedError, ProcessingError
from tiler.report import sections
from tiler.report.html import write_report, write_report_at
from tiler.store import locked_folder


def test_every_figure_of_run_json_is_there(tmp_path: Path) -> None:
    out = results.write(tmp_path / "town", results.run())
    page = results.read(write_report(out))
    assert "Terrain of town" in page.texts[""]
    assert "4,000 points of 2 files" in page.texts[""]
    for figure in (
        "4.0 k",
        "50.0%",
        "60 x 40",
        "1:15 min",
        "Nothing was left out",
    ):
        assert figure in page.texts[""]
    told = {
        "problems": ["heights span 9,876 m"],
        "decisions": [
            "heights are assumed to be in feet",
            "200 points dropped: withheld",
            "WGS 84 / UTM zone 32N",
        ],
        "measured": ["slope_deg 12.5"],
        "counts": [
            "read 4,000",
            "stored 3,800",
            "dropped: withheld 200",
            "ground, before edits and water 1,900",
            "low noise 10",
        ],
        "inputs": ["/data/a.laz", "/data/b.laz", "LAS 1.4, format 6", "4.0 KiB"],
        "outputs": ["dtm.tif 4.0 KiB"],
        "timings": [
            "filter: seeds, densification, labels 4 4 1:01 min",
            "200.0 MiB",
            "300.0 MiB",
            "tile size 30 m you",
            "halo 104 m automatic the radius that the method needs",
            "t+001+001",
            "planned per worker 500.0 MiB",
        ],
        "settings": ["max_building_size_m 20", "label_pass yes", "numpy 2.3.4", "tiler 0.1.0"],
        "accuracy": ["Nothing was measured yet"],
    }
    for name, texts in told.items():
        for text in texts:
            assert text in page.texts[name], name


def test_specification_holds_what_a_tender_asks_for(tmp_path: Path) -> None:
    names = ("dtm.vrt", "mask.vrt", "density.vrt", "outline.gpkg")
    content = results.run(
        outputs=dict.fromkeys((*names, "classified/a.copc.laz"), 1),
        sheets=12,
        crs_code="EPSG:32632",
        dates={"first": "2008-08-03", "last": "2008-08-05", "by": "GPS time of the points"},
        written="2026-11-28T11:26:19+00:00",
    )
    content["configuration"] |= {
        "nodata": -32768.0,
        "sheets": "1000",
        "sheet_name": "{name}_{x_km}_{y_km}",
        "product_name": "dtm=MNT",
        "compress": "zstd",
        "classified": "copc",
    }
    content["plan"]["crs"] = CRS.from_user_input("EPSG:32632+5703").to_wkt()
    text = page_of(tmp_path / "out", content).texts["specification"]
    assert text == (
        " Specification horizontal CRS WGS 84 / UTM zone 32N (EPSG:32632), data at 48.75° N, 9.00° E; unit: metre"
        " vertical datum NAVD88 height (EPSG:5703); unit: foot pixel 1 m, sheets cut from 60 x 40 pixels"
        " nodata -32768 (dtm); none (density); 0 (mask)"
        " sheets 12 sheets with sides of 1000 m, files named {name}_{x_km}_{y_km}, with the names dtm=MNT"
        " products dtm (float32), density (float32), mask (uint8) as cloud-optimized GeoTIFF, compression zstd;"
        " outline as GeoPackage; 1 classified cloud as COPC (LAZ)"
        " date of the survey 2008-08-03 to 2008-08-05 (GPS time of the points) date of the run 2026-11-28"
        " software tiler 0.1.0, method classic"
    )


def test_specification_says_what_is_not_known(tmp_path: Path) -> None:
    content = results.run(outputs={})
    content["plan"]["crs"] = None
    text = page_of(tmp_path / "out", content).texts["specification"]
    for fact in (
        "horizontal CRS not given",
        "vertical datum not given",
        "nodata -9999",
        "sheets none, each product is one file",
        "products none yet",
        "date of the survey unknown",
    ):
        assert fact in text


def test_paths_memory_and_squares_are_at_the_end(tmp_path: Path) -> None:
    page = page_of(tmp_path / "out", results.run())
    parts = list(page.texts)
    assert parts[:4] == ["", "specification", "problems", "map"]
    assert parts[-6:] == ["making", "measured", "inputs", "timings", "settings", "about"]
    for name in parts[: parts.index("making")]:
        for text in ("/data/", "MiB", "halo", "tile size"):
            assert text not in page.texts[name], name


def test_cells_of_wide_tables_have_their_headings_on_narrow_screens(tmp_path: Path) -> None:
    out = results.write(tmp_path / "out", results.run())
    text = write_report(out).read_text("utf-8")
    narrow = text.split("@media screen and (max-width: 40rem) {")[1].split("@media")[0]
    assert ".list td::before { content: attr(data-name)" in narrow
    assert '<td data-name="CRS">WGS 84 / UTM zone 32N</td>' in text
    assert '<div class="wide list" tabindex="0"><table>' in text
    assert "<td>max_building_size_m</td>" in text


def test_advice_is_told_and_what_passes_hand_on_is_told_once(tmp_path: Path) -> None:
    advice = "the terrain holds what looks like a roof 36 m wide"
    statistics = {
        "survey": {"kind": "dim", "notes": ["x"]},
        "seeds": {"kind": "dim", "rise_m": 0.25},
    }
    content = results.run(advice=[advice], statistics=statistics)
    page = results.read(write_report(results.write(tmp_path / "out", content)))
    assert advice in page.texts["problems"]
    assert page.texts["measured"].count("dim") == 1
    assert "survey kind dim seeds rise_m 0.25" in page.texts["measured"]


def page_of(out: Path, content: dict[str, Any]) -> results.Reader:
    """The report of a run.json, read."""
    return results.read(write_report(results.write(out, content)))


@pytest.mark.parametrize(
    ("metre", "noise"), [(1.0, "0.0255 m"), (0.3048, "0.0837 ft (0.0255 m)")]
)
def test_measured_lengths_are_in_the_unit_of_the_crs(metre: float, noise: str) -> None:
    run = {
        "plan": {"metres_per_unit": {"horizontal": metre}},
        "statistics": {"survey": {"survey": {"sigma_m": 0.0255, "cell_m": None}}},
    }
    assert list(sections._measured(run)) == [("survey", "noise of heights", noise)]


def test_steps_between_surveys_are_in_the_unit_of_the_crs(tmp_path: Path) -> None:
    step = {"other": "2023-05-01", "median_m": -0.3048, "mad_m": 0.02, "cells": 900}
    survey = {"name": "2015", "first": "2015-05-01", "last": "2015-05-02", "files": 1}
    survey |= {"points": 2000, "used": 1000, "area_m2": 400.0, "steps": [step]}
    content = results.run(surveys=[survey])
    for foot, text in (
        (1.0, "-0.30 m to 2023-05-01 (MAD 0.02 m)"),
        (0.3048, "-0.984 ft (0.3 m)"),
    ):
        content["plan"]["metres_per_unit"] = {"horizontal": foot, "vertical": foot}
        page = page_of(tmp_path / str(foot), content).texts["inputs"]
        assert "2015 2015-05-01 to 2015-05-02 1 2,000 1,000" in page
        assert text in page


def test_it_loads_nothing_and_runs_its_own_script_alone(tmp_path: Path) -> None:
    text = write_report(results.write(tmp_path / "out", results.run())).read_text("utf-8")
    page = results.read(tmp_path / "out" / "report.html")
    for tag, name, value in page.attributes:
        if name in ("src", "href", "action", "srcset"):
            assert value.startswith(("data:image/png;base64,", "#")) or (tag, value) == (
                "a",
                "dtm.tif",
            )
        assert not name.startswith("on")
        assert name != "style"
    policy = next(
        value for tag, _, value in page.attributes if tag == "meta" and "default-src" in value
    )
    assert policy.startswith("default-src 'none'; img-src data:;")
    script = text.rsplit("<script>", 1)[1].split("</script>")[0]
    assert (
        f"script-src 'sha256-{b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
        in policy
    )
    assert "http://" not in text
    assert "https://" not in text
    ids = [value for _, name, value in page.attributes if name == "id"]
    assert len(ids) == len(set(ids))
    for _, name, value in page.attributes:
        assert name != "href" or not value.startswith("#") or value[1:] in ids
        assert name != "aria-labelledby" or value in ids


def test_names_of_files_cannot_become_markup(tmp_path: Path) -> None:
    name = results.HOSTILE
    plain = page_of(tmp_path / "plain", results.run(inputs=[results.source("a.laz")] * 2))
    content = results.run(
        inputs=[results.source(name), results.source("b.laz", notes=[name])],
        quarantined=[{"path": name, "error": f"{name}: cut short"}],
        failed_tasks=[{"stage": "filter0", "key": "t+000+000", "error": name, "bounds": None}],
        outputs={"dtm.tif": 1, f"classified/{name}": 1},
    )
    content["tiles"]["filter0"][0]["state"] = "failed"
    page = page_of(tmp_path / "out", content)
    escaped = (
        name.replace("\x1b", "\\x1b").replace("\udc80", "\\udc80").replace("\u202e", "\\u202e")
    )
    for part in ("problems", "inputs", "outputs"):
        assert escaped in page.texts[part]
    for tag in ("img", "script", "style", "html", "body"):
        assert page.tags.count(tag) == plain.tags.count(tag)
    assert name in json.dumps(page.data, ensure_ascii=False).replace('\\"', '"').replace(
        "\\u001b", "\x1b"
    )
    (link,) = [
        v
        for tag, n, v in page.attributes
        if (tag, n) == ("a", "href") and v.startswith("classified")
    ]
    assert link.startswith("classified/%3C/script%3E%3Cimg")


def test_what_was_left_out_comes_first(tmp_path: Path) -> None:
    content = results.run(
        quarantined=[{"path": "cut.laz", "error": "cut.laz: cut short"}],
        failed_tasks=[
            {"stage": "filter0", "key": "t+1+1", "error": "no memory", "bounds": [1, 2, 3, 4.5]}
        ],
    )
    page = page_of(tmp_path / "out", content)
    assert "Finished, but incomplete" in page.texts[""]
    assert "Left out: 1 file and 1 task; see Problems." in page.texts[""]
    assert next(iter(page.texts)) == ""
    assert list(page.texts)[1:3] == ["specification", "problems"]
    assert "file left out - cut.laz: cut short" in page.texts["problems"]
    failed = (
        "failed task 2.0, 3.2 filter: seeds, densification, labels t+1+1: no memory run again"
    )
    assert failed in page.texts["problems"]


def test_a_thousand_tiles_and_large_rasters_stay_below_five_megabytes(tmp_path: Path) -> None:
    tiles = [results.tile(i, 40, 50.0) for i in range(1000)]
    content = results.run(
        tiles=dict.fromkeys(("filter0", "grid-dtm", "grid-mask"), tiles),
        inputs=[results.source(f"{'long' * 40}{i}.laz") for i in range(3000)],
        outputs=dict.fromkeys(("dtm.tif", "mask.tif", "density.tif"), 1),
    )
    out = results.write(tmp_path / "out", content, 1500, 1500)
    path = write_report(out)
    assert path.stat().st_size < 5e6
    page = results.read(path)
    assert [len(stage["tiles"]) for stage in page.data["stages"]] == [1000, 1000, 1000]
    assert "2,000 more are in run.json" in page.texts["inputs"]


def test_a_run_without_rasters_has_a_map_of_its_plan(tmp_path: Path) -> None:
    content = results.run(state="interrupted", outputs={})
    for name in (
        "dtm",
        "filter",
        "counts",
        "inputs",
        "seconds",
        "tiles",
        "statistics",
        "notes",
    ):
        content.pop(name)
    page = page_of(tmp_path / "out", content)
    assert "Interrupted" in page.texts[""]
    assert "No terrain model was written yet" in page.texts["map"]
    assert page.data["extent"] == content["plan"]["extent"]
    assert "img" not in page.tags


def test_measured_accuracy_is_shown(tmp_path: Path) -> None:
    out = results.write(tmp_path / "out", results.run())
    (out / "evaluate.json").write_text(json.dumps(results.EVALUATION))
    text = results.read(write_report(out)).texts["accuracy"]
    for figure in (
        "1.23 %",
        "1.00 % of 3,790 points",
        "97.50 %",
        "RMSE 0.123 metre",
        "mean -0.010 metre",
    ):
        assert figure in text
    assert "Nothing was measured" not in text
    (out / "check.json").write_text("[")
    assert "check.json: Expecting value" in results.read(write_report(out)).texts["accuracy"]


def test_measurements_of_an_earlier_dtm_are_told_from_those_of_this_one(tmp_path: Path) -> None:
    out = results.write(tmp_path / "out", results.run())
    seams = {"unit": "metre", "interior": {"pairs": 7, "mean_step": 0.1}, "excess": None}
    (out / "check.json").write_text(json.dumps({"seams": seams}))
    assert "interior 7 0.1000" in results.read(write_report(out)).texts["accuracy"]
    os.utime(out / "check.json", (1, 1))
    assert (
        "check.json is older than the DTM" in results.read(write_report(out)).texts["accuracy"]
    )


def test_requirement_not_met_is_the_first_problem_and_turns_the_state(tmp_path: Path) -> None:
    content = results.run(quarantined=[{"path": "cut.laz", "error": "cut.laz: cut short"}])
    out = results.write(tmp_path / "out", content)
    check = {"requirements": [results.UNMET, {**results.UNMET, "name": "max", "met": True}]}
    (out / "check.json").write_text(json.dumps(check))
    page = results.read(write_report(out))
    row = "requirement not met - the check measured rmse = 0.059 m; the limit is 0.05 m see Accuracy"
    assert row in page.texts["problems"].split("file left out")[0]
    assert page.texts["problems"].count("requirement not met") == 1
    assert "Finished, but incomplete, and 1 requirement is not met" in page.texts[""]
    # A run that is not finished keeps its state, and a check of an earlier terrain judges nothing.
    results.write(out, results.run(state="interrupted"))
    assert "Interrupted: run" in results.read(write_report(out)).texts[""]
    results.write(out, results.run())
    os.utime(out / "check.json", (1, 1))
    page = results.read(write_report(out))
    assert "not met" not in page.texts["problems"] + page.texts[""]
    assert ("p", "class", "state good") in page.attributes


def test_requirement_that_was_not_measured_is_not_met(tmp_path: Path) -> None:
    out = results.write(tmp_path / "out", results.run())
    points = {"name": "nmad", "limit": 1.5, "value": None, "unit": "m", "met": False}
    (out / "check.json").write_text(json.dumps({"requirements": [points]}))
    page = results.read(write_report(out))
    assert "the check did not measure nmad; the limit is 1.5 m" in page.texts["problems"]
    assert ("p", "class", "state bad") in page.attributes


def test_strips_have_a_table(tmp_path: Path) -> None:
    out = results.write(tmp_path / "out", results.run())
    (out / "check.json").write_text(json.dumps({"strips": results.STRIPS}))
    text = results.read(write_report(out)).texts["accuracy"]
    assert "strips, in cells of 2 m" in text
    assert "all 1,048 0.067 0.050 0.048 0.030 0.120 12 - 11 1,048 0.067" in text
    strips = {**results.STRIPS, "cells": 0, "pairs": []}
    (out / "check.json").write_text(json.dumps({"strips": strips}))
    text = results.read(write_report(out)).texts["accuracy"]
    assert (
        "The points have 2 flight lines (by point source id), and no cell has points of two"
        in text
    )


def test_title_is_escaped_and_kept_until_it_is_removed(tmp_path: Path) -> None:
    out = results.write(tmp_path / "town", results.run())
    heading = "Valley <b>2008</b> & more"
    assert write_report_at(str(out), f" {heading}\n") == str(out / "report.html")
    # The second page is written without a title, as `tiler check` does.
    for _ in range(2):
        page = (out / "report.html").read_text("utf-8")
        escaped = "Valley &lt;b&gt;2008&lt;/b&gt; &amp; more"
        assert f"<title>{escaped}</title>" in page
        assert f"<h1>{escaped}</h1>" in page
        write_report_at(str(out))
    assert json.loads((out / "run.json").read_text())["report_title"] == heading
    write_report_at(str(out), " ")
    assert "<title>Terrain of town</title>" in (out / "report.html").read_text("utf-8")


def test_title_is_refused_while_a_run_is_at_work_and_without_a_run(tmp_path: Path) -> None:
    out = results.write(tmp_path / "out", results.run())
    with locked_folder(str(out)), pytest.raises(LockedError):
        write_report_at(str(out), "Valley")
    (out / "run.json").write_text('{"of": "another program"}')
    with pytest.raises(InputError):
        write_report_at(str(out), "Valley")
    assert (out / "run.json").read_text() == '{"of": "another program"}'


def test_refusals(tmp_path: Path) -> None:
    for content, said in (
        (None, r"run\.json: cannot be read \(No such file or directory\); give the OUT"),
        ("{", r"not valid JSON \(.*; run the same command again with --force"),
        (
            '{"state": "done"}',
            r"was not written by this version of tiler \(KeyError: 'plan'\); .* --force",
        ),
    ):
        if content is not None:
            (tmp_path / "run.json").write_text(content)
        with pytest.raises(InputError, match=said):
            write_report(tmp_path)
    out = results.write(tmp_path / "out", results.run())
    (out / "dtm.tif").write_bytes(b"no raster")
    with pytest.raises(ProcessingError, match="a raster cannot be read"):
        write_report(out)
    assert not list(out.glob("report*"))
