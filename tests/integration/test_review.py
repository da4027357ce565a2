"""The operator's loop: places of review.gpkg get a status, a run applies what is fixed, and lists the changed files."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from pyogrio import raw
from shapely import affinity

from tests.invariants.runs import do
from tests.scenes.drawings import EAST, NORTH, ground, written
from tests.scenes.journals import locked
from tiler.core.products import NODATA
from tiler.errors import InputError
from tiler.export import review
from tiler.pipeline import RunResult
from tiler.report import problems

SIDE, NUMBER = 160.0, 57_000
GAPS = shapely.box(24, 10, 32, 50), shapely.box(120, 110, 132, 124)
"""Places without returns in flat land, the larger one first."""


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    whole = ground(lambda x, y: 30 + 0.01 * y, side=SIDE, number=NUMBER)
    inside = shapely.contains_xy(shapely.union_all(GAPS), *whole.xyz[:, :2].T)
    folder = tmp_path_factory.mktemp("gaps")
    return written(folder / "a.laz", type(whole)(whole.xyz[~inside], whole.truth[~inside]))


@pytest.fixture(scope="module")
def reviewed(cloud: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("reviewed") / "out"
    made(cloud, out)
    return out


@pytest.fixture
def out(reviewed: Path, tmp_path: Path) -> Path:
    shutil.copytree(reviewed, tmp_path / "out")
    return tmp_path / "out"


def made(cloud: Path, out: Path, **changes: Any) -> RunResult:
    settings = {"method": "keep", "voids": "leave", "sheets": "80", "edits": None}
    return do(cloud, out, **{**settings, **changes})


def rows(out: Path) -> list[dict[str, Any]]:
    meta, _, shapes, columns = raw.read(out / "review.gpkg", layer="review")
    values = zip(*(column.tolist() for column in columns), strict=True)
    named = [dict(zip(meta["fields"], row, strict=True)) for row in values]
    return [{**n, "shape": shapely.from_wkb(s)} for n, s in zip(named, shapes, strict=True)]


@contextmanager
def edited(out: Path) -> Iterator[sqlite3.Connection]:
    """The file as a GIS changes it: the table, without the functions that only its triggers need."""
    with closing(sqlite3.connect(out / "review.gpkg")) as database:
        triggers = database.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'")
        for (name,) in triggers.fetchall():
            database.execute(f'DROP TRIGGER "{name}"')
        yield database
        database.commit()


def test_the_places_have_their_outlines_and_the_most_serious_is_first(reviewed: Path) -> None:
    first, second = rows(reviewed)
    assert [first["rank"], second["rank"]] == [1, 2]
    for row, gap in ((first, GAPS[0]), (second, GAPS[1])):
        shape = shapely.affinity.translate(row["shape"], -EAST, -NORTH)
        assert gap.buffer(0.5).contains(shape)
        assert row["area_m2"] == pytest.approx(shape.area)
        assert shape.area > 0.6 * gap.area
        assert (row["status"], row["action"]) == ("open", "void")
        assert row["reason"] == "place without returns"
        # Classes of the input were kept, whose errors no scenes tell.
        assert np.isnan(row["chance"])
    sheets = {path.stem for path in (reviewed / "dtm").glob("*.tif")}
    assert {first["sheet"], second["sheet"]} <= sheets


def test_the_chance_is_a_column_that_survives_and_that_old_files_lack(
    cloud: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(problems, "chance_of", lambda *place: 0.7)
    made(cloud, out)
    with closing(sqlite3.connect(out / "review.gpkg")) as database:
        columns = {c[1]: c[2] for c in database.execute("PRAGMA table_info(review)")}
        assert columns["chance"] == "REAL"
        assert database.execute("SELECT chance FROM review").fetchall() == [(0.7,), (0.7,)]
    with edited(out) as database:
        database.execute("UPDATE review SET status = 'ok', chance = 0.6 WHERE rank = 1")
    made(cloud, out)
    assert [(row["status"], row["chance"]) for row in rows(out)] == [("open", 0.7), ("ok", 0.6)]
    with edited(out) as database:
        database.execute("ALTER TABLE review DROP COLUMN chance")
    run = made(cloud, out)
    assert [row["status"] for row in rows(out)] == ["open", "ok"]
    assert [str(row["chance"]) for row in rows(out)] == ["0.7", "nan"]
    assert not (out / "outdated").exists()
    assert not run.warnings


def test_qgis_finds_a_style_and_lists_of_values(reviewed: Path) -> None:
    assert ["layer_styles", None] in pyogrio.list_layers(reviewed / "review.gpkg").tolist()
    meta, _, _, columns = raw.read(reviewed / "review.gpkg", layer="layer_styles")
    style = dict(zip(meta["fields"], (column[0] for column in columns), strict=True))
    assert (style["f_table_name"], style["f_geometry_column"]) == ("review", "geom")
    assert style["useAsDefault"]
    page = ElementTree.fromstring(style["styleQML"].partition("'SYSTEM'>")[2])
    lists = {
        field.get("name"): [
            o.get("value") for o in field.iter("Option") if o.get("value") is not None
        ]
        for field in page.iter("field")
    }
    assert lists["status"] == ["open", "ok", "fixed"]
    assert lists["action"] == ["", "not_ground", "ground", "void", "flat"]


def test_fixed_places_become_edits_and_the_changed_files_are_listed(
    cloud: Path, out: Path
) -> None:
    with edited(out) as database:
        database.execute("UPDATE review SET status = 'fixed' WHERE rank = 2")
        database.execute("UPDATE review SET status = 'ok' WHERE rank = 1")
    gap = rows(out)[1]["shape"]
    times = {path: path.stat().st_mtime_ns for path in out.rglob("*.tif")}
    run = made(cloud, out, edits=str(out / "review.gpkg"))
    assert run.summary["review"] == {"open": 0, "ok": 1, "fixed": 1}
    assert [p["status"] for p in run.summary["problems"] if p["action"]] == ["ok"]
    assert [row["status"] for row in rows(out)] == ["ok", "fixed"]
    changes = json.loads((out / "changed.json").read_text())
    (sheet,) = changes["sheets"]
    assert f"dtm/{sheet}.tif" in changes["changed"]
    changed = {out / path for path in changes["changed"]}
    for path, time in times.items():
        assert (path.stat().st_mtime_ns == time) is (path not in changed)
    with rasterio.open(out / "dtm.vrt") as raster:
        heights, corner = raster.read(1), raster.bounds
    row, cols = np.indices(heights.shape) + 0.5
    inside = shapely.contains_xy(gap, corner.left + cols, corner.top - row)
    assert inside.sum() == pytest.approx(gap.area)
    assert (heights[inside] == NODATA).all()
    land = shapely.box(2, 2, SIDE - 2, SIDE - 2) - shapely.affinity.translate(
        gap, -EAST, -NORTH
    ).buffer(1)
    beside = shapely.contains_xy(land, corner.left + cols - EAST, corner.top - row - NORTH)
    assert (heights[beside] != NODATA).all()
    again = made(cloud, out, edits=str(out / "review.gpkg"))
    assert again.did_nothing
    assert again.summary["problems"] == run.summary["problems"]
    assert json.loads((out / "changed.json").read_text()) == changes


def test_a_second_run_tells_the_same_of_edits_whose_rows_moved(cloud: Path, out: Path) -> None:
    with edited(out) as database:
        database.execute(
            "UPDATE review SET status = 'fixed', action = 'not_ground' WHERE rank = 2"
        )
    given = {"edits": str(out / "review.gpkg"), "max_edge": "6"}
    first = made(cloud, out, **given)
    second = made(cloud, out, **given)
    for run in (first, second):
        ((hole,), (edit,)) = (
            [p for p in run.summary["problems"] if p["what"] == "hole in an edit"],
            run.summary["edits"],
        )
        assert edit["holes"] > 100
        assert f"{edit['holes']} pixels" in hole["why"]
    assert first.summary["edits"][0]["holes"] == second.summary["edits"][0]["holes"]


def test_a_void_has_the_outline_of_its_pixels(cloud: Path, tmp_path: Path) -> None:
    run = made(cloud, tmp_path / "out", max_edge="6", sheets=None)
    voids = [row for row in rows(tmp_path / "out") if row["reason"].startswith("void")]
    assert len(voids) == run.summary["voids"]["number"] > 0
    with rasterio.open(tmp_path / "out" / "dtm.tif") as raster:
        heights, corner = raster.read(1), raster.bounds
    row, col = np.indices(heights.shape) + 0.5
    for void in voids:
        assert void["area_m2"] == pytest.approx(void["shape"].area)
        inside = shapely.contains_xy(void["shape"], corner.left + col, corner.top - row)
        assert (heights[inside] == NODATA).all()


def test_a_large_place_has_a_coarse_outline_and_no_action(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Land around it would lose its heights."""
    monkeypatch.setattr(review, "MOST_BLOCKS", 0)
    made(cloud, tmp_path / "out")
    bare = [row for row in rows(tmp_path / "out") if row["reason"] == "place without returns"]
    assert len(bare) == 2
    for row in bare:
        assert not row["action"]
        assert row["shape"].area >= row["area_m2"]
        assert row["remedy"].endswith("draw the edit, or use the setting for the whole run")


