"""Sheets that a file of polygons gives: pixels, names, refusals, and what a second run makes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from shapely import affinity

from tests.integration.test_sheets import plane
from tests.invariants import clouds
from tests.invariants.runs import do, settings
from tests.tiler.io.vector.files import write
from tiler.errors import ConfigError, InputError
from tiler.plan import make_plan

HOW = {"method": "keep", "ground_classes": "1", "water": "none", "products": "dtm,density"}
EAST, NORTH, SIDE = 500_000.0, 5_400_000.0, 100.0
MIDDLE = (48.3, 53.7)


def polygons(*corners: list[tuple[float, float]]) -> list[Any]:
    return [affinity.translate(shapely.Polygon(ring), EAST, NORTH) for ring in corners]


SHEETS = {
    "A 1": [(0, 0), (61.2, 0), MIDDLE, (0, 40.5)],
    "Köln": [(61.2, 0), (100, 0), (100, 70.1), MIDDLE],
    "3": [(0, 40.5), MIDDLE, (100, 70.1), (100, 100), (0, 100)],
}
"""Three polygons that fill the square and share edges in all directions."""


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clouds.write(tmp_path_factory.mktemp("in") / "in.laz", plane(0.0, 0.0, SIDE))


def drawn(path: Path, sheets: dict[str, Any] = SHEETS, field: str = "Blatt") -> str:
    columns = {field: np.array(list(sheets), object), "year": np.arange(len(sheets))}
    shapes = polygons(*sheets.values())
    return str(write(path, shapes, "Polygon", "EPSG:25832", columns))


@pytest.fixture(scope="module")
def whole(cloud: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole")
    do(cloud, out, **HOW)
    return out


def centres(raster: Any) -> tuple[np.ndarray, np.ndarray]:
    rows, cols = np.indices(raster.shape)
    box = raster.bounds
    return box.left + cols + 0.5, box.top - rows - 0.5


def assert_cut(whole: Path, out: Path, product: str, sheets: dict[str, Any]) -> None:
    """Each file has the heights of its polygon and nothing else, and each pixel is in one file."""
    with rasterio.open(whole / f"{product}.tif") as raster:
        heights, box = raster.read(1), raster.bounds
        nothing = 0 if raster.nodata is None else raster.nodata
    times = np.zeros(heights.shape, int)
    for name, shape in zip(sheets, polygons(*sheets.values()), strict=True):
        with rasterio.open(out / product / f"{product}_{name}.tif") as sheet:
            values, (x, y) = sheet.read(1), centres(sheet)
            west, south, east, north = shape.bounds
            assert tuple(sheet.bounds) == (
                np.floor(west), np.floor(south), np.ceil(east), np.ceil(north),
            )  # fmt: skip
            row, col = round(box.top - sheet.bounds.top), round(sheet.bounds.left - box.left)
        part = np.s_[row : row + values.shape[0], col : col + values.shape[1]]
        inside = shapely.contains_xy(shape, x, y)
        assert np.array_equal(values[inside], heights[part][inside])
        beyond = ~shapely.intersects_xy(shape, x, y)
        assert (values[beyond] == nothing).all()
        times[part] += values != nothing
    assert (times[heights != nothing] == 1).all()
    with rasterio.open(out / f"{product}.vrt") as mosaic:
        assert mosaic.bounds == box
        assert np.array_equal(mosaic.read(1), heights)


@pytest.mark.parametrize("suffix", [".gpkg", ".shp"])
def test_rasters_are_cut_to_polygons(
    cloud: Path, whole: Path, tmp_path: Path, suffix: str
) -> None:
    file = drawn(tmp_path / f"sheets{suffix}")
    result = do(cloud, tmp_path / "out", sheets=file, sheet_field="BLATT", **HOW)
    assert result.exit_code == 0
    assert not result.warnings
    for product in ("dtm", "density"):
        assert_cut(whole, tmp_path / "out", product, SHEETS)
        assert_voids_of_polygons(tmp_path / "out", product, SHEETS)
    assert {p.stem for p in (tmp_path / "out/stac").iterdir()} == {f"stac_{n}" for n in SHEETS}
    _, _, shapes, columns = pyogrio.raw.read(
        tmp_path / "out/sheets.gpkg", layer="dtm", columns=["location"]
    )
    found = dict(zip(columns[0], shapely.from_wkb(shapes), strict=True))
    assert found.keys() == {f"dtm/dtm_{name}.tif" for name in SHEETS}
    for name, shape in zip(SHEETS, polygons(*SHEETS.values()), strict=True):
        assert found[f"dtm/dtm_{name}.tif"].symmetric_difference(shape).area < 0.1
    assert file in (tmp_path / "out/report.html").read_text()
    assert do(cloud, tmp_path / "out", sheets=file, sheet_field="Blatt", **HOW).did_nothing


def assert_voids_of_polygons(out: Path, product: str, sheets: dict[str, Any]) -> None:
    """The index tells of the pixels in the polygon, not of all pixels of the file."""
    fields = ["location", "void_percent", "min", "max"]
    _, _, _, columns = pyogrio.raw.read(out / "sheets.gpkg", layer=product, columns=fields)
    found = {row[0]: row[1:] for row in zip(*columns, strict=True)}
    for name, shape in zip(sheets, polygons(*sheets.values()), strict=True):
        path = f"{product}/{product}_{name}.tif"
        with rasterio.open(out / path) as sheet:
            inside = shapely.contains_xy(shape, *centres(sheet))
            values = sheet.read(1, masked=True)[inside]
        void, low, high = found[path]
        # Pixels whose centres lie on the edge of two polygons belong to one of them.
        assert void == pytest.approx(100 * np.ma.getmaskarray(values).mean(), abs=0.1)
        assert low <= values.min()
        assert high >= values.max()
        if product == "density":
            assert low > 0


def test_another_polygon_makes_only_its_file_again(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    how = {**HOW, "sheet_field": "Blatt", "sheet_name": "{sheet}"}
    do(cloud, out, sheets=drawn(tmp_path / "a.gpkg"), **how)
    times = {path: path.stat().st_mtime_ns for path in out.glob("*/*.tif")}
    assert len(times) == 6
    other = {**SHEETS, "A 1": [(0, 0), (30, 0), MIDDLE, (0, 40.5)]}
    result = do(cloud, out, sheets=drawn(tmp_path / "b.gpkg", other), **how)
    changed = {p for p in times if p.stat().st_mtime_ns != times[p]}
    assert changed == {out / "dtm/A 1.tif", out / "density/A 1.tif"}
    assert json.loads((out / "changed.json").read_text())["sheets"] == ["A 1"]
    (line,) = result.warnings
    assert "pixels with heights" in line
    assert "lie in no sheet" in line
    fewer = {name: other[name] for name in ("A 1", "3")}
    do(cloud, out, sheets=drawn(tmp_path / "c.gpkg", fewer), **how)
    assert {path.stem for path in out.glob("dtm/*.tif")} == set(fewer)
    assert (out / "outdated/dtm/Köln.tif").exists()


def test_vector_products_are_cut_as_well(cloud: Path, tmp_path: Path) -> None:
    out, edits = tmp_path / "out", tmp_path / "edits.gpkg"
    how = {**HOW, "products": "dtm,contours,spots", "sheet_field": "Blatt", "edits": str(edits)}
    how["contour_smooth"] = "0"
    mound = affinity.translate(shapely.box(10, 10, 20, 20), EAST, NORTH)
    columns = {"action": np.array(["flat"], object), "z": np.array([130.0])}
    write(edits, [mound], "Polygon", "EPSG:25832", columns)
    file = drawn(tmp_path / "sheets.gpkg")
    assert do(cloud, out, sheets=file, **how).exit_code == 0
    whole = shapely.from_wkb(pyogrio.raw.read(out / "contours.gpkg")[2])
    files = [out / f"contours/contours_{name}.gpkg" for name in SHEETS]
    parts = [shapely.from_wkb(pyogrio.raw.read(path)[2]) for path in files]
    for part, shape in zip(parts, polygons(*SHEETS.values()), strict=True):
        assert shapely.covers(shapely.buffer(shape, 1e-6), part).all()
    assert sum(shapely.length(part).sum() for part in parts) == pytest.approx(
        shapely.length(whole).sum()
    )
    assert {path.stem for path in (out / "spots").iterdir()} == {f"spots_{n}" for n in SHEETS}
    item = json.loads((out / "stac/stac_3.json").read_text())
    assert item["assets"]["contours"]["href"] == "../contours/contours_3.gpkg"
    columns = {"action": np.array(["flat"], object), "z": np.array([125.0])}
    write(edits, [mound], "Polygon", "EPSG:25832", columns)
    do(cloud, out, sheets=file, **how)
    changes = json.loads((out / "changed.json").read_text())
    cut = [path for path in changes["changed"] if "/" in path and path.endswith(".gpkg")]
    assert cut == ["contours/contours_A 1.gpkg", "spots/spots_A 1.gpkg"]
    assert changes["sheets"] == ["dtm_A 1"]
    assert do(cloud, out, sheets=file, **how).did_nothing
    do(cloud, out, **{**how, "sheet_field": None})
    assert not (out / "contours").exists()
    assert (out / "outdated/contours/contours_3.gpkg").exists()


def test_pixels_of_two_sheets_are_in_the_first(
    cloud: Path, whole: Path, tmp_path: Path
) -> None:
    sheets = {
        "b": [(0, 0), (60, 0), (60, 100), (0, 100)],
        "a": [(40, 0), (100, 0), (100, 100), (40, 100)],
    }
    file, out = drawn(tmp_path / "sheets.gpkg", sheets), tmp_path / "out"
    result = do(cloud, out, sheets=file, sheet_field="Blatt", **HOW)
    (line,) = result.warnings
    assert "overlap by more than a pixel (b and a)" in line
    with rasterio.open(out / "dtm/dtm_a.tif") as sheet:
        values = sheet.read(1)
        assert (values[:, :20] == sheet.nodata).all()
        assert (values[:, 20:] != sheet.nodata).all()
    with rasterio.open(out / "dtm.vrt") as mosaic, rasterio.open(whole / "dtm.tif") as raster:
        assert np.array_equal(mosaic.read(1), raster.read(1))


def test_sheets_without_heights_are_not_written(cloud: Path, tmp_path: Path) -> None:
    """One polygon lies beside the points, one far away."""
    sheets = {
        **SHEETS,
        "beside": [(100.0, 0), (150, 0), (150, 100), (100, 100)],
        "far": [(9000, 0), (9100, 0), (9100, 9)],
    }
    file = drawn(tmp_path / "sheets.gpkg", sheets)
    result = do(cloud, tmp_path / "out", sheets=file, sheet_field="Blatt", **HOW)
    assert {p.stem for p in (tmp_path / "out/dtm").iterdir()} == {f"dtm_{n}" for n in SHEETS}
    assert not result.warnings


def test_names_far_from_the_survey_do_not_matter(cloud: Path, tmp_path: Path) -> None:
    """National grids have thousands of sheets elsewhere: some without a name, some of a name that is also here."""
    far = [(9000, 0), (9100, 0), (9100, 9)]
    shapes = polygons(*SHEETS.values(), far, far)
    columns = {"Blatt": np.array([*SHEETS, "A 1", ""], object)}
    file = str(write(tmp_path / "s.gpkg", shapes, "Polygon", "EPSG:25832", columns))
    result = do(cloud, tmp_path / "out", sheets=file, sheet_field="Blatt", **HOW)
    assert {p.stem for p in (tmp_path / "out/dtm").iterdir()} == {f"dtm_{n}" for n in SHEETS}
    assert not result.warnings


def test_a_polygon_that_comes_twice_is_warned_of(cloud: Path, tmp_path: Path) -> None:
    sheets = {**SHEETS, "again": SHEETS["3"]}
    file = drawn(tmp_path / "sheets.gpkg", sheets)
    result = do(cloud, tmp_path / "out", sheets=file, sheet_field="Blatt", **HOW)
    assert {p.stem for p in (tmp_path / "out/dtm").iterdir()} == {f"dtm_{n}" for n in SHEETS}
    assert "no file is written for again, which have the polygon" in result.warnings[-1]


def test_a_grid_replaces_the_file_of_a_configuration(cloud: Path) -> None:
    plan = make_plan([str(cloud)], settings(sheets="100", sheet_field="Blatt", **HOW))
    assert "the sheets are a grid, so --sheet-field Blatt is not used" in plan.notes


def test_sheets_in_another_crs_and_inside_an_area(
    cloud: Path, whole: Path, tmp_path: Path
) -> None:
    from pyproj import Transformer

    to_degrees = Transformer.from_crs(25832, 4326, always_xy=True).transform
    shapes = [
        shapely.transform(s, to_degrees, interleaved=False) for s in polygons(*SHEETS.values())
    ]
    columns = {"n": np.array([1, 2, 3])}
    file = str(write(tmp_path / "s.gpkg", shapes, "Polygon", "EPSG:4326", columns))
    bounds = ["500010", "5400010", "500090", "5400090"]
    do(cloud, tmp_path / "out", sheets=file, sheet_field="n", bounds=bounds, **HOW)
    with rasterio.open(tmp_path / "out/dtm.vrt") as mosaic:
        values, (x, y) = mosaic.read(1), centres(mosaic)
    within = shapely.contains_xy(shapely.box(*map(float, bounds)), x, y)
    assert np.array_equal(values != -9999, within)


def with_names(*names: str) -> Callable[[Path], str]:
    def make(folder: Path) -> str:
        file = folder / "sheets.gpkg"
        shapes, columns = polygons(*SHEETS.values()), {"Blatt": np.array(names, object)}
        return str(write(file, shapes, "Polygon", "EPSG:25832", columns))

    return make


def given(folder: Path) -> str:
    return drawn(folder / "sheets.gpkg")


def far_away(folder: Path) -> str:
    return drawn(folder / "sheets.gpkg", {"a": [(5000, 0), (6000, 0), (6000, 900)]})


def on_the_edge(folder: Path) -> str:
    return drawn(folder / "sheets.gpkg", {"a": [(100, 0), (150, 0), (150, 100), (100, 100)]})


def test_sheets_without_a_part_of_the_terrain_are_refused(tmp_path: Path) -> None:
    """The points lie in two corners of their extent, and the only sheet in a third one."""
    parts = [plane(0.0, 0.0, 20.0), plane(80.0, 80.0, 20.0)]
    points = clouds.Cloud(
        *(np.concatenate([getattr(p, n) for p in parts]) for n in ("xyz", "truth"))
    )
    cloud = clouds.write(tmp_path / "in.laz", points)
    sheets = {"a": [(70, 0), (100, 0), (100, 30), (70, 30)]}
    how = {**HOW, "max_edge": "10", "sheet_field": "Blatt"}
    with pytest.raises(InputError, match=r"s.gpkg: no polygon contains a part of the clouds"):
        do(cloud, tmp_path / "out", sheets=drawn(tmp_path / "s.gpkg", sheets), **how)
    assert not (tmp_path / "out/stac.json").exists()
    both = drawn(tmp_path / "s.gpkg", {**sheets, "b": [(0, 0), (20, 0), (20, 20), (0, 20)]})
    assert do(cloud, tmp_path / "out", sheets=both, **how).exit_code == 0
    assert [p.name for p in (tmp_path / "out/dtm").iterdir()] == ["dtm_b.tif"]


def test_files_in_the_folder_of_contours_are_refused_before_a_point_is_read(
    cloud: Path, tmp_path: Path
) -> None:
    how = {**HOW, "products": "contours", "sheet_field": "Blatt", "sheets": given(tmp_path)}
    lines = tmp_path / "out/contours/contours_A 1.gpkg"
    lines.parent.mkdir(parents=True)
    wall = shapely.LineString([(EAST + 5, NORTH + 5), (EAST + 9, NORTH + 9)])
    write(lines, [wall], "LineString", "EPSG:25832", {})
    with pytest.raises(ConfigError, match="contours_A 1.gpkg: already exists"):
        do(cloud, tmp_path / "out", **how)
    with pytest.raises(ConfigError, match="contours"):
        do(cloud, tmp_path / "out", force=True, breaklines=[str(lines)], **how)
    with pytest.raises(ConfigError, match="contours"):
        do(cloud, tmp_path / "o", store=str(tmp_path / "o/contours"), **how)
    long = with_names("a", "b", 196 * "c")(tmp_path)
    with pytest.raises(ConfigError, match="has more than 200 bytes"):
        do(cloud, tmp_path / "o", **{**how, "sheets": long, "sheet_name": "{name}{sheet}"})


@pytest.mark.parametrize(
    ("make", "settings", "line"),
    [
        (given, {"sheet_field": "name"}, r"has no field 'name', its fields are blatt, year; give"),
        (given, {}, r"needs the field .* its fields are blatt, year; give --sheet-field"),
        (with_names("a", "b", "A"), {}, r"l0, feature 3: its Blatt 'A' is on some disks also that of feature 1"),
        (with_names("\u00e9", "b", "E\u0301"), {}, "feature 3: its Blatt 'É' is on some disks also that of feature 1"),
        (with_names("a", "", "b"), {}, r"feature 2: its Blatt '' is empty"),
        (with_names("a", "b", "c/d"), {}, r"feature 3: its Blatt 'c/d' contains '/'"),
        (with_names("a", "b", "nul"), {}, r"feature 3: its Blatt 'nul' is the name of a device"),
        (with_names("a", "b", 201 * "c"), {}, r"feature 3: .* has more than 200 bytes"),
        (far_away, {}, r"no polygon contains a part of the clouds"),
        (on_the_edge, {}, r"no polygon contains a part of the clouds"),
        (lambda folder: None, {}, r"--sheet-field Blatt: names the sheets of a file; give"),
        (lambda folder: str(folder / "no.gpkg"), {}, r"no.gpkg: no such file"),
        (given, {"sheet_name": "{name}_{x_km:.1f}_{y_km:.1f}"}, "two sheets would have the name"),
    ],
)  # fmt: skip
def test_what_cannot_be_sheets_is_refused_before_a_point_is_read(
    cloud: Path,
    tmp_path: Path,
    make: Callable[[Path], str | None],
    settings: dict[str, str],
    line: str,
) -> None:
    usual = {} if line.startswith("needs") else {"sheet_field": "Blatt"}
    with pytest.raises((ConfigError, InputError), match=line):
        do(cloud, tmp_path / "out", sheets=make(tmp_path), **{**HOW, **usual, **settings})
    assert not (tmp_path / "out/store.zarr").exists()
