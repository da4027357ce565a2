"""`tiler review`: the cards of a run, and what its page saves, as edits of the next run."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS

from cli.main import main
from tests.integration.test_review import GAPS, SIDE, edited, made, rows
from tests.integration.test_review import cloud as cloud
from tests.integration.test_review import out as out
from tests.integration.test_review import reviewed as reviewed
from tests.scenes.drawings import EAST, NORTH
from tests.tiler.io.vector.files import write
from tests.tiler.report.results import Reader
from tiler.apps.review import crs_name_in_geojson, write_review_page
from tiler.core.points import GROUND
from tiler.errors import ConfigError, InputError
from tiler.io.vector import POLYGONS, read_in_crs
from tiler.report.html import write_report
from tiler.report.places import bridged, points_near, section_ends, terrain_at
from tiler.store import open_store

DATUM = CRS.from_proj4("+proj=tmerc +lat_0=47 +lon_0=9 +x_0=1 +ellps=bessel +units=us-ft")
"""CRS without a code."""


def data_of(page: Path) -> dict[str, Any]:
    found = re.search(r'id="data">(.*?)</script>', page.read_text("utf-8"), re.DOTALL)
    assert found
    return dict(json.loads(found[1]))


def decided(page: Path, *statuses: str) -> Path:
    """The file that the page saves (review.js) if its places get these statuses and the suggested edit is void."""
    data = data_of(page)
    decision = {"action": "void", "z": None, "note": "seen"}
    rows = data["kept"] + [
        {**place, "columns": {**place["columns"], "status": status, **decision}}
        for place, status in zip(data["places"], statuses, strict=True)
        if status != "open"
    ]
    features = [
        {
            "type": "Feature",
            "properties": row["columns"],
            "geometry": json.loads(row["geometry"]),
        }
        for row in rows
    ]
    crs = {"type": "name", "properties": {"name": data["crs"]}}
    file = page.with_name("decisions.geojson")
    content = {"type": "FeatureCollection", "name": "review", "crs": crs, "features": features}
    file.write_text(json.dumps(content))
    return file


def test_the_cards_are_the_open_places_by_their_rank(out: Path) -> None:
    written = write_review_page(out)
    assert (written.shown, written.open) == (2, 2)
    data, text = data_of(Path(written.page)), Path(written.page).read_text("utf-8")
    assert [place["columns"]["rank"] for place in data["places"]] == [1, 2]
    for place, row in zip(data["places"], rows(out), strict=True):
        shape = shapely.from_geojson(place["geometry"])
        assert shape.normalize().equals_exact(row["shape"].normalize())
        assert place["columns"]["reason"] == row["reason"]
    reader = Reader()
    reader.feed(text)
    assert reader.tags.count("article") == 2
    assert "with the edit void" in text
    assert text.count("ground (brown)") == 2
    assert write_review_page(out, 1).shown == 1


def test_the_report_shows_the_open_places(out: Path) -> None:
    text = (out / "report.html").read_text("utf-8")
    reader = Reader()
    reader.feed(text)
    assert reader.tags.count("article") == 2
    assert "2 places, the most serious first" in text
    with edited(out) as database:
        database.execute("UPDATE review SET status = 'ok' WHERE rank = 1")
    write_report(out)
    assert "1 place, the most serious first" in (out / "report.html").read_text("utf-8")
    (out / "review.gpkg").write_bytes(b"cut off")
    write_report(out)
    assert (
        "review.gpkg: does not begin as a .gpkg file does" in (out / "report.html").read_text()
    )
    (out / "review.gpkg").unlink()
    write_report(out)
    assert "Places to look at" not in (out / "report.html").read_text("utf-8")


def test_decisions_become_edits_and_are_remembered(
    cloud: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = Path(write_review_page(out).page)
    first, second = (row["shape"] for row in rows(out))
    file = decided(page, "fixed", "ok")
    made(cloud, out, edits=str(file))
    with rasterio.open(out / "dtm.vrt") as raster:
        heights, box = raster.read(1, masked=True), raster.bounds
    y, x = np.indices(heights.shape) + 0.5
    x, y = box.left + x, box.top - y
    # Coordinates may be rounded on the way, so pixels whose centres lie on the outline are left out.
    assert heights.mask[shapely.contains_xy(first.buffer(-0.01), x, y)].all()
    assert not heights.mask[shapely.contains_xy(second.buffer(-0.01), x, y)].any()
    found = {row["status"]: row for row in rows(out)}
    assert sorted(found) == ["fixed", "ok"]
    assert found["ok"]["note"] == "seen"
    # The saved file is not needed again.
    again = made(cloud, out, edits=str(out / "review.gpkg"))
    assert again.exit_code == 0
    assert sorted(row["status"] for row in rows(out)) == ["fixed", "ok"]
    assert "<article" in page.read_text("utf-8")
    assert main(["review", str(out)]) == 0
    assert f"page  {page}: no place is open" in capsys.readouterr().out
    text = page.read_text("utf-8")
    assert "No place of the run written" in text
    assert "<article" not in text


def voids(out: Path, shape: Any) -> float:
    """Share of the pixels inside a shape, a little away from its outline, that have no height."""
    with rasterio.open(out / "dtm.vrt") as raster:
        heights, box = raster.read(1, masked=True), raster.bounds
    y, x = np.indices(heights.shape) + 0.5
    inside = shapely.contains_xy(shape.buffer(-0.01), box.left + x, box.top - y)
    return float(np.ma.getmaskarray(heights)[inside].mean())


def test_a_page_keeps_the_edits_and_decisions_before_it(cloud: Path, out: Path) -> None:
    """Otherwise the first 50 places would be undone with the next 50, and the user's own edits with the first."""
    own = shapely.box(EAST + 60, NORTH + 60, EAST + 70, NORTH + 70)
    columns = {"action": np.array(["void"], object)}
    file = write(out.parent / "own.gpkg", [own], "Polygon", "EPSG:25832", columns)
    made(cloud, out, edits=str(file))
    first, second = (row["shape"] for row in rows(out))
    assert voids(out, own) == 1
    page = Path(write_review_page(out, 1).page)
    made(cloud, out, edits=str(decided(page, "fixed")))
    assert (voids(out, own), voids(out, first), voids(out, second)) == (1, 1, 0)
    page = Path(write_review_page(out, 1).page)
    result = made(cloud, out, edits=str(decided(page, "fixed")))
    assert (voids(out, own), voids(out, first), voids(out, second)) == (1, 1, 1)
    assert not result.warnings
    assert [row["status"] for row in rows(out)] == 3 * ["fixed"]
    made(cloud, out, edits=str(file))
    file.unlink()
    with edited(out) as database:
        database.execute("UPDATE review SET status = 'open'")
    with pytest.raises(InputError, match=r"own.gpkg: the edits of the run are not there"):
        write_review_page(out)


