"""Points thousands of kilometres from one another: a run follows the points, not the emptiness between them."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import rasterio

from tests.invariants.runs import do, dtm, the_store
from tiler.apps.check import TileEdges, seam_steps
from tiler.apps.evaluate.heights import evaluate_dtm
from tiler.apps.info import describe_raster
from tiler.errors import ConfigError, InputError
from tiler.export.overview import THINNING
from tiler.store import TileStore


def write_points(path: Path, places: np.ndarray, classes: int = 2) -> Path:
    """A file of points, float64 (3, n), metres."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = np.array([*places[:2, 0], 0.0]), np.full(3, 0.01)
    las = laspy.LasData(header)
    las.x, las.y, las.z = places
    las.classification[:] = classes
    las.return_number[:] = 1
    las.number_of_returns[:] = 1
    path.parent.mkdir(parents=True, exist_ok=True)
    las.write(path)
    return path


def site(
    path: Path, west: float, south: float, side: float = 50.0, number: int = 3000, seed: int = 1
) -> Path:
    """A slope with one point a square metre or more."""
    random = np.random.default_rng(seed)
    x, y = random.random((2, number)) * side
    return write_points(
        path, np.round(np.stack([x + west, y + south, 100 + 0.1 * x + 0.05 * y]), 2)
    )


def test_four_points_4000_km_apart(tmp_path: Path) -> None:
    """Their buckets' lattice has a thousand million cells."""
    corners = np.array([[0.0, 4e6, 0.0, 4e6], [0.0, 0.0, 4e6, 4e6], [1.0, 2.0, 3.0, 4.0]])
    path = write_points(tmp_path / "four.las", corners)
    result = do(
        path, tmp_path / "out", method="keep", crs="none", resolution=None, max_edge="20000"
    )
    assert result.exit_code == 0
    assert any("the terrain model is empty" in note for note in result.summary["notes"])
    with rasterio.open(tmp_path / "out" / "dtm.tif") as raster:
        assert raster.shape == (200, 200)  # the last points lie on the outer edge


def test_the_empty_pixels_between_clouds_are_not_counted_as_points(tmp_path: Path) -> None:
    paths = [site(tmp_path / "a.laz", 0, 0), site(tmp_path / "b.laz", 7000, 7000)]
    result = do(paths, tmp_path / "out", crs="none", outline="hull")
    with rasterio.open(tmp_path / "out" / "dtm.tif") as raster:
        n_pixels = raster.width * raster.height
    written = result.summary["stages"]["export"]
    n_points = 6000 + 6000 // THINNING  # of the clouds, and of their overview
    assert (written["points"], written["pixels"]) == (n_points, n_pixels)
    assert n_pixels > 40_000_000
    log = (tmp_path / "out" / "events.jsonl").read_text().splitlines()
    events = [json.loads(line) for line in log]
    done = [e for e in events if e["event"] == "task_done" and e["stage"] == "export"]
    assert [e["points"] for e in done if e["key"].endswith(".tif")] == [0]
    assert sum(e["points"] for e in done) == n_points


def test_coarse_pixels_of_a_wide_extent(tmp_path: Path) -> None:
    """A block of 512 such pixels is wider than what one TIN can be exact for."""
    x, y = (
        axis.ravel()
        for axis in np.meshgrid(np.arange(0, 60e3, 1500.0), np.arange(0, 4500.0, 1500.0))
    )
    path = write_points(tmp_path / "strip.las", np.stack([x, y, 100 + 0.001 * x]))
    do(path, tmp_path / "out", method="keep", crs="none", resolution="500", max_edge="4000")
    with rasterio.open(tmp_path / "out" / "dtm.tif") as raster:
        heights, (west, _, _, _) = raster.read(1), raster.bounds
    column = np.arange(heights.shape[1])
    filled = heights[2] != -9999
    assert filled.sum() > 0.98 * len(column)  # the outline follows cells of a pixel
    expected = 100 + 0.001 * (west + 500 * (column + 0.5))
    np.testing.assert_allclose(heights[2][filled], expected[filled], atol=0.005)


@pytest.fixture
def good(tmp_path: Path) -> list[Path]:
    return [site(tmp_path / f"g{i}.las", 500_000 + 50 * i, 5_000_000, seed=i) for i in range(4)]


KEEP = {"method": "keep", "crs": "EPSG:25832", "resolution": "1"}


@pytest.mark.parametrize(
    ("west", "south", "words"),
    [
        (1e9, 1e9, "outside the coordinates of any CRS"),
        (0.0, 0.0, "km from the other files: too far for one run"),
        (0.0, 4_000_000.0, "most of them empty; use --sheets"),
    ],
)
def test_a_file_with_absurd_coordinates_is_left_out(
    west: float, south: float, words: str, good: list[Path], tmp_path: Path
) -> None:
    bad = site(tmp_path / "bad.las", west, south)
    result = do([*good, bad], tmp_path / "out", **KEEP)
    assert result.exit_code == 5
    (left,) = result.summary["quarantined"]
    assert left["path"] == bad.as_posix()
    assert words in left["error"]
    do(good, tmp_path / "alone", **KEEP)
    assert (dtm(tmp_path / "out")[0] == dtm(tmp_path / "alone")[0]).all()
    with pytest.raises(InputError, match="bad.las: lies at"):
        do([*good, bad], tmp_path / "stopped", on_error="stop", **KEEP)
    assert not (tmp_path / "stopped").exists()


