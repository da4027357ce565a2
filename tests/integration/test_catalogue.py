"""classified.vpc and stac.json: what independent programs read of a folder of results."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import laspy
import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.runs import do
from tiler.errors import InputError
from tiler.inputs import find_inputs

CITY = {"method": "classic", "tile_size": "64"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clouds in folders of their own, one with times of pulses."""
    folder = tmp_path_factory.mktemp("clouds")
    cloud = clouds.city(100.0)
    for name, side in (("west", cloud.xyz[:, 0] < 50), ("east", cloud.xyz[:, 0] >= 50)):
        (folder / name).mkdir()
        clouds.write(folder / name / "a b.laz", cloud.take(side))
    return folder


@pytest.fixture(scope="module")
def out(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("results") / "out"
    assert do(folder, out, **CITY).exit_code == 0
    return out


def read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return found


def test_a_name_that_is_no_utf_8_is_a_link_of_its_bytes(tmp_path: Path) -> None:
    name = "\udcff.laz"
    try:
        clouds.write(tmp_path / name, clouds.city(40.0))
    except OSError:
        pytest.skip("this file system takes no such name")
    assert do(tmp_path, tmp_path / "out", **CITY).exit_code == 0
    assets = read(tmp_path / "out" / "stac.json")["assets"].values()
    (href,) = (asset["href"] for asset in assets if asset["href"].endswith(".laz"))
    assert href == "./classified/%FF.laz"
    assert (tmp_path / "out" / os.fsdecode(unquote_to_bytes(href))).is_file()


def test_the_virtual_cloud_says_what_the_clouds_hold(out: Path) -> None:
    features = read(out / "classified.vpc")["features"]
    hrefs = [f["assets"]["data"]["href"] for f in features]
    assert hrefs == [f"./classified/{side}/a b.laz" for side in ("east", "west")]
    for feature in features:
        las = laspy.read(out / feature["assets"]["data"]["href"])
        properties = feature["properties"]
        assert properties["pc:count"] == len(las)
        low, high = las.xyz.min(axis=0), las.xyz.max(axis=0)
        np.testing.assert_allclose(properties["proj:bbox"], [*low, *high], atol=1e-6)
        told = {s["name"]: s for s in properties["pc:statistics"]}
        for name in ("Z", "Classification", "Intensity"):
            values = np.asarray(getattr(las, name.lower()), np.float64)
            true = {"average": values.mean(), "variance": values.var(), "minimum": values.min()}
            true["maximum"] = values.max()
            assert {figure: told[name][figure] for figure in true} == pytest.approx(
                true, abs=1e-6
            )
        assert 'ID["EPSG",32632]' in properties["proj:wkt2"]
        west, south, _, east, north, _ = feature["bbox"]
        assert 8 < west < east < 10
        assert 48 < south < north < 49


def validator() -> Any:
    """What holds documents against the schemas of STAC's core; those of extensions are on the web alone."""
    pytest.importorskip("jsonschema")
    from pystac.validation import RegisteredValidator

    return RegisteredValidator.get_validator()


def test_the_item_is_valid_and_its_links_lead_to_files(out: Path) -> None:
    pystac = pytest.importorskip("pystac", reason="no STAC reader: pystac is not installed")
    item = pystac.read_file(str(out / "stac.json"))
    validator().validate_core(item.to_dict(), pystac.STACObjectType.ITEM, "1.1.0")
    assert item.ext.proj.epsg == 32632
    assert item.ext.proj.shape == [100, 100]
    assert item.datetime is not None
    for asset in item.assets.values():
        assert Path(unquote(asset.get_absolute_href())).is_file(), asset.href
    assert {"dtm", "outline", "classified.vpc", "report"} < item.assets.keys()


def test_equal_inputs_give_equal_bytes_wherever_they_lie(
    folder: Path, out: Path, tmp_path: Path
) -> None:
    shutil.copytree(folder, tmp_path / "moved")
    do(tmp_path / "moved", tmp_path / "other", **{**CITY, "tile_size": "128"})
    for name in ("classified.vpc", "stac.json"):
        assert (tmp_path / "other" / name).read_bytes() == (out / name).read_bytes()


def test_sheets_are_a_collection(folder: Path, tmp_path: Path) -> None:
    pystac = pytest.importorskip("pystac", reason="no STAC reader: pystac is not installed")
    out = tmp_path / "out"
    do(folder, out, method="keep", ground_classes="1", sheets="64", products="dtm,mask")
    found = pystac.read_file(str(out / "stac.json"))
    items = list(found.get_items())
    assert len(items) == 6  # the city begins at no multiple of 64 m
    core = validator()
    assert "pc:count" not in (out / "stac.json").read_text()
    core.validate_core(read(out / "stac.json"), pystac.STACObjectType.COLLECTION, "1.1.0")
    for item in items:
        core.validate_core(
            read(Path(item.get_self_href())), pystac.STACObjectType.ITEM, "1.1.0"
        )
        boxes = found.extent.spatial.bboxes[0], item.bbox
        assert boxes[0][0] <= boxes[1][0] < boxes[1][2] <= boxes[0][2]
        assert item.get_collection().id == found.id
        assert set(item.assets) == {"dtm", "mask"}
        assert all(Path(asset.get_absolute_href()).is_file() for asset in item.assets.values())
    again = do(folder, out, method="keep", ground_classes="1", products="dtm")
    names = {Path(item.get_self_href()).name for item in items}
    assert {path.name for path in (out / "outdated/stac").iterdir()} == names
    assert again.summary["outputs"].keys() == {
        "dtm.tif",
        "outline.gpkg",
        "review.gpkg",
        "stac.json",
    }
    assert not any(stage.startswith("filter") for stage in again.summary["stages"])


def test_a_virtual_cloud_is_an_input(folder: Path, out: Path, tmp_path: Path) -> None:
    result = do(out / "classified.vpc", tmp_path / "again", **CITY)
    assert (tmp_path / "again/dtm.tif").read_bytes() != b""
    assert [Path(i["path"]).parent.name for i in result.summary["inputs"]] == ["east", "west"]
    assert (tmp_path / "again/classified/classified/east/a b.laz").is_file()


def member(href: str) -> dict[str, Any]:
    return {"type": "Feature", "assets": {"data": {"href": href}}}


def test_members_are_found_beside_the_file_or_elsewhere(folder: Path, tmp_path: Path) -> None:
    west, url = "./west/a b.laz", "https://host/x.copc.laz?key=1"
    file = folder / "town.vpc"
    features = [member(place) for place in (west, str(folder / "east/a b.laz"), west, url)]
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    try:
        found = find_inputs([str(file)])
    finally:
        file.unlink()
    assert [*map(str, found)] == [
        str(folder / "east/a b.laz"),
        str(folder / "west/a b.laz"),
        url,
    ]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"\x80", "can't decode byte"),
        (b"[" * 100_000, "nested too deeply"),
        (b"[]", "not a JSON object"),
        (b'{"type": "Feature"}', "holds no FeatureCollection"),
        (b'{"type": "FeatureCollection", "features": []}', "names no cloud at all"),
        (b'{"type": "FeatureCollection", "features": [7]}', "its feature 1 names no cloud"),
        *(
            (
                json.dumps({"type": "FeatureCollection", "features": [member(href)]}).encode(),
                reason,
            )
            for href, reason in (
                ("/etc/passwd", "no file of .las, .laz"),
                ("a.vpc", "no file of .las, .laz"),
                ("file:///etc/a.laz", "which no virtual point cloud may"),
                ("simplecache::http://h/a.laz", "which no virtual point cloud may"),
                ("a\0.laz", "names no cloud"),
            )
        ),
    ],
)
def test_what_is_no_virtual_cloud_is_told_in_one_line(
    content: bytes, reason: str, tmp_path: Path
) -> None:
    file = tmp_path / "bad.vpc"
    file.write_bytes(content)
    with pytest.raises(
        InputError, match=r"bad\.vpc: the file is not a readable virtual point cloud"
    ) as refused:
        find_inputs([str(file)])
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)


