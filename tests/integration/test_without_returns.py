"""Places without returns: no invented surface there, and each is told, unless it is water."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely

from tests.invariants.runs import do
from tests.scenes.drawings import EAST, NORTH, draw, ground, written

STRIP = shapely.box(24, 10, 32, 50)
"""A strip of 8 m x 40 m, 60 m from the middle of which points lie about 0.7 m apart."""


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Flat land with a wall of 10 m west of a strip without returns."""
    whole = ground(lambda x, y: 30 + 10.0 * ((x > 20) & (x < 24)) + 0.01 * y, number=8000)
    inside = shapely.contains_xy(STRIP, *whole.xyz[:, :2].T)
    folder = tmp_path_factory.mktemp("strip")
    return written(folder / "a.laz", type(whole)(whole.xyz[~inside], whole.truth[~inside]))


def made(cloud: Path, out: Path, **changes: Any) -> tuple[dict[str, np.ndarray], list[Any]]:
    """The models from the south, and the places that were told."""
    settings = {
        "method": "keep",
        "products": "dtm,dsm,ndsm",
        "resolution": "1",
        "voids": "leave",
    }
    run = do(cloud, out, **{**settings, **changes})
    models = {}
    for name in ("dtm", "dsm", "ndsm"):
        with rasterio.open(out / f"{name}.tif") as raster:
            models[name] = np.ma.filled(raster.read(1, masked=True), np.nan)[::-1]
    told = [p for p in run.summary["problems"] if p["what"] == "place without returns"]
    assert len(told) == len(run.summary["without_returns"])
    return models, told


def in_strip(shape: tuple[int, int], margin: float) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    return np.asarray(shapely.contains_xy(STRIP.buffer(margin, join_style="mitre"), x, y))


def test_the_surface_has_no_height_in_them_and_they_are_told(
    cloud: Path, tmp_path: Path
) -> None:
    models, (place,) = made(cloud, tmp_path)
    empty = np.isnan(models["dsm"])
    assert empty[in_strip(empty.shape, -2)].all()
    assert not empty[~in_strip(empty.shape, 0)].any()
    assert (np.isnan(models["ndsm"]) == (empty | np.isnan(models["dtm"]))).all()
    assert np.isfinite(models["dtm"][empty]).all()
    x0, y0, x1, y1 = np.array(place["where"]) - (EAST, NORTH, EAST, NORTH)
    assert STRIP.buffer(0.5).contains(shapely.box(x0, y0, x1, y1))
    assert place["area_m2"] == empty.sum() > 0.6 * STRIP.area
    assert "without returns" in place["why"]


def test_two_gaps_near_each_other_are_told_at_a_place_in_one_of_them(tmp_path: Path) -> None:
    gaps = shapely.box(10, 10, 22, 22), shapely.box(30, 30, 46, 46)
    whole = ground(lambda x, y: 30 + 0.01 * y, number=8000)
    inside = shapely.contains_xy(shapely.union_all(gaps), *whole.xyz[:, :2].T)
    cloud = written(tmp_path / "a.laz", type(whole)(whole.xyz[~inside], whole.truth[~inside]))
    _, (place,) = made(cloud, tmp_path / "out")
    x, y = np.array(place["at"]) - (EAST, NORTH)
    assert any(gap.contains(shapely.Point(x, y)) for gap in gaps)


def test_an_option_fills_the_surface(cloud: Path, tmp_path: Path) -> None:
    models, told = made(cloud, tmp_path, voids="fill")
    assert np.isfinite(models["dsm"][in_strip(models["dsm"].shape, 0)]).all()
    assert len(told) == 1


def test_water_has_its_level_and_is_not_told(cloud: Path, tmp_path: Path) -> None:
    lake = draw(tmp_path / "w.json", [(STRIP.buffer(0.5), {"level": 29.0})])
    models, told = made(cloud, tmp_path / "out", water=lake)
    assert not told
    core = in_strip(models["dsm"].shape, -2)
    assert (models["dsm"][core] == 29).all()
    assert (models["ndsm"][core] == 0).all()