def test_a_void_in_parts_is_edited_where_it_is(cloud: Path, tmp_path: Path) -> None:
    """Cells of a void that touch at a corner: a polygon around both would hold land."""
    out = tmp_path / "out"
    made(cloud, out, max_edge="6", sheets=None)
    with edited(out) as database:
        database.execute(
            "UPDATE review SET status = 'fixed', action = 'void' WHERE reason LIKE 'void%'"
        )
    run = made(cloud, out, max_edge="6", sheets=None, edits=str(out / "review.gpkg"))
    assert [edit["pixels"] for edit in run.summary["edits"]] == [0] * len(run.summary["edits"])
    assert run.summary["voids"]["pixels"] == 0 < run.summary["voids"]["asked_pixels"]
    assert not any("changed nothing" in note for note in run.summary["notes"])
    assert not any(p["what"] == "edit without effect" for p in run.summary["problems"])


def test_an_open_place_is_no_edit_whatever_its_layer_is_called(cloud: Path, out: Path) -> None:
    other = out.parent / "fixes.gpkg"
    meta, _, shapes, columns = raw.read(out / "review.gpkg", layer="review")
    raw.write(
        other, shapes, columns, meta["fields"], geometry_type="MultiPolygon", crs=meta["crs"]
    )
    run = made(cloud, out, edits=str(other))
    assert not run.summary.get("edits")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("UPDATE review SET status = 'done' WHERE rank = 1", "its status is 'done'"),
        ("ALTER TABLE review DROP COLUMN status", "without the column `status`"),
        ("UPDATE review SET status = 'fixed', action = NULL", "has no `action`"),
    ],
)
def test_a_row_that_cannot_be_an_edit_is_refused(
    cloud: Path, out: Path, change: str, told: str
) -> None:
    with edited(out) as database:
        database.execute(change)
    with pytest.raises(InputError, match=told):
        made(cloud, out, edits=str(out / "review.gpkg"))


