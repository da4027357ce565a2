"""A part of a survey is that part of the whole, and a part that changes costs its change."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
import scipy

from tests.invariants.clouds import CORNER
from tests.invariants.runs import computed, do, dtm, output_digests
from tests.scenes.small_stores import small_stores
from tests.tiler.io.vector.files import collection
from tiler.core.area import Area
from tiler.core.products import PRODUCTS

NARROW = {
    "halo": "15",
    "max_edge": "15",
    "tile_size": "32",
    "parameters": {"max_building_size": "20"},
}
SETTINGS = {**NARROW, "products": list(PRODUCTS)}
"""A margin that is narrow against the 192 m of the scene: the outermost buckets are left
out."""

SIGMA_SEES = 12
"""Pixels within which the terrain has a part in a standard error; points around the part are
read, its terrain ends."""

WEST, SOUTH = CORNER
OUTER = [(52.25, 50.0), (140.5, 65.0), (130.0, 140.0), (90.0, 115.5), (55.0, 138.0)]
HOLE = [(80.0, 70.0), (105.0, 72.0), (95.0, 95.0)]


def ring(places: list[tuple[float, float]]) -> list[list[float]]:
    return [[WEST + x, SOUTH + y] for x, y in places]


def written(path: Path, *polygons: list[list[list[float]]]) -> Path:
    """Polygons in the CRS of the clouds as a file."""
    content = collection(*({"type": "Polygon", "coordinates": rings} for rings in polygons))
    content["crs"] = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32632"}}
    path.write_text(json.dumps(content))
    return path


AREA = Area((tuple(np.rint(np.array(ring(r)) * 1000).astype(np.int64) for r in (OUTER, HOLE)),))


@pytest.fixture(scope="module")
def whole(quarter_files: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """OUT of all of the survey."""
    out = tmp_path_factory.mktemp("whole") / "out"
    with pytest.MonkeyPatch.context() as patch:
        small_stores(patch)
        assert do(quarter_files, out, **SETTINGS).exit_code == 0
    return out


def in_area(raster: rasterio.DatasetReader) -> np.ndarray:
    rows, cols = np.mgrid[: raster.height, : raster.width]
    x, y = rasterio.transform.xy(raster.transform, rows.ravel(), cols.ravel())
    places = (np.rint(np.asarray(v) * 1000).astype(np.int64) for v in (x, y))
    return AREA.inside(*places).reshape(raster.shape)


def test_a_part_is_that_part_of_the_whole(
    quarter_files: list[Path], whole: Path, tmp_path: Path
) -> None:
    polygon = written(tmp_path / "area.geojson", [ring(OUTER), ring(HOLE)])
    result = do(quarter_files, tmp_path / "out", **SETTINGS, aoi=str(polygon))
    assert result.exit_code == 0
    counts = result.summary["counts"]
    assert counts["read"] == counts["stored"] + counts["dropped"]["outside the area"]
    assert counts["dropped"]["outside the area"] > 0
    for name, product in PRODUCTS.items():
        with (
            rasterio.open(tmp_path / "out" / f"{name}.tif") as part,
            rasterio.open(whole / f"{name}.tif") as all_of,
        ):
            inside = in_area(part)
            window = (
                rasterio.windows.from_bounds(*part.bounds, all_of.transform)
                .round_offsets()
                .round_lengths()
            )
            expected, found = all_of.read(1, window=window), part.read(1)
            fill = {"density": 0.0, "distance": 15.0}.get(name, product.nodata)
            assert (found[~inside] == fill).all(), name
            if name in (
                "hillshade",
                "slope",
            ):  # of the outermost pixels of the raster no neighbours are known
                inside[[0, -1]] = inside[:, [0, -1]] = False
            # it sees the terrain around, which ends at the border of the part
            if name == "sigma":
                inside = scipy.ndimage.binary_erosion(
                    inside, np.ones((3, 3), np.bool_), SIGMA_SEES
                )
            np.testing.assert_array_equal(found[inside], expected[inside], name)
            assert inside.sum() > (100 if name == "sigma" else 4000)
    assert result.summary["dtm"]["filled"] == int(
        np.count_nonzero(dtm(tmp_path / "out")[0] != -9999)
    )
    assert sum(result.summary["mask"].values()) == inside.size
    changed = 0
    for path in quarter_files:
        files = path, *(out / "classified" / path.name for out in (tmp_path / "out", whole))
        before, after, all_of = (laspy.read(file) for file in files)
        x, y = (np.rint(np.asarray(v) * 1000).astype(np.int64) for v in (before.x, before.y))
        inside = AREA.inside(x, y)
        classes = [np.asarray(c.classification) for c in (before, after, all_of)]
        np.testing.assert_array_equal(classes[1], np.where(inside, classes[2], classes[0]))
        changed += int((classes[1] != classes[0]).sum())
    assert changed > 1000


def test_bounds_are_the_rectangle_of_a_file_and_another_area_redoes_what_it_must(
    quarter_files: list[Path], tmp_path: Path
) -> None:
    settings = {
        "halo": "8",
        "max_edge": "8",
        "tile_size": "32",
        "parameters": {"max_building_size": "10"},
    }
    out = tmp_path / "out"
    corner = ring([(0.0, 0.0), (40.5, 0.0), (40.5, 40.25), (0.0, 40.25)])
    first = do(quarter_files, out, **settings, bounds=[*corner[0], *corner[2]])
    assert [Path(i["path"]).name for i in first.summary["inputs"]] == ["sw.laz"], (
        "others are not read"
    )
    alone = written(tmp_path / "corner.json", [corner])
    same = do(quarter_files, out, **settings, aoi=str(alone))
    assert same.did_nothing
    north = ring([(0.0, 170.0), (60.0, 170.0), (60.0, 300.0), (0.0, 300.0)])
    wider = written(tmp_path / "wider.json", [corner], [north])
    more = do(quarter_files, out, **settings, aoi=str(wider))
    assert {Path(i["path"]).name for i in more.summary["inputs"]} == {"sw.laz", "nw.laz"}
    tiles = more.summary["stages"]["filter0"]
    assert tiles["done"] == first.summary["stages"]["filter0"]["tasks"], "the corner's"
    assert computed(more)["filter0"] == tiles["tasks"] - tiles["done"] > 0
    do(quarter_files, tmp_path / "fresh", **settings, aoi=str(wider))
    assert output_digests(out) == output_digests(tmp_path / "fresh")
