from __future__ import annotations

import shutil
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import psutil
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tiler.config import RunConfig
from tiler.errors import ConfigError, InputError
from tiler.inputs.common_crs import resolve_common_crs
from tiler.inputs.search import find_inputs
from tiler.inputs.sources import SourceInfo, inspect, pieces
from tiler.io.las.headers import read_header
from tiler.io.las.reader import EVERYTHING, PointReader

GOOD: dict[str, tuple[int, str | None]] = {
    "1.0_0.las": (1, None),
    "4_6_crop.las": (23875, None),
    "bad_vlr_count.las": (10, None),
    "extra.laz": (1065, "none"),
    "file_with_both_wkt_and_geotiff_vlrs.las": (25408, None),
    "fullwave.laz": (10750, None),
    "gps-time-nan.las": (1, "none"),
    "no-points.las": (0, None),
    "noise-dirty.las": (1065, "none"),
    "simple.copc.laz": (1065, None),
    "simple1_3.las": (999, "none"),
    "test_noepsg_043500_629205_IGN69.laz": (17845, "none"),
    "vegetation_1_3.las": (10683, "none"),
    "warsaw_small.las": (3000, "none"),
}
"""Files that are read correctly: their points, and the --crs that they need."""

REFUSED = {
    "1.2-no-points.las": "says 1065 points, has room for 0",
    "1.2-with-color-clipped.las": "says 1065 points, has room for 1064",
    "Semis_2022_0906_6665_nok.laz": "header was never finished",
    "garbage_nVariableLength.las": "says 1069128089 variable length records",
}
"""Files that are damaged and refused with any CRS."""

DEGREES = ("epsg_4326.las", "spurious.las")


def odd(shared_data: Path, name: str) -> Path:
    path = shared_data / "odd" / name
    if not path.exists():
        pytest.skip(f"no {path}")
    return path


@pytest.mark.parametrize("name", GOOD)
def test_odd_files_are_read_correctly(shared_data: Path, name: str) -> None:
    points, crs = GOOD[name]
    info = inspect(odd(shared_data, name))
    assert info.points == points
    if crs is not None:
        with pytest.raises(InputError, match="--crs"):
            resolve_common_crs([info], RunConfig())
    resolve_common_crs([info], RunConfig(crs=crs))
    header = read_header(info.path)
    with PointReader(header, EVERYTHING) as reader:
        raw = b"".join(reader.read(s, n).tobytes() for s, n in pieces(info, 700))
    assert raw == (laspy.read(info.path).points.array.tobytes() if points else b"")


@pytest.mark.parametrize("name", REFUSED)
def test_odd_files_are_refused_cheaply(shared_data: Path, name: str) -> None:
    before = psutil.Process().memory_info().rss
    with pytest.raises(InputError) as caught:
        inspect(odd(shared_data, name))
    text = str(caught.value)
    assert REFUSED[name] in text
    assert name in text
    assert "\n" not in text
    assert psutil.Process().memory_info().rss - before < 100_000_000


@pytest.mark.parametrize("name", DEGREES)
def test_degrees_are_refused_by_name(shared_data: Path, name: str) -> None:
    info = inspect(odd(shared_data, name))
    with pytest.raises(InputError, match="WGS 84 is geographic") as caught:
        resolve_common_crs([info], RunConfig())
    assert name in str(caught.value)


def test_salvage_of_the_odd_files(shared_data: Path) -> None:
    assert inspect(odd(shared_data, "1.2-with-color-clipped.las"), salvage=True).points == 1064
    for name in ("1.2-no-points.las", "Semis_2022_0906_6665_nok.laz"):
        with pytest.raises(InputError, match="not one point can be salvaged"):
            inspect(odd(shared_data, name), salvage=True)


def test_one_point_outside_of_the_bounds_is_a_stray_and_does_not_move_them(
    shared_data: Path,
) -> None:
    info = inspect(odd(shared_data, "spurious.las"))
    cloud = laspy.read(info.path)
    assert np.count_nonzero(np.asarray(cloud.x) < cloud.header.mins[0] - 1e-6) == 1
    expected = [*cloud.header.mins, *cloud.header.maxs]
    np.testing.assert_allclose(info.bounds, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "lie", [(1e300, -1e300), (float("nan"), float("nan")), (600_000.0, 599_999.0), (5e8, -5e8)]
)
def test_lying_bounds_are_noted(make_cloud: Any, lie: tuple[float, float]) -> None:
    path = make_cloud("b.las")
    true = inspect(path).bounds
    assert true is not None
    data = bytearray(path.read_bytes())
    struct.pack_into("<2d", data, 179, *lie)
    path.write_bytes(data)
    info = inspect(path)
    np.testing.assert_allclose(info.bounds, true, rtol=0, atol=1e-6)
    assert any("bounds" in note for note in info.notes)


