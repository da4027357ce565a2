"""A part of a COPC file: read by its octree, with the results of reading all of it; over HTTP in few bytes."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.runs import do, dtm
from tests.scenes.copc_files import write_copc
from tests.tiler.servers import http_server
from tiler.errors import InputError
from tiler.inputs import inspect
from tiler.io.las.extract import cut_windows, sample_places

WINDOW = {"halo": "16", "max_edge": "10", "bounds": (500010.0, 5400010.0, 500040.0, 5400030.0)}


@pytest.fixture(scope="module")
def copc(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A city of 200 m in nodes of at most 1,000 points."""
    folder = tmp_path_factory.mktemp("copc")
    las = laspy.read(clouds.write(folder / "city.laz", clouds.city(200.0)))
    return write_copc(folder / "city.copc.laz", laspy.convert(las, point_format_id=6), 1000)


def test_the_octree_is_the_one_that_laspy_reads(copc: Path) -> None:
    info = inspect(copc)
    assert info.octree is not None
    starts = np.cumsum([0, *info.chunks])
    points = laspy.read(copc)
    with laspy.CopcReader.open(str(copc)) as reader:
        levels = max(key[0] for key in info.octree.keys)
        for level in range(levels + 1):
            own = [
                points
                for points, key in zip(info.chunks, info.octree.keys, strict=True)
                if key[0] == level
            ]
            assert len(reader.query(level=level)) == sum(own)
    for chunk, key in enumerate(info.octree.keys):
        x, y = (np.asarray(c[starts[chunk] : starts[chunk + 1]]) for c in (points.x, points.y))
        west, south, east, north = info.octree.box(key)
        assert np.all(
            (x >= west - 1e-6) & (x <= east + 1e-6) & (y >= south - 1e-6) & (y <= north + 1e-6)
        )


def test_chunks_of_0_points_are_chunks_of_different_sizes(copc: Path, tmp_path: Path) -> None:
    """Some writers of COPC leave the field empty."""
    data = bytearray(copc.read_bytes())
    record = data.index(b"laszip encoded") + 16 + 2 + 2 + 32
    assert data[record + 12 : record + 16] == b"\xff\xff\xff\xff"
    data[record + 12 : record + 16] = bytes(4)
    other = tmp_path / "city.copc.laz"
    other.write_bytes(data)
    assert inspect(other).chunks == inspect(copc).chunks
    for path, out in ((copc, tmp_path / "one"), (other, tmp_path / "other")):
        do(path, out, **WINDOW)
    assert np.array_equal(dtm(tmp_path / "one")[0], dtm(tmp_path / "other")[0])
    one, again = (
        laspy.read(tmp_path / out / "classified" / "city.laz") for out in ("one", "other")
    )
    assert one.points.array.tobytes() == again.points.array.tobytes()


def test_a_window_has_the_bytes_of_the_whole_file_cropped(
    copc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    window = do(copc, tmp_path / "window", **WINDOW)
    for module in (
        "plan.area",
        "ingest.tasks.fingerprints",
        "ingest.tasks.points",
        "export.tasks.files",
    ):
        monkeypatch.setattr(f"tiler.{module}.chunks_of", lambda plan, source, margin=None: None)
    whole = do(copc, tmp_path / "whole", **WINDOW)
    assert window.summary["counts"]["read"] < whole.summary["counts"]["read"] / 2
    # That has its buckets filled.
    assert window.summary["counts"]["stored"] < whole.summary["counts"]["stored"]
    for name in ("dtm.tif", "classified/city.laz", "stac.json"):
        assert (tmp_path / "window" / name).read_bytes() == (
            tmp_path / "whole" / name
        ).read_bytes(), name


def test_over_http_only_the_nodes_that_matter_are_fetched(copc: Path, tmp_path: Path) -> None:
    pytest.importorskip("aiohttp", reason="no http: aiohttp is not installed")
    here = do(copc, tmp_path / "here", **WINDOW)
    with http_server(copc.parent) as url:
        there = do([f"{url}/city.copc.laz"], tmp_path / "there", **WINDOW)  # type: ignore[list-item]
    np.testing.assert_array_equal(dtm(tmp_path / "there")[0], dtm(tmp_path / "here")[0])
    fetched = there.summary["fetched"]
    share = here.summary["counts"]["read"] / inspect(copc).points
    assert fetched["points"] < 1.3 * share * copc.stat().st_size + (3 << 16)
    ours, theirs = (
        laspy.read(tmp_path / name / "classified/city.laz") for name in ("there", "here")
    )
    x0, y0, x1, y1 = WINDOW["bounds"]  # type: ignore[misc]
    x, y = np.asarray(theirs.x), np.asarray(theirs.y)
    inside = (x >= x0) & (x < x1) & (y >= y0) & (y < y1)  # type: ignore[has-type]
    np.testing.assert_array_equal(ours.points.array, theirs.points.array[inside])
    assert ours.header.point_count == len(ours) == sum(ours.header.number_of_points_by_return)
    np.testing.assert_allclose(ours.header.mins, ours.xyz.min(axis=0), atol=1e-6)


@pytest.mark.parametrize("where", ["count", "key", "offset", "page"])
def test_a_damaged_octree_is_one_line(where: str, copc: Path, tmp_path: Path) -> None:
    content = bytearray(copc.read_bytes())
    start = struct.unpack_from("<Q", content, 235)[0] + 60  # of the first entry
    if where == "page":
        struct.pack_into("<Q", content, 375 + 54 + 48, len(content) * 2)
    else:
        place, form, value = {
            "count": (28, "<i", 7),
            "key": (0, "<i", 99),
            "offset": (16, "<Q", 5),
        }[where]
        struct.pack_into(form, content, start + place, value)
    bad = tmp_path / "bad.copc.laz"
    bad.write_bytes(content)
    with pytest.raises(
        InputError, match=r"bad\.copc\.laz: its octree .*; get the file again"
    ) as refused:
        do(bad, tmp_path / "out", **WINDOW)
    assert "\n" not in str(refused.value)
    # Without a window it is a LAZ file.
    assert do(bad, tmp_path / "all", method="keep", until="ingest").exit_code == 0


def test_fetched_bytes_are_in_run_json(copc: Path, tmp_path: Path) -> None:
    do(copc, tmp_path / "out", **WINDOW, until="ingest")
    # of files on a disk
    assert "fetched" not in json.loads((tmp_path / "out/run.json").read_text())


def test_windows_cut_by_the_octree_hold_all_their_points(copc: Path, tmp_path: Path) -> None:
    box = (500050.0, 5400050.0, 500080.0, 5400090.0)
    octree = inspect(copc).octree
    counts = [
        cut_windows(copc, [box], [str(tmp_path / name)], octree=tree)
        for name, tree in (("all.las", None), ("near.las", octree))
    ]
    assert counts[0] == counts[1] != [0]
    assert (tmp_path / "all.las").read_bytes() == (tmp_path / "near.las").read_bytes()
    places = sample_places(copc, 20, octree=octree)
    assert np.ptp(np.array(places), axis=0).min() > 150  # of 200 m
