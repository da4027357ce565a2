"""Water in the terrain: level or falling, the land beside it untouched, and the same from the file that a run wrote."""

from __future__ import annotations

import json
import shutil
from contextlib import closing
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from pyproj import Transformer

from tests.invariants import clouds
from tests.invariants.runs import computed, do, settings
from tests.scenes.drawings import EAST, NORTH, digests, draw, ground, pixels, written
from tests.scenes.journals import connected
from tiler.core.products import NODATA, WATER
from tiler.errors import ConfigError, InputError
from tiler.plan import make_plan

LAKE = shapely.Point(18, 20).buffer(9)
RIVER = shapely.box(38, -10, 50, 70)


def valley(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Uneven land, 1 m below it a lake, and a river that falls to the south; both of uneven returns."""
    rng = np.random.default_rng(8)
    wave = rng.normal(0, 0.15, len(x))
    lake, river = (x - 18) ** 2 + (y - 20) ** 2 < 81, np.abs(x - 44) < 6
    land = 30 + 0.02 * y + 0.3 * np.sin(x / 5)
    return np.select([lake, river], [28.5 + wave, 28 + 0.02 * y + wave], land)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloud, its plain DTM in `plain`, and one with water in `wet`."""
    path = tmp_path_factory.mktemp("water")
    cloud = written(path / "valley.laz", ground(valley, number=7000))
    drawn = draw(path / "w.json", [(LAKE, {"kind": "pond"}), (RIVER, {"kind": "river"})])
    do(cloud, path / "plain", method="keep", resolution="0.5")
    do(cloud, path / "wet", method="keep", resolution="0.5", water=drawn, products="dtm,mask")
    return path


def mask(out: Path) -> np.ndarray:
    with rasterio.open(out / "mask.tif") as raster:
        return raster.read(1)[::-1]


def test_a_lake_is_level_and_a_river_falls_and_the_land_stays(folder: Path) -> None:
    before, after, wet = (
        pixels(folder / "plain"),
        pixels(folder / "wet"),
        mask(folder / "wet") == WATER,
    )
    assert (before == after)[~wet].all()
    y, x = (np.mgrid[0:120, 0:120] + 0.5) / 2
    lake = shapely.contains_xy(LAKE, x, y)
    assert (wet == (lake | shapely.contains_xy(RIVER, x, y))).all()
    assert len(set(after[lake].tolist())) == 1
    assert abs(after[lake][0] - 28.5) < 0.05
    river = after[:, 76:100]
    assert np.ptp(river, axis=1).max() < 0.02  # from bank to bank
    assert np.diff(river, axis=0).min() >= 0  # rows go up the river
    assert np.abs(river[:, 12] - 28 - 0.02 * y[:, 0]).max() < 0.15


def test_edits_of_heights_at_a_shore_change_nothing_beside_them(
    folder: Path, tmp_path: Path
) -> None:
    void, flat = shapely.box(25, 15, 31, 25), shapely.box(48, 20, 55, 40)
    places = [(void, {"action": "void"}), (flat, {"action": "flat", "z": 40.0})]
    edits = draw(tmp_path / "edits.json", places)
    drawn = str(folder / "w.json")
    run = do(
        folder / "valley.laz", tmp_path / "out",
        method="keep", resolution="0.5", water=drawn, edits=edits,
    )  # fmt: skip
    before, after = pixels(folder / "wet"), pixels(tmp_path / "out")
    y, x = (np.mgrid[0:120, 0:120] + 0.5) / 2
    in_void, in_flat = (shapely.contains_xy(shape, x, y) for shape in (void, flat))
    assert (after[in_void] == NODATA).all()
    assert (after[in_flat] == 40.0).all()
    assert (before == after)[~(in_void | in_flat)].all()
    changed = [np.count_nonzero((before != after) & inside) for inside in (in_void, in_flat)]
    assert [edit["pixels"] for edit in run.summary["edits"]] == changed


def test_the_file_that_a_run_writes_gives_the_same_terrain(
    folder: Path, tmp_path: Path
) -> None:
    given = folder / "wet" / "water.gpkg"
    do(folder / "valley.laz", tmp_path, method="keep", resolution="0.5", water=str(given))
    assert (pixels(tmp_path) == pixels(folder / "wet")).all()
    kind = pyogrio.raw.read(given, layer="water")[3][1]
    assert kind.tolist() == ["lake", "river"]


def test_the_water_of_out_can_be_edited_and_given(folder: Path, tmp_path: Path) -> None:
    """The run neither writes nor moves the file, so that the same command resumes."""
    cloud, out = folder / "valley.laz", tmp_path / "out"
    shutil.copytree(folder / "wet", out, ignore=shutil.ignore_patterns("store.zarr"))
    given = out / "water.gpkg"
    with closing(connected(given)) as database:
        database.execute("UPDATE water SET level = 29.25 WHERE kind = 'lake'")
        database.commit()
    edited = given.read_bytes()
    for spelling in (given, out / ".." / "out" / "water.gpkg"):
        again = do(cloud, out, method="keep", resolution="0.5", water=str(spelling))
        assert given.read_bytes() == edited
        assert "water.gpkg" not in again.summary["outputs"]
        assert not (out / "outdated" / "water.gpkg").exists()
    y, x = (np.mgrid[0:120, 0:120] + 0.5) / 2
    wet = shapely.contains_xy(LAKE, x, y)
    assert (pixels(out)[wet] == 29.25).mean() > 0.99
    with pytest.raises(
        ConfigError, match=r"water\.gpkg: already exists and was not written by"
    ):
        do(cloud, out, method="keep", resolution="0.5", water="auto")
    assert given.read_bytes() == edited


def test_another_level_changes_the_water_alone_and_no_other_stage(
    folder: Path, tmp_path: Path
) -> None:
    cloud, out = folder / "valley.laz", tmp_path / "out"
    do(cloud, out, method="keep", resolution="0.5")
    to_degrees = Transformer.from_crs(32632, 4326, always_xy=True)
    moved = shapely.transform(
        LAKE, lambda xy: np.stack(to_degrees.transform(*(xy + [EAST, NORTH]).T), axis=1)
    )
    feature = {
        "type": "Feature",
        "properties": {"level": 29.25},
        "geometry": shapely.geometry.mapping(moved),
    }
    path = tmp_path / "l.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    again = do(cloud, out, method="keep", resolution="0.5", water=str(path))
    done = computed(again)
    assert (done["spool"], done["assemble"], done["grid-dtm"], done["grid-dtm-outlined"]) == (
        0,
        0,
        0,
        1,
    )
    y, x = (np.mgrid[0:120, 0:120] + 0.5) / 2
    wet = shapely.contains_xy(LAKE, x, y)
    assert (pixels(out)[wet] == 29.25).mean() > 0.99
    before = digests(folder / "plain")
    do(cloud, out, method="keep", resolution="0.5")
    assert digests(out)["dtm.tif"] == before["dtm.tif"]


def basin(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Uneven land that rises from the shore of `LAKE`."""
    return 30 + 0.2 * np.clip(np.hypot(x - 18, y - 20) - 9, 0, 12) + 0.1 * np.sin(x / 3)


def test_a_lake_without_returns_is_found_and_contours_go_around_it(tmp_path: Path) -> None:
    cloud = ground(basin)
    dry = ~shapely.contains_xy(LAKE, *cloud.xyz[:, :2].T)
    dry |= np.random.default_rng(4).random(len(dry)) < 0.02
    path = written(tmp_path / "basin.laz", clouds.Cloud(cloud.xyz[dry], cloud.truth[dry]))
    products = {"products": "dtm,contours", "contour_interval": "0.25"}
    do(path, tmp_path / "out", method="keep", water="auto", water_min_lake="150", **products)
    heights = pixels(tmp_path / "out")
    y, x = np.mgrid[0:60, 0:60] + 0.5
    inner = shapely.contains_xy(LAKE.buffer(-2.5), x, y)
    assert len(set(heights[inner].tolist())) == 1
    assert abs(heights[inner][0] - 30) < 0.3
    lines = pyogrio.raw.read(tmp_path / "out" / "contours.gpkg")[2]
    pond = shapely.from_wkb(pyogrio.raw.read(tmp_path / "out" / "water.gpkg", layer="water")[2])
    assert len(lines) > 5
    assert not shapely.intersects(shapely.from_wkb(lines), shapely.buffer(pond[0], -2)).any()


@pytest.mark.parametrize(
    ("features", "message"),
    [
        ([(LAKE, {"kind": "swamp"})], "feature 1: its kind is 'swamp'; give lake or river"),
        (
            [(LAKE, {"level": "high"})],
            "feature 1: its level 'high' is not a height; give a number",
        ),
        (
            [(shapely.LineString([(0, 0), (9, 9)]), {})],
            "has lines but no polygons; add polygons of the water",
        ),
        (
            [(RIVER, {}), (shapely.LineString([(40, 0, 3), (40, 9, 5), (40, 30, 4)]), {})],
            "feature 2: its heights rise and fall; give heights that fall along the line",
        ),
    ],
)
def test_what_is_no_water_is_refused(
    folder: Path, tmp_path: Path, features: list, message: str
) -> None:
    with pytest.raises(InputError) as error:
        make_plan(
            [str(folder / "valley.laz")], settings(water=draw(tmp_path / "w.json", features))
        )
    assert message in str(error.value)
    assert str(error.value).startswith(str(tmp_path / "w.json"))
