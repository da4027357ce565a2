"""The picture of a few windows: their places, their content, and their agreement with a run."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning

from ptd.gridding.shape import gradients, multidirectional_hillshade
from tests.tiler.conftest import MakeCloud
from tiler.apps.preview import GAP, make_preview, spread
from tiler.config import RunConfig
from tiler.core.raster import NODATA, Block
from tiler.inputs import inspect
from tiler.io.las.extract import cut_windows, sample_places
from tiler.observe.events import Event, Note, Warned
from tiler.pipeline import run
from tiler.store import open_store

HULL = (0.0, 0.0, 1000.0, 500.0)


def test_windows_are_apart_and_inside() -> None:
    rng = np.random.default_rng(3)
    places = [tuple(p) for p in (rng.uniform(0, 1, (40, 2)) * (1000, 500)).tolist()]
    windows = spread(places, 4, 100.0, HULL)
    assert len(windows) == 4
    for i, (x0, y0, x1, y1) in enumerate(windows):
        assert (x1 - x0, y1 - y0) == (pytest.approx(100), pytest.approx(100))
        assert x0 >= 0
        assert y0 >= 0
        assert x1 <= 1000
        assert y1 <= 500
        for u0, v0, u1, v1 in windows[:i]:
            assert x1 <= u0 or u1 <= x0 or y1 <= v0 or v1 <= y0
    assert spread(places[::-1], 4, 100.0, HULL) == windows


def test_a_small_cloud_has_one_window() -> None:
    assert spread([(3.0, 2.0), (5.0, 5.0)], 3, 200.0, (0.0, 0.0, 9.0, 9.0)) == [
        (-95.5, -95.5, 104.5, 104.5)
    ]
    assert spread([], 3, 200.0, HULL) == []


@pytest.mark.parametrize(("point_format", "version"), [(1, "1.2"), (3, "1.3"), (7, "1.4")])
def test_a_window_is_cut_with_all_that_its_points_hold(
    point_format: int, version: str, make_cloud: MakeCloud, tmp_path: Path
) -> None:
    path = make_cloud("a.laz", 3000, point_format, version, extra=True)
    cloud = laspy.read(path)
    window = (499_000.0, 5_399_000.0, 500_500.0, 5_400_700.0)
    targets = [str(tmp_path / "w0.las"), str(tmp_path / "w1.las")]
    counts = cut_windows(path, [window, (0.0, 0.0, 1.0, 1.0)], targets)
    x, y = np.asarray(cloud.x), np.asarray(cloud.y)
    inside = (x >= window[0]) & (x < window[2]) & (y >= window[1]) & (y < window[3])
    assert counts == [inside.sum(), 0]
    assert 0 < counts[0] < 3000
    assert not Path(targets[1]).exists()
    found = laspy.read(targets[0])
    assert found.points.array.tobytes() == cloud.points.array[inside].tobytes()
    info = inspect(Path(targets[0]))
    assert not info.compressed
    assert info.claimed
    assert info.georeference.name == inspect(path).georeference.name


def test_sampled_places_are_where_points_are(make_cloud: MakeCloud) -> None:
    def two_clumps(cloud: laspy.LasData) -> None:
        half = len(cloud.points) // 2
        for axis in "XY":
            cloud.points.array[axis][:half] = 0
            cloud.points.array[axis][half:] = 100

    path = make_cloud("a.las", 8000, edit=two_clumps)
    assert set(sample_places(path, 8)) == {(500_000.0, 5_400_000.0), (500_001.0, 5_400_001.0)}


@pytest.fixture
def hills(make_cloud: MakeCloud) -> Path:
    """120 m of smooth hills with two points per square metre."""
    rng = np.random.default_rng(5)

    def edit(cloud: laspy.LasData) -> None:
        raw = cloud.points.array
        raw[:] = np.zeros(1, raw.dtype)
        x, y = rng.integers(0, 12_000, (2, raw.size))
        raw["X"], raw["Y"] = x, y
        raw["Z"] = 500 * np.sin(x / 2000) + 300 * np.cos(y / 1500)

    return make_cloud("hills.laz", 28_800, edit=edit)


def read_png(path: Path) -> np.ndarray:
    with pytest.warns(NotGeoreferencedWarning), rasterio.open(path) as picture:
        return picture.read(1)


@pytest.mark.processes
def test_a_preview_equals_a_run(hills: Path, tmp_path: Path) -> None:
    told: list[Event] = []
    config = RunConfig.from_mapping({"max_edge": "20", "products": "slope", "sheets": "10"})
    (window,) = make_preview([str(hills)], tmp_path / "p.png", config, told.append, number=1)
    assert window.points == 28_800
    assert window.ground > 28_000
    assert all(isinstance(event, Note | Warned) for event in told)
    picture = read_png(tmp_path / "p.png")
    plain = RunConfig(in_process=True, workers=1, max_edge=config.max_edge)
    run([str(hills)], tmp_path / "out", plain, until="grid")
    store = open_store(str(tmp_path / "out" / "store.zarr"))
    heights = store.read_block("dtm", Block(0, 0, 120, 120)).astype(np.float64)
    heights[heights == NODATA] = np.nan
    shade = multidirectional_hillshade(
        *gradients(np.pad(heights, 1, constant_values=np.nan), 1.0)
    )
    times = (picture.shape[0] - GAP) // 2 // 120
    assert times >= 2
    terrain = picture[120 * times + GAP :: times, ::times]
    inside = ~np.isnan(shade)
    assert inside.mean() > 0.9
    assert np.array_equal(terrain[inside], shade[inside])


def test_windows_hold_the_points_within_them(hills: Path, tmp_path: Path) -> None:
    windows = make_preview([str(hills)], tmp_path / "p.png", RunConfig(), number=3, side_m=40.0)
    assert 2 <= len(windows) <= 3
    cloud = laspy.read(hills)
    for window in windows:
        x0, y0, x1, y1 = window.bounds
        inside = (cloud.x >= x0) & (cloud.x < x1) & (cloud.y >= y0) & (cloud.y < y1)
        assert window.points == np.count_nonzero(inside)


def test_a_warning_of_a_window_names_the_cloud(hills: Path, tmp_path: Path) -> None:
    cloud = laspy.read(hills)
    cloud.z = np.where(np.arange(len(cloud.z)) % 1000, cloud.z, 500.0)
    cloud.write(tmp_path / "towers.las")
    told: list[str] = []

    def listener(event: Event) -> None:
        if isinstance(event, Warned):
            told.append(event.text)

    make_preview(
        [str(tmp_path / "towers.las")],
        tmp_path / "p.png",
        RunConfig(),
        listener,
        number=1,
        side_m=110.0,
    )
    assert any(text.startswith("window at x ") and "towers.las: rises" in text for text in told)
    assert not any(".tiler-preview-" in text for text in told)