def test_clouds_are_written_as_las_or_not_at_all(
    folder: Path, out: Path, tmp_path: Path
) -> None:
    again = tmp_path / "again"
    shutil.copytree(out, again)
    plain = do(folder, again, **CITY, classified="las")
    assert plain.summary["stages"]["filter0"]["computed"] == 0
    for name in ("east/a b", "west/a b"):
        las, laz = (
            laspy.read(again / f"classified/{name}.las"),
            laspy.read(out / f"classified/{name}.laz"),
        )
        assert las.points.array.tobytes() == laz.points.array.tobytes()
        assert not las.header.are_points_compressed
    (first, _) = read(again / "classified.vpc")["features"]
    data = {
        "href": "./classified/east/a b.las",
        "type": "application/vnd.las",
        "roles": ["data"],
    }
    assert first["assets"]["data"] == data
    assert first["properties"]["pc:encoding"] == "LAS"
    assert not list((again / "classified").rglob("*.laz"))
    do(folder, again, **CITY, classified="copc")
    (first, _) = read(again / "classified.vpc")["features"]
    assert first["id"] == "east/a b"
    data |= {"href": "./classified/east/a b.copc.laz", "type": "application/vnd.laszip+copc"}
    assert first["assets"]["data"] == data
    with laspy.CopcReader.open(again / "classified/east/a b.copc.laz") as reader:
        points = reader.query().array.tolist()
    assert sorted(points) == sorted(
        laspy.read(out / "classified/east/a b.laz").points.array.tolist()
    )
    none = do(folder, again, **CITY, classified="none")
    assert none.exit_code == 0
    assert not (again / "classified.vpc").exists()
    assert not list((again / "classified").rglob("*.las"))
    assert set(read(again / "stac.json")["assets"]) == {"dtm", "outline", "report"}
    assert (again / "dtm.tif").read_bytes() == (out / "dtm.tif").read_bytes()
