"""Sheets that clouds do not cover are named, with the covered share."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cli.main import main
from tests.tiler.apps.acceptance.pulses import Pulses, lattice
from tiler.apps.acceptance import check_clouds
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
        rectangle(0, 20, 40, 100, None),
    )
    row = missing(dict(check_clouds([cloud], sheets=sheets, sheet_field="SHEET")))
    assert row["found"] == 3
    assert [text.partition(" (")[0] for text in row["where"]] == ["none", "east", "polygon 4"]
    shares = [float(text.partition("(")[2].rstrip("%)")) for text in row["where"]]
    assert shares == pytest.approx([0, 25, 25], abs=4)
    assert row["remark"] == "of 4 sheets"
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
    assert "b (0%)" in capsys.readouterr().out


def test_a_field_that_is_not_there_is_refused(
    cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheets = grid(tmp_path, rectangle(0, 0, 30, 30, "a"))
    with pytest.raises(InputError, match="has no field 'name', its fields are sheet; give one"):
        check_clouds([cloud], sheets=sheets, sheet_field="name")
    assert main(["check", str(cloud), "--sheet-field", "name"]) == 2
    assert "give --sheets FILE as well" in capsys.readouterr().err