def test_rows_of_another_survey_do_not_enter_the_file(cloud: Path, out: Path) -> None:
    """Of two rows that were decided, one lies in this survey. The file may be its own, or that of a larger one."""
    with edited(out) as database:
        database.execute("UPDATE review SET status = 'ok'")
    meta, _, shapes, columns = raw.read(out / "review.gpkg", layer="review")
    shapes[0] = shapely.to_wkb(affinity.translate(shapely.from_wkb(shapes[0]), 5000.0))
    other, kind = (
        out.parent / "other.gpkg",
        {"geometry_type": "MultiPolygon", "crs": meta["crs"]},
    )
    raw.write(other, shapes, columns, meta["fields"], layer="review", **kind)
    (out / "review.gpkg").unlink()
    run = made(cloud, out, edits=str(other))
    assert (
        f"{other}: 1 place of it lies outside the survey, so review.gpkg does not list it"
        in [note for note in run.summary["notes"] if "other.gpkg" in note]
    )
    assert run.summary["review"] == {"open": 1, "ok": 1, "fixed": 0}
    assert all(row["shape"].bounds[0] < EAST + SIDE for row in rows(out))
    # The user's own file keeps all its rows.
    shutil.copy2(other, out / "review.gpkg")
    run = made(cloud, out, edits=str(out / "review.gpkg"))
    assert run.summary["review"] == {"open": 1, "ok": 2, "fixed": 0}


