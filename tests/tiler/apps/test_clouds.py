"""`tiler info` of several clouds, or a folder of them, is a table."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cli.main import main
from tests.tiler.apps.test_info import write_cloud
from tiler.apps.clouds import (
    COLUMNS,
    ListedCloud,
    UnreadableCloud,
    describe_many,
    is_many,
    table_row,
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    clouds = tmp_path / "clouds"
    clouds.mkdir()
    write_cloud(clouds / "a.laz", side=20)
    write_cloud(clouds / "b.las", side=10, crs="EPSG:2994")
    (clouds / "c.laz").write_bytes(b"no cloud")
    return clouds


def test_each_cloud_has_a_row_and_a_broken_one_its_reason(folder: Path) -> None:
    found = describe_many([str(folder)])
    assert [Path(cloud.path).name for cloud in found] == ["a.laz", "b.las", "c.laz"]
    a, b, c = found
    assert isinstance(a, ListedCloud)
    assert isinstance(b, ListedCloud)
    assert (a.points, b.points) == (1600, 400)
    assert a.per_m2 == pytest.approx(4, rel=0.1)
    assert (a.unit, b.unit) == ("m", "ft")
    assert isinstance(c, UnreadableCloud)
    assert c.error
    assert all(len(row) == len(COLUMNS) for row in map(table_row, found))


def test_the_command_takes_folders_and_many_files(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(folder / "a.laz"), str(folder / "b.las")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "2 clouds"
    assert len(lines) == 4
    assert "1,600" in lines[2]
    assert main(["info", str(folder), "--json"]) == 0
    clouds = json.loads(capsys.readouterr().out)
    assert [list(cloud) for cloud in clouds] == [
        ["path", "points", "per_m2", "bounds", "unit", "crs", "warnings"],
        ["path", "points", "per_m2", "bounds", "unit", "crs", "warnings"],
        ["path", "error"],
    ]


def test_a_virtual_point_cloud_is_the_table_of_its_clouds(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ("a.laz", "b.las", "c.laz")
    features = [{"assets": {"data": {"href": f"./clouds/{name}"}}} for name in names]
    listed = {"type": "FeatureCollection", "features": features}
    path = tmp_path / "all.vpc"
    path.write_text(json.dumps(listed))
    assert main(["info", str(path), "--json"]) == 0
    of_list = json.loads(capsys.readouterr().out)
    assert main(["info", str(folder), "--json"]) == 0
    assert of_list == json.loads(capsys.readouterr().out)
    path.write_text("{}")
    assert main(["info", str(path)]) == 3
    assert "is not a readable virtual point cloud" in capsys.readouterr().err
    assert main(["info", str(tmp_path / "none.vpc")]) == 3
    assert "no such file" in capsys.readouterr().err


def test_one_file_a_store_and_a_result_are_no_table(folder: Path) -> None:
    (folder / "run.json").write_text("{}")
    assert not is_many([str(folder)])
    assert not is_many([str(folder / "a.laz")])
    assert is_many([str(folder / "*.laz")])
