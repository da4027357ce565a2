"""Heights end where the survey does, and a polygon says where that is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
import shapely
from pyogrio import raw

from tests.invariants import clouds
from tests.invariants.runs import do
from tests.scenes.drawings import draw

SIDE = 300.0


def land(shape: str) -> shapely.Geometry:
    """Where points are, in metres from the corner of the scene."""
    box, centre = shapely.box(0, 0, SIDE, SIDE), shapely.Point(150, 150)
    bites = shapely.MultiPoint([(0, 60), (0, 200), (120, 0), (300, 250)]).buffer(24)
    return {
        "ragged": box
        - bites
        - shapely.box(200, 0, 240, 120)
        - shapely.Point(100, 200).buffer(30),
        "strip": shapely.LineString([(0, 0), (300, 300)]).buffer(30) & box,
        "ring": centre.buffer(140) - centre.buffer(80),
        "islands": shapely.Point(80, 80).buffer(60) | shapely.Point(230, 230).buffer(50),
    }[shape]


def make(
    tmp_path: Path, shape: str, **settings: object
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Path]:
    """The DTM's mask of heights, and x and y of its pixels; OUT."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0, SIDE, (2, 90_000))
    inside = shapely.contains_xy(land(shape), x, y)
    xyz = np.round(np.stack([x, y, 20 + 0.05 * x], axis=1)[inside], 3)
    points = clouds.Cloud(xyz, np.ones(len(xyz), bool))
    cloud = clouds.write(tmp_path / "cloud.laz", points, classes=np.full(len(xyz), 2, np.uint8))
    out = tmp_path / "out"
    do(cloud, out, method="keep", tile_size=None, halo=None, memory=None, **settings)
    with rasterio.open(out / "dtm.tif") as raster:
        heights = raster.read(1) != raster.nodata
        rows, cols = np.mgrid[: raster.height, : raster.width]
        west, north = (
            raster.bounds.left - clouds.CORNER[0],
            raster.bounds.top - clouds.CORNER[1],
        )
    return heights, west + cols + 0.5, north - rows - 0.5, out


@pytest.mark.parametrize("shape", ["ragged", "strip", "ring", "islands"])
def test_no_height_beyond_the_survey(shape: str, tmp_path: Path) -> None:
    heights, x, y, out = make(tmp_path, shape)
    assert json.loads((out / "run.json").read_text())["outline"]["gap_m"] == 20
    true = land(shape)
    closed = true.buffer(10).buffer(-10)
    enclosed = shapely.union_all(
        [shapely.Polygon(part.exterior) for part in shapely.get_parts(closed)]
    )
    beyond = ~shapely.contains_xy(enclosed.buffer(3), x, y)  # a coarse cell is 2 m wide
    assert not heights[beyond].any()
    assert heights[shapely.contains_xy(true.buffer(-3), x, y)].all()
    meta, _, shapes, _ = raw.read(out / "outline.gpkg")
    polygons = shapely.transform(shapely.from_wkb(shapes), lambda xy: xy - clouds.CORNER[:2])
    assert list(meta["fields"]) == ["area_m2", "void_m2", "void_percent"]
    assert shapely.is_valid(polygons).all()
    outline = shapely.union_all(polygons)
    assert outline.symmetric_difference(closed).area < 0.03 * closed.area
    assert sum(len(p.interiors) for p in polygons) == {"ragged": 1, "ring": 1}.get(shape, 0)
    whole = shapely.union_all([shapely.Polygon(part.exterior) for part in polygons])
    within = shapely.contains_xy(whole, x, y)
    assert within[heights].all(), "the outline is the edge of the terrain"
    assert (within & ~heights).sum() == json.loads((out / "run.json").read_text())["voids"][
        "pixels"
    ]


def test_the_hull_can_be_asked_for(tmp_path: Path) -> None:
    heights, x, y, out = make(tmp_path, "ragged", outline="hull")
    assert heights[shapely.contains_xy(shapely.box(205, 10, 235, 100), x, y)].mean() > 0.9
    assert not (out / "outline.gpkg").exists()


@pytest.mark.parametrize("outline", ["survey", "hull"])
@pytest.mark.parametrize("voids", ["leave", "mark", "fill"])
def test_the_heights_in_run_json_are_counted_in_the_delivered_models(
    voids: str, outline: str, tmp_path: Path
) -> None:
    settings = {"voids": voids, "outline": outline, "max_edge": "20", "products": "dtm,dsm"}
    heights, _, _, out = make(tmp_path, "ring", **settings)

    def assert_counted() -> int:
        run = json.loads((out / "run.json").read_text())
        for model in ("dtm", "dsm"):
            with rasterio.open(out / f"{model}.tif") as raster:
                n_heights = np.count_nonzero(raster.read(1) != raster.nodata)
            assert run[model]["filled"] == n_heights, model
        return int(run["dtm"]["filled"])

    assert assert_counted() == np.count_nonzero(heights)
    if outline == "survey":
        hole = np.pi * 80**2  # the ring's, in pixels of 1 m
        ring = np.pi * 140**2 - hole
        expected = ring if voids == "leave" else ring + hole
        assert np.count_nonzero(heights) == pytest.approx(expected, rel=0.02)
    given = {"method": "keep", "tile_size": None, "halo": None, "memory": None, **settings}
    cloud = tmp_path / "cloud.laz"
    do(cloud, out, **given)
    assert assert_counted() == np.count_nonzero(heights)
    pond, cleared = shapely.box(140, 140, 160, 160), shapely.box(20, 140, 40, 160)
    edits = draw(tmp_path / "edits.geojson", [(cleared, {"action": "void"})])
    water = draw(tmp_path / "water.geojson", [(pond, {"level": 22.0})])
    for corrected in ({"edits": edits}, {"edits": edits, "water": water}):
        do(cloud, out, **given, **corrected)
        # The void loses its 400 pixels; the pond gets up to 400, if it had none before.
        n_less = 400 if voids != "leave" or "water" not in corrected else 0
        assert assert_counted() == np.count_nonzero(heights) - n_less
