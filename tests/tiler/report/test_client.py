"""The client's page says what run.json and the manifest say, and draws sheets and voids where they are."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import shapely

from tests.tiler.report import results
from tiler.core.products import FILLED, HOLE, MASK_VALUES, MEASURED, OUTSIDE
from tiler.report.client import MAX_SHEETS, client_page
from tiler.report.problems import MAX_ROWS

WEST, NORTH = results.WEST, results.NORTH
RASTER = {"kind": "raster", "product": "dtm", "columns": 30, "rows": 20, "bytes": 4096}


def entry(path: str, **facts: Any) -> dict[str, Any]:
    return {"path": path, "bytes": 2048, "kind": "page", **facts}


def run(**changes: Any) -> dict[str, Any]:
    void = {
        "area_m2": 12.0,
        "pixels": 12,
        "bounds": [WEST + 10, NORTH - 9, WEST + 13, NORTH - 5],
    }
    voids = {
        "number": 2, "pixels": 20, "asked_pixels": 4, "surveyed_pixels": 1200,
        "largest": [void, {**void, "area_m2": 8.0}],
    }  # fmt: skip
    return results.run(check={}, voids=voids, crs_code="EPSG:32632", **changes)


def written(
    tmp_path: Path, content: dict[str, Any], entries: list[dict[str, Any]]
) -> tuple[results.Reader, str]:
    page = client_page(results.write(tmp_path / "town", content), content, entries)
    (tmp_path / "index.html").write_bytes(page)
    return results.read(tmp_path / "index.html"), page.decode()


def test_the_page_says_what_the_run_says(tmp_path: Path) -> None:
    pixels = {MEASURED: 900, FILLED: 299, HOLE: 1, OUTSIDE: 5000}
    mask = {MASK_VALUES[value]: number for value, number in pixels.items()}
    content = run(
        mask=mask,
        water=[{"rings": [[WEST, NORTH, WEST + 30, NORTH, WEST, NORTH - 20]]}],
        review={"open": 1234, "ok": 5, "fixed": 6},
    )
    entries = [
        entry("dtm.tif", **RASTER, bounds=[WEST, NORTH - 40, WEST + 60, NORTH]),
        entry("classified/a.laz", kind="cloud", points=123456),
    ]
    page, markup = written(tmp_path, content, entries)
    told = {
        "": ["Finished", "Terrain of town", "pixels of 1 m from 4,000 points of 2 files"],
        "specification": ["EPSG:32632", "vertical datum", "1 m, 60 x 40 pixels"],
        "map": ["North is up", "20 m", "water", "voids"],
        "accuracy": ["was not measured at checkpoints", "Seams between tiles were not checked"],
        "completeness": [
            "with a height 98.0 % of the survey",
            "voids 2, together 20 m2; the largest has 12 m2",
            "left without heights by edits 4 m2",
            "measured: a ground point lies in the pixel 75.0 %",
            "filled beyond the limit 24.9 %",
            "tile that failed less than 0.1 %",
            "water 1 body",
            "left out nothing",
            "1,234 open, 5 found right, 6 changed",
        ],
        "files": ["dtm, 30 x 20 pixels", "500000, 5399960, 500060, 5400000", "123,456 points"],
    }
    for section, texts in told.items():
        for text in texts:
            assert text in page.texts[section], (section, text)
    assert "outside the survey" not in page.texts["completeness"]
    links = [value for tag, name, value in page.attributes if (tag, name) == ("a", "href")]
    assert {"dtm.tif", "classified/a.laz"} <= set(links)
    assert "script" not in page.tags
    assert "script-src 'none'" in markup
    assert "19.4 s" not in page.texts[""]


def test_sheets_and_voids_are_drawn_where_they_are(tmp_path: Path) -> None:
    sheet = entry(
        "dtm/east_1.tif", **RASTER, bounds=[WEST + 30, NORTH - 40, WEST + 60, NORTH - 20]
    )
    _, markup = written(tmp_path, run(), [sheet])
    paths = re.findall(r'<path d="(.+?)"', markup)
    # A pixel of the picture is 1 m.
    assert "M60 40L60 20L30 20L30 40L60 40Z" in paths
    assert "M10 9L13 9L13 5L10 5L10 9Z" in paths
    assert re.search(r'<text x="45" y="30"[^>]*>east_1</text>', markup)


def test_rings_are_closed_and_may_touch_themselves(tmp_path: Path) -> None:
    corners = [(0, 0), (20, 0), (20, 0.1), (10, 10), (20, 20), (0, 20), (10, 10), (0, 0)]
    ring = [edge for x, y in corners for edge in (WEST + x, NORTH - y)]
    _, markup = written(tmp_path, run(outline={"rings": [ring]}), [])
    assert "M0 0L20 0L10 10L20 20L0 20L10 10L0 0Z" in re.findall(r'<path d="(.+?)"', markup)


def test_the_scale_bar_is_a_round_length_below_the_picture(tmp_path: Path) -> None:
    _, markup = written(tmp_path, run(), [])
    end = re.search(r'<path d="M0 [0-9.]+H(.+?)"', markup)
    text = re.search(r'class="beside">(.+?) m<', markup)
    assert end is not None
    assert text is not None
    assert float(end[1]) == float(text[1]) == 20


def test_more_sheets_than_the_map_can_show_are_counted(tmp_path: Path) -> None:
    sheet = entry("dtm/a.tif", **RASTER, bounds=[WEST, NORTH - 40, WEST + 60, NORTH - 20])
    page, markup = written(tmp_path, run(), [sheet] * (MAX_SHEETS + 1))
    assert "401 sheets are not drawn" in page.texts["map"]
    assert "M0 40L60" not in markup


def test_measurements_that_cannot_be_read_are_a_warning(tmp_path: Path) -> None:
    page, _ = written(tmp_path, {**run(), "check": {"unreadable": "check.json: damaged"}}, [])
    assert "cannot be read" in page.texts["accuracy"]
    assert "not measured" not in page.texts["accuracy"]


def test_what_was_measured_is_told_unless_it_is_older_than_the_terrain(tmp_path: Path) -> None:
    check = {"requirements": [results.UNMET]}
    for older, is_told in ((False, True), (True, False)):
        content = {**run(), "check": {**check, "older": older}}
        page, _ = written(tmp_path, content, [])
        assert (("p", "class", "state bad") in page.attributes) is is_told
        assert ("NOT met" in page.texts["accuracy"]) is is_told
        assert ("1 requirement is not met" in page.texts[""]) is is_told


def test_names_do_not_become_markup(tmp_path: Path) -> None:
    page, _ = written(tmp_path, run(report_title=results.HOSTILE), [entry(results.HOSTILE)])
    assert "img" not in page.tags
    assert "script" not in page.tags
    assert "onerror" in page.texts["files"]


def test_a_delivery_of_many_files_lists_the_first(tmp_path: Path) -> None:
    entries = [entry(f"{number}.tif") for number in range(MAX_ROWS + 7)]
    page, _ = written(tmp_path, run(), entries)
    assert "7 more are in manifest.json" in page.texts["files"]
    assert page.texts["files"].count(".tif") == MAX_ROWS


@pytest.mark.parametrize("absent", [("voids",), ("voids", "dtm"), ("voids", "dtm", "mask")])
def test_a_run_without_a_terrain_has_a_page(absent: tuple[str, ...], tmp_path: Path) -> None:
    content = {name: value for name, value in run(outputs={}).items() if name not in absent}
    page, _ = written(tmp_path, content, [entry("outline.gpkg")])
    assert "No terrain model is delivered" in page.texts["map"]


def test_drawn_sheets_are_polygons_with_holes_on_the_map(tmp_path: Path) -> None:
    bounds = [WEST, NORTH - 40, WEST + 60, NORTH]
    outer = [(0, 0), (60, 0), (60, 20), (0, 40), (0, 0)]
    hole = [(10, 5), (20, 5), (20, 15), (10, 5)]
    rings = [[(WEST + x, NORTH - y) for x, y in ring] for ring in (outer, hole)]
    (tmp_path / "town").mkdir()
    shapes = shapely.to_wkb(np.array([shapely.Polygon(rings[0], rings[1:])]))
    pyogrio.raw.write(
        tmp_path / "town/sheets.gpkg",
        shapes,
        [np.array(["dtm/dtm_a.tif"], object)],
        ["location"],
        geometry_type="Polygon",
        crs="EPSG:32632",
        layer="dtm",
    )
    page, markup = written(tmp_path, run(), [entry("dtm/dtm_a.tif", **RASTER, bounds=bounds)])
    assert "M0 0L60 0L60 20L0 40L0 0ZM10 5L20 5L20 15L10 5Z" in re.findall(
        r'<path d="(.+?)"', markup
    )
    assert "sheets" in page.texts["map"]