STRANGE = (
    "stake_m = 9e999",
    "z = 'high'",
    "area_m2 = 'wide'",
    "chance = 'high'",
    "reason = 5",
    "rank = NULL",
)


@pytest.mark.parametrize("change", STRANGE)
def test_strange_values_do_not_break_the_page(change: str, out: Path) -> None:
    with edited(out) as database:
        database.execute(f"UPDATE review SET {change}")
    for place in data_of(Path(write_review_page(out).page))["places"]:
        columns = place["columns"]
        numbers = [
            columns[name] for name in ("stake_m", "area_m2") if columns[name] is not None
        ]
        assert np.isfinite(numbers).all()
        assert isinstance(columns["reason"], str)


def test_a_card_tells_the_rank_and_the_middle_of_its_place(out: Path) -> None:
    with edited(out) as database:
        database.execute("UPDATE review SET status = 'ok' WHERE rank = 1")
    (_, row) = rows(out)
    west, south, east, north = row["shape"].bounds
    text = Path(write_review_page(out).page).read_text("utf-8")
    assert "2. place without returns" in text
    assert f"{(west + east) / 2:.1f}, {(south + north) / 2:.1f}" in text


def test_the_chance_is_on_the_card_in_the_report_and_in_the_saved_file(
    cloud: Path, out: Path
) -> None:
    with edited(out) as database:
        database.execute("UPDATE review SET chance = 0.7 WHERE rank = 2")
    page = Path(write_review_page(out).page)
    write_report(out)
    assert page.read_text("utf-8").count("chance that it is wrong") == 1
    assert (out / "report.html").read_text("utf-8").count("wrong with a chance of 70 %") == 1
    made(cloud, out, edits=str(decided(page, "open", "ok")))
    assert [(row["status"], str(row["chance"])) for row in rows(out)] == [
        ("open", "nan"), ("ok", "0.7"),
    ]  # fmt: skip