def test_one_good_file_is_told_from_one_beyond_its_crs(
    good: list[Path], tmp_path: Path
) -> None:
    bad = site(tmp_path / "bad.las", 0.0, 0.0)
    assert do([bad, good[0]], tmp_path / "out", **KEEP).summary["quarantined"][0][
        "path"
    ] == str(bad)
    with pytest.raises(
        ConfigError, match=r"bad.las and .*g0.las lie up to .* run them separately"
    ):
        do([bad, good[0]], tmp_path / "local", **{**KEEP, "crs": "none"})


@pytest.mark.parametrize("in_one_file", [True, False])
def test_two_sites_400_km_apart(in_one_file: bool, tmp_path: Path) -> None:
    """One raster over both would have 1.6e11 pixels; as sheets they are a few."""
    one, two = (
        site(tmp_path / "1.las", 500_000, 5_000_000),
        site(tmp_path / "2.las", 900_000, 5_400_000),
    )
    inputs = [one, two]
    if in_one_file:
        points = np.concatenate([laspy.read(path).xyz.T for path in inputs], axis=1)
        inputs = [write_points(tmp_path / "12.las", points)]
    result = do(inputs, tmp_path / "out", sheets="50", **KEEP)
    assert result.exit_code == 0
    names = {path.name for path in (tmp_path / "out" / "dtm").iterdir()}
    assert names == {"dtm_500000_5000000.tif", "dtm_900000_5400000.tif"}
    assert result.summary["plan"]["projected_disk_bytes"] < 50e6
    assert (tmp_path / "out" / "report.html").exists()
    vrt = tmp_path / "out" / "dtm.vrt"  # whoever reads it does not look at what lies between
    assert describe_raster(vrt)["heights"]["maximum"] < 110
    assert seam_steps(vrt, TileEdges(10))["interior"]["pairs"] > 1000
    assert evaluate_dtm(vrt, vrt)["rmse"] == 0
    with pytest.raises(ConfigError, match=r"up to 400 km apart: .* use --sheets or --bounds"):
        do(inputs, tmp_path / "whole", **KEEP)
    near = do(
        inputs, tmp_path / "part", bounds=[499_990, 4_999_990, 500_060, 5_000_060], **KEEP
    )
    assert near.exit_code == 0
    assert near.summary["dtm"]["width"] == 50


def test_a_header_that_hides_where_points_lie(good: list[Path], tmp_path: Path) -> None:
    """Neither its bounds nor the sample of the plan tell of a run of points far away."""
    cloud = laspy.read(site(tmp_path / "lie.las", 500_200, 5_000_000, number=200_000))
    cloud.x[22_000:22_500] += 390_000
    cloud.y[22_000:22_500] += 390_000
    cloud.write(tmp_path / "lie.las")
    data = bytearray((tmp_path / "lie.las").read_bytes())
    data[179:211] = np.array([500_250.0, 500_200.0, 5_000_050.0, 5_000_000.0]).tobytes()
    (tmp_path / "lie.las").write_bytes(data)
    result = do([*good, tmp_path / "lie.las"], tmp_path / "out", **KEEP)
    assert result.exit_code == 5
    (left,) = result.summary["quarantined"]
    assert left["path"].endswith("lie.las")
    assert "holds points far outside of the bounds that its header gives" in left["error"]
    assert result.summary["dtm"]["width"] == 200


def test_heights_that_no_run_can_hold(good: list[Path], tmp_path: Path) -> None:
    x, y = np.random.default_rng(1).random((2, 500)) * 50
    high = write_points(
        tmp_path / "high.las", np.stack([500_200 + x, 5_000_000 + y, np.full(500, 2e7)])
    )
    result = do([*good, high], tmp_path / "out", **KEEP)
    assert result.exit_code == 5
    assert [q["path"] for q in result.summary["quarantined"]] == [high.as_posix()]


def test_one_more_input_makes_the_sheets_that_it_touches(tmp_path: Path) -> None:
    west, south = 500_000, 5_000_000
    first = [site(tmp_path / f"{i}.las", west + 1000 * i, south + 1000 * i) for i in (0, 2)]
    how = {**KEEP, "sheets": "50", "max_edge": "20"}
    do(first, tmp_path / "out", **how)

    def tags() -> dict[str, str]:
        return {
            p.name: rasterio.open(p).tags()["TILER_INPUTS"]
            for p in (tmp_path / "out/dtm").iterdir()
        }

    before = tags()
    assert len(set(before.values())) == 2
    result = do(
        [*first, site(tmp_path / "1.las", west + 1000, south + 1000)], tmp_path / "out", **how
    )
    assert result.summary["stages"]["export"]["tasks"] == 5  # outline and review, too
    assert result.summary["stages"]["export"]["computed"] == 2
    assert tags().items() > before.items()


def test_blocks_of_an_earlier_run_are_removed_by_tasks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a wider limit filled pixels between two sites, a narrower one leaves nothing."""
    west, south = 500_000, 5_000_000
    inputs = [site(tmp_path / f"{i}.las", west + 1500 * i, south) for i in (0, 1)]
    do(inputs, tmp_path / "out", **KEEP, max_edge="2500")
    monkeypatch.setattr(TileStore, "write_block", not_by_the_command(TileStore.write_block))
    do(inputs, tmp_path / "out", **KEEP)
    do(inputs, tmp_path / "alone", **KEEP)
    filled = [dtm(tmp_path / name)[0] != -9999 for name in ("out", "alone")]
    assert (filled[0] == filled[1]).all()
    kept, alone = (the_store(tmp_path / name).stored_blocks("dtm") for name in ("out", "alone"))
    assert kept == alone


def not_by_the_command(write: Any) -> Any:
    """`TileStore.write_block`, which the stages that list tasks may not call."""

    def checked(*arguments: Any) -> None:
        callers = {Path(frame.filename).name for frame in inspect.stack()}
        assert "worker.py" in callers
        write(*arguments)

    return checked