def test_an_empty_file_is_no_error_as_edits(cloud: Path, out: Path) -> None:
    with edited(out) as database:
        database.execute("DELETE FROM review")
    run = made(cloud, out, edits=str(out / "review.gpkg"))
    assert run.summary["review"]["open"] == 2


def test_columns_of_the_user_are_kept_in_a_copy_and_his_notes_in_the_file(
    cloud: Path, out: Path
) -> None:
    with edited(out) as database:
        database.execute("ALTER TABLE review ADD COLUMN who TEXT")
        database.execute(
            "UPDATE review SET status='ok', who='me', note='a pond' WHERE rank = 1"
        )
        database.execute("UPDATE review SET note='ask' WHERE rank = 2")
    run = made(cloud, out)
    assert any("the columns who are in outdated/review.gpkg" in n for n in run.summary["notes"])
    assert "who" in raw.read(out / "outdated" / "review.gpkg", layer="review")[0]["fields"]
    assert [(row["status"], row["note"]) for row in rows(out)] == [
        ("open", "ask"),
        ("ok", "a pond"),
    ]


def test_a_run_without_the_edits_warns_and_keeps_the_decisions(cloud: Path, out: Path) -> None:
    with edited(out) as database:
        database.execute("UPDATE review SET status = 'fixed' WHERE rank = 1")
    run = made(cloud, out)
    (warning,) = [text for text in run.warnings if "1 fixed place" in text]
    assert f"--edits {out / 'review.gpkg'}" in warning
    assert sorted(row["status"] for row in rows(out)) == ["fixed", "open", "open"]


def test_a_damaged_file_is_moved_and_told(cloud: Path, out: Path) -> None:
    before = (out / "review.gpkg").read_bytes()
    (out / "review.gpkg").write_bytes(before[:3000])
    run = made(cloud, out)
    line = f"{out}/review.gpkg: cannot be read (its database is damaged); get the file again; moved"
    assert any(text.startswith(line) for text in run.warnings)
    assert (out / "outdated" / "review.gpkg").read_bytes() == before[:3000]
    assert [row["status"] for row in rows(out)] == ["open", "open"]


def test_a_file_that_another_program_has_locked_is_not_taken_for_damaged(
    cloud: Path, out: Path
) -> None:
    with edited(out) as database:
        database.execute("UPDATE review SET status = 'ok' WHERE rank = 1")
    before = {
        path: path.read_bytes() for path in out.rglob("*.*") if path.suffix in (".gpkg", ".tif")
    }
    line = r"review.gpkg: is in use by another program; close it there, then run again$"
    with locked(out / "review.gpkg"), pytest.raises(InputError, match=line):
        made(cloud, out)
    assert {path: path.read_bytes() for path in before} == before
    assert not (out / "outdated").exists()
    assert made(cloud, out).summary["review"] == {"open": 1, "ok": 1, "fixed": 0}


def test_a_run_that_finds_nothing_writes_an_empty_list(tmp_path: Path) -> None:
    cloud = written(
        tmp_path / "a.laz", ground(lambda x, y: 30 + 0.01 * y, side=SIDE, number=NUMBER)
    )
    run = made(cloud, tmp_path / "out")
    assert rows(tmp_path / "out") == []
    assert run.summary["review"] == {"open": 0, "ok": 0, "fixed": 0}
    assert not (tmp_path / "out" / "changed.json").exists()
    assert made(cloud, tmp_path / "out").did_nothing