@pytest.mark.parametrize("crs", [CRS(25832), CRS(2992), DATUM, CRS("EPSG:25832+5783")])
def test_outlines_come_back_in_any_crs(crs: CRS, tmp_path: Path) -> None:
    name = crs_name_in_geojson(crs.to_wkt())
    shape = shapely.box(500_000.125, 5_400_000.25, 500_010.5, 5_400_010.75)
    feature = {
        "type": "Feature",
        "properties": {},
        "geometry": json.loads(shapely.to_geojson(shape)),
    }
    named = {"type": "name", "properties": {"name": name}}
    file = tmp_path / "decisions.geojson"
    file.write_text(
        json.dumps({"type": "FeatureCollection", "crs": named, "features": [feature]})
    )
    features = read_in_crs(file, POLYGONS, crs.to_wkt())
    assert features.features[0].geometry.equals(shape)
    assert not features.notes


def test_sections_show_the_points_of_their_strip(out: Path) -> None:
    store = open_store(str(out / "store.zarr"))
    blocks = [store.read_bucket(cell, ("xyz", "classification")) for cell in store.buckets()]
    xyz = np.concatenate([store.meta.frame.coordinates(block.xyz) for block in blocks])
    classes = np.concatenate([block.classification for block in blocks])
    middle = np.array([EAST, NORTH]) + SIDE / 2
    for angle in (0.0, 0.4, np.pi / 2, 2.5):
        direction = np.array([np.cos(angle), np.sin(angle)])
        # Off the millimetres of the coordinates, so that no point lies on the edge of the strip.
        ends = np.stack((middle - 30.0003 * direction, middle + 33.0003 * direction)) + 0.0002
        along = (xyz[:, :2] - ends[0]) @ direction
        aside = (xyz[:, :2] - ends[0]) @ [direction[1], -direction[0]]
        near = (along >= 0) & (along < 63.0006) & (np.abs(aside) <= 0.50005)
        for kept in ([GROUND], [9]):
            ground, others = points_near(store, ends, 1.0001, kept)
            is_ground = np.isin(classes, kept)
            for points, wanted in ((ground, near & is_ground), (others, near & ~is_ground)):
                expected = np.stack((along[wanted], xyz[wanted, 2]))
                assert points.shape == expected.shape
                in_order, wanted_order = np.lexsort(points), np.lexsort(expected)
                assert np.allclose(points[:, in_order], expected[:, wanted_order])


@given(
    st.floats(1, 60),
    st.floats(1.1, 8),
    st.floats(0, np.pi),
    st.floats(-1e6, 1e6),
    st.floats(0.3, 1),
)
def test_sections_cross_the_shorter_side(
    short: float, ratio: float, angle: float, x: float, metres: float
) -> None:
    box = shapely.affinity.rotate(
        shapely.box(0, 0, short, short * ratio), angle, use_radians=True
    )
    ends = section_ends(shapely.affinity.translate(box, x, -x), metres)
    middle = np.array([box.centroid.x + x, box.centroid.y - x])
    assert np.allclose(ends.mean(axis=0), middle, atol=1e-6)
    length = np.hypot(*(ends[1] - ends[0]))
    assert length == pytest.approx(
        min(short + 2 * max(0.75 * short, 15 / metres), 400 / metres)
    )
    direction = (ends[1] - ends[0]) / length
    assert abs(direction @ [np.cos(angle), np.sin(angle)]) == pytest.approx(1, abs=1e-5)


