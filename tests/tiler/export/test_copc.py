"""Classified clouds as COPC, read back by laspy."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from pyproj import CRS

from tests.tiler.export.test_classified import ALL_FORMATS, decoded, export, label
from tiler.io.las import octree, writers
from tiler.io.las.headers import read_header

NEWER = {0: 6, 1: 6, 2: 7, 3: 7, 4: 6, 5: 7, 6: 6, 7: 7, 8: 8, 9: 6, 10: 8}
SAME = ("intensity", "return_number", "number_of_returns", "scan_direction_flag", "edge_of_flight_line",
        "classification", "synthetic", "key_point", "withheld", "user_data", "point_source_id")  # fmt: skip
COLOURS = ("red", "green", "blue", "nir", "gps_time", "echo_width", "scanner_channel")


def by_place(cloud: laspy.LasData) -> laspy.LasData:
    """The points in an order that does not depend on that of the file."""
    cloud.points = cloud.points[np.lexsort((cloud.intensity, cloud.Z, cloud.Y, cloud.X))]
    return cloud


@pytest.mark.parametrize(("point_format", "version"), ALL_FORMATS)
def test_all_but_what_formats_6_to_8_cannot_hold_is_that_of_the_laz(
    make_cloud: Any, memory_store: Any, tmp_path: Path, point_format: int, version: str
) -> None:
    path = make_cloud("a.las", point_format=point_format, version=version, extra=True)
    cells = label(memory_store, {row: 1 + row % 2 for row in range(100, 900)})
    export(memory_store, path, tmp_path / "a.laz", cells)
    record = export(memory_store, path, tmp_path / "a.copc.laz", cells, copc=True)
    old, new = (by_place(laspy.read(tmp_path / f"a.{kind}")) for kind in ("laz", "copc.laz"))
    assert new.point_format.id == NEWER[point_format]
    for axis in "XYZ":
        np.testing.assert_array_equal(old[axis], new[axis])
    for name in (*SAME, *(n for n in COLOURS if n in old.point_format.dimension_names)):
        np.testing.assert_array_equal(old[name], new[name], err_msg=name)
    if point_format < 6:
        np.testing.assert_array_equal(np.rint(new.scan_angle * 0.006), old.scan_angle_rank)
        np.testing.assert_array_equal(
            new.overlap, by_place(laspy.read(path)).classification == 12
        )
    else:
        np.testing.assert_array_equal(new.scan_angle, old.scan_angle)
        np.testing.assert_array_equal(new.overlap, old.overlap)
    for name in ("mins", "maxs", "scales", "offsets"):
        np.testing.assert_array_equal(getattr(new.header, name), getattr(old.header, name))
    numbers = np.bincount(np.asarray(new.return_number), minlength=16)[1:]
    np.testing.assert_array_equal(new.header.number_of_points_by_return, numbers)
    mine = next(v for v in new.header.vlrs if v.user_id == "mine")
    assert (mine.record_id, mine.description) == (7, "a record of the user's")
    assert new.header.parse_crs() == old.header.parse_crs()
    assert new.header.creation_date == old.header.creation_date
    assert new.header.system_identifier == "a scanner"
    told = " ".join(record.notes)
    assert ("as format" in told) == (point_format != NEWER[point_format])
    assert ("waveforms left out" in told) == (point_format in (4, 5, 9, 10))
    assert ("GPS time" in told) == (point_format in (0, 2))


@pytest.fixture
def small_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writers, "BRICK_POINTS", 3000)
    monkeypatch.setattr(octree, "LEAF_POINTS", 300)
    monkeypatch.setattr(octree, "MIN_POINTS", 10)
    monkeypatch.setattr(octree, "CELLS_OF_NODE", 4)
    monkeypatch.setattr(writers, "CELLS_OF_NODE", 4)


def uneven(cloud: laspy.LasData) -> None:
    """Most points in a corner, a thousand at one place, and one far above."""
    count, rng = len(cloud.points), np.random.default_rng(1)
    for axis in "XY":
        cloud[axis] = np.sort(rng.exponential(20_000, count)).astype(np.int32)[
            rng.permutation(count)
        ]
    cloud.X[:1000], cloud.Y[:1000], cloud.Z[:1000] = 7000, 8000, 90
    cloud.Z[-1] = 5_000_000
    cloud.gps_time[:] = rng.permutation(count)


@pytest.mark.usefixtures("small_nodes")
def test_the_octree_is_true(make_cloud: Any, memory_store: Any, tmp_path: Path) -> None:
    path = make_cloud("a.laz", n=12_000, point_format=7, version="1.4", edit=uneven)
    out, again = tmp_path / "a.copc.laz", tmp_path / "b.copc.laz"
    export(memory_store, path, out, (), copc=True)
    export(memory_store, path, again, (), copc=True)
    assert out.read_bytes() == again.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.copc.laz", "a.laz", "b.copc.laz"]
    header = read_header(out)
    tree, points = octree.read_octree(header), laspy.read(out)
    sizes = np.ptp(points.xyz, axis=0)
    with laspy.CopcReader.open(str(out)) as reader:
        info, hierarchy = reader.copc_info, reader.root_page.entries
        np.testing.assert_allclose(2 * info.halfsize, sizes.max() + 0.01)
        np.testing.assert_allclose(info.spacing, 2 * info.halfsize / 16)
        assert (info.gps_min, info.gps_max) == (0.0, 11_999.0)
        by_level = [
            reader.query(level=level) for level in range(max(k[0] for k in tree.keys) + 1)
        ]
        box = laspy.copc.Bounds(
            mins=points.header.mins[:2] + 50, maxs=points.header.mins[:2] + 100
        )
        found = np.sort(reader.query(bounds=box).gps_time)
    inside = ((points.xyz[:, :2] >= box.mins) & (points.xyz[:, :2] <= box.maxs)).all(axis=1)
    assert len(found) > 100
    np.testing.assert_array_equal(found, np.sort(points.gps_time[inside]))
    np.testing.assert_array_equal(
        np.sort(np.concatenate([p.gps_time for p in by_level])), np.arange(12_000)
    )
    assert sum(entry.point_count for entry in hierarchy.values()) == 12_000
    keys = {(k.level, k.x, k.y, k.z): entry.point_count for k, entry in hierarchy.items()}
    assert len(keys) == len(tree.keys) > 50
    low, done = np.asarray(info.center) - info.halfsize, 0
    for (level, *corner), count in zip(
        ((k.level, k.x, k.y, k.z) for k in sorted(hierarchy, key=lambda k: hierarchy[k].offset)),
        header.laz.counts.tolist(), strict=True,
    ):  # fmt: skip
        assert level == 0 or (level - 1, *(c // 2 for c in corner)) in keys
        place = (points.xyz[done : done + count] - low) / (2 * info.halfsize) * 2**level
        np.testing.assert_array_equal(
            np.clip(np.floor(place + 1e-9), corner, None)[:, :3], np.tile(corner, (count, 1))
        )
        assert (np.diff(points.gps_time[done : done + count]) > 0).all()
        children = any(
            (level + 1, *(2 * c + (n >> b & 1) for b, c in enumerate(corner))) in keys
            for n in range(8)
        )
        cells = len(np.unique(np.floor(place * 16), axis=0))
        most_few = count - cells < 8 * octree.MIN_POINTS  # beside those of the cells
        assert most_few or (
            not children and (count <= octree.LEAF_POINTS or level == octree.DEEPEST)
        )
        done += count


def test_an_empty_cloud_and_one_of_a_point(
    make_cloud: Any, memory_store: Any, tmp_path: Path
) -> None:
    for count in (0, 1):
        out = tmp_path / f"{count}.copc.laz"
        record = export(memory_store, make_cloud(f"{count}.las", n=count), out, (), copc=True)
        assert record.points == len(laspy.read(out)) == count
        with laspy.CopcReader.open(str(out)) as reader:
            assert len(reader.query()) == count
    np.testing.assert_array_equal(decoded(out)["X"], laspy.read(tmp_path / "1.las").X)


def test_its_crs_is_wkt_whatever_the_source_has(
    make_cloud: Any, memory_store: Any, tmp_path: Path
) -> None:
    wkt = CRS("EPSG:2992").to_wkt()
    memory_store.meta.frame = replace(memory_store.meta.frame, crs_wkt=wkt)
    keys = laspy.VLR(
        "LASF_Projection", 34735, "", struct.pack("<8H", 1, 1, 0, 1, 3072, 0, 1, 2992)
    )
    path = make_cloud("a.las", n=5, crs=None, edit=lambda cloud: cloud.header.vlrs.append(keys))
    for crs in ("geotiff", "wkt of the source"):
        record = export(memory_store, path, tmp_path / "a.copc.laz", (), copc=True)
        cloud = laspy.read(tmp_path / "a.copc.laz")
        assert cloud.header.global_encoding.wkt
        assert [v.record_id for v in cloud.header.vlrs if v.user_id == "LASF_Projection"] == [
            2112
        ]
        assert ("CRS written as WKT, which COPC requires" in record.notes) == (crs == "geotiff")
        assert cloud.header.parse_crs().to_epsg() == (2992 if crs == "geotiff" else 25832)
        path = make_cloud("a.las", n=5, point_format=6, version="1.4")


@pytest.mark.slow
def test_each_point_of_a_town_comes_back(
    shared_data: Path, memory_store: Any, tmp_path: Path
) -> None:
    path, out = tmp_path / "third.laz", tmp_path / "a.copc.laz"
    town = laspy.read(shared_data / "autzen" / "autzen_en.laz")
    town.points = town.points[np.arange(0, len(town.points), 3)]
    town.write(path)
    export(memory_store, path, out, (), copc=True)
    with laspy.CopcReader.open(str(out)) as reader:
        by_level = [reader.query(level=level) for level in range(5)]
        found = np.concatenate([points.array for points in by_level])
    expected = laspy.read(path).points.array
    found, expected = (
        np.sort(records.view(f"S{records.itemsize}")) for records in (found, expected)
    )
    assert found.tobytes() == expected.tobytes()
    read = laspy.read(out)
    assert len(read.points) == len(expected)
    root = by_level[0]
    # Of a side of four of its cells: hardly one is without a point of the root where others
    # are.
    side = 2 * reader.copc_info.halfsize / 32
    where = [
        np.unique(np.floor(np.stack([p.x, p.y]) / side), axis=1).shape[1] for p in (root, read)
    ]
    assert where[0] > 0.99 * where[1]


@pytest.mark.slow
def test_pdal_reads_all_points(make_cloud: Any, memory_store: Any, tmp_path: Path) -> None:
    pdal = pytest.importorskip("pdal")
    export(memory_store, make_cloud("a.las", n=50_000), tmp_path / "a.copc.laz", (), copc=True)
    assert pdal.Reader.copc(str(tmp_path / "a.copc.laz")).pipeline().execute() == 50_000
