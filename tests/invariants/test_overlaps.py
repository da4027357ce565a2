"""A place does not depend on how files overlap: any tiles with any buffers are the uncut cloud, byte by byte."""

from __future__ import annotations

from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.invariants import clouds
from tests.invariants.clouds import Cloud
from tests.invariants.runs import (
    classes_by_point,
    computed,
    do,
    output_digests,
)
from tests.scenes.drawings import draw
from tiler.errors import ConfigError
from tiler.pipeline import RunResult

SIDE_M, DENSITY = 100.0, 0.6
"""Points 1.3 m apart: pixels of 1.5 m. Counted twice, they would get pixels of 1 m."""
DEFAULTS: dict[str, Any] = {"resolution": None, "tile_size": None, "halo": None}
METHODS = ("auto", "classic")

CUTS = st.lists(st.floats(0.1, 0.9), max_size=2).map(sorted)
BUFFERS = st.lists(st.sampled_from([0.0, 0.3, 5.0, 15.0, 25.0, SIDE_M]), min_size=9, max_size=9)


@pytest.fixture(scope="module")
def scene() -> Cloud:
    """A cloud in which some points occur twice, as some scanners write them."""
    cloud = clouds.city(SIDE_M, DENSITY)
    random = np.random.default_rng(0)
    return cloud.take(np.append(np.arange(len(cloud)), random.integers(0, len(cloud), 40)))


def classes_of(cloud: Cloud) -> np.ndarray:
    """Noise and water here and there. Classes follow from the position, so all copies have the same."""
    classes = np.ones(len(cloud), np.uint8)
    millimetres = np.rint(cloud.xyz * 1000).astype(np.int64).sum(axis=1)
    classes[millimetres % 17 == 1], classes[millimetres % 23 == 2] = 18, 9
    return classes


def write(path: Path, cloud: Cloud) -> Path:
    millimetres = np.rint(cloud.xyz * 1000).astype(np.int64).sum(axis=1)
    return clouds.write(path, cloud, classes=classes_of(cloud), withheld=millimetres % 29 == 3)


def tiles(
    folder: Path, cloud: Cloud, columns: list[float], rows: list[float], buffers: list[float]
) -> Path:
    """Write a file for each tile between the cuts, which are shares of the side, each with its own buffer."""
    east, north = (
        [-1.0, *(SIDE_M * cut for cut in cuts), 2 * SIDE_M] for cuts in (columns, rows)
    )
    x, y = cloud.xyz[:, 0], cloud.xyz[:, 1]
    for number, ((x0, x1), (y0, y1)) in enumerate(product(pairwise(east), pairwise(north))):
        buffer = buffers[number]
        inside = (x >= x0 - buffer) & (x < x1 + buffer)
        inside &= (y >= y0 - buffer) & (y < y1 + buffer)
        write(folder / f"{number}.laz", cloud.take(inside))
    return folder


def write_whole(folder: Path, cloud: Cloud) -> Path:
    return write(folder / "all.laz", cloud)


def twice(folder: Path, cloud: Cloud) -> Path:
    write(folder / "a.laz", cloud)
    write(folder / "b.laz", cloud.take(np.random.default_rng(1).permutation(len(cloud))))
    return folder


def positions_with_classes(out: Path) -> np.ndarray:
    """X, Y, Z and class of each position in the classified clouds, sorted."""
    return np.unique(classes_by_point(out), axis=0)


def terrain_bytes(out: Path) -> bytes:
    """Bytes of dtm.tif without the value of the tag that names the input files, which has a fixed length."""
    path = out / "dtm.tif"
    with rasterio.open(path) as raster:
        inputs = raster.tags()["TILER_INPUTS"].encode()
    content = path.read_bytes()
    assert content.count(inputs) == 1
    return content.replace(inputs, bytes(32))


def assert_same_place(out: Path, uncut: Path) -> None:
    assert terrain_bytes(out) == terrain_bytes(uncut)
    np.testing.assert_array_equal(positions_with_classes(out), positions_with_classes(uncut))


def pixel_m(result: RunResult) -> float:
    return float(result.summary["plan"]["resolution_m"])