def test_sections_have_the_terrain_at_their_positions(tmp_path: Path) -> None:
    heights = np.random.default_rng(4).normal(300, 20, (60, 90)).astype(np.float32)
    heights[20:30, 40:50] = -9999
    transform = rasterio.Affine(0.3, 0, EAST, 0, -0.3, NORTH)
    profile = {"width": 90, "height": 60, "count": 1, "dtype": "float32", "nodata": -9999}
    path = tmp_path / "dtm.tif"
    with rasterio.open(path, "w", driver="GTiff", transform=transform, **profile) as raster:
        raster.write(heights, 1)
    middle = np.array([EAST + 13.5, NORTH - 9])
    with rasterio.open(path) as raster:
        for angle in (0.0, 0.6, np.pi / 2, 2.5, 4.0):
            along = np.linspace(-20, 20, 401)[:, np.newaxis]
            positions = middle + along * [np.cos(angle), np.sin(angle)]
            samples = raster.sample(positions, masked=True)
            expected = [np.nan if sample.mask[0] else sample[0] for sample in samples]
            found = terrain_at(raster, positions)
            assert np.array_equal(found, expected, equal_nan=True)
            assert 0 < np.isfinite(found).sum() < len(found)
        beyond = terrain_at(raster, middle + [[100.0, 0], [0, 100.0]])
    assert np.isnan(beyond).all()


def test_a_plane_is_bridged_exactly() -> None:
    y, x = np.indices((40, 50))
    plane = (5 + 0.25 * x - 0.5 * y).astype(np.float32)
    inside = (np.abs(x - 25) < 7) & (np.abs(y - 20) < 9)
    house = np.where(inside, plane + 8, plane).astype(np.float32)
    after = bridged(house, inside)
    assert after is not None
    assert np.allclose(after, plane, atol=1e-4)
    assert bridged(house, np.ones_like(inside)) is None


def test_sections_say_that_the_points_are_not_there(out: Path) -> None:
    shutil.rmtree(out / "store.zarr/points")
    assert "cannot be read" in Path(write_review_page(out).page).read_text("utf-8")
    shutil.rmtree(out / "store.zarr")
    text = Path(write_review_page(out).page).read_text("utf-8")
    assert text.count("the store of the run is not there") == len(GAPS)
    assert "ground (brown)" not in text


def test_only_a_page_of_this_command_is_replaced(out: Path, tmp_path: Path) -> None:
    assert write_review_page(out).page == write_review_page(out).page
    other = tmp_path / "mine.html"
    other.write_text("mine")
    with pytest.raises(ConfigError, match="exists and is not a page of this command"):
        write_review_page(out, page_path=other)
    assert other.read_text() == "mine"
    with pytest.raises(ConfigError, match="suffix"):
        write_review_page(out, page_path=tmp_path / "page.txt")
    with pytest.raises(ConfigError, match="report.html"):
        write_review_page(out, page_path=out / "report.html")
    with pytest.raises(ConfigError, match="its folder does not exist"):
        write_review_page(out, page_path=tmp_path / "no" / "page.html")
    with pytest.raises(ConfigError, match="is a URL"):
        write_review_page(out, page_path="https://example.org/page.html")
    (tmp_path / "link.html").symlink_to(tmp_path / "elsewhere.html")
    with pytest.raises(ConfigError, match="is a link"):
        write_review_page(out, page_path=tmp_path / "link.html")
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(ConfigError, match="is not a page of this command"):
        write_review_page(out, page_path=tmp_path / "folder.html")


def test_what_cannot_be_reviewed_is_one_line(out: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no results of a run"):
        write_review_page(tmp_path)
    with pytest.raises(ConfigError, match="is a URL"):
        write_review_page("https://example.org/out")
    with edited(out) as database:
        database.execute("UPDATE review SET status = 'ok'")
    assert write_review_page(out).open == 0
    (out / "review.gpkg").unlink()
    with pytest.raises(InputError, match=r"review.gpkg: no such file; run again"):
        write_review_page(out)
