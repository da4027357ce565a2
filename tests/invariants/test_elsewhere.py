"""What a place gets does not depend on what else is in the run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely

from tests.invariants import clouds
from tests.invariants.runs import do
from tests.scenes.drawings import EAST, NORTH, ground, written

SIDE_M = 60
"""Of the scene of `ground`."""
POND = shapely.Point(22, 30).buffer(11)
VOID = shapely.box(46, 12, 56, 22)


def basin(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Uneven land that rises from the shore of `POND`."""
    return 30 + 0.2 * np.clip(np.hypot(x - 22, y - 30) - 11, 0, 12) + 0.1 * np.sin(x / 3)


def cloud(moved_m: tuple[float, float] = (0, 0), number: int = 14_000) -> clouds.Cloud:
    """A scene with a pond without returns, a void, and a bay in its border, at another place."""
    whole = ground(basin, number=number)
    gone = shapely.union_all([POND, VOID, shapely.box(20, -1, 40, 3)])
    kept = ~shapely.contains_xy(gone, *whole.xyz[:, :2].T)
    return clouds.Cloud(whole.xyz[kept] + (*moved_m, 0), whole.truth[kept])


def result(out: Path) -> dict[str, object]:
    """Pixels of the rasters, outlines and water of a run within the scene, without what has none."""
    found: dict[str, object] = {}
    for name in ("dtm", "mask"):
        with rasterio.open(out / f"{name}.tif") as raster:
            window = raster.window(EAST, NORTH, EAST + SIDE_M, NORTH + SIDE_M)
            found[name] = raster.read(1, window=window).tolist()
    scene = shapely.box(EAST, NORTH, EAST + SIDE_M, NORTH + SIDE_M)
    for file, layer in (("water.gpkg", "water"), ("outline.gpkg", "outline")):
        shapes = shapely.from_wkb(pyogrio.raw.read(out / file, layer=layer)[2])
        found[layer] = sorted(shapely.to_wkt(s) for s in shapes if scene.buffer(1).contains(s))
    return found


SETTINGS = {
    "method": "keep", "resolution": "0.5", "water": "auto", "water_min_lake": "150", "products": "dtm,mask",
    "voids": "mark", "max_edge": "40", "tile_size": None, "halo": None, "memory": None,
}  # fmt: skip


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the scene; OUT, beside its cloud."""
    folder = tmp_path_factory.mktemp("alone")
    do(written(folder / "a.laz", cloud()), folder / "out", **SETTINGS)
    assert json.loads((folder / "out" / "run.json").read_text())["water"]
    return folder / "out"


@pytest.mark.parametrize(
    "places",
    [
        [(2600.0, 2600.0)],  # far away: all else on a larger raster
        # Other blocks, neighbours farther than the longest edge and the widest gap, and 9 km
        # away.
        [(-1040.0, -30.0), (0.0, 110.0), (115.0, 90.0), (9000.0, -20.0)],
    ],
)
def test_another_place_changes_nothing(
    places: list[tuple[float, float]], alone: Path, tmp_path: Path
) -> None:
    others = [written(tmp_path / f"{n}.laz", cloud(place)) for n, place in enumerate(places)]
    do([alone.parent / "a.laz", *others], tmp_path / "out", **SETTINGS)
    assert result(tmp_path / "out") == result(alone)


def test_sparse_points_elsewhere_do_not_widen_gaps_here(alone: Path, tmp_path: Path) -> None:
    sparse = written(tmp_path / "sparse.laz", cloud((3000, 0), number=90))
    found = do([alone.parent / "a.laz", sparse], tmp_path / "out", **SETTINGS)
    assert found.summary["outline"]["widest_gap_m"] > 20
    assert result(tmp_path / "out") == result(alone)
