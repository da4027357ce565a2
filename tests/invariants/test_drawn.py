"""What people draw: breaklines and corrections that a run takes up, and contours and spots that it draws itself."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pyogrio
import pytest
import shapely

from tests.invariants.clouds import CORNER
from tests.invariants.runs import computed, do, settings
from tests.scenes.drawings import EAST, NORTH, Features, digests, draw, ground, pixels, written
from tests.scenes.small_stores import small_stores
from tiler.core.products import NODATA
from tiler.errors import ConfigError, InputError
from tiler.plan import make_plan

PIXEL = 0.4  # of runs on the town


# --- breaklines


def wall(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A retaining wall of 3 m along x = 30.2 m."""
    return 100 + 0.05 * y + np.where(x > 30.2, 3.0, 0.0)


def lines_of_wall() -> Features:
    top = shapely.LineString([(30.22, 0, 103), (30.22, 60, 106)])
    foot = shapely.LineString([(30.18, 60, 103), (30.18, 0, 100)])
    return [(top, {}), (foot, {})]


def test_a_wall_is_sharp_within_a_pixel(tmp_path: Path) -> None:
    cloud = written(tmp_path / "wall.laz", ground(wall, number=8_000))
    do(cloud, tmp_path / "plain", method="keep", resolution="0.5")
    lines = draw(tmp_path / "l.json", lines_of_wall())
    do(cloud, tmp_path / "drawn", method="keep", resolution="0.5", breaklines=lines)
    y, x = (np.mgrid[4:116, 56:65] + 0.5) / 2
    plain, drawn = (
        pixels(tmp_path / out)[4:116, 56:65] - wall(x, y) for out in ("plain", "drawn")
    )
    assert np.sqrt((plain**2).mean()) > 0.25
    assert np.sqrt((drawn**2).mean()) < 0.002