def test_an_empty_file_is_noted_and_its_crs_is_ignored(make_cloud: Any) -> None:
    empty = inspect(make_cloud("empty.las", n=0, crs="EPSG:4326", edit=None))
    assert empty.points == 0
    assert "has no points" in empty.notes
    assert pieces(empty) == []
    full = inspect(make_cloud("full.las"))
    assert resolve_common_crs([empty, full], RunConfig()).wkt is not None


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize("size", [1, 50_000, 60_000, 100_000, 10**6])
def test_pieces_cover_each_point_once_and_consist_of_whole_chunks(
    make_cloud: Any, suffix: str, size: int
) -> None:
    info = inspect(make_cloud(f"p.{suffix}", n=130_001))
    if size == 1 and suffix == "las":
        size = 1000
    ranges = pieces(info, size)
    starts = [0, *np.cumsum([n for _, n in ranges]).tolist()]
    assert [s for s, _ in ranges] == starts[:-1]
    assert starts[-1] == 130_001
    if suffix == "laz":
        assert all(s % 50_000 == 0 for s, _ in ranges)


@pytest.fixture(scope="module")
def laz_info(tmp_path_factory: pytest.TempPathFactory) -> SourceInfo:
    cloud = laspy.create(point_format=6)
    cloud.x = cloud.y = cloud.z = np.arange(3.0)
    path = tmp_path_factory.mktemp("laz") / "small.laz"
    cloud.write(path)
    return inspect(path)


@given(
    counts=st.lists(st.integers(0, 6_000_000), max_size=20),
    size=st.integers(1_000, 1_000_000),
    record_length=st.sampled_from([20, 34, 67, 3_000]),
)
@example(counts=[2_000_000, 500], size=1_000_000, record_length=34)
def test_pieces_of_chunks_of_any_length_cover_each_point_once(
    laz_info: SourceInfo, counts: list[int], size: int, record_length: int
) -> None:
    """Chunks of a LAZ file may have more points than a piece, and fewer than make it worth to divide them."""
    info = replace(
        laz_info, chunks=tuple(counts), points=sum(counts), record_length=record_length
    )
    ranges = pieces(info, size)
    ends = np.cumsum([n for _, n in ranges], dtype=np.int64).tolist()
    assert [start for start, _ in ranges] == [0, *ends][: len(ranges)]
    assert sum(n for _, n in ranges) == sum(counts)
    assert all(n > 0 for _, n in ranges)


def test_inputs_of_files_folders_and_globs(make_cloud: Any, tmp_path: Path) -> None:
    for name in ("a/one.las", "a/b/two.LAZ", "a/three.copc.laz", "c/four.las"):
        make_cloud(name, n=3)
    (tmp_path / "a" / "readme.txt").write_text("no cloud")
    here = str(tmp_path)
    names = ["two.LAZ", "one.las", "three.copc.laz"]
    assert sorted(p.name for p in find_inputs([f"{here}/a"])) == sorted(names)
    assert find_inputs([f"{here}/a", f"{here}/c"]) == find_inputs([f"{here}/c", f"{here}/a"])
    assert [p.name for p in find_inputs([f"{here}/**/*.las"])] == ["one.las", "four.las"]


def test_a_file_named_twice_is_read_once_and_noted(make_cloud: Any, tmp_path: Path) -> None:
    path = make_cloud("once.las", n=3)
    (tmp_path / "link.las").symlink_to(path)
    notes: list[str] = []
    assert (
        len(
            find_inputs(
                [str(path), str(tmp_path), str(tmp_path / "link.las")], note=notes.append
            )
        )
        == 1
    )
    assert any("named twice" in n for n in notes)


def test_a_hard_link_is_the_same_file(make_cloud: Any, tmp_path: Path) -> None:
    path = make_cloud("once.las", n=3)
    (tmp_path / "same.las").hardlink_to(path)
    copy = shutil.copy(path, tmp_path / "twin.las")
    notes: list[str] = []
    assert find_inputs([str(tmp_path)], note=notes.append) == [path, Path(copy)]
    assert notes == [f"{tmp_path / 'same.las'}: named twice (as {path}), read once"]


def test_no_input_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        find_inputs([str(tmp_path / "nowhere")])
    with pytest.raises(ConfigError, match="no input"):
        find_inputs([])
    with pytest.raises(InputError, match=r"no \.las.* file there"):
        find_inputs([str(tmp_path)])