@pytest.fixture(scope="module")
def uncut(scene: Cloud, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results of the whole cloud by method."""
    folder = tmp_path_factory.mktemp("uncut")
    path = write_whole(folder / "in", scene)
    for method in METHODS:
        do(path, folder / method, method=method, **DEFAULTS)
    return {method: folder / method for method in METHODS}


@given(method=st.sampled_from(METHODS), columns=CUTS, rows=CUTS, buffers=BUFFERS)
@example(method="auto", columns=[0.5], rows=[0.5], buffers=[25.0] * 9)
@example(method="classic", columns=[], rows=[], buffers=[0.0] * 9)
@settings(max_examples=12)
def test_any_tiles_with_any_buffers_are_the_uncut_cloud(
    method: str,
    columns: list[float],
    rows: list[float],
    buffers: list[float],
    scene: Cloud,
    uncut: dict[str, Path],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    folder = tmp_path_factory.mktemp("tiles")
    paths = tiles(folder / "in", scene, columns, rows, buffers)
    result = do(paths, folder / "out", method=method, **DEFAULTS)
    assert pixel_m(result) == 1.5
    assert_same_place(folder / "out", uncut[method])


def test_the_same_file_twice_is_the_file(
    scene: Cloud, uncut: dict[str, Path], tmp_path: Path
) -> None:
    result = do(twice(tmp_path / "in", scene), tmp_path / "out", method="auto", **DEFAULTS)
    assert_same_place(tmp_path / "out", uncut["auto"])
    positions = len(np.unique(scene.xyz, axis=0))
    assert result.summary["counts"]["duplicates_between_files"] == positions


def test_edits_change_all_points_of_a_position_alike(scene: Cloud, tmp_path: Path) -> None:
    features = [
        (shapely.box(5, 5, 45, 95), {"action": "ground"}),
        (shapely.box(55, 5, 95, 95), {"action": "not_ground"}),
    ]
    edits = draw(tmp_path / "edits.json", features)
    for name, write_files in {"uncut": write_whole, "twice": twice}.items():
        do(write_files(tmp_path / name / "in", scene), tmp_path / name / "out", edits=edits)
    assert_same_place(tmp_path / "twice" / "out", tmp_path / "uncut" / "out")
    found = positions_with_classes(tmp_path / "twice" / "out")
    assert len(found) == len(np.unique(found[:, :3], axis=0))


def test_withheld_points_and_noise_do_not_count_in_the_default_pixel(tmp_path: Path) -> None:
    cloud = clouds.city(SIDE_M, DENSITY)
    double = Cloud(
        np.concatenate([cloud.xyz, cloud.xyz + [0.1, 0.1, 30.0]]), np.tile(cloud.truth, 2)
    )
    added = np.arange(len(double)) >= len(cloud)
    noise = np.where(added, 18, 1).astype(np.uint8)
    names = {"noise": {"classes": noise}, "withheld": {"withheld": added}, "points": {}}
    pixels = {}
    for name, columns in names.items():
        path = clouds.write(tmp_path / f"{name}.laz", double, **columns)
        pixels[name] = pixel_m(do(path, tmp_path / name, until="ingest", **DEFAULTS))
    assert pixels == {"noise": 1.5, "withheld": 1.5, "points": 1.0}


def test_a_later_run_keeps_the_pixel_that_the_points_decided(
    scene: Cloud, tmp_path: Path
) -> None:
    folder = twice(tmp_path / "in", scene)
    first = do(folder, tmp_path / "out", until="ingest", **DEFAULTS)
    (text,) = (note for note in first.notes if note.startswith("decided: pixels"))
    assert text.startswith("decided: pixels of 1.5 m, because only ")
    do(folder, tmp_path / "out", **DEFAULTS)
    digests = output_digests(tmp_path / "out")
    again = do(folder, tmp_path / "out", **DEFAULTS)
    assert computed(again) == dict.fromkeys(computed(again), 0)
    assert (pixel_m(first), pixel_m(again)) == (1.5, 1.5)
    assert output_digests(tmp_path / "out") == digests


def test_sheets_that_do_not_suit_the_pixel_of_the_points_are_refused(
    scene: Cloud, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=r"--sheets 64 m is not a whole number of pixels"):
        do(twice(tmp_path / "in", scene), tmp_path / "out", sheets="64", **DEFAULTS)