def test_a_plane_stays_one(tmp_path: Path) -> None:
    def plane(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 50 + x / 4 - y / 8

    def line(*places: tuple[float, float]) -> shapely.LineString:
        return shapely.LineString(
            [(x, y, plane(np.float64(x), np.float64(y))) for x, y in places]
        )

    cloud = ground(plane)
    cloud.xyz[:] = np.round(cloud.xyz / 0.008) * 0.008  # heights are whole millimetres
    cloud.xyz[:, 2] = plane(cloud.xyz[:, 0], cloud.xyz[:, 1])
    ring = shapely.Polygon(
        [(*p, plane(*np.array(p))) for p in ((8, 8), (24, 8), (24, 40), (8, 40))]
    )
    drawn = [
        (line((0, 4), (56, 4), (56, 52)), {}),
        (line((4, 56), (20, 40), (52, 8)), {}),
        (ring, {}),
    ]
    lines = draw(tmp_path / "l.json", drawn)
    do(
        written(tmp_path / "plane.laz", cloud),
        tmp_path / "out",
        method="keep",
        breaklines=lines,
    )
    y, x = np.mgrid[1:58, 1:58] + 0.5
    assert np.abs(pixels(tmp_path / "out")[1:58, 1:58] - plane(x, y)).max() < 1.1e-3


def test_a_2d_line_takes_the_height_of_its_column(tmp_path: Path) -> None:
    cloud = written(tmp_path / "flat.laz", ground(lambda x, y: 0 * x + 20))
    crest = draw(
        tmp_path / "l.json", [(shapely.LineString([(10.5, 20.5), (40.5, 20.5)]), {"z": 22.5})]
    )
    do(cloud, tmp_path / "out", method="keep", breaklines=crest)
    assert pixels(tmp_path / "out")[20, 11:40] == pytest.approx(22.5, abs=0.001)
    assert pixels(tmp_path / "out")[17, 11:40] == pytest.approx(20, abs=0.001)


# --- all of it, on a town


def drawings(folder: Path) -> dict[str, str]:
    """Settings of a run that takes up and draws everything."""
    folder.mkdir(exist_ok=True)
    lines = [(shapely.LineString([(20, 30, 108), (90, 120, 109), (150, 40, 110)]), {})]
    edits = [
        (shapely.box(60, 60, 100, 90), {"action": "not_ground", "z": None}),
        (shapely.box(70, 70, 80, 75), {"action": "ground", "z": None}),
        (shapely.box(120, 20, 140, 50), {"action": "void", "z": None}),
        (shapely.Polygon([(20, 150), (60, 150), (20, 180)]), {"action": "flat", "z": 104.25}),
    ]
    return {
        "breaklines": draw(folder / "lines.json", lines),
        "edits": draw(folder / "edits.json", edits),
        "products": "dtm,mask,contours,spots",
        "contour_interval": "0.5",
        "contour_smooth": "0",
        "resolution": str(PIXEL),
    }


@pytest.fixture(scope="module")
def made(quarter_files: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """OUT of a run with drawings. Not to be changed."""
    folder = tmp_path_factory.mktemp("drawn")
    with pytest.MonkeyPatch.context() as patch:
        small_stores(patch)
        do(quarter_files, folder / "out", **drawings(folder / "in"))
    return folder / "out"


@pytest.mark.parametrize("tile", ["96", pytest.param("32", marks=pytest.mark.slow)])
def test_neither_tiles_nor_buckets_nor_order_show(
    tile: str,
    made: Path,
    quarter_files: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    small_stores(monkeypatch, 4000)
    do(quarter_files[::-1], tmp_path / "out", tile_size=tile, **drawings(tmp_path / "in"))
    assert digests(tmp_path / "out") == digests(made)


def test_only_what_an_edit_reaches_is_done_again(
    quarter_files: list[Path], tmp_path: Path
) -> None:
    fine = {"resolution": "0.25", "max_edge": "2", "water": "auto"}
    plain = do(quarter_files, tmp_path / "out", **fine)
    before = digests(tmp_path / "out")
    edits = draw(
        tmp_path / "e.json", [(shapely.box(165, 150, 185, 170), {"action": "not_ground"})]
    )
    again = do(quarter_files, tmp_path / "out", **fine, edits=edits)
    assert plain.exit_code == again.exit_code == 0
    done = {stage: n for stage, n in computed(again).items() if n}
    # One of four blocks; cells of the two blocks that see its water.
    once = (
        "grid-dtm",
        "grid-dtm-outlined",
        "grid-occupancy",
        "grid-water-ground",
    )
    assert (
        done
        == {
            **dict.fromkeys(once, 1),
            "edits": 2,  # buckets
            "grid-dtm-above": 4,  # reads one pixel of the neighbours
            "grid-water-areas": 2,
            "grid-water-planes": 2,
            "export": 5,
            "catalogue": 2,
        }
    )  # files: the raster, the outline that follows its pixels, one of four clouds, and their overview
    changed = {
        name for name, digest in digests(tmp_path / "out").items() if digest != before[name]
    }
    assert changed == {"dtm.tif", "ne.laz", "review.gpkg"}
    (fact,) = again.summary["edits"]
    assert fact["ground_before"] > 0 == fact["ground_after"]
    assert do(quarter_files, tmp_path / "out", **fine, edits=edits).did_nothing


def test_classes_and_heights_follow_edits(made: Path) -> None:
    las = [laspy.read(path) for path in sorted(made.glob("classified/*.laz"))]
    x, y, c = (
        np.concatenate([np.asarray(getattr(f, n)) for f in las])
        for n in ("x", "y", "classification")
    )
    x, y = x - EAST, y - NORTH
    out = (x >= 60) & (x < 100) & (y >= 60) & (y < 90)
    back = (x >= 70) & (x < 80) & (y >= 70) & (y < 75)
    assert not (c[out & ~back] == 2).any()
    assert (c[out & back] == 2).any()
    summary = json.loads((made / "run.json").read_text())
    assert [e["action"] for e in summary["edits"]] == ["not_ground", "ground", "void", "flat"]
    assert summary["edits"][1]["by"] == "lowest points"
    heights = pixels(made)
    rows, cols = (np.arange(n) * PIXEL + PIXEL / 2 for n in heights.shape)
    void = np.ix_((rows > 20) & (rows < 50), (cols > 120) & (cols < 140))
    assert (heights[void] == NODATA).all()
    assert summary["edits"][2]["pixels"] == heights[void].size
    flat = (
        (rows[:, None] > 150)
        & (cols > 20)
        & (rows[:, None] - 150 < 30 * (1 - (cols - 20) / 40) - 0.01)
    )
    assert (heights[flat] == 104.25).all()
    page = (made / "report.html").read_text()
    assert "4 edits" in page
    assert "Breaklines" in page
    assert '"title":"edits"' in page.replace(" ", "")


def test_a_correction_that_leaves_a_hole_is_a_problem(tmp_path: Path) -> None:
    cloud = written(tmp_path / "plane.laz", ground(lambda x, y: 20 + x / 10))
    shapes = [(shapely.box(20, 20, 40, 45), "not_ground"), (shapely.box(5, 5, 9, 8), "void")]
    shapes.append((shapely.box(20, 50, 22, 52), "not_ground"))
    edits = draw(tmp_path / "e.json", [(shape, {"action": action}) for shape, action in shapes])
    options = {"method": "keep", "edits": edits, "max_edge": "8", "products": "dtm,mask"}
    summary = do(cloud, tmp_path / "out", **options).summary
    empty = pixels(tmp_path / "out")[1:59, 1:59] == NODATA
    assert summary["edits"][0]["holes"] == empty[19:44, 19:39].sum() > 400
    assert summary["edits"][1]["holes"] == summary["voids"]["asked_pixels"] == 12
    assert summary["edits"][2]["holes"] == 0
    assert summary["voids"]["pixels"] == empty.sum() - 12
    assert summary["voids"]["pixels"] + 12 == summary["mask"]["hole"]
    (void,) = summary["voids"]["largest"]
    west, south, east, north = void["bounds"] - np.tile(CORNER, 2)
    assert west >= 19
    assert south >= 19
    assert east <= 41
    assert north <= 46
    kinds = {problem["what"]: problem["where"] for problem in summary["problems"]}
    assert kinds.keys() == {"void inside the survey", "hole in an edit"}
    assert kinds["void inside the survey"] == tuple(void["bounds"])
    page = (tmp_path / "out" / "report.html").read_text()
    assert "100.0 %" not in page
    assert (
        f"edit 1 (not_ground) leaves {summary['edits'][0]['holes']:,} pixels without a height"
        in page
    )


def test_contours_agree_with_the_terrain_and_neither_cross_nor_break(made: Path) -> None:
    meta, _, shapes, (elevation, index, label) = pyogrio.raw.read(made / "contours.gpkg")
    lines = shapely.from_wkb(shapes)
    assert meta["crs"] == "EPSG:32632"
    assert meta["geometry_type"] == "LineString"
    assert list(meta["fields"]) == ["elevation", "index", "label"]
    assert list(label) == [f"{height:.1f}" for height in elevation]
    assert json.loads((made / "run.json").read_text())["contours"]["lines"] == len(lines) > 10
    assert (index == (np.round(elevation / 0.5) % 5 == 0)).all()
    assert all(shapely.is_simple(lines))
    one, other = shapely.STRtree(lines).query(lines, predicate="intersects")
    assert (one == other).all()
    heights = pixels(made).astype(np.float64)
    known = np.pad(heights != NODATA, 1)
    for line, height in zip(lines, elevation, strict=True):
        col, row = (shapely.get_coordinates(line) - CORNER).T / PIXEL - 0.5
        i, j = np.floor(row + 1e-9).astype(int), np.floor(col + 1e-9).astype(int)
        u, v = row - i, col - j
        i1 = np.minimum(i + (u > 1e-6), len(heights) - 1)
        j1 = np.minimum(j + (v > 1e-6), heights.shape[1] - 1)
        found = heights[i, j] * (1 - u) * (1 - v) + heights[i1, j] * u + heights[i, j1] * v
        found += heights[i, j] * u * v  # one of u and v is 0
        assert found == pytest.approx(height, abs=0.01)
        if not line.is_closed:  # ends lie at the border of the raster or of the void
            for r, c in ((row[0], col[0]), (row[-1], col[-1])):
                near = known[round(r) : round(r) + 3, round(c) : round(c) + 3]
                assert not near.all()


@pytest.mark.parametrize("classes", ["2", "8"])
def test_level_ground_and_none_at_all_have_no_contours(classes: str, tmp_path: Path) -> None:
    cloud = written(tmp_path / "level.laz", ground(lambda x, y: 0 * x + 20.3, number=500))
    do(
        cloud,
        tmp_path / "out",
        method="keep",
        ground_classes=classes,
        products="contours,spots",
    )
    for name in ("contours", "spots"):
        assert pyogrio.read_info(tmp_path / "out" / f"{name}.gpkg")["features"] == 0


def test_spots_are_tops_and_bottoms(made: Path) -> None:
    _, _, shapes, (elevation, kind, label) = pyogrio.raw.read(made / "spots.gpkg")
    assert {"high", "low"} >= set(kind) != set()
    heights = pixels(made)
    for shape, height, sort in zip(shapely.from_wkb(shapes), elevation, kind, strict=True):
        col, row = ((shapely.get_coordinates(shape)[0] - CORNER) / PIXEL).astype(int)
        near = heights[max(row - 125, 0) : row + 126, max(col - 125, 0) : col + 126]
        near = near[near != NODATA]
        assert height == pytest.approx(heights[row, col], abs=0.00501)
        assert heights[row, col] == (near.max if sort == "high" else near.min)()
    assert list(label) == [f"{height:.2f}" for height in elevation]


# --- what is refused

LINE, FAR = shapely.LineString([(0, 0), (5, 5)]), shapely.LineString([(0, 0, 1), (1e10, 0, 1)])
BOX = shapely.box(0, 0, 5, 5)
ROOF = "its action is 'roof'; give one of not_ground, ground, void, flat in"
FLAT = "is flat without a height; give one in the column `z`, in the unit of the heights"
TOO_HIGH = "is flat at 1e+09, which is no height; give one in the column `z`"


@pytest.mark.parametrize(
    ("option", "features", "told"),
    [
        ("breaklines", [(FAR, {})], "two of its vertices are 1e+10 apart; give"),
        ("breaklines", [(LINE, {})], "has no heights; draw it in 3D, or give it a column `z`"),
        ("edits", [(BOX, {"action": "roof"})], ROOF),
        ("edits", [(BOX, {"name": "x"})], "has no `action`; give one of"),
        ("edits", [(BOX, {"action": "flat"})], FLAT),
        ("edits", [(BOX, {"action": "flat", "z": 1e9})], TOO_HIGH),
        ("edits", [(LINE, {"action": "void"})], "needs one layer of polygons, has 0"),
    ],
)
def test_one_line_says_what_is_wrong(
    option: str, features: Features, told: str, city_file: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as caught:
        do(city_file, tmp_path / "out", **{option: draw(tmp_path / "drawn.json", features)})
    assert told in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path}/drawn.json: ")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_breaklines_and_idw_are_refused(city_file: Path, tmp_path: Path) -> None:
    lines = draw(tmp_path / "l.json", lines_of_wall())
    with pytest.raises(ConfigError, match="idw does not follow lines"):
        do(city_file, tmp_path / "out", breaklines=lines, interpolation="idw")


def test_contours_of_others_are_not_replaced(city_file: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "contours.gpkg").write_text("mine")
    with pytest.raises(ConfigError, match="contours.gpkg: already exists"):
        do(city_file, tmp_path / "out", products="contours")
    assert (tmp_path / "out" / "contours.gpkg").read_text() == "mine"


def test_drawings_outside_of_the_survey_are_warned_of(city_file: Path, tmp_path: Path) -> None:
    edits = draw(tmp_path / "e.json", [(shapely.box(900, 0, 905, 5), {"action": "void"})])
    warnings = make_plan([str(city_file)], settings(edits=edits)).warnings
    assert any(f"{edits}: 1 of 1 features lie outside the survey" in text for text in warnings)
