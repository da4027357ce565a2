"""The area of a run: from its settings, in any CRS, and what of the inputs it leaves."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from pyproj import CRS, Transformer

from cli.main import main
from tests.tiler.io.vector.files import collection, write
from tiler.config import RunConfig
from tiler.core.lattice import Bounds
from tiler.errors import ConfigError, InputError, TilerError
from tiler.plan import make_plan
from tiler.plan.area import area_of
from tiler.schedule import call_isolated, limits_memory

UTM = CRS.from_epsg(25832).to_wkt()
FEET = CRS.from_epsg(2263).to_wkt()
SQUARE = shapely.box(500_000.0, 5_400_000.0, 500_100.5, 5_400_200.0)


def of(path: Path, wkt: str | None = UTM) -> Any:
    return area_of(RunConfig(aoi=str(path), in_process=True), wkt, [])


def test_nothing_asked_for_is_everything() -> None:
    assert area_of(RunConfig(), UTM, []) is None
    area = area_of(RunConfig(bounds=(1.0, 2.0, 3.5, 4.0)), None, [])
    assert area is not None
    assert area.bounds == Bounds(1000, 2000, 3500, 4000)


@pytest.mark.processes
@pytest.mark.skipif(not limits_memory(), reason="memory is not limited here")
def test_a_file_that_is_too_large_is_to_be_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "tiler.plan.area.call_isolated", partial(call_isolated, memory_bytes=128 << 20)
    )
    path = tmp_path / "a.geojson"
    path.write_text(f'{{"features": [{"1.5," * 5_000_000}1]}}')
    with pytest.raises(
        InputError, match="needs more than the 128 MiB .*; cut it to the survey with"
    ):
        area_of(RunConfig(aoi=str(path)), UTM, [])


def test_polygons_of_the_same_crs_are_taken_to_the_count(tmp_path: Path) -> None:
    area = of(write(tmp_path / "a.gpkg", [SQUARE], "Polygon"))
    assert area.to_json() == [
        [[round(v * 1000) for place in SQUARE.exterior.coords[:-1] for v in place]]
    ]


def test_polygons_of_another_crs_are_brought_into_that_of_the_clouds(tmp_path: Path) -> None:
    """A long edge is straight in its own CRS and bent in the other: it gets points, the same in either direction."""
    west, south, east, north = 9.0, 48.7, 9.4, 48.75
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    paths = [tmp_path / "a.geojson", tmp_path / "b.geojson"]
    for path, places in zip(paths, (ring, ring[::-1]), strict=True):
        path.write_text(json.dumps(collection({"type": "Polygon", "coordinates": [places]})))
    notes: list[str] = []
    area = area_of(RunConfig(aoi=str(paths[0])), UTM, notes)
    assert area is not None
    assert notes == [f"{paths[0]}: was transformed from WGS 84 to ETRS89 / UTM zone 32N"]
    move = Transformer.from_crs(4326, 25832, always_xy=True).transform
    rng = np.random.default_rng(1)
    lon, lat = (
        rng.uniform(west - 0.01, east + 0.01, 3000),
        rng.uniform(south - 0.01, north + 0.01, 3000),
    )
    # within 6 cm
    near = rng.uniform(-1, 1, 3000) * 5e-7 + np.where(rng.random(3000) < 0.5, south, north)
    for latitude in (lat, near):
        x, y = (np.rint(np.asarray(v) * 1000).astype(np.int64) for v in move(lon, latitude))
        inside = (lon > west) & (lon < east) & (latitude > south) & (latitude < north)
        clear = (
            np.min(np.abs([lon - west, lon - east, latitude - south, latitude - north]), axis=0)
            > 2e-7
        )
        assert (area.inside(x, y) == inside)[clear].all()
    places = {tuple(p) for p in np.reshape(area.to_json()[0][0], (-1, 2)).tolist()}
    assert {
        tuple(p) for p in np.reshape(of(paths[1]).to_json()[0][0], (-1, 2)).tolist()
    } == places


def test_polygons_in_metres_for_clouds_in_feet(tmp_path: Path) -> None:
    """EPSG:32118 and 2263 are one projection, in metres and in US survey feet."""
    ring = [[300_000.0, 60_000.0], [300_500.0, 60_000.0], [300_500.0, 60_300.0]]
    path = write(tmp_path / "a.shp", [shapely.Polygon(ring)], "Polygon", "EPSG:32118")
    found = np.reshape(of(path, FEET).to_json()[0][0], (-1, 2))
    wanted = shapely.Polygon(np.array(ring) / (1200 / 3937) * 1000)
    assert shapely.hausdorff_distance(shapely.Polygon(found), wanted) < 2


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        (
            {"bounds": (0.0, 0.0, 1.0, 1.0), "aoi": "a.shp"},
            ConfigError,
            "--bounds and --aoi: both select",
        ),
        ({"bounds": (0.0001, 0.0, 0.0002, 1.0)}, ConfigError, "is empty"),
        ({"aoi": "absent.gpkg"}, InputError, "no such file"),
        (
            {"aoi": "https://host/x.geojson"},
            InputError,
            "^https://host/x.geojson: this file is not read from a URL; download it",
        ),
        ({"aoi": "a.shp"}, InputError, "has no CRS; write it with one"),
        ({"aoi": "odd.shp"}, InputError, "its CRS .* is not known|has no CRS"),
        (
            {"aoi": "world.geojson"},
            InputError,
            "extends beyond the area of use of ETRS89 / UTM zone 32N",
        ),
        ({"aoi": "thin.gpkg"}, InputError, "has no area"),
    ],
)
def test_what_is_refused(
    settings: dict[str, Any],
    error: type[TilerError],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a.shp", "odd.shp"):
        write(tmp_path / name, [SQUARE], "Polygon", None)
    (tmp_path / "odd.prj").write_text("no CRS")
    world = collection(shapely.box(-180.0, -90.0, 180.0, 90.0).__geo_interface__)
    (tmp_path / "world.geojson").write_text(json.dumps(world))
    first, second, *_ = SQUARE.exterior.coords
    write(tmp_path / "thin.gpkg", [shapely.Polygon([first, second, first])], "Polygon")
    with pytest.raises(error, match=message):
        area_of(RunConfig(**settings), UTM, [])


def test_where_the_crs_of_the_clouds_is_unknown(tmp_path: Path) -> None:
    path = write(tmp_path / "a.shp", [SQUARE], "Polygon", None)
    notes: list[str] = []
    assert area_of(RunConfig(aoi=str(path), in_process=True), None, notes) is not None
    assert "the CRS of the clouds is assumed" in notes[0]
    with pytest.raises(
        InputError, match="the CRS of the clouds is unknown; give it with --crs, or use"
    ):
        of(write(tmp_path / "a.gpkg", [SQUARE], "Polygon"), None)


def test_files_far_off_are_not_read(make_cloud: Any, tmp_path: Path) -> None:
    near, far = (
        make_cloud("near.las"),
        make_cloud("far.las", offsets=(509_000.0, 5_400_000.0, 0.0)),
    )
    everything = make_plan([str(near), str(far)], RunConfig())
    bounds = (499_000.0, 5_399_000.0, 500_000.0, 5_400_000.0)
    plan = make_plan([str(near), str(far)], RunConfig(bounds=bounds))
    assert (
        [source.path for source in plan.inputs.sources]
        == list(plan.inputs.cloud_names)
        == [near]
    )
    assert any(
        note.endswith("1 files lie farther away and are not read") for note in plan.notes
    )
    assert 0 < plan.inputs.points < 1000 < everything.inputs.points
    assert plan.grid == everything.grid
    assert plan.method.tile == everything.method.tile
    assert plan.inputs.extent == Bounds(499_000_000, 5_399_000_000, 500_000_000, 5_400_000_000)


@pytest.mark.parametrize(
    ("options", "code", "text"),
    [
        (
            ["--bounds", "0", "0", "9", "9"],
            2,
            "--bounds: (0, 0) to (9, 9) contains no part of the clouds, which",
        ),
        (
            ["--aoi", "far.gpkg"],
            2,
            "--aoi far.gpkg: (700000, 5400000) to (700001, 5400001) contains no part of",
        ),
        (
            ["--aoi", "far.gpkg", "--bounds", "0", "0", "9", "9"],
            2,
            "--bounds and --aoi: both select a part",
        ),
        (["--aoi", "none.gpkg"], 3, "none.gpkg: no such file"),
        (["--aoi", "no.shp"], 3, "no.shp: contains no polygon"),
    ],
)
def test_one_line_and_its_exit_code(
    options: list[str],
    code: int,
    text: str,
    make_cloud: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    far = shapely.box(700_000.0, 5_400_000.0, 700_001.0, 5_400_001.0)
    write(tmp_path / "far.gpkg", [far], "Polygon")
    write(tmp_path / "no.shp", [None], "Polygon")
    assert main(["plan", str(make_cloud("a.las")), *options]) == code
    error = capsys.readouterr().err
    assert text in error
    assert error.startswith("tiler: error: ")
    assert error.count("\n") == 1
