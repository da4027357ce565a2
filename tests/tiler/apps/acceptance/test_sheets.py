"""Sheets that clouds do not cover are named, with the covered share."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pyogrio import raw

from cli.main import main
from tests.tiler.apps.acceptance.pulses import Pulses, lattice
from tiler.apps.acceptance import check_clouds, read_specification
from tiler.errors import InputError


def rectangle(west: float, south: float, east: float, north: float, name: object) -> dict:
    west, south, east, north = 5e5 + west, 5e6 + south, 5e5 + east, 5e6 + north
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    return {
        "type": "Feature",
        "properties": {"sheet": name},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }


def grid(folder: Path, *features: dict) -> Path:
    path = folder / "grid.geojson"
    crs = {"type": "name", "properties": {"name": "EPSG:25832"}}
    content = {"type": "FeatureCollection", "crs": crs, "features": list(features)}
    path.write_text(json.dumps(content))
    return path


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    """Pulses on 0 to 60 by 0 to 40 m; half of a sheet of 40 by 40 m in the east is covered."""
    return Pulses(*lattice(0, 60, 0, 40)).write(tmp_path / "a.laz")


def missing(found: dict) -> dict:
    return next(row for row in found["rows"] if row["name"] == "missing_sheets")


def test_sheets_are_named_by_what_is_covered(cloud: Path, tmp_path: Path) -> None:
    sheets = grid(
        tmp_path,
        rectangle(0, 0, 40, 40, 1.0),
        rectangle(50, 0, 90, 40, "east"),
        rectangle(60, 40, 100, 80, "none"),
        rectangle(0, 28, 40, 108, None),
    )
    row = missing(dict(check_clouds([cloud], sheets=sheets, sheet_field="SHEET")))
    assert row["found"] == 3
    assert [text.partition(" (")[0] for text in row["where"]] == ["none", "polygon 4", "east"]
    shares = [float(text.partition("(")[2].rstrip(" %)")) for text in row["where"]]
    assert shares == pytest.approx([0, 15, 25], abs=4)
    assert row["remark"] == f"of 4 sheets in {sheets}"
    assert row["state"] == "not asked"


def test_a_specification_may_ask_for_all_sheets(
    cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheets = grid(tmp_path, rectangle(0, 0, 30, 30, "a"))
    asked = tmp_path / "asked.toml"
    asked.write_text("missing_sheets = 0\n")
    call = ["check", str(cloud), "--spec", str(asked)]
    assert main([*call, "--sheets", str(sheets)]) == 0
    assert main(call) == 5
    assert "no sheets were given (--sheets)" in capsys.readouterr().out
    sheets = grid(tmp_path, rectangle(0, 0, 30, 30, "a"), rectangle(100, 0, 130, 30, "b"))
    assert main([*call, "--sheets", str(sheets), "--sheet-field", "sheet"]) == 5
    assert "b (0 %)" in capsys.readouterr().out


def test_sparse_clouds_cover_their_sheets(tmp_path: Path) -> None:
    """The specification asks for cells of 0.7 m, and the cloud has a pulse per square metre."""
    cloud = Pulses(*lattice(0, 60, 0, 60, 1.0)).write(tmp_path / "a.laz")
    sheets = grid(tmp_path, rectangle(0, 0, 30, 60, "a"), rectangle(30, 0, 60, 60, "b"))
    row = missing(dict(check_clouds([cloud], read_specification("usgs-ql1"), sheets=sheets)))
    assert (row["found"], row["where"]) == (0, [])


def test_sheets_smaller_than_cells_are_counted(cloud: Path, tmp_path: Path) -> None:
    sheets = grid(tmp_path, rectangle(10, 10, 10.1, 10.1, "a"), rectangle(0, 0, 40, 40, "b"))
    row = missing(dict(check_clouds([cloud], sheets=sheets)))
    assert row["found"] == 0
    assert row["remark"] == f"of 2 sheets in {sheets}, 1 sheet too small to know"


def test_clouds_without_a_crs_take_the_coordinates_of_the_sheets(tmp_path: Path) -> None:
    cloud = Pulses(*lattice(0, 60, 0, 40)).write(tmp_path / "a.laz", crs=None)
    sheets = grid(tmp_path, rectangle(0, 0, 40, 40, "a"), rectangle(90, 0, 130, 40, "b"))
    found = check_clouds([cloud], sheets=sheets, sheet_field="sheet")
    assert missing(dict(found))["where"] == ["b (0 %)"]
    assert any("coordinates are taken as those of the clouds" in n for n in found["notes"])


def test_polygons_have_their_number_in_the_file(cloud: Path, tmp_path: Path) -> None:
    empty = {"type": "Feature", "properties": {"sheet": "x"}, "geometry": None}
    sheets = grid(tmp_path, empty, rectangle(90, 0, 130, 40, " "))
    row = missing(dict(check_clouds([cloud], sheets=sheets, sheet_field="sheet")))
    assert row["where"] == ["polygon 2 (0 %)"]


def test_a_field_that_is_not_there_is_refused(
    cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheets = grid(tmp_path, rectangle(0, 0, 30, 30, "a"))
    with pytest.raises(InputError, match="has no field 'name', its fields are sheet; give one"):
        check_clouds([cloud], sheets=sheets, sheet_field="name")
    assert main(["check", str(cloud), "--sheet-field", "name"]) == 2
    assert "give --sheets FILE as well" in capsys.readouterr().err


@pytest.mark.parametrize("sides", ["1km", "1000", "1000x1250"])
def test_a_grid_is_refused_because_it_names_no_sheets(
    cloud: Path, sides: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(cloud), "--sheets", sides]) == 2
    assert f"--sheets {sides}: is a grid" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["check", "plan"])
@pytest.mark.parametrize("name", ["./1000", "./1000.gpkg"])
def test_a_number_that_begins_as_a_path_is_a_missing_file(
    name: str, command: str, cloud: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--sheets", name, "--sheet-field", "n"]
    assert main([command, str(cloud), *options]) == 3
    assert f"{name[2:]}: no such file" in capsys.readouterr().err


def test_a_file_with_several_layers_gets_the_line_of_a_run(
    cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheets, layer = tmp_path / "sheets.gpkg", tmp_path / "polygons.gpkg"
    source = grid(tmp_path, rectangle(0, 0, 30, 30, "a"), rectangle(90, 0, 130, 40, "b"))
    meta, _, shapes, columns = raw.read(source)
    polygons = {key: meta[key] for key in ("crs", "fields", "geometry_type")}
    for name in ("dtm", "dsm"):
        append = sheets.exists()
        raw.write(sheets, shapes, columns, layer=name, append=append, **polygons)
    lines = []
    for call in (["check"], ["run", "-o", str(tmp_path / "out"), "--progress", "none"]):
        given = [*call, str(cloud), "--sheets", str(sheets), "--sheet-field", "sheet"]
        assert main(given) == 3
        lines.append(capsys.readouterr().err)
    assert lines[0] == lines[1]
    assert "write one with `ogr2ogr polygons.gpkg FILE LAYER`" in lines[0]
    # What ogr2ogr does.
    raw.write(layer, *(raw.read(sheets, layer="dsm")[i] for i in (2, 3)), **polygons)
    row = missing(dict(check_clouds([cloud], sheets=layer, sheet_field="sheet")))
    assert row["where"] == ["b (0 %)"]
