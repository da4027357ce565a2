"""What is missing or doubtful is one list, each with its place, its reason and a remedy, and a link to the map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.tiler.report import results
from tiler.core.chances import LIDAR, REASONS, Counts, Reason
from tiler.report import problems
from tiler.report.html import write_report
from tiler.report.problems import SOURCES, Problem, kinds_text, problems_of, table_rows

WATER = {
    "number": 3,
    "kind": "lake",
    "area_m2": 9200.0,
    "bounds": [1.0, 2.0, 5.0, 8.0],
    "level": 4.0,
    "level_end": 4.0,
}


def found(**changes: Any) -> list[Problem]:
    """Problems of a run that has none but those of the changes."""
    content = results.run(**changes)
    content["plan"]["warnings"] = []
    return problems_of(content)


def test_a_run_without_problems_says_so(tmp_path: Path) -> None:
    content = results.run()
    content["plan"]["warnings"] = []
    assert found() == []
    page = results.read(write_report(results.write(tmp_path / "out", content)))
    assert "None: every file was read, every tile was processed" in page.texts["problems"]


def test_doubts_about_water_are_problems_with_a_place() -> None:
    (problem,) = found(
        water_doubts=[{"text": "lake 3 is water with 79% certainty", "place": [1.0, 2.0]}]
    )
    assert problem.where == (1.0, 2.0, 1.0, 2.0)
    assert problem.why == "lake 3 is water with 79% certainty"
    assert "water.gpkg" in problem.remedy


def test_squares_that_a_canopy_hides_are_problems_with_a_place() -> None:
    (problem,) = found(
        canopy_doubts=[{"text": "a closed canopy", "place": [0.0, 64.0, 64.0, 128.0]}]
    )
    assert problem.where == (0.0, 64.0, 64.0, 128.0)
    assert problem.why == "a closed canopy"
    assert "--canopy void" in problem.remedy


def test_terrain_above_all_returns_is_a_problem_with_a_place_an_area_and_a_height() -> None:
    place = {"pixels": 5, "bounds": [0.0, 1.0, 4.0, 8.0], "area_m2": 1045.0, "height_m": 10.669}
    (problem,) = found(above_returns={"pixels": 9, "number": 1, "worst": [place]})
    assert problem.what == "terrain above all returns"
    assert problem.where == (0.0, 1.0, 4.0, 8.0)
    assert problem.why == "1,045 m2 of terrain lie above all returns, by up to 35.1 ft (10.7 m)"
    assert "action ground" in problem.remedy


def void(area_m2: float, at_border: bool = True) -> dict[str, Any]:
    bounds = [area_m2, 0.0, area_m2 + 1.0, 1.0]
    return {"pixels": 7, "bounds": bounds, "area_m2": area_m2, "at_border": at_border}


def voids(*largest: dict[str, Any]) -> dict[str, Any]:
    return {"surveyed_pixels": 9000, "pixels": 7, "asked_pixels": 0, "largest": [*largest]}


def rows(**changes: Any) -> list[Problem]:
    """Rows of the table of a run that has no problems but those of the changes."""
    content = results.run(**changes)
    content["plan"]["warnings"] = []
    return table_rows(content)


def test_a_problem_inside_the_survey_comes_before_one_at_its_border() -> None:
    place = {"pixels": 12, "bounds": [0.0, 0.0, 4.0, 3.0], "area_m2": 12.0, "height_m": 1.5}
    changes = {
        "voids": voids(void(5000), void(800), void(60, False), void(3, False)),
        "above_returns": {"pixels": 12, "number": 1, "worst": [place]},
        "water_doubts": [{"text": "a lake", "place": [1.0, 2.0]}],
        "classes": {"no_part": {"17": 1200}},
    }
    inside, border = "void inside the survey", "void at the border of the survey"
    assert [(problem.what, problem.area_m2) for problem in found(**changes)] == [
        ("terrain above all returns", 12.0),
        (inside, 60),
        (inside, 3),
        (border, 5000),
        ("doubtful water", None),
        ("class that is not filtered", None),
        (border, 800),
    ]
    assert rows(**changes) == found(**changes)


def test_small_voids_at_the_border_share_the_last_row_but_are_all_in_the_list() -> None:
    small = [void(area) for area in (515, 212, 2, 2)]
    changes = {"voids": voids(void(1000), *small, void(1, False)), "healed": ["a"]}
    *others, last = rows(**changes)
    assert [problem.area_m2 for problem in others] == [1, 1000, None]
    assert last.what == "void at the border of the survey"
    assert last.where is None
    assert last.why.startswith("4 small ones, 731 m2 together")
    assert [problem.area_m2 for problem in found(**changes)] == [1, 1000, None, 515, 212, 2, 2]


def test_places_that_were_found_right_are_counted_and_not_in_the_table(tmp_path: Path) -> None:
    holes = voids(void(7, False), void(9, False))
    holes["largest"][1]["bounds"] = holes["largest"][0]["bounds"]
    first, second = found(voids=holes)
    assert first.where == second.where
    right = [[first.what, first.why, *(first.where or ())]]
    changes = {"voids": holes, "found_right": right}
    assert [problem.status for problem in found(**changes)] == ["ok", "open"]
    assert [problem.area_m2 for problem in rows(**changes)] == [9]
    listed = [problem.to_json() for problem in found(**changes)]
    assert kinds_text(listed) == "1: void inside the survey; 1 place found right (ok)"
    assert kinds_text(listed[:1]) == "none; 1 place found right (ok)"
    run = results.run(voids=voids(void(7, False)), found_right=right)
    run["plan"]["warnings"] = []
    run["review"] = {"open": 0, "ok": 1, "fixed": 0}
    page = results.read(write_report(results.write(tmp_path / "out", run)))
    assert "Problems None is open. The run's folder has" in page.texts["problems"]


def test_places_after_the_worst_ten_of_a_kind_share_a_row() -> None:
    worst = [
        {"pixels": 20, "bounds": [0.0, 0.0, 5.0, 4.0], "area_m2": 20.0, "height_m": 20.0 - i}
        for i in range(13)
    ]
    changes = {
        "above_returns": {"pixels": 260, "number": 13, "worst": worst},
        "voids": voids(void(7, False)),
    }
    *ten, hole, last = rows(**changes)
    assert ten == found(**changes)[:10]
    assert hole.what == "void inside the survey"
    assert last.what == ten[0].what
    assert last.why.startswith("3 more, 60 m2 together")
    assert len(found(**changes)) == 14


def test_the_number_of_problems_stands_above_a_table_with_fewer_rows(tmp_path: Path) -> None:
    void = {"pixels": 9, "area_m2": 9.0, "bounds": [0.0, 0.0, 3.0, 3.0], "at_border": True}
    out = results.write(tmp_path / "out", results.run(voids={
        "pixels": 27, "asked_pixels": 0, "surveyed_pixels": 100, "largest": [void] * 3,
    }))  # fmt: skip
    text = results.read(write_report(out)).texts["problems"]
    assert "void at the border of the survey (3). Places of one kind share a row" in text
    alone = results.write(tmp_path / "alone", results.run())
    assert "share a row" not in results.read(write_report(alone)).texts["problems"]


def test_voids_of_an_earlier_run_lie_inside_the_survey() -> None:
    earlier = {"pixels": 7, "bounds": [0.0, 0.0, 1.0, 1.0], "area_m2": 7.0}
    (problem,) = found(voids=voids(earlier))
    assert problem.what == "void inside the survey"


def test_doubtful_tiles_have_a_place() -> None:
    tiles = [results.tile(0, 2, 30.0), results.tile(3, 2, 30.0, marked=7)]
    filtered = {"points": 1, "ground": 1, "marked": 7}
    (problem,) = found(tiles={"filter0": tiles}, filter=filtered)
    assert (problem.what, problem.where) == ("doubtful tile", tuple(tiles[1]["bounds"]))
    (problem,) = found(tiles={}, filter=filtered)
    assert problem.why.startswith("7 labels are not certified")


@pytest.mark.parametrize(
    ("change", "what", "where", "why"),
    [
        (
            {"advice": ["a roof"], "advice_at": [[3.0, 4.0]]},
            "objects suspected in the terrain",
            (3.0, 4.0, 3.0, 4.0),
            "a roof",
        ),
        (
            {"advice": ["of an earlier version"]},
            "objects suspected in the terrain",
            None,
            "of an earlier version",
        ),
        ({"doubts": ["not sure"]}, "doubtful decision", None, "not sure"),
        (
            {"healed": ["a", "b"]},
            "damaged store",
            None,
            "damaged and computed again: a, b",
        ),
        (
            {"classes": {"no_part": {"17": 1200}}},
            "class that is not filtered",
            None,
            "1,200 points of class 17 were not filtered and keep their class",
        ),
        (
            {"strays": [{"path": "a.laz", "point": 5, "x": 1.0, "y": 2.0, "z": 9.5}]},
            "stray point",
            (1.0, 2.0, 1.0, 2.0),
            "point 5 of a.laz, at the height 9.5, is far from all other points",
        ),
    ],
)
def test_each_kind(change: dict[str, Any], what: str, where: Any, why: str) -> None:
    (problem,) = found(**change)
    assert problem[:3] == (what, where, why)


def test_a_place_is_a_link_to_the_map_and_marked_there(tmp_path: Path) -> None:
    content = results.run(advice=["a roof"], advice_at=[[500003.25, 5399990.0]])
    page = results.read(write_report(results.write(tmp_path / "out", content)))
    assert (
        "objects suspected in the terrain 500003.2, 5399990.0 a roof" in page.texts["problems"]
    )
    links = [value for _, name, value in page.attributes if name == "data-place"]
    assert links == ["500003.25,5399990,500003.25,5399990"]
    assert page.data["problems"] == [
        ["objects suspected in the terrain", 500003.25, 5399990.0, 500003.25, 5399990.0]
    ]


def test_an_object_left_is_a_problem_with_an_outline_and_an_edit() -> None:
    ring = [0.0, 0.0, 9.0, 0.0, 9.0, 5.0, 0.0, 5.0, 0.0, 0.0]
    place = {
        "bounds": [0.0, 0.0, 9.0, 5.0], "area_m2": 45.0, "height_m": 2.04, "steep": 0.873, "ground": 12,
        "chance": 0.8, "rings": [ring],
    }  # fmt: skip
    empty = {**place, "ground": 0}
    likely, perhaps, bare = found(left_objects=[place, {**place, "chance": 0.79}, empty])
    assert (likely.what, likely.action, likely.stake_m) == (
        "object left in the terrain",
        "not_ground",
        2.04,
    )
    assert (likely.chance, likely.rings) == (0.8, [ring])
    assert likely.why.startswith("likely an object: 45 m2")
    assert "6.56 ft (2 m) above the land around" in likely.why
    assert "along 87% of the border" in likely.why
    assert perhaps.why.startswith("perhaps an object")
    assert bare.action == "void"
    assert "action flat" in bare.remedy


BOUNDS = [1.0, 2.0, 5.0, 8.0]
EVERY_PROBLEM: dict[str, Any] = {
    "check": {"requirements": [results.UNMET]},
    "quarantined": [{
        "path": "a.laz", "error": "a.laz: cut off", "bounds": results.run()["plan"]["extent"],
    }],
    "failed_tasks": [{"stage": "filter0", "key": "t", "error": "killed", "bounds": BOUNDS}],
    "implausible": [{
        "what": "terrain below all returns", "bounds": BOUNDS, "why": "hills are cut off", "remedy": "",
    }],
    "above_returns": {"worst": [{"bounds": BOUNDS, "area_m2": 24.0, "height_m": 2.0}]},
    "left_objects": [{
        "bounds": BOUNDS, "area_m2": 24.0, "height_m": 2.0, "steep": 0.9, "ground": 3, "chance": 0.7, "rings": [],
    }],
    "unsure": [{
        "bounds": BOUNDS, "area_m2": 40.0, "error_m": 0.8, "gap_m": 2.5, "slope": 0.4, "objects": 0.9, "chance": 0.6,
        "rings": [],
    }],
    "advice": ["a roof"], "advice_at": [[3.0, 4.0]],
    "voids": voids(void(1e5, at_border=False), void(1e5), void(1.0)),
    "without_returns": [{"bounds": BOUNDS, "area_m2": 24.0}],
    "edits": [
        {"number": 1, "action": "not_ground", "holes": 3, "bounds": BOUNDS},
        {"number": 2, "action": "ground", "changed": False, "bounds": BOUNDS},
    ],
    "water_doubts": [{"text": "lake 3", "place": [1.0, 2.0]}],
    "canopy_doubts": [{"text": "a canopy", "place": BOUNDS}],
    "tiles": {"filter0": [results.tile(0, 2, 30.0, marked=5)]},
    "filter": {"points": 9, "marked": 5},
    "classes": {"no_part": {"3": 7}},
    "strays": [{"point": 1, "path": "a.laz", "x": 1.0, "y": 2.0, "z": 9000.0}],
    "healed": ["b1"],
}  # fmt: skip
"""Content of run.json with which every source finds a problem."""


def test_a_file_that_was_left_out_has_a_place_beside_the_survey() -> None:
    west, south, east, north = results.run()["plan"]["extent"]
    beside = [east, south, east + 50, north]
    (known,) = found(quarantined=[{"path": "a.laz", "error": "cut off", "bounds": beside}])
    assert known.where == tuple(beside)
    for bounds in (None, [0.0, 0.0, 1.0, 1.0], [east + 1e6, south, east + 2e6, north]):
        (far,) = found(quarantined=[{"path": "a.laz", "error": "cut off", "bounds": bounds}])
        assert far.where is None
    damaged = [-1e300, -1e300, 1e300, 1e300]
    (wide,) = found(quarantined=[{"path": "a.laz", "error": "cut off", "bounds": damaged}])
    side = max(east - west, north - south)
    assert wide.where == (west - side, south - side, east + side, north + side)


def test_a_void_beside_a_file_that_was_left_out_is_blamed_on_it() -> None:
    west, south, east, north = results.run()["plan"]["extent"]
    hole = {
        "pixels": 7,
        "bounds": [east - 4, south, east, north],
        "area_m2": 5e3,
        "at_border": True,
    }
    left = [{"path": "a.laz", "error": "cut off", "bounds": [east, south, east + 50, north]}]
    alone = found(voids=voids(hole))[0]
    _, beside = found(voids=voids(hole), quarantined=left)
    assert "wall" in alone.remedy
    assert beside.remedy.startswith("repair the file beside it")
    assert beside.remedy.endswith("with action void to accept it")


def test_unsure_terrain_names_its_causes() -> None:
    (place,) = EVERY_PROBLEM["unsure"]
    open_land = {**place, "slope": 0.1, "objects": 0.2}
    both, neither = found(unsure=[place, open_land])
    assert (
        "plants or buildings (90% of the points are not ground) and a slope of 40%" in both.why
    )
    assert ("plants" in neither.why, "slope" in neither.why) == (False, False)
    assert (both.action, both.stake_m, both.chance) == ("", 0.8, 0.6)


def test_distances_of_unsure_terrain_are_in_the_unit_of_x_and_errors_in_that_of_heights() -> (
    None
):
    plan = {"metres_per_unit": {"horizontal": 1.0, "vertical": 0.3048}}
    (place,) = found(plan=plan, unsure=EVERY_PROBLEM["unsure"])
    assert "about 2.5 m from the nearest ground point" in place.why
    assert "a typical error is 2.62 ft (0.8 m)" in place.why


def test_the_table_of_chances_has_every_reason_with_a_position() -> None:
    content = results.run(**EVERY_PROBLEM)
    assert [source for source in SOURCES if not list(source(content))] == []
    located = {problem.what for problem in problems_of(content) if problem.where is not None}
    assert located == set(REASONS)


def test_chances_are_those_of_the_kind_of_the_clouds(monkeypatch: pytest.MonkeyPatch) -> None:
    lake = {"water_doubts": EVERY_PROBLEM["water_doubts"], "healed": ["b1"]}
    monkeypatch.setitem(REASONS, "doubtful water", Reason(1.0, {LIDAR: [Counts(98, 19)]}))
    survey = {"survey": {"survey": {"kind": LIDAR}}}
    assert [p.chance for p in found(**lake, statistics=survey)] == [0.2, None]
    assert [p.chance for p in found(**lake)] == [None, None]


def test_a_chance_of_the_source_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    own = Problem("doubtful water", (1.0, 2.0, 3.0, 4.0), "a lake", chance=0.9)
    monkeypatch.setattr(problems, "SOURCES", (lambda run: iter([own]),))
    assert found() == [own]
