"""Water that is found in laser scans has the extent, the levels and the shores of the truth."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import shapely

from tests.benchmarks.water import scored
from tests.invariants.runs import do
from tests.scenes.drawings import digests
from tests.scenes.small_stores import USUAL_ROW_POINTS, small_stores
from tests.scenes.water_scenes import BARE, write_cloud
from tiler.simulate import describe_scene

HIDDEN_SEED = 23
"""None of those on which the search was made."""


@dataclasses.dataclass(frozen=True)
class Finished:
    """A finished run of a scene: folder of the cloud and of OUT, and the figures of its water."""

    folder: Path
    figures: dict[str, Any]


Run = Callable[..., Finished]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Runs of scenes, each made once. Not to be changed."""

    @functools.cache
    def make(name: str, classes: bool) -> Finished:
        folder = tmp_path_factory.mktemp(name)
        return Finished(folder, scored(name, HIDDEN_SEED, folder, classes))

    return make


SHORE_M = {"als_weir": 1.5, "als_meander": 1.5, "als_lakes": 1.5, "als_canal": 1.5}
"""Distance of the found shore from the true one, RMS."""
MAX_DUG = {"als_weir": 0.03, "als_meander": 0.005, "als_lakes": 0.015, "als_canal": 0.005}
"""Share of the outermost pixels of water on land above it. Those of the weir are faces of
masonry."""
MAX_DUG_WHOLE = {
    "als_weir": 0.02,
    "als_meander": 0.005,
    "als_lakes": 0.008,
    "als_canal": 0.005,
}
"""The same share, without pixels that have the true shore in them. Lock walls of the weir have no
ground."""
MAX_VOID = 0.005
"""Share of the water without a height, where a river leaves the survey."""
MAX_FLOATING = 0.005
"""Share of the shore more than 0.1 m below the level."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "classes"),
    [
        ("als_weir", False),
        ("als_meander", False),
        ("als_lakes", True),
        ("als_canal", False),
    ],
)
def test_extent_levels_and_shores(name: str, classes: bool, finished: Run) -> None:
    figures = finished(name, classes).figures
    assert figures["recall"] > 0.94
    assert figures["precision"] > 0.98
    assert figures["level_rmse"] < 0.05
    assert figures["shore_rmse"] < SHORE_M[name]
    assert figures["floating"] < MAX_FLOATING
    assert figures["dug"] < MAX_DUG[name]
    assert figures["dug_whole"] < MAX_DUG_WHOLE[name]
    assert figures["void"] < MAX_VOID
    assert figures["rises"] <= 0


@pytest.mark.slow
def test_a_flat_meadow_that_returns_little_is_no_water(finished: Run) -> None:
    assert finished("als_wet_meadow", False).figures["bodies"] == 0


@pytest.mark.slow
def test_the_levels_of_reaches_win_when_the_file_is_given_back(
    finished: Run, tmp_path: Path
) -> None:
    folder = finished("als_meander", False).folder
    cloud, out, given = folder / "cloud.laz", folder / "out", tmp_path / "given.gpkg"
    settings = {
        "method": "auto",
        "products": "dtm",
        "tile_size": None,
        "halo": None,
        "memory": "2GiB",
    }
    do(cloud, tmp_path / "same", water=str(out / "water.gpkg"), **settings)
    assert digests(tmp_path / "same")["dtm.tif"] == digests(out)["dtm.tif"]
    given.write_bytes((out / "water.gpkg").read_bytes())
    meta, _, shapes, columns = pyogrio.raw.read(given, layer="reaches")
    columns[list(meta["fields"]).index("level")] -= 0.3
    pyogrio.raw.write(
        given, shapes, columns, meta["fields"], layer="reaches", driver="GPKG", geometry_type="Point Z",
        crs=meta["crs"], append=False,
    )  # fmt: skip
    do(cloud, tmp_path / "lower", water=str(given), **settings)
    levels = [
        json.loads((o / "run.json").read_text())["water"][0] for o in (out, tmp_path / "lower")
    ]
    assert abs(levels[0]["level"] - levels[1]["level"] - 0.3) < 0.002
    assert abs(levels[0]["level_end"] - levels[1]["level_end"] - 0.3) < 0.002


@pytest.mark.slow
def test_the_file_for_hydrographers_has_shores_and_stations_at_the_level(finished: Run) -> None:
    path = finished("als_weir", False).folder / "out" / "water.gpkg"
    lines = shapely.from_wkb(pyogrio.raw.read(path, layer="breaklines")[2])
    heights = shapely.get_coordinates(lines, include_z=True)[:, 2]
    assert heights.min() > 140
    assert heights.max() < 143.6
    meta, _, _, columns = pyogrio.raw.read(path, layer="reaches")
    table = dict(zip(meta["fields"], columns, strict=True))
    for number in np.unique(table["number"]):
        mine = table["number"] == number
        assert np.diff(table["level"][mine]).max() <= 0
        assert np.diff(table["along"][mine]).min() > 0


SMALL = {
    "lakes": describe_scene("als_lakes", seed=HIDDEN_SEED),
    "meander": describe_scene("als_meander", seed=HIDDEN_SEED, side_m=700.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_the_same_bodies_are_found_whatever_the_pixel(name: str, tmp_path: Path) -> None:
    cloud, found = write_cloud(tmp_path / "cloud.laz", SMALL[name], BARE), {}
    for pixel in ("0.5", "1", "5"):
        out = tmp_path / pixel
        do(cloud, out, method="keep", water="auto", resolution=pixel, tile_size=None, halo=None)
        found[pixel] = json.loads((out / "run.json").read_text())["water"]
    for bodies in found.values():
        assert [body["kind"] for body in bodies] == [body["kind"] for body in found["1"]]
        for body, other in zip(bodies, found["1"], strict=True):
            assert abs(body["level"] - other["level"]) < 0.02
            assert abs(body["level_end"] - other["level_end"]) < 0.02
            assert abs(body["area_m2"] / other["area_m2"] - 1) < 0.03


@pytest.mark.slow
def test_water_goes_on_below_a_bridge_that_is_removed(tmp_path: Path) -> None:
    """The deck is 2.1 m above the water with this seed; decks below 2 m are not sought."""
    figures = scored("als_meander", 1, tmp_path, bridges="remove")
    assert figures["bodies"] == 1
    assert figures["level_rmse"] < 0.05
    assert figures["rises"] <= 0


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SMALL, "canal"])
def test_tiles_and_workers_do_not_show_in_the_water(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small_stores(monkeypatch, row_points=USUAL_ROW_POINTS)  # what workers know
    spec = SMALL.get(name) or describe_scene("als_canal", seed=HIDDEN_SEED)
    cloud = write_cloud(tmp_path / "cloud.laz", spec, BARE)
    runs: list[dict[str, Any]] = [
        {"tile_size": "60", "workers": 1},
        {"tile_size": "170", "workers": 1},
    ]
    if name == "canal":  # its shores depend on most
        runs.append({"tile_size": "170", "workers": 2, "in_process": False})
    made = []
    for number, settings in enumerate(runs):
        out = tmp_path / str(number)
        do(cloud, out, method="keep", water="auto", products="dtm,mask", **settings)
        made.append(
            {name: digests(out)[name] for name in ("dtm.tif", "mask.tif", "water.gpkg")}
        )
    assert made == made[:1] * len(made)
