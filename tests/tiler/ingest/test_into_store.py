"""Both steps of ingest and the exporter, through a real store."""

from __future__ import annotations

import itertools
from collections import defaultdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from tiler.core.lattice import Cell, CoordFrame, Lattice
from tiler.core.points import SOURCE_SHIFT
from tiler.export.classified import write_classified
from tiler.export.output_files import CloudCopy
from tiler.ingest.assemble import BucketParts, assemble_buckets
from tiler.ingest.spool import SpoolPiece, spool_piece
from tiler.inputs import find_inputs, inspect, pieces
from tiler.store import BucketInfo, StoreMeta, TileStore, create_store

FRAME = CoordFrame(origin=(500_000_000, 5_400_000_000))


def ingest(
    url: str, paths: list[Path], size: int = 400, wanted: Any = None
) -> tuple[TileStore, list[dict[str, Any]], list[dict[str, Any]]]:
    store = create_store(
        url, StoreMeta(FRAME, Lattice(Fraction(500_000)), Lattice(Fraction(5000)), True)
    )
    spooled = []
    fragments: dict[tuple[int, int], list[Any]] = defaultdict(list)
    for source, path in enumerate(paths):
        for number, (start, count) in enumerate(pieces(inspect(path), size)):
            piece = f"s{source:06d}p{number:06d}"
            work = SpoolPiece(str(path), source, piece, start, count, wanted)
            record = spool_piece(store, work=work)
            spooled.append(record)
            stops = list(itertools.accumulate(n for _, _, n in record.buckets))
            for (ix, iy, n), stop in zip(record.buckets, stops, strict=True):
                fragments[ix, iy].append((piece, stop - n, stop))
    store.allocate({Cell(*c): sum(b - a for _, a, b in f) for c, f in fragments.items()})
    parts = tuple(BucketParts(Cell(*c), tuple(f)) for c, f in sorted(fragments.items()))
    made = assemble_buckets(store, buckets=parts).buckets
    store.publish_index({Cell(*r.cell): BucketInfo(r.n, r.n_candidates) for r in made})
    return store, spooled, made


def content(store: TileStore) -> list[Any]:
    """All columns except the source of a point."""
    columns = ("xyz", "classification", "flags", "returns")
    found = []
    for cell, info in store.buckets().items():
        block = store.read_bucket(cell, columns=columns)
        rows = np.vstack([block.xyz, block.classification, block.flags, block.returns])
        points, candidates = (
            sorted(map(tuple, rows.T.tolist())),
            rows[:3, : info.n_candidates].tolist(),
        )
        found.append((cell, info, points, candidates))
    return found


@pytest.mark.parametrize("twin", ["b.laz", "a.laz"])
def test_a_las_beside_its_laz_is_found_to_be_double(
    make_cloud: Any, tmp_path: Path, twin: str
) -> None:
    one, other = make_cloud("a.las"), make_cloud(twin)
    store, spooled, made = ingest(
        str(tmp_path / "store.zarr"), find_inputs([str(one), str(other)])
    )
    _, _, alone = ingest(str(tmp_path / "alone.zarr"), [one])
    assert sum(r.stored for r in spooled) == sum(r.n for r in made) == 2000
    assert sum(r.duplicates["between"] for r in made) == 1000
    assert [r.n_candidates for r in made] == [r.n_candidates for r in alone]
    assert len(content(store)) == len(made)


def test_order_and_split_of_the_files_change_nothing(make_cloud: Any, tmp_path: Path) -> None:
    whole = make_cloud("whole.las", n=900)
    cloud = laspy.read(whole)
    parts = []
    for k, rows in enumerate((slice(600, 900), slice(0, 250), slice(250, 600))):
        part = laspy.LasData(cloud.header, cloud.points[rows].copy())
        part.write(tmp_path / f"part{k}.laz")
        parts.append(tmp_path / f"part{k}.laz")
    expected = content(ingest(str(tmp_path / "one.zarr"), [whole], size=10**6)[0])
    for k, order in enumerate((parts, parts[::-1])):
        assert content(ingest(str(tmp_path / f"{k}.zarr"), order, size=100)[0]) == expected


def test_labels_go_back_to_the_rows_of_their_source(make_cloud: Any, tmp_path: Path) -> None:
    url = str(tmp_path / "store.zarr")
    paths = [
        make_cloud("a.las", seed=1),
        make_cloud("b.laz", seed=2, point_format=7, version="1.4"),
    ]
    wanted = [[iy, 997, 1003] for iy in range(10_798, 10_802)]
    store, spooled, _ = ingest(url, paths, wanted=wanted)
    stored = [set(), set()]
    for cell in store.buckets():
        origin = store.read_bucket(cell, columns=("origin",)).origin
        assert origin is not None
        rows = origin & ((1 << SOURCE_SHIFT) - 1)
        store.write_labels("final", cell, (1 + rows % 2).astype(np.uint8) | 0x80)
        for source in (0, 1):
            stored[source] |= set(rows[origin >> SOURCE_SHIFT == source].tolist())
    assert (
        0
        < sum(r.dropped.get("outside the area", 0) for r in spooled)
        == 2000 - sum(map(len, stored))
    )
    cells = tuple(store.buckets())
    for source, path in enumerate(paths):
        out = tmp_path / "out" / f"{source}.laz"
        cloud = CloudCopy(
            path=str(path),
            source=source,
            out=str(out),
            labels="final",
            cells=cells,
            reclass="all",
        )
        write_classified(store, cloud=cloud)
        before, after = laspy.read(path), laspy.read(out)
        expected = np.asarray(before.classification).copy()
        rows = np.array(sorted(stored[source]))
        expected[rows] = 1 + rows % 2
        np.testing.assert_array_equal(after.classification, expected)
        np.testing.assert_array_equal(after.X, before.X)


def test_odd_clouds_through_the_store(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "odd" / "simple.copc.laz"
    if not path.exists():
        pytest.skip(f"no {path}")
    frame = CoordFrame(origin=(637_000_000, 851_000_000))
    meta = StoreMeta(frame, Lattice(Fraction(10**6)), Lattice(Fraction(1000)), True)
    store = create_store(str(tmp_path / "s.zarr"), meta)
    record = spool_piece(store, work=SpoolPiece(str(path), 0, "p", 0, 1065))
    assert record.stored == 1065
    assert len(store.read_fragment("p", 0, 1065)) == 1065
