"""The interval follows nearly all of the terrain; spots keep away from water; sheets have the lines of the whole."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import scipy
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pyogrio import raw

from tiler.core.area import Area
from tiler.core.drawn_sheets import StoredAreas
from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.raster import RasterSpec
from tiler.core.water import LAKE, Water, Waters
from tiler.export.contours import Heights, SheetPart, write_contours, write_spots
from tiler.export.output_files import OutFile
from tiler.store import StoreMeta, TileStore, create_store

SIDE = 200
SPEC = RasterSpec(Lattice(Fraction(1000)), 0, SIDE, SIDE, SIDE)


def stored(store: TileStore, heights: np.ndarray) -> None:
    store.create_raster("dtm", SPEC)
    for block in SPEC.blocks(512):
        store.write_block("dtm", block, heights.astype(np.float32))


@pytest.mark.parametrize("tower", [0, 300])
def test_one_tower_does_not_change_the_interval(
    tower: float, small_store: TileStore, tmp_path: Path
) -> None:
    heights = np.tile(np.linspace(20, 40, SIDE), (SIDE, 1))
    heights[50:60, 50:60] += tower
    stored(small_store, heights)
    to, terrain = OutFile(str(tmp_path), "contours.gpkg"), Heights("dtm", SPEC, None, None)
    record = write_contours(
        small_store, to=to, heights=terrain, interval=None, noise=0.02, sigma=0.0
    )
    assert record.interval == 0.5
    assert (record.low, record.high) == pytest.approx((20.4, 39.6), abs=0.2)


def test_no_spot_in_water_or_within_two_pixels_of_it(
    small_store: TileStore, tmp_path: Path
) -> None:
    rng = np.random.default_rng(3)
    heights = 20 + rng.normal(0, 2, (SIDE, SIDE))
    stored(small_store, heights)
    ring = np.array([(60, 60), (140, 60), (140, 140), (60, 140)], np.int64) * 1000
    waters = Waters((Water(1, LAKE, Area(((ring,),)), 15_000),))
    small_store.put_waters(waters)
    kept, to = {}, OutFile(str(tmp_path), "spots.gpkg")
    for key in (None, waters.key):
        terrain = Heights("dtm", SPEC, None, key)
        record = write_spots(
            small_store, to=to, heights=terrain, interval=Fraction(1), noise=0.0, reach=3
        )
        _, _, shapes, _ = raw.read(tmp_path / "spots.gpkg")
        places = shapely.get_coordinates(shapely.from_wkb(shapes))
        assert len(places) == record.highs + record.lows
        kept[key] = {tuple(place) for place in places}
    near = {place for place in kept[None] if all(58 < v < 142 for v in place)}
    assert near
    assert kept[waters.key] == kept[None] - near


def rough(seed: int) -> np.ndarray:
    """Hills with rings of a few pixels, and a hole without heights."""
    rng = np.random.default_rng(seed)
    heights = 20 + 4 * scipy.ndimage.gaussian_filter(rng.normal(0, 9, (SIDE, SIDE)), 6)
    heights += scipy.ndimage.gaussian_filter(rng.normal(0, 3, (SIDE, SIDE)), 1)
    heights[90:110, 60:150] = -9999
    return heights


def sheets_of(seed: int) -> list[Area]:
    """Polygons that fill the raster and more, and share edges: the cells of random points."""
    rng = np.random.default_rng(seed)
    points = shapely.multipoints(rng.uniform(0, SIDE, (6, 2)))
    cells = shapely.get_parts(
        shapely.voronoi_polygons(points, extend_to=shapely.box(-9, -9, SIDE + 9, SIDE + 9))
    )
    rings = [np.rint(shapely.get_coordinates(cell) * 1000).astype(np.int64) for cell in cells]
    return [Area(((ring,),)) for ring in rings]


def parts_of(
    store: TileStore, seed: int, is_drawn: bool
) -> list[tuple[SheetPart, shapely.Polygon]]:
    if is_drawn:
        areas = sheets_of(seed)
        name = store.put_areas(areas)
        return [
            (
                SheetPart(RasterSpec.enclosing(SPEC.lattice, area.bounds), StoredAreas((area.key,), name)),
                shapely.Polygon(area.polygons[0][0] / 1000),
            )
            for area in areas
        ]  # fmt: skip
    specs = [
        RasterSpec(SPEC.lattice, west, north, 70, 90)
        for west in (-10, 80, 170)
        for north in (60, 130, 200)
    ]
    return [(SheetPart(spec), shapely.box(*spec.edges)) for spec in specs]


def lines_of(path: Path) -> tuple[np.ndarray, np.ndarray]:
    _, _, shapes, columns = raw.read(path, columns=["elevation"])
    return shapely.from_wkb(shapes), columns[0]


@pytest.mark.parametrize("is_drawn", [False, True])
@settings(max_examples=10)
@given(seed=st.integers(0, 1000))
def test_lines_of_a_sheet_are_the_parts_in_it_of_the_lines_without_sheets(
    tmp_path_factory: pytest.TempPathFactory,
    is_drawn: bool,
    seed: int,
) -> None:
    folder = tmp_path_factory.mktemp("sheets")
    meta = StoreMeta(CoordFrame(), Lattice(Fraction(10_000)), Lattice(Fraction(1000)), False)
    store = create_store(str(folder / "store.zarr"), meta)
    stored(store, rough(seed))
    how = {"heights": Heights("dtm", SPEC, None, None), "noise": 0.0, "sigma": 1.0}
    record = write_contours(
        store, to=OutFile(str(folder), "all.gpkg"), interval=Fraction(1), **how
    )
    assert record.short
    whole, levels = lines_of(folder / "all.gpkg")
    length = 0.0
    for part, shape in parts_of(store, seed, is_drawn):
        to = OutFile(str(folder), "part.gpkg")
        write_contours(store, to=to, interval=Fraction(1), sheet=part, **how)
        lines, of = lines_of(folder / "part.gpkg")
        length += shapely.length(lines).sum()
        for level in np.unique(levels):
            expected = shapely.line_merge(
                shapely.intersection(shapely.multilinestrings(whole[levels == level]), shape)
            )
            found = shapely.line_merge(shapely.multilinestrings(lines[of == level]))
            assert shapely.hausdorff_distance(found, expected) < 1e-6 or expected.is_empty
            assert found.length == pytest.approx(expected.length, abs=1e-6)
            inner = shapely.points(shapely.get_coordinates(found))
            inner = inner[shapely.contains_properly(shapely.buffer(shape, -1e-6), inner)]
            every = {tuple(xy) for xy in shapely.get_coordinates(whole[levels == level])}
            assert {(point.x, point.y) for point in inner} <= every
    assert length == pytest.approx(shapely.length(whole).sum())


def test_lines_of_a_sheet_do_not_depend_on_the_first_pixel_of_the_raster(
    tmp_path: Path, small_store: TileStore
) -> None:
    """The heights of a larger raster are the same in the sheet, which also has other lines to its west."""
    lattice, west, north = Lattice(Fraction(609601, 2000)), 1_640_417, 2_788_713
    heights, files = rough(4), []
    sheet = SheetPart(RasterSpec(lattice, west + 40, north - 30, 120, 100))
    for name, more in (("a", 0), ("b", 37)):
        spec = RasterSpec(lattice, west - more, north, SIDE, SIDE + more)
        small_store.create_raster(name, spec)
        wide = np.pad(heights, ((0, 0), (more, 0)), "reflect").astype(np.float32)
        for block in spec.blocks(512):
            small_store.write_block(name, block, wide)
        to, terrain = OutFile(str(tmp_path), f"{name}.gpkg"), Heights(name, spec, None, None)
        write_contours(
            small_store, to=to, heights=terrain, interval=Fraction(1), noise=0.0, sigma=1.5, sheet=sheet,
        )  # fmt: skip
        files.append((tmp_path / f"{name}.gpkg").read_bytes())
    assert files[0] == files[1]


@pytest.mark.parametrize("is_drawn", [False, True])
def test_each_spot_is_in_one_sheet(
    small_store: TileStore, tmp_path: Path, is_drawn: bool
) -> None:
    stored(small_store, rough(5))
    how = {
        "heights": Heights("dtm", SPEC, None, None),
        "interval": Fraction(1),
        "noise": 0.0,
        "reach": 4,
    }
    write_spots(small_store, to=OutFile(str(tmp_path), "all.gpkg"), **how)
    whole, levels = lines_of(tmp_path / "all.gpkg")
    found = []
    for part, shape in parts_of(small_store, 2, is_drawn):
        write_spots(small_store, to=OutFile(str(tmp_path), "p.gpkg"), sheet=part, **how)
        points, of = lines_of(tmp_path / "p.gpkg")
        assert shapely.intersects(shapely.buffer(shape, 1e-9), points).all()
        found += list(zip(shapely.get_x(points), shapely.get_y(points), of, strict=True))
    expected = list(zip(shapely.get_x(whole), shapely.get_y(whole), levels, strict=True))
    assert len(expected) > 50
    assert sorted(found) == sorted(expected)


def test_of_two_sheets_the_first_has_the_lines_of_both(
    small_store: TileStore, tmp_path: Path
) -> None:
    stored(small_store, np.tile(np.linspace(20, 40, SIDE), (SIDE, 1)))
    squares = [(0, 0, 120, 120), (80, 0, 200, 200)]
    first, second = (
        Area(((shapely.get_coordinates(shapely.box(*square)).astype(np.int64) * 1000,),))
        for square in squares
    )
    name = small_store.put_areas([first, second])
    part = SheetPart(
        RasterSpec.enclosing(SPEC.lattice, second.bounds),
        StoredAreas((second.key, first.key), name),
    )
    terrain = Heights("dtm", SPEC, None, None)
    write_contours(
        small_store, to=OutFile(str(tmp_path), "c.gpkg"), heights=terrain, interval=Fraction(1),
        noise=0.0, sigma=0.0, sheet=part,
    )  # fmt: skip
    lines, _ = lines_of(tmp_path / "c.gpkg")
    assert len(lines)
    left = shapely.get_x(shapely.centroid(lines)) < 120
    assert left.any()
    assert (shapely.bounds(lines[left])[:, 1] == 120).all()
    assert (shapely.bounds(lines[~left])[:, 1] < 1).all()


@pytest.mark.parametrize("is_drawn", [False, True])
@pytest.mark.parametrize("is_turned", [False, True])
def test_a_line_on_the_edge_of_two_sheets_is_in_the_one_to_the_east_or_north(
    is_turned: bool, is_drawn: bool, small_store: TileStore, tmp_path: Path
) -> None:
    """The line comes from the sheet to the west or south, runs along the edge, and goes back."""
    half, quarter = SIDE // 2, SIDE // 4
    plane = np.tile(np.arange(SIDE) + 0.5, (SIDE, 1))
    plane[:quarter] += 4
    plane[-quarter:] += 4
    plane = np.minimum(plane, SIDE - 1)  # There is one level.
    stored(small_store, plane.T[::-1] if is_turned else plane)
    how = {"heights": Heights("dtm", SPEC, None, None), "noise": 0.0, "sigma": 0.0}
    how["interval"] = Fraction(half)
    write_contours(small_store, to=OutFile(str(tmp_path), "all.gpkg"), **how)
    (whole,), _ = lines_of(tmp_path / "all.gpkg")
    found = []
    for part in halves(small_store, is_turned, is_drawn):
        write_contours(small_store, to=OutFile(str(tmp_path), "part.gpkg"), sheet=part, **how)
        found.append(lines_of(tmp_path / "part.gpkg")[0])
    (after,) = found[1]
    assert (shapely.get_coordinates(after)[:, 1 if is_turned else 0] == half).all()
    assert after.length == half - 1
    lines = np.concatenate(found)
    assert len(lines) == 3
    assert shapely.length(lines).sum() == pytest.approx(whole.length)
    assert shapely.equals(shapely.union_all(lines), whole)
    first, last = (
        shapely.line_locate_point(whole, shapely.get_point(lines, end)) for end in (0, -1)
    )
    assert (first < last).all()


def halves(store: TileStore, is_turned: bool, is_drawn: bool) -> list[SheetPart]:
    """Return the half to the west or south, and the other one."""
    half = SIDE // 2
    if is_turned:
        specs = [RasterSpec(SPEC.lattice, 0, north, half, SIDE) for north in (half, SIDE)]
    else:
        specs = [RasterSpec(SPEC.lattice, west, SIDE, SIDE, half) for west in (0, half)]
    if not is_drawn:
        return [SheetPart(spec) for spec in specs]
    rings = [shapely.get_coordinates(shapely.box(*spec.edges))[:4] * 1000 for spec in specs]
    areas = [Area(((ring.astype(np.int64),),)) for ring in rings]
    name = store.put_areas(areas)
    return [
        SheetPart(spec, StoredAreas((area.key,), name))
        for spec, area in zip(specs, areas, strict=True)
    ]
